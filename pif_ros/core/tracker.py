"""
Time: which measurement comes when, and what is believed at any moment.

The posterior is a function of the ordered measurements alone.  Whatever the order of arrival
within the history, and however often a forecast is asked for, the same measurements give the same
bits.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass
from enum import Enum
import math
from typing import Generic

from pif_ros.core.filters import Belief, Filter, NANOSECONDS


@dataclass(frozen=True, order=True)
class Measurement:
    """What a source measured at a stamp; equal stamps are ordered by source and values."""

    stamp_ns: int
    source: str
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Estimate(Generic[Belief]):
    """
    What is believed at a stamp.

    log_evidence: log p(y | all before it) of the measurement that led here, 0 where none did;
    total_log_evidence: its sum since the last reset.  A stamp of None is that of a prior which
    waits for the first measurement.
    """

    stamp_ns: int | None
    belief: Belief
    log_evidence: float = 0.0
    total_log_evidence: float = 0.0


@dataclass(frozen=True)
class Correction:
    """
    A correction that was made: by what, and what the belief before it said of it.

    log_peak: what the log evidence would have been, had the measurement been just as expected by
    a belief that is sure of itself.
    """

    measurement: Measurement
    log_evidence: float
    log_peak: float


class Rejection(Enum):
    """Why a measurement cannot be put where it belongs."""

    TOO_LATE = 'too late'
    DUPLICATE = 'duplicate'


class CorrectionFailed(RuntimeError):
    """A measurement that could not be used, since something raised; the cause says what."""

    def __init__(self, measurement: Measurement) -> None:
        super().__init__(f'no correction by {measurement}')
        self.measurement = measurement


class Tracker(Generic[Belief]):
    """
    A filter's memory: measurements of the last seconds, and the belief after each.

    history: seconds back from the newest stamp within which a late measurement is still put where
    it belongs, and everything after it replayed; depth: beliefs kept at most, whatever the
    history.  A prior without a stamp holds at the first measurement's.
    """

    def __init__(self, filter_: Filter[Belief], prior: Belief, history: float = 1.0,
                 depth: int = 1000) -> None:
        if not 0 <= history < math.inf:
            raise ValueError(f'history: expected seconds, 0 or more, got {history}')
        if depth < 1:
            raise ValueError(f'depth: expected at least 1 belief, got {depth}')
        self.filter = filter_
        self.prior = prior
        self._history_ns = round(history * NANOSECONDS)
        self._depth = depth
        self.reset()

    def reset(self, belief: Belief | None = None, stamp_ns: int | None = None) -> None:
        """Forget all measurements, and start from a belief (the prior where none is given)."""
        self._anchor = Estimate(stamp_ns, self.prior if belief is None else belief)
        self._anchored: Measurement | None = None
        self._timeline: list[Measurement] = []
        self._posteriors: list[Estimate[Belief]] = []
        self.corrections: list[Correction] = []
        self._rung: tuple[Estimate[Belief], int, Belief] | None = None

    @property
    def stamp_ns(self) -> int | None:
        """Return the newest stamp that is known, None before there is one."""
        return self._timeline[-1].stamp_ns if self._timeline else self._anchor.stamp_ns

    @property
    def backlog(self) -> int:
        """Return how many corrections the next estimate has to make."""
        return len(self._timeline) - len(self._posteriors)

    def observe(self, measurement: Measurement) -> Rejection | None:
        """Put a measurement where it belongs; the work is done when an estimate is asked for."""
        stamp = measurement.stamp_ns
        if self._anchor.stamp_ns is not None and stamp < self._anchor.stamp_ns:
            return Rejection.TOO_LATE
        if self._anchored is not None and measurement <= self._anchored:
            return Rejection.TOO_LATE
        if self._timeline and stamp < self._timeline[-1].stamp_ns - self._history_ns:
            return Rejection.TOO_LATE
        place = bisect.bisect_left(self._timeline, measurement)
        if self._timeline[place:place + 1] == [measurement]:
            return Rejection.DUPLICATE
        self._timeline.insert(place, measurement)
        del self._posteriors[place:]
        return None

    def estimate(self, at_most: int | None = None) -> Estimate[Belief]:
        """
        Return the belief after the newest measurement; the prior where there is none.

        With at_most, so many corrections are made and the rest stays as backlog.  What was
        corrected now is left in corrections.  Raises CorrectionFailed for
        a measurement at which the model or the sensor raised; it is not remembered.
        """
        done = len(self._posteriors)
        self.corrections = []
        for measurement in self._timeline[done:None if at_most is None else done + at_most]:
            before = self._newest()
            try:
                predicted = self._carried(before, measurement.stamp_ns)
                belief, log_evidence = self.filter.correct(
                    predicted, measurement.values, measurement.source, measurement.stamp_ns)
                log_peak = self.filter.log_peak(
                    predicted, measurement.source, measurement.stamp_ns)
            except Exception as error:  # noqa: B902  models and sensors are others' code
                del self._timeline[len(self._posteriors)]
                raise CorrectionFailed(measurement) from error
            # what no state allows is not believed, and says nothing of what is
            weight = log_evidence if log_evidence > -math.inf else 0.0
            self._posteriors.append(Estimate(measurement.stamp_ns, belief, log_evidence,
                                             before.total_log_evidence + weight))
            self.corrections.append(Correction(measurement, log_evidence, log_peak))
        newest = self._newest()
        self._forget()
        return newest

    def forecast(self, stamp_ns: int) -> Estimate[Belief]:
        """Return what is believed of a later moment; commits to nothing."""
        newest = self.estimate()
        if newest.stamp_ns is None or stamp_ns <= newest.stamp_ns:
            return newest
        return Estimate(stamp_ns, self._carried(newest, stamp_ns), 0.0,
                        newest.total_log_evidence)

    def _newest(self) -> Estimate[Belief]:
        return self._posteriors[-1] if self._posteriors else self._anchor

    def _carried(self, before: Estimate[Belief], stamp_ns: int) -> Belief:
        """
        Return a belief predicted to a stamp.

        Whole steps taken for an earlier forecast from the same belief are not taken again.
        """
        if before.stamp_ns is None or before.stamp_ns == stamp_ns:
            return before.belief
        step = self.filter.time_step_ns
        steps = (stamp_ns - before.stamp_ns) // step
        known, belief = 0, before.belief
        if self._rung is not None and self._rung[0] is before and self._rung[1] <= steps:
            _, known, belief = self._rung
        whole, last = before.stamp_ns + known * step, before.stamp_ns + steps * step
        belief = self.filter.predict(belief, whole, last)
        self._rung = (before, steps, belief)
        return self.filter.predict(belief, last, stamp_ns)

    def _forget(self) -> None:
        """Let go of what lies beyond the history; the last belief before it stays as anchor."""
        if not self._timeline:
            return
        oldest = self._timeline[-1].stamp_ns - self._history_ns
        count = bisect.bisect_left(self._timeline, oldest, key=lambda m: m.stamp_ns)
        count = min(max(count, len(self._timeline) - self._depth), len(self._posteriors))
        if count > 0:
            self._anchor, self._anchored = self._posteriors[count - 1], self._timeline[count - 1]
            del self._timeline[:count], self._posteriors[:count]
