"""A cloud of weighted particles, and what can be read off it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.modes import densest, Mode, modes, MOST, NEARLY_ALL, Pieces, SHARE
from pif_ros.core.rivals.passage import circles, short_way, wrapped
from scipy import ndimage, special

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: For the mode, how many particles stand for all, and how many of these are candidates.
CROWD, CANDIDATES = 4096, 256
#: For the modes, the cells of the smoothed histogram at most, and how far it goes beyond the
#: particles, in cells: as far as one of them is smeared.
BINS, BEYOND = 2**20, 3
#: Fewer equal particles than this are no hump of their own.
SEVERAL = 10


@dataclass(frozen=True, eq=False)
class ParticleBelief:
    """
    Particles (n, N) with the logs of their weights (N,).

    The weights sum to the mass: 1, less what has died since the last correction.  box: what tells
    which states go round.  All statistics are those of the cloud scaled to mass 1; where all
    particles are dead, of the places where they died.
    """

    points: Array
    log_weights: Array
    box: Grid | None = None

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return self.points.nbytes + self.log_weights.nbytes

    @cached_property
    def mass(self) -> float:
        """Return the sum of the weights."""
        return float(np.exp(self.log_weights).sum())

    @cached_property
    def weights(self) -> Array:
        """Return the weights, scaled to sum to 1, shape (N,)."""
        peak = self.log_weights.max()
        if peak == -np.inf:
            return np.full(self.log_weights.shape, 1 / len(self.log_weights))
        w = np.exp(self.log_weights - peak)
        return w / w.sum()

    @property
    def effective_size(self) -> float:
        """Return 1 / sum w^2: how many equal weights would say as much."""
        return float(1 / (self.weights @ self.weights))

    def mean(self) -> Array:
        """Return the mean, shape (n,); circular on periodic axes."""
        mean = self.points @ self.weights
        for i, low, period in circles(self.box):
            turn = np.exp(2j * np.pi * (self.points[i] - low) / period) @ self.weights
            mean[i] = low + (np.angle(turn) / (2 * np.pi) % 1.0) * period
        return mean

    def mode(self) -> Array:
        """
        Return the densest place, shape (n,).

        Of some particles the one with the highest sum of Gaussians about the others, moved to
        the mean under its Gaussian.  These are as wide as suits a single hump, standard deviation
        * N^(-1 / (n + 4)) with N the effective size  [Scott 1992, section 6.3].
        """
        mean, width = self.mean(), self._width()
        crowd = _thinned(systematic(self.weights, 0.5), CROWD)
        candidates = _thinned(crowd, CANDIDATES)
        others = self._scaled(crowd, mean, width)
        best = candidates[np.argmax(_densities(_thinned(others, CANDIDATES), others))]
        d = short_way(self.points - self.points[:, best, None], self.box)
        w = self.weights * np.exp(-0.5 * np.square(d / width[:, None]).sum(axis=0))
        return wrapped(self.points[:, best] + d @ w / w.sum(), self.box)

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""
        point = self.mean() if about is None else np.asarray(about, dtype=float)
        d = short_way(self.points - point[:, None], self.box)
        return (d * self.weights) @ d.T

    def on(self, grid: Grid, axes: Sequence[int]) -> GridBelief:
        """Return the histogram of some axes on their cells of a grid, with the mass there."""
        cells = grid.select(axes)
        inside, flat = _places(cells, wrapped(self.points[list(axes)], cells))
        mass = np.bincount(flat, self.weights[inside], cells.size)
        return GridBelief(cells, (mass / cells.cell_volume).reshape(cells.shape))

    def entropy(self) -> float:
        """Return the differential entropy in nats, with the density that the modes are of."""
        found = self._pieces()
        return -float(special.xlogy(found.mass, found.density).sum())

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """
        Return the humps, heaviest first, the most that are wanted; as of GridBelief.

        They are those of the sum of Gaussians of the width that suits a single hump, on a grid
        of cells as wide, and have the moments of the particles in them.  What holds no more than
        some few particles is none, unless there is nothing else.
        """
        found = self._pieces()
        humps = modes(found.some(densest(found.density, found.mass, max(share, NEARLY_ALL))),
                      share, most)
        return humps[:1] + [hump for hump in humps[1:]
                            if hump.mass * self.effective_size >= SEVERAL]

    def edge_mass(self) -> float:
        """Return the share of the mass in the outermost cells of the box, and beyond it."""
        inner = np.ones(len(self.weights), dtype=bool)
        for i, round_ in enumerate(self.box.periodic if self.box is not None else ()):
            if self.box is not None and not round_:
                width = self.box.spacing[i]
                inner &= ((self.box.lower[i] + width <= self.points[i])
                          & (self.points[i] < self.box.upper[i] - width))
        return float(self.weights[~inner].sum())

    def _pieces(self) -> Pieces:
        """Return the particles in the cells of a smoothed histogram."""
        points, w = self.points[:, self.weights > 0], self.weights[self.weights > 0]
        grid = self._bins(points)
        x = wrapped(points, grid)
        _, cell = _places(grid, x)
        mass = np.bincount(cell, w, grid.size).reshape(grid.shape)
        ends = ['wrap' if round_ else 'constant' for round_ in grid.periodic]
        smooth = ndimage.gaussian_filter(mass, 1.0, mode=ends, truncate=float(BEYOND))
        return Pieces(grid, cell, x, w, smooth.ravel()[cell] / grid.cell_volume)

    def _bins(self, points: Array) -> Grid:
        """Return a grid around points, its cells as wide as the Gaussians if these are few."""
        width, lower, upper = self._width(), points.min(axis=1), points.max(axis=1)
        periodic = [False] * len(points)
        for i, low, period in circles(self.box):
            lower[i], upper[i], periodic[i] = low, low + period, True
        beyond = np.where(periodic, 0, BEYOND)
        cells = np.maximum(np.ceil((upper - lower) / width) + 2 * beyond, 2)
        while cells.prod() > BINS:
            width = 1.1 * width
            cells = np.maximum(np.ceil((upper - lower) / width) + 2 * beyond, 2)
        # on a circle the cells are as much narrower as it takes to fill it
        middle, half = (lower + upper) / 2, np.where(periodic, upper - lower, cells * width) / 2
        return Grid(tuple(middle - half), tuple(middle + half), tuple(cells.astype(int)),
                    tuple(periodic))

    def _width(self) -> Array:
        """Return how wide a Gaussian about each particle suits a single hump, (n,)."""
        spread = np.sqrt(self.covariance().diagonal())
        width = spread * self.effective_size**(-1 / (len(spread) + 4))
        return np.where(width > 0, width, 1.0)

    def _scaled(self, some: Indices, mean: Array, width: Array) -> Array:
        """Return some particles in units of widths (n,), what goes round as points of a circle."""
        rows = list((self.points[:, some] - mean[:, None]) / width[:, None])
        for i, low, period in circles(self.box):
            angle = 2 * np.pi / period * (self.points[i, some] - low)
            rows[i] = period / (2 * np.pi * width[i]) * np.stack([np.cos(angle), np.sin(angle)])
        return np.vstack(rows)


def _places(grid: Grid, x: Array) -> tuple[NDArray[np.bool_], Indices]:
    """Return which of some points (n, N) lie on a grid, and the flat indices of their cells."""
    low, shape = np.array(grid.lower)[:, None], np.array(grid.shape)[:, None]
    inside = grid.contains(x)
    index = np.floor((x[:, inside] - low) / grid.spacing[:, None]).astype(np.intp)
    return inside, np.ravel_multi_index(tuple(np.clip(index, 0, shape - 1)), grid.shape)


def systematic(weights: Array, u: float) -> Indices:
    """
    Return which particles to keep, as often as to keep them, N in order.

    Particle i is kept as often as a comb (u + j) / N with one u from [0, 1) has teeth in its
    share: N w_i times on average, and no more than one off  [Kitagawa 1996].
    """
    count = len(weights)
    ends = np.cumsum(weights)
    ends /= ends[-1]
    ends *= count
    # rounding must not lose the last tooth, nor give it to a weight of 0 at the end
    teeth = np.where(ends == count, count, np.ceil(ends - u)).astype(np.intp)
    return np.repeat(np.arange(count), np.diff(teeth, prepend=0))


def _densities(z: Array, others: Array) -> Array:
    """Return the sums of unit Gaussians about others (n, N) at points (n, M), shape (M,)."""
    square = z.T @ others
    square *= -2
    square += np.square(z).sum(axis=0)[:, None]
    square += np.square(others).sum(axis=0)
    return np.exp(-0.5 * square).sum(axis=1)


def _thinned(values: NDArray, count: int) -> NDArray:
    """Return at most so many columns, evenly out of all."""
    return values[..., ::-(-values.shape[-1] // count)]
