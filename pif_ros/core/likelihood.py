"""The likelihood of a measurement in every cell of a grid, in the log domain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor
from pif_ros.core.posterior import Terms

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Cells up to this many standard deviations wide sum a likelihood well at their centres: a
#: Gaussian sampled every 2 of them sums to 1.4 % of its mass, every 1.5 of them to 0.03 %.
RESOLVED = 2.0
#: Points per axis at most, by dimension, over which a cell's likelihood is averaged.
FINEST = {1: 32, 2: 8, 3: 4, 4: 3}
#: A cell with less than this share of the densest one is not worth averaging over.
SIGNIFICANT = 1e-9
#: Beyond this square of an expected measurement, whitened, a log likelihood is not added up from
#: its terms, whose difference would have lost its digits from the tenth on.
FAR = 1e6
#: Points that are averaged over at a time.
CHUNK = 1 << 16
_NO_CELLS = np.zeros(0, dtype=np.intp), np.zeros(0)


@dataclass(frozen=True, eq=False)
class GridLikelihood:
    """
    A sensor's likelihood on a grid.

    Where the expected measurement changes by more than two of its standard deviations from edge
    to edge of a cell, the cell's centre does not stand for it; with average_cells, and where the
    belief has mass, the likelihood is averaged over such a cell.  once: whether it is asked for
    one measurement only, so that only the cells which that needs are looked at.
    """

    grid: Grid
    sensor: Sensor
    average_cells: bool = True
    once: bool = False

    def log(self, y: Array, density: Array, t: float, cells: Indices | None = None) -> Array:
        """
        Return log p(y | x) for some cells (all where none are given), given the density there.

        Where the sensor's function is undefined it is NaN.
        """
        found = self.terms(y, density, t, cells)
        return found.total() if isinstance(found, Terms) else found

    def terms(self, y: Array, density: Array, t: float,
              cells: Indices | None = None) -> Array | Terms:
        """Return the same, by its terms where those are small enough to lose no digits."""
        places, own = self._coarse(y, density, t, cells)
        terms = self._terms(y, cells)
        if terms is not None:
            return Terms(*terms, places, own)
        with np.errstate(over='ignore', invalid='ignore'):
            log_l = self.sensor.log_likelihood(y, self._expected(cells, t), t)
        log_l[places] = own
        return log_l

    def remarks(self, name: str) -> list[str]:
        """Return a sentence where some cells are wider than the likelihood."""
        width, coarse = self.widths, self._too_wide
        if width is None or not len(coarse):
            return []
        cure = ('its likelihood is averaged over such cells where the belief is'
                if self.average_cells else 'filter.average_cells is off, so variances are wrong')
        share = f'{len(coarse) / self.grid.size:.0%}'
        return [f'grid.shape: {"some" if share == "0%" else share} of the cells are wider than '
                f'sensor {name!r} resolves, up to {float(width.max()):.1f} of its standard '
                f'deviations; {cure}']

    def _coarse(self, y: Array, density: Array, t: float,
                cells: Indices | None) -> tuple[Indices, Array]:
        """Return which of the cells are too wide for their centres, and their averages."""
        if not self.average_cells:
            return _NO_CELLS
        if self.widths is None:
            places = np.flatnonzero(density > SIGNIFICANT * density.max())
            x = np.take(self.grid.points, places if cells is None else cells[places], axis=1)
            width = cell_widths(self.sensor, x, self.grid.spacing, t)
            places, width = places[width > RESOLVED], width[width > RESOLVED]
        elif len(self._too_wide):
            places = (self._too_wide if cells is None
                      else np.flatnonzero(self.widths[cells] > RESOLVED))
            places = places[density[places] > SIGNIFICANT * density.max()]
            width = self.widths[places if cells is None else cells[places]]
        else:
            return _NO_CELLS
        if not len(places):
            return _NO_CELLS
        return places, self._averaged(y, places if cells is None else cells[places],
                                      float(width.max()), t)

    def _terms(self, y: Array, cells: Indices | None) -> tuple[Array, Array, Array, float] | None:
        """Return what a log likelihood is the sum of, None where it is none or loses digits."""
        if self._whitened is None:
            return None
        # -|v - u|^2 / 2 = v u - |v|^2 / 2 - |u|^2 / 2, of which only the first needs both; where
        # |u| is far beyond all |v|, the result is as large as its terms, and has their digits
        whiten, origin, v, square = self._whitened
        if cells is not None:
            v, square = np.take(v, cells, axis=1), square[cells]
        with np.errstate(over='ignore', invalid='ignore'):
            u = whiten @ y - origin
            constant = self.sensor.log_peak(0.0) - 0.5 * float(u @ u)
        return u, v, square, constant

    @cached_property
    @np.errstate(over='ignore', invalid='ignore')
    def _whitened(self) -> tuple[Array, Array, Array, Array] | None:
        """
        Return what whitens, an origin (m,), the whitened h from there (m, size), -|.|^2 / 2 of it.

        None where the residual is no difference, or is one of numbers that are too far apart.
        """
        sensor = self.sensor
        if sensor.time_dependent or callable(sensor.covariance) or any(sensor.angular):
            return None
        whiten = _whitening(sensor, 0.0)
        v = whiten @ sensor.function(self.grid.points, 0.0)
        # an origin on the grid, so that large coordinates cost no digits
        origin = np.nan_to_num(v[:, self.grid.size // 2], posinf=0.0, neginf=0.0)
        v = np.ascontiguousarray(v - origin[:, None])
        square = -0.5 * np.einsum('ij,ij->j', v, v)
        # where h is undefined or infinite there are no digits to lose
        if not square.min() >= -FAR / 2 and np.any(
                np.isfinite(v).all(axis=0) & (square < -FAR / 2)):
            return None
        return whiten, origin, v, square

    def _expected(self, cells: Indices | None, t: float) -> Array:
        """Return h of some cells, all where none are given."""
        if self.sensor.time_dependent or self.once:
            x = self.grid.points if cells is None else self.grid.points[:, cells]
            return self.sensor.function(x, t)
        return self._constant if cells is None else np.take(self._constant, cells, axis=1)

    @cached_property
    @np.errstate(over='ignore', invalid='ignore')
    def _constant(self) -> Array:
        return np.asarray(self.sensor.function(self.grid.points, 0.0), dtype=float)

    @cached_property
    def widths(self) -> Array | None:
        """Return each cell's width in standard deviations, (size,); None where not kept."""
        if self.once or self.sensor.time_dependent or callable(self.sensor.covariance):
            return None
        return cell_widths(self.sensor, self.grid.points, self.grid.spacing, 0.0)

    @cached_property
    def _too_wide(self) -> Indices:
        return np.flatnonzero(self.widths > RESOLVED) if self.widths is not None else _NO_CELLS[0]

    @np.errstate(over='ignore', invalid='ignore')
    def _averaged(self, y: Array, cells: Indices, width: float, t: float) -> Array:
        """Return the log of the likelihood's average over some cells, so wide at most."""
        count = min(math.ceil(width) + 1, FINEST[self.grid.ndim])
        at_once = max(1, CHUNK // count**self.grid.ndim)
        return np.concatenate([self._averaged_together(y, cells[k:k + at_once], count, t)
                               for k in range(0, len(cells), at_once)])

    def _averaged_together(self, y: Array, cells: Indices, count: int, t: float) -> Array:
        n, sensor = self.grid.ndim, self.sensor
        steps = (np.arange(count) + 0.5) / count - 0.5
        inner = np.stack(np.meshgrid(*[steps] * n, indexing='ij')).reshape(n, 1, -1)
        x = self.grid.points[:, cells, None] + inner * self.grid.spacing[:, None, None]
        whiten, h = _whitening(sensor, t), sensor.function(x, t)
        v = np.tensordot(whiten, sensor.residual(y, h), axes=1)
        lattice = h.reshape(len(h), len(cells), *[count] * n)
        log_l = _log_density(v, [
            np.tensordot(whiten, _change(sensor, lattice, axis).reshape(h.shape), axes=1)
            for axis in range(2, n + 2)])
        log_l[np.isnan(log_l)] = -np.inf
        peak = log_l.max(axis=1, keepdims=True)
        peak = np.where(np.isfinite(peak), peak, 0.0)
        with np.errstate(divide='ignore'):
            average = np.log(np.exp(log_l - peak).mean(axis=1)) + peak[:, 0]
        return average + _log_constant(whiten)


def cell_widths(sensor: Sensor, centres: Array, spacing: Array, t: float) -> Array:
    """Return how far cells reach along the axis on which they reach furthest, (N,)."""
    return widths_along(sensor, centres, spacing, t).max(axis=0)


@np.errstate(over='ignore', invalid='ignore')
def widths_along(sensor: Sensor, centres: Array, spacing: Array, t: float) -> Array:
    """
    Return how far cells (n, N) reach in expected measurements, (n, N), in standard deviations.

    Along each of the axes on which there is a spacing, (n,) or (n, N).  A half of a cell at whose
    edge the function is undefined counts for as much as the other; 0 where both are.
    """
    whiten, centre = _whitening(sensor, t), sensor.function(centres, t)
    widths = np.zeros(centres.shape)
    for axis in np.flatnonzero(spacing.reshape(len(spacing), -1).any(axis=1)):
        half = np.zeros((len(spacing), spacing.size // len(spacing)))
        half[axis] = spacing[axis] / 2
        # edge to centre to edge, since a sensor may turn back within a cell
        down, up = (_lengths(whiten @ sensor.difference(
            sensor.function(centres + side * half, t), centre)) for side in (-1, 1))
        widths[axis] = _or_else(down, up) + _or_else(up, down)
    return widths


def _or_else(a: Array, b: Array) -> Array:
    """Return a, b where that is not finite, 0 where neither is."""
    return np.where(np.isfinite(a), a, np.where(np.isfinite(b), b, 0.0))


def _lengths(v: Array) -> Array:
    """Return the lengths of vectors (m, N), (N,)."""
    return np.sqrt(np.einsum('ij,ij->j', v, v))


def _log_density(v: Array, changes: list[Array]) -> Array:
    """
    Return log N(v; 0, S) + m log(2 pi) / 2 for whitened residuals v (m, ...).

    changes: how much the expected measurement changes from point to point along each axis,
    whitened, (m, ...).  S = 1, widened along a change of more than 2 to half of it, so that what
    lies between the points is seen.
    """
    excess = []
    for change in changes:
        square = np.einsum('i...,i...->...', change, change)
        share = np.where(square > 4, 0.25 - 1 / np.maximum(square, 4), 0.0)
        excess.append(np.sqrt(share) * change)
    if not any(part.any() for part in excess):
        return -0.5 * np.einsum('i...,i...->...', v, v)
    m = len(v)
    S = np.eye(m) + sum(np.einsum('i...,j...->...ij', part, part) for part in excess)
    solved = np.linalg.solve(S, np.moveaxis(v, 0, -1)[..., None])[..., 0]
    return -0.5 * (np.einsum('i...,...i->...', v, solved) + np.linalg.slogdet(S)[1])


def _change(sensor: Sensor, h: Array, axis: int) -> Array:
    """
    Return the change of h from point to point along an axis, the larger of the two sides.

    That of the only side on which it is defined, 0 where there is none.
    """
    steps = sensor.difference(np.delete(h, 0, axis), np.delete(h, -1, axis))
    left = np.concatenate([steps.take([0], axis), steps], axis)
    right = np.concatenate([steps, steps.take([-1], axis)], axis)
    left, right = _or_else(left, right), _or_else(right, left)
    return np.where(np.abs(left) > np.abs(right), left, right)


def _whitening(sensor: Sensor, t: float) -> Array:
    return np.linalg.inv(np.linalg.cholesky(sensor.noise(t)))


def _log_constant(whiten: Array) -> float:
    """Return the log of a Gaussian's peak, from the matrix that whitens it."""
    return float(np.log(np.diag(whiten)).sum() - 0.5 * len(whiten) * np.log(2 * np.pi))
