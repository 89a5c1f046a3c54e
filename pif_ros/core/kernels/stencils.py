"""Where each cell's mass may go in one step, and with what weights."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.lattice import Integers, variance_in_cells
from pif_ros.core.kernels.moments import step_moments
from pif_ros.core.kernels.multiplicative import alike, MultiplicativeStencil
from pif_ros.core.kernels.sampled import SampledStencil, STRETCH
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.thin import MomentStencil, THIN
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]


class Stencil(Protocol):
    """
    Where each cell's mass may go, and with what weights.

    Cell i moves by shift[:, i] + offsets[:, k] cells, k = 0 ... K - 1, and by what it leans.
    """

    shift: Integers
    offsets: Integers

    def weights(self, cells: Integers) -> tuple[Array, Integers | None]:
        """
        Return what each move from some cells weighs, (cells, K), and leans, (n, cells, K).

        A row of weights sums to 1; leans of None are none.
        """


def choose_stencils(model: StateModel, grid: Grid, settings: KernelSettings,
                    t: float) -> list[tuple[Stencil, Integers]]:
    """
    Return the stencils that the settings ask for, or that suit the step, and for which cells.

    The density sampled at the cells' centres is the step itself, but needs noise that is at least
    THIN; the moments hold everywhere.
    """
    _check_jacobian(model, settings, t)
    step = step_moments(model, grid.points, grid.spacing, settings, t)
    plain = variance_in_cells(model, grid, settings, t)
    regular = np.linalg.matrix_rank(np.moveaxis(plain, -1, 0), hermitian=True) == grid.ndim
    must_sample = settings.weights == 'sampled' or settings.weights == 'auto' and settings.extent
    if must_sample and not regular.all():
        raise ValueError("weights: expected 'moments', or 'auto' without an extent, where the "
                         'noise does not reach every state (g = e Q e^T is singular), '
                         f'got {settings.weights!r}')
    if must_sample:
        sampled = np.ones(grid.size, dtype=bool)
    elif settings.weights == 'auto':
        sampled = step.settled & regular & _is_wide(step.covariance, grid.spacing, plain, regular)
    else:
        sampled = np.zeros(grid.size, dtype=bool)
    chosen: list[tuple[Stencil, Integers]] = []
    if sampled.any() and model.multiplicative:
        chosen += [(MultiplicativeStencil(model, grid, settings, t, step, cells), cells)
                   for cells in alike(step, grid, np.flatnonzero(sampled))]
    elif sampled.any():
        cells = np.flatnonzero(sampled)
        chosen.append((SampledStencil(model, grid, settings, t, step, cells), cells))
    if not sampled.all():
        cells = np.flatnonzero(~sampled)
        chosen.append((MomentStencil(grid, settings, step, cells), cells))
    return chosen


def _check_jacobian(model: StateModel, settings: KernelSettings, t: float) -> None:
    """Refuse a determinant where the noise of a step cannot be told from the step."""
    if model.noise_bends and settings.jacobian == 'determinant':
        shape = model.vielbein_at(np.zeros((model.ndim, 1)), t).shape[:2]
        if shape[0] != shape[1]:
            raise ValueError("jacobian: expected 'exponential' where s > 0 and e is not square, "
                             f"got 'determinant' with an e of {shape[0]} x {shape[1]}")


def _is_wide(covariance: Array, spacing: Array, plain: Array,
             regular: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a step is wide enough to be sampled, and no wider than a window is made for."""
    in_cells = np.moveaxis(covariance / np.outer(spacing, spacing)[..., None], -1, 0)
    in_cells = np.where(regular[:, None, None], in_cells, np.eye(len(spacing)))
    # each state's noise with the others given, and its noise alone
    given = 1 / np.diagonal(np.linalg.inv(in_cells), axis1=1, axis2=2)
    alone = np.diagonal(in_cells, axis1=1, axis2=2)
    return np.asarray(np.all(given >= THIN**2, axis=1)
                      & np.all(alone <= STRETCH**2 * np.einsum('iik->ki', plain), axis=1))
