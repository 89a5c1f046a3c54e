"""Where each cell's mass may go in one step, and with what weights."""

from __future__ import annotations

from fractions import Fraction
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import (action, Array, drift_terms, KernelSettings, step_moments,
                                          StepMoments)
from pif_ros.core.models import StateModel
from scipy.special import gammainccinv

Integers = NDArray[np.int64]

#: Thinner than this, in cells per step, a Gaussian sampled at the nodes has a wrong variance.
THIN = 0.7
#: A window follows a steep drift that widens the step up to so many times the plain noise.
STRETCH = 2.0
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
        """Return what each move from some cells weighs, (cells, K); a row sums to 1."""


def choose_stencils(model: StateModel, grid: Grid, settings: KernelSettings,
                    t: float) -> list[tuple[Stencil, Integers]]:
    """
    Return the stencils that the settings ask for, or that suit the step, and for which cells.

    The density sampled at the cells' centres is the step itself, but needs noise that is at least
    THIN; the moments hold everywhere.
    """
    variance = variance_in_cells(model, grid, settings, t)
    regular = np.linalg.matrix_rank(variance, hermitian=True) == len(variance)
    if not regular and (settings.weights == 'sampled'
                        or settings.weights == 'auto' and settings.extent):
        raise ValueError("weights: expected 'moments', or 'auto' without an extent, where the "
                         'noise does not reach every state (g = e Q e^T is singular), '
                         f'got {settings.weights!r}')
    step = step_moments(model, grid.points, grid.spacing, settings, t)
    if settings.weights == 'sampled' or (settings.weights == 'auto' and settings.extent):
        sampled = np.ones(grid.size, dtype=bool)
    elif settings.weights == 'auto' and regular:
        sampled = step.settled & _is_wide(step.covariance, grid.spacing, variance)
    else:
        sampled = np.zeros(grid.size, dtype=bool)
    chosen: list[tuple[Stencil, Integers]] = []
    if sampled.any():
        cells = np.flatnonzero(sampled)
        chosen.append((_SampledStencil(model, grid, settings, t, step, cells), cells))
    if not sampled.all():
        cells = np.flatnonzero(~sampled)
        chosen.append((_MomentStencil(grid, settings, step, cells), cells))
    return chosen


def _is_wide(covariance: Array, spacing: Array, plain: Array) -> NDArray[np.bool_]:
    """Return where a step is wide enough to be sampled, and no wider than a window is made for."""
    in_cells = np.moveaxis(covariance / np.outer(spacing, spacing)[..., None], -1, 0)
    # each state's noise with the others given, and its noise alone
    given = 1 / np.diagonal(np.linalg.inv(in_cells), axis1=1, axis2=2)
    alone = np.diagonal(in_cells, axis1=1, axis2=2)
    return np.asarray(np.all(given >= THIN**2, axis=1)
                      & np.all(alone <= STRETCH**2 * np.diag(plain), axis=1))


