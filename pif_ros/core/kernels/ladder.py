"""Kernels of longer and longer steps, as long as they say what the short ones do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import itertools

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.operators import Operator
from pif_ros.core.kernels.split import SplitKernel

Array = NDArray[np.float64]

#: No rung is longer than so many doublings of the step.
HIGHEST = 10
#: A rung with so many times the weights of the one below is no gain; from three nodes on an axis
#: to a Gaussian's there is a jump to little more than twice as many.
DEARER = 2.5
#: Deviation of the narrow probes in cells: what is narrower no grid carries well.
NARROW_PROBE = 3.0


def ladder(make: Callable[[float], Operator], first: Operator, grid: Grid, time_step: float,
           error: float) -> tuple[Operator, ...]:
    """
    Return the kernels of 1, 2, 4, ... steps, each made at once.

    make: what gives the kernel of a step of some seconds; first: that of time_step.  A rung is
    taken where one step of it differs by at most this error in L1 from two of the rung below, on
    every probe and in either order.
    """
    rungs = [first]
    while len(rungs) <= HIGHEST:
        longer, below = make(time_step * 2**len(rungs)), rungs[-1]
        if longer.nnz > DEARER * below.nnz or not _agree(longer, below, grid, error):
            break
        rungs.append(longer)
    return tuple(rungs)


def turned(kernel: Operator, step_ns: int, t_ns: int) -> Operator:
    """
    Return a kernel in the order that the step of a length from a stamp takes it in.

    A split one alternates its order, and by the stamp alone, so that it does not matter in how
    many calls steps are taken.
    """
    odd = t_ns // step_ns % 2
    return kernel.turned if odd and isinstance(kernel, SplitKernel) else kernel


def probes(grid: Grid) -> Iterator[Array]:
    """
    Give densities (size,) to try a kernel on: Gaussians in the middle and half-way to the corners.

    Narrow ones, and wide ones of an eighth of the box.
    """
    lower, size = np.array(grid.lower), np.array(grid.upper) - np.array(grid.lower)
    places = [np.full(grid.ndim, 0.5),
              *map(np.array, itertools.product((0.25, 0.75), repeat=grid.ndim))]
    for place, width in itertools.product(places, (NARROW_PROBE * grid.spacing, size / 8)):
        belief = GridBelief.gaussian(grid, lower + place * size, np.diag(width**2))
        yield belief.density.ravel()


def _agree(longer: Operator, below: Operator, grid: Grid, error: float) -> bool:
    """Return whether one step is as good as two of half its length on all probes."""
    for p in probes(grid):
        for t in (0, 1):
            twice = turned(below, 1, t + 1) @ (turned(below, 1, t) @ p)
            once = turned(longer, 1, t) @ p
            if np.abs(once - twice).sum() * grid.cell_volume > error:
                return False
    return True
