"""The problem that all contestants of the step are given  [Sensors, Eqs. 31, 32]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import coupled_trigonometric

Array = NDArray[np.float64]

SYSTEM = coupled_trigonometric()
SENSOR = SYSTEM.sensors['squares']()
EDGE = 6.0
TIME_STEP = 0.01
STEP_NS = 10_000_000
PRIOR_MEAN = np.zeros(2)
PRIOR_COVARIANCE = 10 * np.eye(2)


@dataclass(frozen=True, eq=False)
class Recording:
    """A simulated path (steps, 2) and what was measured along it (steps, 2)."""

    truth: Array
    measurements: Array


def box(cells: int) -> Grid:
    """Return the box of the paper with so many cells on each axis."""
    return Grid((-EDGE, -EDGE), (EDGE, EDGE), (cells, cells))


def grid_filter(cells: int, settings: KernelSettings,
                average_cells: bool = False) -> DiracFeynmanFilter:
    """Return this package's filter for the problem."""
    return DiracFeynmanFilter(SYSTEM.model, box(cells), {'squares': SENSOR}, settings,
                              average_cells)


def prior(grid: Grid) -> GridBelief:
    """Return N(0, 10 I) on a grid, cut at its edges."""
    return GridBelief.gaussian(grid, PRIOR_MEAN, PRIOR_COVARIANCE)


def simulate(seed: int, steps: int, substeps: int = 20, margin: float = 1.0) -> Recording:
    """
    Return a path drawn from the prior, and its measurements, one per time step.

    Euler's method with substeps; a path that comes nearer to the edge than the margin is drawn
    again, since no grid could follow it.
    """
    rng = np.random.default_rng(seed)
    while True:
        x = rng.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE)
        path = np.empty((steps, 2))
        for k in range(steps):
            x = euler(x[:, None], TIME_STEP, substeps, rng)[:, 0]
            path[k] = x
        if np.abs(path).max() < EDGE - margin:
            return Recording(path, path**2 + rng.standard_normal(path.shape))


def euler(x: Array, seconds: float, substeps: int, rng: np.random.Generator) -> Array:
    """Return states (2, N) after some seconds of Euler's method."""
    eps = seconds / substeps
    for _ in range(substeps):
        x = x + eps * SYSTEM.model.drift(x, 0.0) + np.sqrt(eps) * rng.standard_normal(x.shape)
    return x
