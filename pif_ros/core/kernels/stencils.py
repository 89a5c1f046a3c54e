"""Where each cell's mass may go in one step, and with what weights."""

from __future__ import annotations

from fractions import Fraction
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainccinv

from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import (
    action, Array, drift_terms, KernelSettings, step_moments)
from pif_ros.core.models import StateModel

Integers = NDArray[np.int64]

#: Thinner than this, in cells per step, a Gaussian sampled at the nodes has a wrong variance.
THIN = 0.7
#: No move is longer than this, in cells; it has left any grid.
FAR = 1e9


class Stencil(Protocol):
    """
    Where each cell's mass may go, and with what weights.

    Cell i moves by shift[:, i] + offsets[:, k] cells, k = 0 ... K - 1.
    """

    shift: Integers
    offsets: Integers

    def weights(self, cells: Integers) -> Array:
        """Return the weights (cells, K) of the moves from some cells; each row sums to 1."""


def choose_stencil(model: StateModel, grid: Grid, settings: KernelSettings, t: float) -> Stencil:
    """Return the stencil that the settings ask for, or that suits the noise."""
    variance = variance_in_cells(model, grid, settings, t)
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


class _SampledStencil:
    """The density of the step at the cell centres, any r, either Jacobian."""

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings,
                 t: float) -> None:
        move, spread = step_moments(model, grid.points, settings, t, iterations=1)
        dx, eps = grid.spacing, settings.time_step
        self.shift = _whole_cells(move / dx[:, None])
        self._model, self._grid, self._settings, self._t = model, grid, settings, t
        self._g = model.diffusion(t + settings.r * eps)
        self._reach = reach(settings.tolerance, grid.ndim)
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


class _MomentStencil:
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
        self._reach = reach(settings.tolerance, 1)
        self._half = self._half_widths()
        self.offsets = np.empty((grid.ndim, np.prod(2 * self._half + 1)), dtype=int)
        self.offsets[self._order] = _box(self._half)

    def weights(self, cells: Integers) -> Array:
        """Return the weights (cells, K), exact in mass and mean."""
        w: Array = np.ones(len(cells))
        y: list[Array] = []
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
        strides = strides_of(shape)
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


def reach(tolerance: float, n: int) -> float:
    """Return the radius, in standard deviations, beyond which a Gaussian has this share."""
    return math.sqrt(2 * gammainccinv(n / 2, tolerance))


def variance_in_cells(model: StateModel, grid: Grid, settings: KernelSettings,
                      t: float) -> Array:
    """Return eps g in cells, (n, n)."""
    variance = settings.time_step * model.diffusion(t + settings.r * settings.time_step)
    return variance / np.outer(grid.spacing, grid.spacing)


def _whole_cells(move: Array) -> Integers:
    return np.rint(np.clip(np.nan_to_num(move), -FAR, FAR)).astype(int)


def _box(half: Integers) -> Integers:
    """Return all offsets up to half cells on each axis, shape (n, K), in C order."""
    axes = [np.arange(-h, h + 1) for h in half]
    return np.stack(np.meshgrid(*axes, indexing='ij')).reshape(len(axes), -1)


def strides_of(shape: Integers) -> Integers:
    return np.concatenate([np.cumprod(shape[:0:-1])[::-1], [1]]).astype(int)