class _SampledStencil:
    """The density of the step at the cell centres, any r, either Jacobian."""

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings, t: float,
                 step: StepMoments, cells: Integers) -> None:
        dx, eps = grid.spacing, settings.time_step
        self.shift = _whole_cells(step.mean / dx[:, None])
        self._grid, self._settings = grid, settings
        self._g = model.diffusion(t + settings.r * eps)
        self._reach = reach(settings.tolerance, grid.ndim)
        # a steep drift may widen the step
        plain = eps * np.diag(self._g)
        widest = np.diagonal(step.covariance[..., cells].max(axis=2)) / plain
        stretch = np.sqrt(np.clip(widest, 1.0, STRETCH**2))
        half = np.ceil(self._reach * stretch * np.sqrt(plain) / dx + 0.5)
        box = _box(half.astype(int))
        # the ellipse of the step, and half a cell around it since shifts are whole cells
        whiten = np.linalg.inv(np.linalg.cholesky(eps * self._g)) * dx
        inner = np.maximum(np.abs(box) - 0.5, 0) * np.sign(box) / stretch[:, None]
        self.offsets = box[:, np.linalg.norm(whiten @ inner, axis=0) <= self._reach]
        self._fields = _Fields(model, grid, settings, t, self.shift, self.offsets)

    def weights(self, cells: Integers) -> Array:
        """Return what each move weighs, normalised over the unlimited lattice, (cells, K)."""
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
    unit lower triangular and y independent, the widest of what is left first.  Each axis is laid
    onto its nodes by weights with the right mean and variance: a sampled Gaussian where it is
    wide, three nodes where it is thin, and where even the thinnest weights with this mean are too
    wide (a mean between two nodes spreads by itself), the two nodes beside it.
    """

    def __init__(self, grid: Grid, settings: KernelSettings, step: StepMoments,
                 cells: Integers) -> None:
        dx = grid.spacing
        spread = step.covariance / np.outer(dx, dx)[..., None]
        order = _widest_first(spread[..., cells].mean(axis=2))
        self._lower, self._variance = _unit_triangular(spread[order][:, order])
        self.shift = _whole_cells(step.mean / dx[:, None])
        self._rest = (step.mean / dx[:, None] - self.shift)[order]
        self._half = self._half_widths(reach(settings.tolerance, 1), cells)
        self.offsets = np.empty((grid.ndim, np.prod(2 * self._half + 1)), dtype=int)
        self.offsets[order] = _box(self._half)

    def weights(self, cells: Integers) -> Array:
        """Return what each move weighs, exact in mass and thin means, (cells, K)."""
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
            wanted = self._variance[d, cells].reshape(shape)
            w_d, variance = _node_weights(nodes, mean, wanted)
            w = w[..., None] * w_d
            # where the nodes spread more than they should, later axes lean on them less
            lean = np.divide(wanted, variance, out=np.zeros_like(variance), where=variance > 0)
            y.append((nodes - mean) * lean)
        return w.reshape(len(cells), -1)

    def _half_widths(self, radius: float, cells: Integers) -> Integers:
        """Return how many nodes each axis needs on either side of its shift."""
        half: list[int] = []
        for d in range(len(self._variance)):
            widest = float(self._variance[d, cells].max())
            own = 1 if widest < THIN**2 else math.ceil(radius * math.sqrt(widest)) + 1
            lean = sum(float(np.abs(self._lower[d, j, cells]).max()) * (half[j] + 0.5)
                       for j in range(d))
            half.append(own + math.ceil(lean))
        return np.array(half)


def _node_weights(nodes: Integers, mean: Array, variance: Array) -> tuple[Array, Array]:
    """Return weights on nodes with a mean and, where it can be, a variance; and that variance."""
    nearest = np.rint(mean)
    offset, position = mean - nearest, nodes - nearest
    # second moment about the nearest node, at least that of the two nodes beside the mean
    second = np.maximum(variance + offset**2, np.abs(offset))
    thin = np.where(position == 0, 1 - second,
                    np.where(np.abs(position) == 1, (second + position * offset) / 2, 0.0))
    is_thin = variance < THIN**2
    if np.all(is_thin):
        return thin, second - offset**2
    wide = np.exp(-(nodes - mean)**2 / (2 * np.maximum(variance, THIN**2)))
    wide /= wide.sum(axis=-1, keepdims=True)
    return np.where(is_thin, thin, wide), np.where(is_thin, second - offset**2, variance)


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


def _widest_first(covariance: Array) -> Integers:
    """Return the axes in the order in which each has the most variance left, the former given."""
    left = covariance.copy()
    order: list[int] = []
    for _ in range(len(left)):
        variance = np.diagonal(left).copy()
        variance[order] = -1.0
        widest = int(np.argmax(variance))
        order.append(widest)
        if variance[widest] > 0:
            left = left - np.outer(left[widest], left[widest]) / left[widest, widest]
    return np.array(order)


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
