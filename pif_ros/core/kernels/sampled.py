"""The density of a step sampled at the centres of the cells that it may reach."""

from __future__ import annotations

from fractions import Fraction
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import action, drift_terms
from pif_ros.core.kernels.lattice import box, Integers, reach, strides_of, whole_cells
from pif_ros.core.kernels.moments import StepMoments
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]

#: A window follows a steep drift that widens the step up to so many times the plain noise.
STRETCH = 2.0


class SampledStencil:
    """The density of the step at the cell centres, any r, either Jacobian."""

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings, t: float,
                 step: StepMoments, cells: Integers) -> None:
        dx, eps = grid.spacing, settings.time_step
        self.shift = whole_cells(step.mean / dx[:, None])
        self._grid, self._settings = grid, settings
        self._g = model.diffusion(t + settings.r * eps)
        self._reach = reach(settings.tolerance, grid.ndim)
        # a steep drift may widen the step
        plain = eps * np.diag(self._g)
        widest = np.diagonal(step.covariance[..., cells].max(axis=2)) / plain
        stretch = np.sqrt(np.clip(widest, 1.0, STRETCH**2))
        half = np.ceil(self._reach * stretch * np.sqrt(plain) / dx + 0.5)
        cube = box(half.astype(int))
        # the ellipse of the step, and half a cell around it since shifts are whole cells
        whiten = np.linalg.inv(np.linalg.cholesky(eps * self._g)) * dx
        inner = np.maximum(np.abs(cube) - 0.5, 0) * np.sign(cube) / stretch[:, None]
        self.offsets = cube[:, np.linalg.norm(whiten @ inner, axis=0) <= self._reach]
        self._fields = _Fields(model, grid, settings, t, self.shift, self.offsets)

    def weights(self, cells: Integers) -> tuple[Array, Integers | None]:
        """Return what each move weighs, normalised over the unlimited lattice, (cells, K)."""
        dx, eps = self._grid.spacing, self._settings.time_step
        moves = [(self.shift[i, cells, None] + self.offsets[i]) * dx[i] for i in range(len(dx))]
        f, log_w = self._fields.at(cells, moves)
        return normalised(log_w - action(moves, f, self._g, eps), self._reach), None


def normalised(log_w: Array, radius: float) -> Array:
    """Return rows that sum to 1, without what is less than a Gaussian has at a radius."""
    log_w[~(log_w < np.inf)] = -np.inf
    peak = log_w.max(axis=1, keepdims=True)
    log_w -= np.where(np.isfinite(peak), peak, 0.0)
    w = np.exp(log_w)
    w[log_w < -0.5 * radius**2] = 0.0
    return w / np.maximum(w.sum(axis=1, keepdims=True), 1e-300)


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
