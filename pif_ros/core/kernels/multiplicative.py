"""Steps of multiplicative noise, each cell with a width of its own, sampled at the centres."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import drift_terms, log_transition_density
from pif_ros.core.kernels.lattice import box, Integers, reach, whole_cells
from pif_ros.core.kernels.moments import noise_roughness, StepMoments
from pif_ros.core.kernels.sampled import normalised
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]


def alike(step: StepMoments, grid: Grid, cells: Integers) -> Iterator[Integers]:
    """Give the cells whose steps are about as wide together, since they share a window."""
    width = np.sqrt(np.einsum('iik->ik', step.covariance[..., cells])) / grid.spacing[:, None]
    _, group = np.unique(np.ceil(2 * np.log2(width)), axis=1, return_inverse=True)
    for number in range(group.max() + 1):
        yield cells[group.ravel() == number]


class MultiplicativeStencil:
    """The density of the step at the cell centres, for some cells that are about as wide."""

    def __init__(self, model: StateModel, grid: Grid, settings: KernelSettings, t: float,
                 step: StepMoments, cells: Integers) -> None:
        self._model, self._grid, self._settings, self._t = model, grid, settings, t
        dx = grid.spacing
        self.shift = whole_cells(step.mean / dx[:, None])
        self._reach, self._cells = reach(settings.tolerance, grid.ndim), cells
        wide = np.moveaxis(step.covariance[..., cells] / np.outer(dx, dx)[..., None], -1, 0)
        self._whiten = np.linalg.inv(np.linalg.cholesky(wide))
        # a window that holds the ellipses of all the cells, and half a cell around them
        self._radius = self._reach * self._skew(cells)
        middle = np.linalg.inv(np.linalg.cholesky(wide.mean(axis=0)))
        widest = math.sqrt(np.linalg.eigvalsh(middle @ wide @ middle.T).max())
        half = widest * self._radius * np.sqrt(np.diag(wide.mean(axis=0))) + 0.5
        cube = box(np.ceil(half).astype(int))
        self.offsets = cube[:, np.linalg.norm(
            middle @ _inner(cube), axis=0) <= widest * self._radius]

    def weights(self, cells: Integers) -> tuple[Array, Integers | None]:
        """Return what each move weighs, normalised over the unlimited lattice, (cells, K)."""
        model, grid = self._model, self._grid
        whiten = self._whiten[np.searchsorted(self._cells, cells)]
        near = np.linalg.norm(whiten @ _inner(self.offsets), axis=1) <= self._radius
        cell, move = np.nonzero(near)
        x = grid.points[:, cells[cell]]
        moved = (self.shift[:, cells[cell]] + self.offsets[:, move]) * grid.spacing[:, None]
        log_w = np.full(near.shape, -np.inf)
        with np.errstate(all='ignore'):
            log_w[near] = (self._bent if model.noise_bends else self._straight)(x, moved, cell,
                                                                                cells)
        return normalised(log_w, self._reach), None

    def _bent(self, x: Array, moved: Array, cell: Integers, cells: Integers) -> Array:
        return log_transition_density(self._model, x + moved, x, self._settings, self._t)

    def _straight(self, x: Array, moved: Array, cell: Integers, cells: Integers) -> Array:
        """Return the same but for a constant of each cell, whose moves all have its noise."""
        settings, eps = self._settings, self._settings.time_step
        f, log_jacobian = drift_terms(self._model, x + settings.r * moved, settings, self._t)
        g = self._model.diffusion_at(self._grid.points[:, cells], self._t + settings.r * eps)
        whiten = np.linalg.inv(np.linalg.cholesky(eps * np.moveaxis(g, -1, 0)))
        z = np.einsum('kij,jk->ik', whiten[cell], moved - eps * f)
        return log_jacobian - 0.5 * np.einsum('ik,ik->k', z, z)

    def _skew(self, cells: Integers) -> float:
        """Return how much longer the longer tail is, since noise that bends widens on its way."""
        model, eps = self._model, self._settings.time_step
        if not model.noise_bends:
            return 1.0
        rough = noise_roughness(model, self._grid.points[:, cells], eps,
                                self._t + self._settings.r * eps)
        z = self._reach * float(rough.max())
        return math.expm1(z) / z if z > 0 else 1.0


def _inner(moves: Integers) -> Array:
    """Return the corners of some moves' cells that are nearest to the origin."""
    return np.maximum(np.abs(moves) - 0.5, 0) * np.sign(moves)
