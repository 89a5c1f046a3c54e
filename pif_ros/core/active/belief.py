"""What the filter believes, kept only where there is something to believe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.active.pieces import pieces
from pif_ros.core.active.window import Window, wrapped
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.modes import densest, Mode, modes, MOST, NEARLY_ALL, Pieces, SHARE
from scipy import special

Array = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Patch:
    """A density on a window, shape window.shape, in 1 / (units of the state)."""

    window: Window
    density: Array

    @classmethod
    def at(cls, base: Grid, level: Sequence[int], first: Sequence[int] | Integers,
           density: Array) -> Patch:
        """Return a density from a first cell on; round a circle its ends come to lie together."""
        for axis, round_ in enumerate(base.periodic):
            cells, count = base.shape[axis] << level[axis], density.shape[axis]
            if round_ and count >= cells:
                before, beyond = density.shape[:axis], density.shape[axis + 1:]
                missing = np.zeros((*before, -count % cells, *beyond))
                turns = np.concatenate([density, missing], axis).reshape(
                    *before, -1, cells, *beyond)
                density = np.roll(turns.sum(axis=axis), int(first[axis]), axis)
        return cls(Window.of(base, level, first, density.shape), density)

    @cached_property
    def mass(self) -> float:
        """Return the probability in it."""
        return float(self.density.sum() * self.window.spacing.prod())

    def marginal(self, *axes: int) -> Array:
        """Return the mass in every cell of some axes, in increasing order."""
        others = tuple(i for i in range(self.density.ndim) if i not in axes)
        mass: Array = self.density.sum(axis=others) * self.window.spacing.prod()
        return mass


@dataclass(frozen=True, eq=False)
class ActiveBelief:
    """
    A density that is the sum of patches, which may overlap and differ in the size of their cells.

    base: the box of the world, whose cells are the widest; dropped: the share of mass that was
    left out as negligible since the last correction.  The mass is 1, less that and what has left
    the box.  All statistics are those of the density scaled to mass 1; on a periodic axis the mean
    is circular, and deviations are taken the short way round.
    """

    base: Grid
    patches: tuple[Patch, ...]
    dropped: float = 0.0

    @cached_property
    def mass(self) -> float:
        """Return the probability in the box."""
        return sum(patch.mass for patch in self.patches)

    @property
    def size(self) -> int:
        """Return the number of cells that are kept."""
        return sum(patch.window.size for patch in self.patches)

    @property
    def nbytes(self) -> int:
        """Return the memory that the density takes, in bytes."""
        return sum(patch.density.nbytes for patch in self.patches)

    def normalised(self) -> ActiveBelief:
        """Return the same belief with mass 1."""
        return replace(self, patches=tuple(
            Patch(patch.window, patch.density / self.mass) for patch in self.patches))

    def mean(self) -> Array:
        """Return the mean, shape (n,); circular on periodic axes."""
        return np.array([self._mean_on(axis) for axis in range(self.base.ndim)])

    def mode(self) -> Array:
        """Return the centre of the densest cell of any patch, shape (n,)."""
        densest = max(self.patches, key=lambda patch: patch.density.max())
        where = np.unravel_index(np.argmax(densest.density), densest.density.shape)
        x = np.array([axis[i] for axis, i in zip(densest.window.grid.axes, where)])
        return wrapped(self.base, x)

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""
        point = self.mean() if about is None else np.asarray(about, dtype=float)
        n = self.base.ndim
        C = np.zeros((n, n))
        for patch in self.patches:
            d = [_deviations(self.base, patch.window, axis, point[axis]) for axis in range(n)]
            for i in range(n):
                C[i, i] += patch.marginal(i) @ d[i]**2
                for j in range(i):
                    C[i, j] += d[j] @ patch.marginal(j, i) @ d[i]
        C += np.tril(C, -1).T
        return C / self.mass

    def on(self, grid: Grid, axes: Sequence[int]) -> GridBelief:
        """Return the density of some of the axes on their cells of the base grid."""
        cells = grid.select(axes)
        kept = sorted(axes)
        mass = np.zeros([grid.shape[i] for i in kept])
        for patch in self.patches:
            _add(mass, patch, kept)
        density = np.transpose(mass, [kept.index(i) for i in axes]) / cells.cell_volume
        return GridBelief(cells, density)

    def entropy(self) -> float:
        """Return the differential entropy in nats."""
        found = self._pieces()
        return -float(special.xlogy(found.mass, found.density).sum())

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """
        Return the humps, heaviest first, the most that are wanted; as of GridBelief.

        Humps hang together where their cells touch, whatever patch these are of.  Where patches
        of very different cells make too many of the finest, these are taken together.
        """
        found = self._pieces()
        return modes(found.some(densest(found.density, found.mass, max(share, NEARLY_ALL))),
                     share, most)

    def edge_mass(self) -> float:
        """Return the share of the mass in the world's outermost cells, as wide as its widest."""
        inner = sum(_inner_mass(patch) for patch in self.patches)
        return max(1 - inner / self.mass, 0.0)

    def _pieces(self) -> Pieces:
        return pieces(self.base, [patch.window for patch in self.patches],
                      [patch.density for patch in self.patches])

    def _mean_on(self, axis: int) -> float:
        base = self.base
        coordinates = np.concatenate([p.window.grid.axes[axis] for p in self.patches])
        w = np.concatenate([p.marginal(axis) for p in self.patches]) / self.mass
        if not base.periodic[axis]:
            return float(coordinates @ w)
        low, period = base.lower[axis], base.upper[axis] - base.lower[axis]
        turn = np.exp(2j * np.pi * (coordinates - low) / period) @ w
        return low + float(np.angle(turn) / (2 * np.pi) % 1.0) * period


