"""What the filter believes: a probability density on a grid, and what can be read off it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import itertools

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.modes import densest, Mode, modes, MOST, NEARLY_ALL, Pieces, SHARE

Array = NDArray[np.float64]

#: A density on a circle is summed over so many turns to either side at most: a wider one is flat.
TURNS = 6


@dataclass(frozen=True, eq=False)
class GridBelief:
    """
    A density on a grid, shape grid.shape, in 1 / (units of the state).

    Its mass is 1, less what has left the grid since the last correction.  All statistics are those
    of the density scaled to mass 1, and none assumes a single hump.  On a periodic axis the mean
    is circular, and deviations are taken the short way round.
    """

    grid: Grid
    density: Array

    @classmethod
    def uniform(cls, grid: Grid) -> GridBelief:
        """Return the belief that knows nothing but the box."""
        return cls(grid, np.full(grid.shape, 1.0 / (grid.size * grid.cell_volume)))

    @classmethod
    def gaussian(cls, grid: Grid, mean: ArrayLike, covariance: ArrayLike) -> GridBelief:
        """
        Return a Gaussian, mean (n,) and covariance (n, n), cut at the edges of the grid.

        Raises ValueError where the mean lies off the grid or the covariance is not positive
        definite.  As for gaussian_on, a grid cannot hold less than half a cell.
        """
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        if mean.shape != (grid.ndim,) or not np.all(np.isfinite(mean)):
            raise ValueError(f'mean: expected {grid.ndim} finite numbers, got {mean.tolist()}')
        if not np.all(grid.contains(mean)):
            raise ValueError(f'mean: expected a point on the grid, got {mean.tolist()}')
        check_covariance('covariance', covariance, grid.ndim)
        return cls(grid, gaussian_on(grid, mean, covariance)).normalised()

    @cached_property
    def mass(self) -> float:
        """Return the probability on the grid."""
        return float(self.density.sum() * self.grid.cell_volume)

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return self.density.nbytes

    def normalised(self) -> GridBelief:
        """Return the same belief with mass 1."""
        return GridBelief(self.grid, self.density / self.mass)

    @cached_property
    def _weights(self) -> Array:
        return self.density.ravel() / self.density.sum()

    @cached_property
    def _planes(self) -> dict[tuple[int, int], Array]:
        """Return the probabilities over each pair of axes, a row for each cell of the first."""
        n, total = self.grid.ndim, self.density.sum()
        return {(i, j): self.density.sum(axis=tuple(k for k in range(n) if k not in (i, j)))
                / total if n > 2 else self.density / total
                for i in range(n) for j in range(i + 1, n)}

    @cached_property
    def _lines(self) -> list[Array]:
        """Return the probabilities along each axis."""
        last = self.grid.ndim - 1
        if not last:
            return [self._weights]
        return [*(self._planes[i, last].sum(axis=1) for i in range(last)),
                self._planes[0, last].sum(axis=0)]

    def mean(self) -> Array:
        """Return the mean, shape (n,); circular on periodic axes."""
        grid = self.grid
        mean = np.empty(grid.ndim)
        for i, (x, w) in enumerate(zip(grid.axes, self._lines)):
            if grid.periodic[i]:
                low, period = grid.lower[i], grid.upper[i] - grid.lower[i]
                angle = np.angle(np.exp(2j * np.pi * (x - low) / period) @ w)
                mean[i] = low + (angle / (2 * np.pi) % 1.0) * period
            else:
                mean[i] = x @ w
        return mean

    def mode(self) -> Array:
        """Return the centre of the densest cell, shape (n,)."""
        return self.grid.points[:, np.argmax(self.density)]

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""
        grid = self.grid
        point = self.mean() if about is None else np.asarray(about, dtype=float)
        d = [grid.wrap_along(i, x - point[i]) for i, x in enumerate(grid.axes)]
        moments = np.diag([w @ (part * part) for w, part in zip(self._lines, d)])
        for (i, j), plane in self._planes.items():
            moments[i, j] = moments[j, i] = d[i] @ plane @ d[j]
        return moments

    def marginal(self, axes: Sequence[int]) -> GridBelief:
        """Return the density of some of the axes, in the order given."""
        others = tuple(i for i in range(self.grid.ndim) if i not in axes)
        width = float(np.prod(self.grid.spacing[list(others)]))
        density = self.density.sum(axis=others) * width
        kept = sorted(axes)
        return GridBelief(self.grid.select(axes),
                          np.transpose(density, [kept.index(i) for i in axes]))

    def on(self, grid: Grid, axes: Sequence[int]) -> GridBelief:
        """Return the density of some of the axes on the cells of a grid, which is its own."""
        return self.marginal(axes)

    def entropy(self) -> float:
        """Return the differential entropy in nats."""
        w = self._weights[self._weights > 0]
        return float(np.log(self.grid.cell_volume) - w @ np.log(w))

    def highest_density_region(self, share: float) -> NDArray[np.bool_]:
        """Return the smallest set of cells that holds this share of the mass, grid.shape."""
        w = self._weights
        return densest(w, w, share).reshape(self.grid.shape)

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """
        Return the humps, heaviest first, the most that are wanted.

        Those are the connected parts of the region of highest density with this share of the
        mass, each with what lies around it; their masses sum to nearly 1.
        """
        w = self._weights
        cell = np.flatnonzero(densest(w, w, max(share, NEARLY_ALL)))
        points = np.array([x[i] for x, i in zip(self.grid.axes,
                                                np.unravel_index(cell, self.grid.shape))])
        return modes(Pieces(self.grid, cell, points, w[cell], w[cell]), share, most)

    def edge_mass(self) -> float:
        """Return the share of the mass in the outermost cells of the axes that are not circles."""
        inner = tuple(slice(None) if round_ else slice(1, -1) for round_ in self.grid.periodic)
        return max(1 - float(self.density[inner].sum() / self.density.sum()), 0.0)


def gaussian_on(grid: Grid, mean: Array, covariance: Array) -> Array:
    """
    Return a Gaussian's density at the centres of a grid's cells, grid.shape.

    On a periodic axis it is the sum over all turns.  A standard deviation below half a cell, in
    whatever direction, is widened to it, or the centres would miss it.
    """
    # all in cells
    widths, turned = np.linalg.eigh(covariance / np.outer(grid.spacing, grid.spacing))
    P = (turned * np.maximum(widths, 0.25)) @ turned.T
    precision, density = np.linalg.inv(P), np.zeros(grid.size)
    nearest = grid.wrap(grid.points - mean[:, None]) / grid.spacing[:, None]
    for turn in _turns(grid, np.sqrt(np.diag(P))):
        d = nearest + turn
        density += np.exp(-0.5 * np.einsum('ik,ij,jk->k', d, precision, d))
    return density.reshape(grid.shape) / (np.sqrt(np.linalg.det(2 * np.pi * P))
                                          * grid.cell_volume)


def _turns(grid: Grid, deviations: Array) -> list[Array]:
    """Return the shifts (n, 1) by whole periods that a density so wide reaches, in cells."""
    steps: list[Array] = [np.zeros(1)] * grid.ndim
    for i in np.flatnonzero(grid.periodic):
        period = grid.shape[i]
        count = min(int(7 * deviations[i] / period + 0.5), TURNS)
        steps[i] = period * np.arange(-count, count + 1.0)
    return [np.array(turn)[:, None] for turn in itertools.product(*steps)]


def check_covariance(name: str, covariance: Array, size: int) -> None:
    """Raise ValueError unless a matrix is a finite, symmetric, positive definite (size, size)."""
    if covariance.shape != (size, size):
        raise ValueError(f'{name}: expected {size} x {size} numbers, '
                         f'got {" x ".join(map(str, covariance.shape))}')
    if not np.all(np.isfinite(covariance)):
        raise ValueError(f'{name}: expected finite numbers, got {covariance.tolist()}')
    if np.abs(covariance - covariance.T).max() > 1e-6 * np.abs(covariance).max():
        raise ValueError(f'{name}: expected a symmetric matrix, got {covariance.tolist()}')
    if np.linalg.eigvalsh(covariance)[0] <= 0:
        raise ValueError(f'{name}: expected a positive definite matrix, got {covariance.tolist()}')
