"""The Dirac-Feynman kernel tabulated on a grid: one stored weight per pair of cells."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse, stats

from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import (
    Array, KernelSettings, action, drift_terms, step_moments)
from pif_ros.core.models import StateModel

Integers = NDArray[np.int64]

#: Thinner than this, in cells per step, a Gaussian sampled at the nodes has a wrong variance.
THIN = 0.7
#: Weights that are worked on at a time, for the sake of the cache.
CHUNK = 1 << 18


def dirac_feynman(model: StateModel, grid: Grid, settings: KernelSettings,
                  t: float = 0.0) -> sparse.csr_array:
    """
    Return the kernel of one step from time t, (size, size), row x'', column x'.

    A column is normalised against what it would hold if the grid went on; what leaves the grid is
    missing from it, and a periodic axis wraps.  Raises ValueError where 'sampled' weights are
    asked for a singular diffusion matrix.
    """
    stencil = _stencil(model, grid, settings, t)
    most = grid.size * stencil.offsets.shape[1]
    data, rows = np.empty(most), np.empty(most, dtype=np.int32)
    counts, end = [np.zeros(1, dtype=int)], 0
    for w, targets, count in _columns(grid, stencil, settings.extent):
        start, end = end, end + len(w)
        data[start:end], rows[start:end] = w, targets
        counts.append(count)
    pointers = np.cumsum(np.concatenate(counts))
    kernel = sparse.csc_array((data[:end], rows[:end], pointers), shape=(grid.size, grid.size))
    if any(grid.periodic):
        kernel.sum_duplicates()
    return kernel.tocsr()


def stored_elements(model: StateModel, grid: Grid, settings: KernelSettings,
                    t: float = 0.0) -> float:
    """Return about how many weights a kernel holds, from the noise alone, without making it."""
    variance = _variance_in_cells(model, grid, settings, t)
    n, widths = grid.ndim, np.sqrt(np.diag(variance))
    reach = math.sqrt(stats.chi2.isf(settings.tolerance, n))
    ball = math.pi**(n / 2) / math.gamma(n / 2 + 1) * float(np.prod(reach * widths + 0.5))
    return grid.size * max(ball, 3.0**n)


class _Stencil:
    """
    Where each cell's mass may go, and with what weights.

    Cell i moves by shift[:, i] + offsets[:, k] cells, k = 0 ... K - 1.
    """

    shift: Integers
    offsets: Integers

    def weights(self, cells: Integers) -> Array:
        """Return the weights (cells, K) of the moves from some cells; each row sums to 1."""
        raise AssertionError('a stencil says how it weighs')


def _stencil(model: StateModel, grid: Grid, settings: KernelSettings, t: float) -> _Stencil:
    """Return the stencil that the settings ask for, or that suits the noise."""
    variance = _variance_in_cells(model, grid, settings, t)
    if np.linalg.matrix_rank(variance, hermitian=True) < len(variance):
        if settings.weights == 'sampled':
            raise ValueError("weights: expected 'auto' or 'moments' where the noise does not "
                             "reach every state (g = e Q e^T is singular), got 'sampled'")
        return _MomentStencil(model, grid, settings, t)
    # a cell's width against the noise of one state with the others given
    thinnest = 1 / np.sqrt(np.diag(np.linalg.inv(variance)).max())
    if settings.weights == 'sampled' or (
            settings.weights == 'auto' and (settings.extent > 0 or thinnest >= THIN)):
        return _SampledStencil(model, grid, settings, t)
    return _MomentStencil(model, grid, settings, t)


class _SampledStencil(_Stencil):
    """The density of the step at the cell centres, any r, either Jacobian."""

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings,
                 t: float) -> None:
        move, spread = step_moments(model, grid.points, settings, t, iterations=1)
        dx, eps = grid.spacing, settings.time_step
        self.shift = _whole_cells(move / dx[:, None])
        self._model, self._grid, self._settings, self._t = model, grid, settings, t
        self._g = model.diffusion(t + settings.r * eps)
        self._reach = math.sqrt(stats.chi2.isf(settings.tolerance, grid.ndim))
        # a steep drift may widen the step; twice the plain width is as far as it is followed
        widest = np.minimum(spread.max(axis=2).diagonal() / (eps * np.diag(self._g)), 4.0)
        stretch = np.sqrt(np.maximum(widest, 1.0))
        half = np.ceil(self._reach * stretch * np.sqrt(eps * np.diag(self._g)) / dx + 0.5)
        box = _box(half.astype(int))
        # the ellipse of the step, and half a cell around it since shifts are whole cells
        whiten = np.linalg.inv(np.linalg.cholesky(eps * self._g)) * dx
        inner = np.maximum(np.abs(box) - 0.5, 0) * np.sign(box) / stretch[:, None]
        self.offsets = box[:, np.linalg.norm(whiten @ inner, axis=0) <= self._reach]
        self._fields = _Fields(model, grid, settings, t, self.shift, self.offsets)

    def weights(self, cells: Integers) -> Array:
        """Return the weights (cells, K), normalised over the unlimited lattice."""
        dx, eps = self._grid.spacing, self._settings.time_step
        moves = [(self.shift[i, cells, None] + self.offsets[i]) * dx[i] for i in range(len(dx))]
        f, log_w = self._fields.at(cells, moves)
        log_w = log_w - action(moves, f, self._g, eps)
        log_w[np.isnan(log_w)] = -np.inf
        peak = log_w.max(axis=1, keepdims=True)
        log_w -= np.where(np.isfinite(peak), peak, 0.0)
        w = np.exp(log_w)
        w[log_w < -0.5 * self._reach**2] = 0.0
        return w / np.maximum(w.sum(axis=1, keepdims=True), 1e-300)


class _MomentStencil(_Stencil):
    """
    Weights with the step's mean and covariance, for noise of any width, none included.

    The step's Gaussian is taken apart into one axis given the ones before it, x = m + L y with L
    unit lower triangular and y independent, widest axis first.  Each axis is laid onto its nodes
    by weights with the right mean and variance: a sampled Gaussian where it is wide, three nodes
    where it is thin, and where even the thinnest weights with this mean are too wide (a mean
    between two nodes spreads by itself), the two nodes beside it.
    """

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings,
                 t: float) -> None:
        move, spread = step_moments(model, grid.points, settings, t)
        dx = grid.spacing
        spread = spread / (dx[:, None] * dx)[..., None]
        self._order = np.argsort(-spread.max(axis=2).diagonal(), kind='stable')
        self._lower, self._variance = _unit_triangular(
            spread[self._order][:, self._order])
        self.shift = _whole_cells(move / dx[:, None])
        self._rest = (move / dx[:, None] - self.shift)[self._order]
        self._reach = math.sqrt(stats.chi2.isf(settings.tolerance, 1))
        self._half = self._half_widths()
        self.offsets = np.empty((grid.ndim, np.prod(2 * self._half + 1)), dtype=int)
        self.offsets[self._order] = _box(self._half)

    def weights(self, cells: Integers) -> Array:
        """Return the weights (cells, K), exact in mass and mean."""
        w, y = np.ones(len(cells)), []
        for d, half in enumerate(self._half):
            # one axis of the array for each axis of the grid so far, and one for its nodes
            shape = (len(cells),) + (1,) * (d + 1)
            nodes = np.arange(-half, half + 1)
            mean = self._rest[d, cells].reshape(shape)
            for j in range(d):
                y[j] = y[j][..., None]
                mean = mean + self._lower[d, j, cells].reshape(shape) * y[j]
            w = w[..., None] * _node_weights(nodes, mean, self._variance[d, cells].reshape(shape))
            y.append(nodes - mean)
        return w.reshape(len(cells), -1)

    def _half_widths(self) -> Integers:
        """Return how many nodes each axis needs on either side of its shift."""
        half: list[int] = []
        for d in range(len(self._variance)):
            widest = float(self._variance[d].max())
            own = 1 if widest < THIN**2 else math.ceil(self._reach * math.sqrt(widest)) + 1
            lean = sum(float(np.abs(self._lower[d, j]).max()) * (half[j] + 0.5)
                       for j in range(d))
            half.append(own + math.ceil(lean))
        return np.array(half)


def _node_weights(nodes: Integers, mean: Array, variance: Array) -> Array:
    """Return weights on nodes with a mean and a variance, both in cells; sums are 1."""
    nearest = np.rint(mean)
    offset, position = mean - nearest, nodes - nearest
    # second moment about the nearest node, at least that of the two nodes beside the mean
    second = np.maximum(variance + offset**2, np.abs(offset))
    thin = np.where(position == 0, 1 - second,
                    np.where(np.abs(position) == 1, (second + position * offset) / 2, 0.0))
    if np.all(variance < THIN**2):
        return thin
    wide = np.exp(-(nodes - mean)**2 / (2 * np.maximum(variance, THIN**2)))
    return np.where(variance < THIN**2, thin, wide / wide.sum(axis=-1, keepdims=True))


class _Fields:
    """
    Drift and Jacobian at x^(r) = x' + r (x'' - x') for all moves of a stencil.

    For simple r these points are a lattice (the half-way points for r = 1/2), so that the model
    is asked once for each point of it instead of once for each move.
    """

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings, t: float,
                 shift: Integers, offsets: Integers) -> None:
        self._ask = lambda x: drift_terms(model, x, settings, t)
        self._r, self._points = settings.r, grid.points
        a, b = Fraction(settings.r).limit_denominator(4).as_integer_ratio()
        low = a * (shift.min(axis=1) + offsets.min(axis=1))
        high = (a * (shift.max(axis=1) + offsets.max(axis=1))
                + b * (np.array(grid.shape) - 1))
        shape = high - low + 1
        self._on_lattice = a / b == settings.r and math.prod(
            shape.tolist()) <= grid.size * offsets.shape[1]
        if not self._on_lattice:
            return
        axes = [grid.lower[i] + (0.5 + np.arange(low[i], high[i] + 1) / b) * grid.spacing[i]
                for i in range(grid.ndim)]
        lattice = np.stack(np.meshgrid(*axes, indexing='ij')).reshape(grid.ndim, -1)
        self._f, self._log_jacobian = self._ask(lattice)
        strides = _strides(shape)
        index = np.indices(grid.shape).reshape(grid.ndim, -1)
        self._base = strides @ (b * index + a * shift - low[:, None])
        self._moved = strides @ (a * offsets)

    def at(self, cells: Integers, moves: list[Array]) -> tuple[Array, Array]:
        """Return f (n, cells, K) and the log Jacobian (cells, K)."""
        if self._on_lattice:
            where = self._base[cells, None] + self._moved
            return np.stack([f.take(where) for f in self._f]), self._log_jacobian.take(where)
        return self._ask(np.stack([
            x[cells, None] + self._r * move for x, move in zip(self._points, moves)]))


def _columns(grid: Grid, stencil: _Stencil,
             extent: int) -> Iterator[tuple[Array, Integers, Integers]]:
    """Give weights, rows and their number per column, for some columns at a time."""
    shape, strides = np.array(grid.shape)[:, None], _strides(np.array(grid.shape))
    index = np.indices(grid.shape).reshape(grid.ndim, -1)
    start, moved = index + stencil.shift, strides @ stencil.offsets
    low, high = stencil.offsets.min(axis=1)[:, None], stencil.offsets.max(axis=1)[:, None]
    whole = np.all((start + low >= 0) & (start + high < shape), axis=0)
    base, moved = (strides @ start).astype(np.int32), moved.astype(np.int32)
    step = max(1, CHUNK // stencil.offsets.shape[1])
    for first in range(0, grid.size, step):
        cells = np.arange(first, min(first + step, grid.size))
        w = stencil.weights(cells)
        keep = w > 0
        rows = base[cells, None] + moved
        edge = np.flatnonzero(~whole[cells])
        rows[edge], inside = _land(
            grid, start[:, cells[edge], None] + stencil.offsets[:, None], strides)
        keep[edge] &= inside
        if extent:
            for i in range(grid.ndim):
                keep &= np.abs(stencil.shift[i, cells, None] + stencil.offsets[i]) <= extent
        yield w[keep], rows[keep], keep.sum(axis=1)


def _land(grid: Grid, target: Integers,
          strides: Integers) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the flat indices of cells (n, ...), and which of them are on the grid."""
    index = np.zeros(target.shape[1:], dtype=np.int32)
    inside = np.ones(index.shape, dtype=bool)
    for i, (cells, periodic) in enumerate(zip(grid.shape, grid.periodic)):
        if not periodic:
            inside &= (target[i] >= 0) & (target[i] < cells)
        index += (strides[i] * (target[i] % cells if periodic else target[i])).astype(np.int32)
    return index, inside


