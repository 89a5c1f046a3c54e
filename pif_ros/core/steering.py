"""The controls that a tracker has taken: what holds when, and what is not needed any more."""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
import math

from pif_ros.core.controls import Controls, Value
from pif_ros.core.estimates import Rejection

#: Controls kept at most: a quarter of an hour of a hundred a second, without a measurement.
MOST_CONTROLS = 100_000


class Steering:
    """
    Controls in the order of their stamps, each of which holds from its stamp on.

    inputs: names of a control's components; hold_ns: how long one holds at most, where no other
    follows.
    """

    def __init__(self, inputs: Sequence[str], hold_ns: int) -> None:
        self._inputs, self._hold_ns = inputs, hold_ns
        self._taken: list[tuple[int, Value]] = []
        self._controls: Controls | None = None

    @property
    def taken(self) -> tuple[tuple[int, Value], ...]:
        """Return what was taken, as pairs of stamp and values."""
        return tuple(self._taken)

    @property
    def newest_ns(self) -> int | None:
        """Return the newest stamp, None before there is one."""
        return self._taken[-1][0] if self._taken else None

    def controls(self) -> Controls:
        """Return the same as a filter wants it."""
        if self._controls is None:
            stamps, values = zip(*self._taken) if self._taken else ((), ())
            self._controls = Controls(stamps, values, self._hold_ns)
        return self._controls

    def put(self, stamp_ns: int, values: Sequence[float], earliest_ns: float) -> Rejection | None:
        """
        Put a control where it belongs, unless it is from before the earliest that is still wanted.

        Of different ones with equal stamps the larger tuple counts, whichever comes first.  Raises
        ValueError where the values are not one for each input.
        """
        # + 0.0: there is one zero only
        value = tuple(float(v) + 0.0 for v in values)
        if len(value) != len(self._inputs) or not value or not all(map(math.isfinite, value)):
            raise ValueError(f'values: expected {len(self._inputs)} finite numbers '
                             f'({", ".join(self._inputs) or "no inputs"}), got {list(value)}')
        if stamp_ns < earliest_ns:
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

    def since(self, stamp_ns: int) -> list[tuple[int, Value]]:
        """Return those that may hold at a stamp, and later ones."""
        return [control for control in self._taken if control[0] >= stamp_ns - self._hold_ns]

    def forget_before(self, stamp_ns: float) -> None:
        """Let go of those before the last one that is no later than a stamp, and holds there."""
        self._forget(bisect.bisect_right(self._taken, stamp_ns, key=_stamp) - 1)

    def make_room(self) -> None:
        """Let go of the oldest where there is no room for another one."""
        self._forget(len(self._taken) + 1 - MOST_CONTROLS)

    def _forget(self, count: int) -> None:
        """Let go of so many of the oldest, of none where that is negative."""
        if count > 0:
            del self._taken[:count]
            self._controls = None


def _stamp(control: tuple[int, Value]) -> int:
    return control[0]
