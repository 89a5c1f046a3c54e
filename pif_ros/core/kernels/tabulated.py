"""The Dirac-Feynman kernel tabulated on a grid: one stored weight per pair of cells."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from pif_ros.core.grid import Grid
from pif_ros.core.kernels.formula import Array, KernelSettings
from pif_ros.core.kernels.stencils import (
    choose_stencil, Integers, reach, Stencil, strides_of, variance_in_cells)
from pif_ros.core.models import StateModel

#: Weights that are worked on at a time, for the sake of the cache.
CHUNK = 1 << 18


def dirac_feynman(model: StateModel, grid: Grid, settings: KernelSettings,
                  t: float = 0.0) -> sparse.csr_array:
    """
    Return the kernel of one step from time t, (size, size), row x'', column x'.

    A column is normalised against what it would hold if the grid went on; what leaves the grid is
    missing from it, and a periodic axis wraps.  Raises ValueError where 'sampled' weights are
    asked for a singular diffusion matrix.
    """
    stencil = choose_stencil(model, grid, settings, t)
    most = grid.size * stencil.offsets.shape[1]
    data, rows = np.empty(most), np.empty(most, dtype=np.int32)
    counts, end = [np.zeros(1, dtype=int)], 0
    for w, targets, count in _columns(grid, stencil, settings.extent):
        start, end = end, end + len(w)
        data[start:end], rows[start:end] = w, targets
        counts.append(count)
    pointers = np.cumsum(np.concatenate(counts)).astype(np.int32)
    assert end <= np.iinfo(np.int32).max
    kernel = sparse.csc_array((data[:end], rows[:end], pointers), shape=(grid.size, grid.size))
    if any(grid.periodic):
        kernel.sum_duplicates()
    return kernel.tocsr()


def stored_elements(model: StateModel, grid: Grid, settings: KernelSettings,
                    t: float = 0.0) -> float:
    """Return about how many weights a kernel holds, from the noise alone, without making it."""
    variance = variance_in_cells(model, grid, settings, t)
    n, widths = grid.ndim, np.sqrt(np.diag(variance))
    radii = reach(settings.tolerance, n) * widths + 0.5
    ball = math.pi**(n / 2) / math.gamma(n / 2 + 1) * float(np.prod(radii))
    return grid.size * max(ball, 3.0**n)


def _columns(grid: Grid, stencil: Stencil,
             extent: int) -> Iterator[tuple[Array, Integers, Integers]]:
    """Give weights, rows and their number per column, for some columns at a time."""
    shape, strides = np.array(grid.shape)[:, None], strides_of(np.array(grid.shape))
    index = np.indices(grid.shape).reshape(grid.ndim, -1)
    start, moved = index + stencil.shift, strides @ stencil.offsets
    low, high = stencil.offsets.min(axis=1)[:, None], stencil.offsets.max(axis=1)[:, None]
    whole = np.all((start + low >= 0) & (start + high < shape), axis=0)
    base, moved = (strides @ start).astype(np.int32), moved.astype(np.int32)
    step = max(1, CHUNK // stencil.offsets.shape[1])
    for first in range(0, grid.size, step):
        cells = np.arange(first, min(first + step, grid.size))
        w = stencil.weights(cells)
        keep = w > 0
        rows = base[cells, None] + moved
        edge = np.flatnonzero(~whole[cells])
        rows[edge], inside = _land(
            grid, start[:, cells[edge], None] + stencil.offsets[:, None], strides)
        keep[edge] &= inside
        if extent:
            for i in range(grid.ndim):
                keep &= np.abs(stencil.shift[i, cells, None] + stencil.offsets[i]) <= extent
        yield w[keep], rows[keep], keep.sum(axis=1)


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
