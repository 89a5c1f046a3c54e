"""Where the density lives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: Widths of cells whose volumes and variances are numbers, on four axes too.
NARROWEST, WIDEST = 1e-70, 1e70


@dataclass(frozen=True)
class Grid:
    """
    A box cut into equal cells; a cell stands for its centre.

    lower, upper: edges of the box, in the units of the state; shape: cells per axis, 1 to 4 axes;
    periodic: axes on which upper is lower again.  Raises ValueError where these do not fit.
    """

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    shape: tuple[int, ...]
    periodic: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        """Bring the fields to plain tuples and refuse what is no box."""
        n = len(self.shape)
        put = object.__setattr__
        put(self, 'lower', tuple(float(v) for v in self.lower))
        put(self, 'upper', tuple(float(v) for v in self.upper))
        if any(v != int(v) for v in self.shape):
            raise ValueError(f'shape: expected whole numbers of cells, got {list(self.shape)}')
        put(self, 'shape', tuple(int(v) for v in self.shape))
        put(self, 'periodic', tuple(bool(v) for v in self.periodic) or (False,) * n)
        if not 1 <= n <= 4:
            raise ValueError(f'shape: expected 1 to 4 axes, got {n}')
        for name in ('lower', 'upper', 'periodic'):
            if len(getattr(self, name)) != n:
                raise ValueError(f'{name}: expected {n} values, one for each axis of shape, '
                                 f'got {len(getattr(self, name))}')
        for i, (low, high, cells) in enumerate(zip(self.lower, self.upper, self.shape)):
            if not (math.isfinite(high - low) and low < high):
                raise ValueError(f'upper: expected finite lower < upper on axis {i}, '
                                 f'got {low:g} and {high:g}')
            if cells < 2:
                raise ValueError(f'shape: expected at least 2 cells on axis {i}, got {cells}')
            if not NARROWEST < (high - low) / cells < WIDEST:
                raise ValueError(f'upper: expected cells from {NARROWEST:g} to {WIDEST:g} wide on '
                                 f'axis {i}, got {(high - low) / cells:g}')

    @property
    def ndim(self) -> int:
        """Return the number of axes."""
        return len(self.shape)

    @property
    def size(self) -> int:
        """Return the number of cells."""
        return math.prod(self.shape)

    @cached_property
    def spacing(self) -> NDArray[np.float64]:
        """Return the width of a cell on each axis, shape (n,)."""
        return (np.array(self.upper) - np.array(self.lower)) / np.array(self.shape)

    @cached_property
    def cell_volume(self) -> float:
        """Return the volume of a cell."""
        return float(np.prod(self.spacing))

    @cached_property
    def axes(self) -> tuple[NDArray[np.float64], ...]:
        """Return the coordinates of the cell centres along each axis."""
        return tuple(low + (np.arange(cells) + 0.5) * width
                     for low, cells, width in zip(self.lower, self.shape, self.spacing))

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """Return the cell centres in C order, shape (n, size)."""
        return np.stack(np.meshgrid(*self.axes, indexing='ij')).reshape(self.ndim, -1)

    def wrap(self, difference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return differences of states (n, ...) taken the short way round on periodic axes."""
        if not any(self.periodic):
            return difference
        return np.stack([self.wrap_along(i, part) for i, part in enumerate(difference)])

    def wrap_along(self, axis: int, difference: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return differences of one of the states, any shape, the short way round."""
        if not self.periodic[axis]:
            return difference
        period = self.upper[axis] - self.lower[axis]
        return (difference + period / 2) % period - period / 2

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Return whether states (n, ...) lie in the box; a periodic axis holds everything."""
        x = np.asarray(x, dtype=float)
        inside = np.ones(x.shape[1:], dtype=bool)
        for i in range(self.ndim):
            if not self.periodic[i]:
                inside &= (self.lower[i] <= x[i]) & (x[i] <= self.upper[i])
        return inside

    def select(self, axes: Sequence[int]) -> Grid:
        """Return the grid of some of the axes, in the order given."""
        return Grid(tuple(self.lower[i] for i in axes), tuple(self.upper[i] for i in axes),
                    tuple(self.shape[i] for i in axes), tuple(self.periodic[i] for i in axes))
