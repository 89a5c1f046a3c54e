"""
Time: which measurement comes when, and what is believed at any moment.

The posterior is a function of the ordered measurements and controls alone.  Whatever the order of
arrival within the history, and however often a forecast is asked for, the same ones give the same
bits.
"""

from __future__ import annotations

import bisect
from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Generic

from pif_ros.core.estimates import (Correction, CorrectionFailed, Estimate, Measurement, Memory,
                                    Rejection)
from pif_ros.core.filters import Belief, Filter, NANOSECONDS
from pif_ros.core.guard import Guard
from pif_ros.core.steering import Steering
from pif_ros.core.timeline import Timeline


class Tracker(Generic[Belief]):
    """
    A filter's memory: measurements and controls of the last seconds, and the belief after each.

    history: seconds back from the newest stamp within which a late measurement is still put where
    it belongs, and everything after it replayed; memory: bytes that the beliefs kept for that may
    take, whatever the history, the newest apart; hold: seconds for which a control holds at most,
    where no other follows; guard: what corrects, and may reject; max_gap: seconds without a
    measurement after which, at the next, the prior holds again.  A prior without a stamp holds at
    the first measurement's.
    """

    def __init__(self, filter_: Filter[Belief], prior: Belief, history: float = 1.0,
                 memory: float = 256e6, hold: float = 1.0, guard: Guard = Guard(),
                 max_gap: float = math.inf) -> None:
        if not 0 <= history < math.inf:
            raise ValueError(f'history: expected seconds, 0 or more, got {history}')
        if not memory >= 0:
            raise ValueError(f'memory: expected bytes, 0 or more, got {memory}')
        if not 0 <= hold < math.inf:
            raise ValueError(f'hold: expected seconds, 0 or more, got {hold}')
        if not max_gap >= 0:
            raise ValueError(f'max_gap: expected seconds, 0 or more, got {max_gap}')
        self.filter = filter_
        self.prior = prior
        self.guard = guard
        self._memory = memory
        self._timeline = Timeline(
            round(history * NANOSECONDS),
            round(max_gap * NANOSECONDS) if max_gap < math.inf else math.inf,
            Estimate(None, prior))
        self._steering = Steering(
            filter_.model.inputs, round(hold * NANOSECONDS), self._timeline)
        self.reset()

    def reset(self, belief: Belief | None = None, stamp_ns: int | None = None,
              steered_ns: int | None = None) -> None:
        """
        Forget what was taken, and start from a belief (the prior where none is given).

        steered_ns: a stamp within the history; the controls that may hold in that are kept, and so
        are the measurements from the belief's stamp on.  What held before the history is not known
        any more.
        """
        kept: list[Measurement] = []
        if steered_ns is None or steered_ns < self._steering.oldest_ns:
            self._steering.replace(())
        else:
            self._steering.replace(self._steering.since(self._steering.oldest_ns))
            kept = [] if stamp_ns is None else self._timeline.since(stamp_ns)
        self._timeline.start(
            Estimate(stamp_ns, self.prior if belief is None else belief), measurements=kept)
        self._posteriors: list[Estimate[Belief]] = []
        self.corrections: list[Correction] = []
        # what was predicted where the newest corrections were made, whose watch is to come
        self._unwatched: list[tuple[Belief, Measurement]] = []
        self._failed: Exception | None = None
        self._largest = 0
        self._rung: tuple[Estimate[Belief], int, Belief] | None = None

    def set_clock(self, by_ns: int, belief: Belief) -> None:
        """
        Go on from the newest belief, as it is by a clock that is so much ahead.

        What drives it, and what is known of how the measurements fitted, goes along; what came
        before has an older clock's stamps and is forgotten.
        """
        try:
            self.look()
        finally:
            newest, steered = self.newest, self._steering.taken
            self.reset(belief)
            if newest.stamp_ns is not None:
                self._timeline.start(
                    replace(newest, stamp_ns=newest.stamp_ns + by_ns, belief=belief))
            self._steering.replace((stamp_ns + by_ns, value) for stamp_ns, value in steered)

    def memory(self) -> Memory[Belief]:
        """
        Return what decides the future, at the cost of a list: no belief is copied.

        Where a sensor raises in the watch, that is left to the next look().
        """
        self._watch()
        line = self._timeline
        return Memory(line.anchor, line.anchored, tuple(line.measurements), self._steering.taken)

    def recall(self, memory: Memory[Belief]) -> None:
        """
        Go on from what a tracker of the same filter remembered, to the bit as that would have.

        The corrections after the anchor are a backlog, which the next estimate makes anew.
        """
        self.reset()
        self._timeline.start(memory.anchor, memory.anchored, memory.measurements)
        self._steering.replace(memory.controls)

    @property
    def stamp_ns(self) -> int | None:
        """Return the newest stamp of a measurement, None before there is one."""
        return self._timeline.stamp_ns

    @property
    def kept(self) -> int:
        """Return how many beliefs are kept for what comes late."""
        return len(self._posteriors)

    @property
    def nbytes(self) -> int:
        """Return the memory that the beliefs take, in bytes."""
        return sum(each.belief.nbytes for each in (self._timeline.anchor, *self._posteriors))

    @property
    def newest(self) -> Estimate[Belief]:
        """Return what was believed after the newest of the corrections that were made."""
        return self._posteriors[-1] if self._posteriors else self._timeline.anchor

    @property
    def backlog(self) -> int:
        """Return how many corrections the next estimate has to make."""
        return len(self._timeline.measurements) - len(self._posteriors)

    def observe(self, measurement: Measurement) -> Rejection | None:
        """Put a measurement where it belongs; the work is done when an estimate is asked for."""
        place = self._timeline.put(measurement)
        if isinstance(place, Rejection):
            return place
        self._undo(place)
        return None

    def control(self, stamp_ns: int, values: Sequence[float]) -> Rejection | None:
        """
        Put a control where it belongs: it holds from its stamp on, and what it moves is replayed.

        Of different ones with equal stamps the larger tuple counts, whichever comes first.  One
        from before the belief that all else starts from is too late, unless nothing was measured
        before that, and it may still hold then.  Raises ValueError where the values are not one
        for each input of the model.
        """
        rejection = self._steering.put(stamp_ns, values)
        if rejection is not None:
            return rejection
        # a posterior at the stamp itself was not moved by what holds from there on
        self._undo(bisect.bisect_right(
            self._posteriors, stamp_ns, key=lambda e: e.stamp_ns or 0))
        self._cut_rung(stamp_ns)
        self._steering.forget()
        return None

    def estimate(self, at_most: int | None = None, look: bool = True) -> Estimate[Belief]:
        """
        Return the belief after the newest measurement; the prior where there is none.

        With at_most, so many corrections are made and the rest stays as backlog; without look, the
        watch that moves no belief is left to look().  What was corrected now is left in
        corrections.  Raises CorrectionFailed for a measurement at which the model or the sensor
        raised; it is not remembered.
        """
        done, taken = len(self._posteriors), self._timeline.measurements
        self.corrections = []
        for measurement in taken[done:None if at_most is None else done + at_most]:
            later = not look and self.guard.only_watches(measurement.source)
            if not later:
                self.look()
            place = len(self._posteriors)
            before = self._before(place)
            try:
                predicted = self._carried(before, measurement.stamp_ns)
                made = self.guard.correct(
                    self.filter, predicted, measurement.values, measurement.source,
                    measurement.stamp_ns, None if later else before.watch)
                log_peak = self.filter.log_peak(
                    predicted, measurement.source, measurement.stamp_ns)
            except Exception as error:  # noqa: B902  models and sensors are others' code
                del taken[place]
                raise CorrectionFailed(measurement) from error
            # what no state allows, or is gated, is not believed, and says nothing of what is
            used = made.log_evidence > -math.inf and not made.gated
            self._largest = max(self._largest, made.belief.nbytes)
            if later:
                self._unwatched.append((predicted, measurement))
            self._posteriors.append(Estimate(
                measurement.stamp_ns, made.belief, made.log_evidence,
                before.total_log_evidence + (made.log_evidence if used else 0.0),
                before.watch if later else made.watch))
            self.corrections.append(Correction(measurement, made.log_evidence, log_peak, made.tail,
                                               made.gated, made.recovered,
                                               self._timeline.gap_ns(place)))
        newest = self.newest
        self._forget()
        return newest

    def look(self) -> None:
        """
        Bring the watch up to the newest correction: what that costs delays no estimate.

        Where a sensor raises, the watch before it goes on, and it is raised again in the end.
        """
        self._watch()
        failed, self._failed = self._failed, None
        if failed is not None:
            raise failed

    def _watch(self) -> None:
        """Bring the watch up to the newest correction, and remember the first that raised."""
        while self._unwatched:
            place = len(self._posteriors) - len(self._unwatched)
            predicted, measurement = self._unwatched.pop(0)
            watch = self._before(place).watch
            try:
                watch = self.guard.watched(self.filter, predicted, measurement.values,
                                           measurement.source, measurement.stamp_ns, watch)
            except Exception as error:  # noqa: B902  models and sensors are others' code
                self._failed = self._failed or error
            self._posteriors[place] = replace(self._posteriors[place], watch=watch)

    def forecast(self, stamp_ns: int) -> Estimate[Belief]:
        """Return what is believed of a later moment; commits to nothing."""
        newest = self.estimate()
        if newest.stamp_ns is None or stamp_ns <= newest.stamp_ns:
            return newest
        return Estimate(stamp_ns, self._carried(newest, stamp_ns), 0.0,
                        newest.total_log_evidence, newest.watch)

    def _before(self, place: int) -> Estimate[Belief]:
        """Return what a place in the timeline goes on from: after a gap that is the prior."""
        if self._timeline.gap_ns(place):
            return Estimate(None, self.prior)
        return self._posteriors[place - 1] if place else self._timeline.anchor

    def _carried(self, before: Estimate[Belief], stamp_ns: int) -> Belief:
        """
        Return a belief predicted to a stamp.

        Whole steps taken for an earlier forecast from the same belief are not taken again.
        """
        if before.stamp_ns is None or before.stamp_ns == stamp_ns:
            return before.belief
        belief, whole, last = self._started(before, stamp_ns)
        controls = self._steering.controls()
        belief = self.filter.predict(belief, whole, last, controls)
        self._rung = (before, (last - before.stamp_ns) // self.filter.time_step_ns, belief)
        return self.filter.predict(belief, last, stamp_ns, controls)

    def _started(self, before: Estimate[Belief], stamp_ns: int) -> tuple[Belief, int, int]:
        """Return a belief as far on its way as is known, its stamp, and that of the last step."""
        assert before.stamp_ns is not None
        step = self.filter.time_step_ns
        steps = (stamp_ns - before.stamp_ns) // step
        known, belief = 0, before.belief
        if self._rung is not None and self._rung[0] is before and self._rung[1] <= steps:
            _, known, belief = self._rung
        return belief, before.stamp_ns + known * step, before.stamp_ns + steps * step

    def _undo(self, place: int) -> None:
        """Forget the corrections from a place in the timeline on, which are to be made anew."""
        done = len(self._posteriors) - len(self._unwatched)
        del self._posteriors[place:]
        del self._unwatched[max(place - done, 0):]

    def _cut_rung(self, stamp_ns: int) -> None:
        """Forget the steps of an earlier forecast where they go beyond a stamp."""
        if self._rung is not None:
            before, steps, _ = self._rung
            if (before.stamp_ns or 0) + steps * self.filter.time_step_ns > stamp_ns:
                self._rung = None

    def _forget(self) -> None:
        """Let go of what lies beyond the history; the last belief before it stays as anchor."""
        if not self._timeline.measurements:
            return
        count = max(self._timeline.beyond_history(), self._beyond_memory())
        count = min(count, len(self._posteriors))
        if count > len(self._posteriors) - len(self._unwatched):
            self.look()
        if count > 0:
            self._timeline.advance(count, self._posteriors[count - 1])
            del self._posteriors[:count]
        self._steering.forget()

    def _beyond_memory(self) -> int:
        """Return how many of the oldest posteriors there is no memory for."""
        left, count = self._memory, len(self._posteriors)
        if count * self._largest <= left:
            return 0
        for newer, estimate in enumerate(reversed(self._posteriors)):
            left -= estimate.belief.nbytes
            if newer and left < 0:
                return count - newer
        return 0
