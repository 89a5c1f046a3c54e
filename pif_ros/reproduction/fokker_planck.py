"""The Fokker-Planck equation in one dimension, solved as a reference for transition densities."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from scipy import sparse
from scipy.sparse.linalg import expm_multiply

Array = NDArray[np.float64]


def fokker_planck(model: StateModel, grid: Grid, starts: Sequence[float],
                  seconds: float) -> Array:
    """
    Return the densities of a scalar process so many seconds after it was at points, (S, size).

    dp/dt = -d(f p)/dx + (g/2) d^2 p/dx^2  [TM, Eq. 10] in finite volumes with exponentially fitted
    fluxes (Scharfetter and Gummel 1969), second order in the cell, and the exponential of that
    matrix, exact in time.  No mass leaves the grid.
    """
    p = np.stack([sharp_point(grid, x) for x in starts], axis=1)
    moved: Array = expm_multiply(generator(model, grid) * seconds, p)
    return moved.T


def generator(model: StateModel, grid: Grid) -> sparse.csc_array:
    """Return G of dp/dt = G p for the density p in the cells; its columns sum to 0."""
    dx, D = grid.spacing[0], 0.5 * float(model.diffusion(0.0)[0, 0])
    edges = 0.5 * (grid.points[:, 1:] + grid.points[:, :-1])
    z = np.asarray(model.drift(edges, 0.0))[0] * dx / D
    up, down = D / dx**2 * _bernoulli(-z), D / dx**2 * _bernoulli(z)
    stay = -np.append(up, 0.0) - np.append(0.0, down)
    return sparse.csc_array(sparse.diags([up, stay, down], offsets=[-1, 0, 1]))


def point(grid: Grid, x: float) -> Array:
    """Return the density (size,) of a state that is known, shared between two cells."""
    where = (x - grid.axes[0][0]) / grid.spacing[0]
    low = int(np.floor(where))
    p = np.zeros(grid.size)
    p[low:low + 2] = low + 1 - where, where - low
    return p / grid.cell_volume


def sharp_point(grid: Grid, x: float) -> Array:
    """
    Return the density (size,) of a state that is known, with its variance, 0, as well.

    Three cells, of which one is below 0: for what is linear, and not for a belief.
    """
    where = (x - grid.axes[0][0]) / grid.spacing[0]
    nearest = round(where)
    d, p = where - nearest, np.zeros(grid.size)
    p[nearest - 1:nearest + 2] = d * (d - 1) / 2, 1 - d * d, d * (d + 1) / 2
    return p / grid.cell_volume


def _bernoulli(z: Array) -> Array:
    """Return z / (exp(z) - 1), 1 at 0."""
    small = np.abs(z) < 1e-8
    return np.where(small, 1 - z / 2, z / np.expm1(np.where(small, 1.0, z)))
