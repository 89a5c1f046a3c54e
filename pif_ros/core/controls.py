"""What drives a model from outside: a control that is constant between stamps."""

from __future__ import annotations

import bisect
from collections.abc import Iterator
from dataclasses import dataclass
import itertools

import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel

Value = tuple[float, ...]

NANOSECONDS = 1_000_000_000
#: States at which a control is looked at, at most, along each axis.
LOOKS = 5


@dataclass(frozen=True)
class Controls:
    """
    A control u(t) in pieces: values[k] holds from stamps_ns[k] on, until the next stamp.

    But for hold_ns at most: after that, and before the first stamp, all components are 0.  A stamp
    is thus the start of the interval for which its value holds.
    """

    stamps_ns: tuple[int, ...] = ()
    values: tuple[Value, ...] = ()
    hold_ns: int = 0

    def __post_init__(self) -> None:
        """Refuse stamps that do not increase, and values that do not go with them."""
        if len(self.values) != len(self.stamps_ns):
            raise ValueError(f'values: expected {len(self.stamps_ns)}, one for each stamp, '
                             f'got {len(self.values)}')
        if not all(a < b for a, b in itertools.pairwise(self.stamps_ns)):
            raise ValueError('stamps_ns: expected increasing stamps, '
                             f'got {list(self.stamps_ns)}')
        if len(set(map(len, self.values))) > 1:
            raise ValueError('values: expected as many components in each, '
                             f'got {sorted(set(map(len, self.values)))}')
        if self.hold_ns < 0:
            raise ValueError(f'hold_ns: expected 0 or more, got {self.hold_ns}')

    def between(self, from_ns: int, to_ns: int) -> Iterator[tuple[int, int, Value]]:
        """
        Yield start, end and value of the pieces that cover [from_ns, to_ns), in order.

        Neighbours differ: where a piece ends does not depend on what is asked for, save for the
        first start and the last end.  Where there is no control at all, the value is empty.
        """
        for u, pieces in itertools.groupby(self._pieces(from_ns, to_ns), key=lambda p: p[2]):
            (start, end, _), *rest = pieces
            yield start, rest[-1][1] if rest else end, u

    def _pieces(self, from_ns: int, to_ns: int) -> Iterator[tuple[int, int, Value]]:
        """Yield the same with neighbours that may be equal."""
        none = (0.0,) * len(self.values[0]) if self.values else ()
        now, k = from_ns, bisect.bisect_right(self.stamps_ns, from_ns) - 1
        while now < to_ns:
            u, held = (self.values[k], self.stamps_ns[k] + self.hold_ns) if k >= 0 else (none, now)
            k += 1
            following = min(self.stamps_ns[k] if k < len(self.stamps_ns) else to_ns, to_ns)
            for until, value in ((min(held, following), u), (following, none)):
                if now < until:
                    yield now, until, value
                    now = until


NO_CONTROLS = Controls()


def driven(model: StateModel, controls: Controls, from_ns: int,
           to_ns: int) -> Iterator[tuple[int, int, StateModel]]:
    """
    Yield start, end and the plain model of the pieces of time in which a control is constant.

    A model without inputs is not touched: it is one piece.
    """
    if not model.inputs:
        if from_ns < to_ns:
            yield from_ns, to_ns, model
        return
    for start, end, u in controls.between(from_ns, to_ns):
        yield start, end, model.under(u)


@np.errstate(all='ignore')
def carries_across(model: StateModel, grid: Grid, u: Value, t: float, seconds: float) -> bool:
    """
    Return whether a control carries a state across the whole grid within so many seconds.

    That is f(x, u, t) - f(x, 0, t), seen at some states x, and what is not finite is beyond all:
    no step follows such a motion, and no number of steps is enough for one that has no bounds.
    """
    some = [axis[np.unique(np.linspace(0, len(axis) - 1, LOOKS).astype(int))]
            for axis in grid.axes]
    x = np.stack(np.meshgrid(*some, indexing='ij')).reshape(grid.ndim, -1)
    f = model.under(u).drift(x, t) - model.under(()).drift(x, t)
    width = np.array(grid.upper) - np.array(grid.lower)
    return not bool((np.abs(f) * seconds <= width[:, None]).all())
