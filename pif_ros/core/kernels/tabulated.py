"""The Dirac-Feynman kernel tabulated on a grid: one stored weight per pair of cells."""

from __future__ import annotations

from collections.abc import Iterator
import dataclasses
import functools
import math
import operator

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.lattice import Integers, reach, strides_of, variance_in_cells
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.stencils import choose_stencils, Stencil
from pif_ros.core.models import StateModel
from scipy import sparse

Array = NDArray[np.float64]

#: Weights that are worked on at a time, for the sake of the cache.
CHUNK = 1 << 18


def dirac_feynman(model: StateModel, grid: Grid, settings: KernelSettings,
                  t: float = 0.0) -> sparse.csr_array:
    """
    Return the kernel of one step from time t, (size, size), row x'', column x'.

    A column is normalised against what it would hold if the grid went on; what leaves the grid is
    missing from it, and a periodic axis wraps.  Raises ValueError where 'sampled' weights are
    asked for a singular diffusion matrix, or a determinant for noise with s > 0 and an e that is
    not square.
    """
    model = _inflated(model.at_scale(grid.spacing), grid, settings)
    parts = [_tabulated(grid, stencil, cells, settings.extent)
             for stencil, cells in choose_stencils(model, grid, settings, t)]
    kernel = functools.reduce(operator.add, parts)
    if any(grid.periodic):
        kernel.sum_duplicates()
    return kernel.tocsr()


def stored_elements(model: StateModel, grid: Grid, settings: KernelSettings,
                    t: float = 0.0) -> float:
    """Return about how many weights a kernel holds, from the noise alone, without making it."""
    n, model = grid.ndim, _inflated(model, grid, settings)
    coarse = Grid(grid.lower, grid.upper, tuple(min(cells, 10) for cells in grid.shape))
    variance = variance_in_cells(model, coarse, settings, t)
    widths = np.sqrt(np.einsum('iik->ik', variance)) * (coarse.spacing / grid.spacing)[:, None]
    radii = reach(settings.tolerance, n) * widths + 0.5
    ball = math.pi**(n / 2) / math.gamma(n / 2 + 1) * float(np.prod(radii, axis=0).mean())
    return grid.size * max(ball, 3.0**n)


def _inflated(model: StateModel, grid: Grid, settings: KernelSettings) -> StateModel:
    """
    Return the model with the noise that the settings ask for  [Sensors, section 4.3].

    g = alpha dx: a step's standard deviation is sqrt(alpha dx eps).  What the sense of the model's
    own noise does to the drift stays.
    """
    if not settings.noise_inflation:
        return model
    return dataclasses.replace(
        model, noise_covariance=None, multiplicative=False, vielbein_jacobian=None, s=0.0,
        drift=model.ito_drift, drift_jacobian=model.ito_jacobian,
        vielbein=np.diag(np.sqrt(settings.noise_inflation * grid.spacing)))


def _tabulated(grid: Grid, stencil: Stencil, cells: Integers, extent: int) -> sparse.csc_array:
    """Return the columns of some cells, (size, size); the others are empty."""
    most = len(cells) * stencil.offsets.shape[1]
    data, rows = np.empty(most), np.empty(most, dtype=np.int32)
    counts, end = np.zeros(grid.size + 1, dtype=np.int64), 0
    for some, w, targets, count in _columns(grid, stencil, cells, extent):
        start, end = end, end + len(w)
        data[start:end], rows[start:end] = w, targets
        counts[some + 1] = count
    pointers = np.cumsum(counts)
    if end <= np.iinfo(np.int32).max:
        pointers = pointers.astype(np.int32)
    return sparse.csc_array((data[:end], rows[:end], pointers), shape=(grid.size, grid.size))


def _columns(grid: Grid, stencil: Stencil, cells: Integers,
             extent: int) -> Iterator[tuple[Integers, Array, NDArray[np.int32], Integers]]:
    """Give some cells at a time, with the weights, rows and number of weights of their columns."""
    shape, strides = np.array(grid.shape)[:, None], strides_of(np.array(grid.shape))
    start = np.indices(grid.shape).reshape(grid.ndim, -1) + stencil.shift
    low, high = stencil.offsets.min(axis=1)[:, None], stencil.offsets.max(axis=1)[:, None]
    whole = np.all((start + low >= 0) & (start + high < shape), axis=0)
    base, moved = ((strides @ place).astype(np.int32) for place in (start, stencil.offsets))
    step = max(1, CHUNK // stencil.offsets.shape[1])
    for first in range(0, len(cells), step):
        some = cells[first:first + step]
        w, leans = stencil.weights(some)
        keep = w > 0
        if leans is None:
            rows = base[some, None] + moved
            edge = np.flatnonzero(~whole[some])
            rows[edge], inside = _land(
                grid, start[:, some[edge], None] + stencil.offsets[:, None], strides)
            keep[edge] &= inside
        else:
            rows, inside = _land(
                grid, start[:, some, None] + stencil.offsets[:, None] + leans, strides)
            keep &= inside
        if extent:
            moves = stencil.shift[:, some, None] + stencil.offsets[:, None]
            keep &= np.all(np.abs(moves if leans is None else moves + leans) <= extent, axis=0)
        yield some, w[keep], rows[keep], keep.sum(axis=1)


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