def seen_cells(patch: Patch, seen: Sequence[int] | None) -> tuple[Array, Array, Array]:
    """
    Return masses (N,), centres (n, N) and widths (n, N) of a patch's cells on some axes.

    What is not among these (all, where it is None) is put together in its middle, of width 0.
    """
    grid = patch.window.grid
    kept = [i for i in range(grid.ndim) if seen is None or i in seen]
    lines = [axis if i in kept else axis[len(axis) // 2, None] for i, axis in enumerate(grid.axes)]
    centres = np.stack(np.meshgrid(*lines, indexing='ij')).reshape(grid.ndim, -1)
    centres = wrapped(patch.window.base, centres)
    widths = np.where(np.isin(np.arange(grid.ndim), kept), grid.spacing, 0.0)
    return patch.marginal(*kept).ravel(), centres, np.broadcast_to(widths[:, None], centres.shape)


def _deviations(base: Grid, window: Window, axis: int, point: float) -> Array:
    """Return how far a window's cells are from a point along an axis, the short way round."""
    d: Array = window.grid.axes[axis] - point
    if base.periodic[axis]:
        period = base.upper[axis] - base.lower[axis]
        d = (d + period / 2) % period - period / 2
    return d


def _inner_mass(patch: Patch) -> float:
    """Return the mass of a patch that is not in the outermost cells of the base."""
    window, inner = patch.window, patch.density
    for axis, round_ in enumerate(window.base.periodic):
        if not round_:
            cell = (window.offset[axis] + np.arange(window.shape[axis])) >> window.level[axis]
            last = window.base.shape[axis] - 1
            inner = inner.compress((0 < cell) & (cell < last), axis)
    return float(inner.sum() * window.spacing.prod())


def _add(mass: Array, patch: Patch, axes: Sequence[int]) -> None:
    """Add a patch's mass on some axes, in increasing order, to that of the base's cells."""
    part, window = patch.marginal(*axes), patch.window
    places = []
    for k, axis in enumerate(axes):
        cell = (window.offset[axis] + np.arange(window.shape[axis])) >> window.level[axis]
        starts = np.flatnonzero(np.diff(cell, prepend=cell[0] - 1))
        part = np.add.reduceat(part, starts, axis=k)
        places.append(cell[starts] % patch.window.base.shape[axis])
    # a window that ends in the base cell in which it began meets that cell twice
    np.add.at(mass, np.ix_(*places), part)
