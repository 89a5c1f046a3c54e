"""A box of cells on the lattice of a grid, or on a finer one inside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid

Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Window:
    """
    Some cells of a base grid, each axis of which is halved level times.

    offset: the first cell on each axis, in cells of this level from the base's lower edge; shape:
    cells on each axis, at least 2.  On a periodic axis a window may run past the upper edge, and
    where it goes all the way round it is the circle itself.
    """

    base: Grid
    level: tuple[int, ...]
    offset: tuple[int, ...]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, base: Grid, level: Sequence[int] | Integers, offset: Sequence[int] | Integers,
           shape: Sequence[int] | Integers) -> Window:
        """Return a window in plain whole numbers, one turn round a circle at most."""
        cells = [int(n) << int(up) for n, up in zip(base.shape, level)]
        first, count = [int(v) for v in offset], [int(v) for v in shape]
        for i, round_ in enumerate(base.periodic):
            if round_:
                whole = count[i] >= cells[i]
                first[i], count[i] = (0, cells[i]) if whole else (first[i] % cells[i], count[i])
        return cls(base, tuple(int(v) for v in level), tuple(first), tuple(count))

    @classmethod
    def whole(cls, base: Grid) -> Window:
        """Return the base grid itself."""
        n = base.ndim
        return cls(base, (0,) * n, (0,) * n, base.shape)

    @property
    def size(self) -> int:
        """Return the number of cells."""
        return math.prod(self.shape)

    @cached_property
    def cells(self) -> tuple[int, ...]:
        """Return how many cells of this level the base has on each axis."""
        return tuple(n << up for n, up in zip(self.base.shape, self.level))

    @cached_property
    def circles(self) -> tuple[bool, ...]:
        """Return the axes on which the window goes all the way round."""
        return tuple(round_ and count == cells for round_, count, cells
                     in zip(self.base.periodic, self.shape, self.cells))

    @cached_property
    def spacing(self) -> NDArray[np.float64]:
        """Return the width of a cell on each axis, shape (n,)."""
        return self.base.spacing / np.exp2(self.level)

    @cached_property
    def grid(self) -> Grid:
        """Return the window as a grid; past a periodic edge its coordinates go on."""
        lower = np.array(self.base.lower) + np.array(self.offset) * self.spacing
        upper = np.array(self.base.lower) + (np.array(self.offset) + self.shape) * self.spacing
        return Grid(tuple(lower), tuple(upper), self.shape, self.circles)

    def to_cells(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return states (n, ...) in cells from the centre of the window's first cell."""
        rest = (1,) * (x.ndim - 1)
        lower = np.array(self.base.lower).reshape(-1, *rest)
        first = np.array(self.offset).reshape(-1, *rest)
        cells: NDArray[np.float64] = (
            (x - lower) / self.spacing.reshape(-1, *rest) - first - 0.5)
        return cells


def wrapped(base: Grid, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return states (n, ...) with what is periodic between its edges."""
    for i, round_ in enumerate(base.periodic):
        low, high = base.lower[i], base.upper[i]
        # for a few cells half the time of min and max
        if round_ and not (low <= np.minimum.reduce(x[i], None)
                           and np.maximum.reduce(x[i], None) < high):
            x = x.copy()
            with np.errstate(invalid='ignore'):
                x[i] -= (high - low) * np.floor((x[i] - low) / (high - low))
    return x


@dataclass(frozen=True)
class RolledGrid(Grid):
    """Cells that go on beyond the edge of a circle, with centres where their world has them."""

    world: Grid = field(kw_only=True)

    @classmethod
    def of(cls, grid: Grid, world: Grid) -> Grid:
        """Return a grid rolled into a world, itself where it does not reach beyond it."""
        beyond = any(round_ and high > end for round_, high, end in
                     zip(world.periodic, grid.upper, world.upper))
        return (cls(grid.lower, grid.upper, grid.shape, grid.periodic, world=world)
                if beyond else grid)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Return the cell centres in C order, shape (n, size)."""
        return wrapped(self.world, super().points)