def _unit_triangular(spread: Array) -> tuple[Array, Array]:
    """Return L (n, n, N), unit lower triangular, and D (n, N) with spread = L D L^T."""
    n = len(spread)
    L = np.zeros(spread.shape)
    D = np.zeros(spread.shape[1:])
    floor = 1e-12 * np.einsum('iik->k', spread)
    for j in range(n):
        D[j] = spread[j, j] - sum(L[j, k]**2 * D[k] for k in range(j))
        D[j] = np.where(D[j] > floor, D[j], 0.0)
        L[j, j] = 1.0
        for i in range(j + 1, n):
            rest = spread[i, j] - sum(L[i, k] * L[j, k] * D[k] for k in range(j))
            L[i, j] = np.divide(rest, D[j], out=np.zeros_like(rest), where=D[j] > 0)
    return L, D


def _variance_in_cells(model: StateModel, grid: Grid, settings: KernelSettings,
                       t: float) -> Array:
    """Return eps g in cells, (n, n)."""
    variance = settings.time_step * model.diffusion(t + settings.r * settings.time_step)
    return variance / np.outer(grid.spacing, grid.spacing)


def _whole_cells(move: Array) -> Integers:
    return np.rint(np.nan_to_num(move, posinf=0.0, neginf=0.0)).astype(int)


def _box(half: Integers) -> Integers:
    """Return all offsets up to half cells on each axis, shape (n, K), in C order."""
    axes = [np.arange(-h, h + 1) for h in half]
    return np.stack(np.meshgrid(*axes, indexing='ij')).reshape(len(axes), -1)


def _strides(shape: Integers) -> Integers:
    return np.concatenate([np.cumprod(shape[:0:-1])[::-1], [1]]).astype(int)
