"""
Trackers of many targets on one kernel, who predict together what they have to predict at a time.

A target's belief is the same to the bit as without the others.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pif_ros.core.batch import Batch, Span
from pif_ros.core.estimates import Estimate, Measurement, Rejection
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.tracker import Tracker


class Member(Tracker[Any]):
    """A tracker that takes predictions which were made elsewhere, together with others'."""

    def reset(self, belief: Any = None, stamp_ns: int | None = None,
              steered_ns: int | None = None) -> None:
        """Forget what was taken, and what was foreseen with it, and start from a belief."""
        super().reset(belief, stamp_ns, steered_ns)
        self._foreseen: tuple[Estimate[Any], int, Any] | None = None

    @property
    def next_ns(self) -> int | None:
        """Return the stamp to predict to for what waits next, None for nothing or after a gap."""
        place = len(self._posteriors)
        if not self.backlog or self._timeline.gap_ns(place):
            return None
        return self._timeline.measurements[place].stamp_ns

    def leg(self, stamp_ns: int) -> tuple[Any, Span] | None:
        """
        Return what is to be predicted next on the way from the newest belief to a stamp.

        All whole steps that were not taken before, then the rest of one, then None.
        """
        before = self.newest
        if (before.stamp_ns is None or stamp_ns <= before.stamp_ns
                or self._is_foreseen(before, stamp_ns)):
            return None
        belief, whole, last = self._started(before, stamp_ns)
        span = (whole, last) if whole < last else (last, stamp_ns)
        return (belief, span) if span[0] < span[1] else None

    def foresee(self, stamp_ns: int, belief: Any) -> None:
        """Take the belief at the end of the next leg to a stamp."""
        before = self.newest
        _, whole, last = self._started(before, stamp_ns)
        if whole < last:
            assert before.stamp_ns is not None
            self._rung = (before, (last - before.stamp_ns) // self.filter.time_step_ns, belief)
        else:
            self._foreseen = (before, stamp_ns, belief)

    def _carried(self, before: Estimate[Any], stamp_ns: int) -> Any:
        if self._foreseen is not None and self._is_foreseen(before, stamp_ns):
            return self._foreseen[2]
        return super()._carried(before, stamp_ns)

    def _is_foreseen(self, before: Estimate[Any], stamp_ns: int) -> bool:
        known = self._foreseen
        return known is not None and known[0] is before and known[1] == stamp_ns


class Bank:
    """
    The trackers of many targets, whose filters have one kernel, by name.

    Where the filters are no DiracFeynmanFilters, whose kernel is made beforehand, each predicts
    for itself.  A target's beliefs do not depend on who else is in the bank.  Raises ValueError
    for filters with kernels of their own.
    """

    def __init__(self, trackers: Mapping[str, Member]) -> None:
        self.trackers = dict(trackers)
        filters = [tracker.filter for tracker in self.trackers.values()]
        grids = [each for each in filters if isinstance(each, DiracFeynmanFilter)]
        self._batch = Batch(grids[0]) if grids else None
        if grids and not (len(grids) == len(filters)
                          and all(map(grids[0].shares_kernels, grids))):
            raise ValueError('trackers: expected filters with one kernel, got several kernels')

    def rehearse(self) -> None:
        """Predict all priors by a step, so that what is made once is made now."""
        if self._batch is not None:
            priors = [tracker.prior for tracker in self.trackers.values()]
            self._batch.predict(priors, [(0, self._batch.filter.time_step_ns)] * len(priors))

    def observe(self, target: str, measurement: Measurement) -> Rejection | None:
        """Put a measurement of a target where it belongs."""
        return self.trackers[target].observe(measurement)

    def estimates(self) -> dict[str, Estimate[Any]]:
        """Return what is believed of each target after its newest measurement."""
        while waiting := [tracker for tracker in self.trackers.values() if tracker.backlog]:
            self.foresee_corrections(waiting)
            for tracker in waiting:
                tracker.estimate(at_most=1)
        return {name: tracker.estimate() for name, tracker in self.trackers.items()}

    def forecasts(self, stamp_ns: int) -> dict[str, Estimate[Any]]:
        """Return what is believed of each target at a later moment; commits to nothing."""
        self.estimates()
        self.foresee((tracker, stamp_ns) for tracker in self.trackers.values())
        return {name: tracker.forecast(stamp_ns) for name, tracker in self.trackers.items()}

    def foresee_corrections(self, trackers: Iterable[Member]) -> None:
        """Predict to the next measurement of each tracker that has one waiting."""
        self.foresee((tracker, tracker.next_ns) for tracker in trackers
                     if tracker.next_ns is not None)

    def foresee(self, asked: Iterable[tuple[Member, int]]) -> None:
        """Predict together what trackers would have to predict by themselves to get to a stamp."""
        if self._batch is None:
            return
        wanted = list(asked)
        for _ in ('whole steps', 'the rest of one'):
            legs = [(tracker, stamp_ns, leg) for tracker, stamp_ns in wanted
                    if (leg := tracker.leg(stamp_ns)) is not None]
            if len(legs) < 2:
                # alone it is as well done when it is asked for
                return
            carried = self._batch.predict([leg[0] for *_, leg in legs],
                                          [leg[1] for *_, leg in legs])
            for (tracker, stamp_ns, _), belief in zip(legs, carried):
                tracker.foresee(stamp_ns, belief)
