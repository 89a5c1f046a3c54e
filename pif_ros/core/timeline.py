"""What a tracker has taken, in the order in which it counts, and what that starts from."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
import math
from typing import Generic

from pif_ros.core.estimates import Estimate, Measurement, Rejection
from pif_ros.core.filters import Belief


class Timeline(Generic[Belief]):
    """
    Measurements in their order, and the estimate before them, which is the anchor.

    anchored: the measurement that led to the anchor, None where it is a start; history_ns: how far
    back from the newest stamp a measurement is still put where it belongs; max_gap_ns: how long
    nothing may be measured before what was known is given up.
    """

    def __init__(self, history_ns: int, max_gap_ns: float, anchor: Estimate[Belief]) -> None:
        self._history_ns, self._max_gap_ns = history_ns, max_gap_ns
        self.start(anchor)

    def start(self, anchor: Estimate[Belief], anchored: Measurement | None = None,
              measurements: Iterable[Measurement] = ()) -> None:
        """Forget what was taken, and start from an estimate; these come after it."""
        self.anchor, self.anchored, self.measurements = anchor, anchored, list(measurements)

    @property
    def stamp_ns(self) -> int | None:
        """Return the newest stamp of a measurement, the anchor's where there is none."""
        return self.measurements[-1].stamp_ns if self.measurements else self.anchor.stamp_ns

    def put(self, measurement: Measurement) -> int | Rejection:
        """Put a measurement where it belongs, and return its place, or why it has none."""
        start_ns, taken = self.anchor.stamp_ns, self.measurements
        if start_ns is not None and measurement.stamp_ns < start_ns:
            return Rejection.TOO_LATE
        if self.anchored is not None and measurement <= self.anchored:
            return Rejection.TOO_LATE
        if taken and measurement.stamp_ns < taken[-1].stamp_ns - self._history_ns:
            return Rejection.TOO_LATE
        place = bisect.bisect_left(taken, measurement)
        if taken[place:place + 1] == [measurement]:
            return Rejection.DUPLICATE
        taken.insert(place, measurement)
        return place

    def since(self, stamp_ns: int) -> list[Measurement]:
        """Return the measurements from a stamp on."""
        return self.measurements[self._place(stamp_ns):]

    def beyond_history(self) -> int:
        """Return how many of some measurements are so old that nothing comes before them."""
        return self._place(self.measurements[-1].stamp_ns - self._history_ns)

    def advance(self, count: int, anchor: Estimate[Belief]) -> None:
        """Let go of so many measurements, one or more, for the estimate that they led to."""
        self.anchor, self.anchored = anchor, self.measurements[count - 1]
        del self.measurements[:count]

    def gap_ns(self, place: int) -> int:
        """Return the length of a gap before a place that ends what was known, 0 for none."""
        before_ns = self.measurements[place - 1].stamp_ns if place else self.anchor.stamp_ns
        gap_ns = 0 if before_ns is None else self.measurements[place].stamp_ns - before_ns
        return gap_ns if gap_ns > self._max_gap_ns else 0

    def oldest_ns(self, newest_ns: int | None) -> float:
        """
        Return how far back the history reaches, as far as it is kept.

        newest_ns: the newest stamp of anything else, which counts where nothing was measured.
        """
        if self.measurements:
            newest_ns = self.measurements[-1].stamp_ns
        oldest_ns = -math.inf if newest_ns is None else newest_ns - self._history_ns
        start_ns = None if self.anchored is None else self.anchor.stamp_ns
        return oldest_ns if start_ns is None else max(oldest_ns, start_ns)

    def is_cut_off(self, oldest_ns: float) -> bool:
        """Return whether a gap reaches into the history, so that nothing late can bridge it."""
        if not self.measurements:
            return False
        place = self._place(oldest_ns)
        last_ns = self.measurements[place - 1].stamp_ns if place else self.anchor.stamp_ns
        return last_ns is not None and oldest_ns - last_ns > self._max_gap_ns

    def _place(self, stamp_ns: float) -> int:
        """Return how many measurements are older than a stamp."""
        return bisect.bisect_left(self.measurements, stamp_ns, key=lambda m: m.stamp_ns)
