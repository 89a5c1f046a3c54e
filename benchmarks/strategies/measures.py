"""What the strategies are held against: densities carried on, and the exact ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, Operator
from pif_ros.core.systems import sine_cubic_drift
from scipy.interpolate import CubicSpline

Array = NDArray[np.float64]
#: A density (N,) of states (n, N).
Density = Callable[[Array], Array]

#: Where the one-dimensional system lives, the paper's cells, and those of its reference.
LINE = ((-20.0,), (20.0,))
LINE_CELLS, FINE_CELLS = 160, 800


def start(grid: Grid) -> Array:
    """Return N(0, 1) on a grid, (size,)."""
    return GridBelief.gaussian(grid, np.zeros(grid.ndim), np.eye(grid.ndim)).density.ravel()


def carried(operator: Operator, p: Array, times: int) -> Array:
    """Return a density (size,) after an operator is applied so many times."""
    for _ in range(times):
        p = operator @ p
    return p


def products(operator: Operator, p: Array, times: int = 1) -> Callable[[int], object]:
    """Return what applies an operator to a density so many times, each time it is called."""
    return lambda k: carried(operator, p, times)


def l1(p: Array, q: Array, grid: Grid) -> float:
    """Return the integral of |p - q| over a grid."""
    return float(np.abs(p - q).sum() * grid.cell_volume)


def to_exact(p: Array, density: Density, grid: Grid) -> float:
    """Return the integral of |p - q|, with what of q lies off the grid."""
    q = density(grid.points)
    return l1(p, q, grid) + max(1 - float(q.sum()) * grid.cell_volume, 0.0)


def line(cells: int) -> Grid:
    """Return the grid of the one-dimensional system."""
    return Grid(*LINE, (cells,))


def exact_on_line(time_step: float, steps: int) -> Density:
    """
    Return the density of sine_cubic_drift some steps after N(0, 1).

    Fine cells, two and four sub-steps, extrapolated, since the kernel's error is of first order.
    """
    grid, found = line(FINE_CELLS), []
    for substeps in (2, 4):
        kernel = dirac_feynman(sine_cubic_drift().model, grid, KernelSettings(
            time_step / substeps, weights='sampled', tolerance=1e-9))
        found.append(carried(kernel, start(grid), substeps * steps))
    spline = CubicSpline(grid.axes[0], 2 * found[1] - found[0])
    return lambda x: np.asarray(spline(x[0]))
