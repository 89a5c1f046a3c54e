"""The controls that a tracker has taken: what holds when, and what is not needed any more."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
import math
from typing import Any

from pif_ros.core.controls import Controls, Value
from pif_ros.core.estimates import Rejection
from pif_ros.core.timeline import Timeline

#: Controls kept at most: a quarter of an hour of a hundred a second, without a measurement.
MOST_CONTROLS = 100_000


class Steering:
    """
    Controls in the order of their stamps, each of which holds from its stamp on.

    inputs: names of a control's components; hold_ns: how long one holds at most, where no other
    follows; timeline: the measurements between which they are needed.
    """

    def __init__(self, inputs: Sequence[str], hold_ns: int, timeline: Timeline[Any]) -> None:
        self._inputs, self._hold_ns, self._timeline = inputs, hold_ns, timeline
        self._taken: list[tuple[int, Value]] = []
        self._controls: Controls | None = None

    @property
    def taken(self) -> tuple[tuple[int, Value], ...]:
        """Return what was taken, as pairs of stamp and values."""
        return tuple(self._taken)

    def controls(self) -> Controls:
        """Return the same as a filter wants it."""
        if self._controls is None:
            stamps, values = zip(*self._taken) if self._taken else ((), ())
            self._controls = Controls(stamps, values, self._hold_ns)
        return self._controls

    @property
    def oldest_ns(self) -> float:
        """Return how far back the history reaches, by measurements or else by controls."""
        return self._timeline.oldest_ns(self._taken[-1][0] if self._taken else None)

    def put(self, stamp_ns: int, values: Sequence[float]) -> Rejection | None:
        """
        Put a control where it belongs, unless it is from before the earliest that may still count.

        Of different ones with equal stamps the larger tuple counts, whichever comes first.  Raises
        ValueError where the values are not one for each input.
        """
        # + 0.0: there is one zero only
        value = tuple(float(v) + 0.0 for v in values)
        if len(value) != len(self._inputs) or not value or not all(map(math.isfinite, value)):
            raise ValueError(f'values: expected {len(self._inputs)} finite numbers '
                             f'({", ".join(self._inputs) or "no inputs"}), got {list(value)}')
        if stamp_ns < self._earliest_ns():
            return Rejection.TOO_LATE
        place = bisect.bisect_left(self._taken, stamp_ns, key=_stamp)
        same = place < len(self._taken) and self._taken[place][0] == stamp_ns
        if same and value <= self._taken[place][1]:
            return Rejection.DUPLICATE
        if not same and len(self._taken) >= MOST_CONTROLS:
            return Rejection.TOO_MANY
        self._taken[place:place + same] = [(stamp_ns, value)]
        self._controls = None
        return None

    def replace(self, controls: Iterable[tuple[int, Value]]) -> None:
        """Have these instead."""
        self._taken, self._controls = list(controls), None

    def since(self, stamp_ns: float) -> list[tuple[int, Value]]:
        """Return those that may hold at a stamp, and later ones."""
        return [control for control in self._taken if control[0] >= stamp_ns - self._hold_ns]

    def forget(self) -> None:
        """Let go of what nothing is predicted with any more."""
        line, oldest_ns = self._timeline, self.oldest_ns
        start_ns = line.anchor.stamp_ns
        first_ns = line.measurements[0].stamp_ns if line.measurements else math.inf
        if start_ns is None and not line.measurements:
            # the first measurement may be on its way for longer than the history
            self._drop(len(self._taken) + 1 - MOST_CONTROLS)
        elif start_ns is None or first_ns >= oldest_ns and line.is_cut_off(oldest_ns):
            self._drop_before(min(oldest_ns, first_ns))
        else:
            # a path goes on from its last point, and not from one that was rejected since
            path_ns = getattr(line.anchor.belief, 'stamp_ns', None)
            needed_ns = start_ns if path_ns is None else min(start_ns, path_ns)
            # and a start may be followed by another that is as old as the history
            self._drop_before(min(needed_ns, oldest_ns - self._hold_ns)
                              if line.anchored is None else needed_ns)

    def _earliest_ns(self) -> float:
        """Return the stamp before which a control is too late."""
        line, oldest_ns = self._timeline, self.oldest_ns
        start_ns, taken = line.anchor.stamp_ns, line.measurements
        if line.is_cut_off(oldest_ns):
            return oldest_ns - self._hold_ns
        if line.anchored is None and not (taken and taken[0].stamp_ns < oldest_ns):
            return (oldest_ns if start_ns is None else start_ns) - self._hold_ns
        return max(oldest_ns if taken else -math.inf, -math.inf if start_ns is None else start_ns)

    def _drop_before(self, stamp_ns: float) -> None:
        """Let go of those before the last one that is no later than a stamp, and holds there."""
        self._drop(bisect.bisect_right(self._taken, stamp_ns, key=_stamp) - 1)

    def _drop(self, count: int) -> None:
        """Let go of so many of the oldest, of none where that is negative."""
        if count > 0:
            del self._taken[:count]
            self._controls = None


def _stamp(control: tuple[int, Value]) -> int:
    return control[0]
