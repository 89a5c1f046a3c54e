"""
The kernel split by axis: one operator along each, exact in mass, mean and variance.

exp(eps L) of the generator L = sum_d L_d, L_d = f_d d/dx_d + g_dd/2 d^2/dx_d^2, is the product of
the exp(eps L_d) to first order in eps; with the order turned round at every other step it is to
second order  [Strang 1968].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.blocks import BlockFactor, Chain, compiled, product, SPARED
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.kernels.lattice import FAR, Integers, strides_of, variance_in_cells, whole_cells
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.single import narrow, widen
from pif_ros.core.kernels.tilted import half_width, lattice_weights
from pif_ros.core.models import StateModel
from scipy import sparse

Array = NDArray[np.float64]

#: Weights that are worked on at a time, for the sake of the cache.
CHUNK = 1 << 17
#: Where eps df/dx changes by more than this from one cell to the next, its value is an accident.
ROUGH = 0.3
#: A step in which the drift grows by more than exp of this is no step.
GROWTH = 1.0


@dataclass(frozen=True, eq=False)
class SplitKernel:
    """
    A product of sparse operators: densities move as K @ p, the first factor first.

    In blocks where there is a compiler, else as sparse arrays; either gives the other's result,
    but for what is not worth carrying.
    """

    factors: tuple[sparse.csc_array | BlockFactor, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Return the shape as of a matrix, (size, size)."""
        return self.factors[0].shape

    @property
    def nnz(self) -> int:
        """Return the number of stored weights."""
        return sum(int(factor.nnz) for factor in self.factors)

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return sum(factor.nbytes if isinstance(factor, BlockFactor) else
                   factor.data.nbytes + factor.indices.nbytes + factor.indptr.nbytes
                   for factor in self.factors)

    def __matmul__(self, density: Any) -> Any:
        """Return the densities (size,) or (size, targets) after the step."""
        if density.ndim == 1 and self._chain is not None:
            return self._chain @ density
        if self.factors[0].dtype == np.float64:
            return self._moved(density)
        shares, densest = narrow(density)
        return widen(self._moved(shares), densest)

    @cached_property
    def turned(self) -> SplitKernel:
        """Return the same factors in the opposite order."""
        return SplitKernel(self.factors[::-1])

    @property
    def T(self) -> SplitKernel:  # noqa: N802
        """Return the transpose."""
        return SplitKernel(tuple(factor.T for factor in self.factors[::-1]))

    def _moved(self, p: Any) -> Any:
        if self._in_blocks:
            return product(self.factors, p)
        for factor in self.factors:
            p = factor @ p
        return p

    @cached_property
    def _chain(self) -> Chain | None:
        """Return the factors in one piece, None where that is not worth their copy."""
        factors = [factor for factor in self.factors if isinstance(factor, BlockFactor)]
        if (len(factors) < len(self.factors) or factors[0].dtype != np.float64
                or factors[0].size >= SPARED):
            return None
        return Chain.of(factors)

    @cached_property
    def _in_blocks(self) -> bool:
        return all(isinstance(factor, BlockFactor) for factor in self.factors)


def split_kernel(model: StateModel, grid: Grid, settings: KernelSettings,
                 t: float = 0.0) -> SplitKernel:
    """
    Return the kernel of one step from time t, a factor for each axis, then the other directions.

    Each factor's columns are normalised on the lattice that goes on; what leaves the grid is
    missing from them, and a periodic axis wraps.  f and g are taken at t + eps / 2.  Raises
    ValueError for a drift that is not finite, or more than three correlated axes.
    """
    variance = variance_in_cells(model, grid, settings, t)[..., 0]
    along, others = integer_directions(variance)
    factors = []
    for axis, (mean, spread) in enumerate(_axis_moments(model, grid, settings, t, along)):
        step = np.eye(grid.ndim, dtype=int)[axis]
        factors.append(_factor(grid, settings, step, mean, spread))
    for strength, direction in others:
        factors.append(_factor(grid, settings, np.array(direction), np.zeros(grid.size),
                               np.full(grid.size, strength)))
    return SplitKernel(tuple(factors))


def symmetric_kernel(model: StateModel, grid: Grid, settings: KernelSettings,
                     t: float = 0.0) -> SplitKernel:
    """
    Return the kernel of one step, of second order by itself, to be taken in any order.

    Half a step with all factors but the last, all of it with the last, and the other halves in
    the opposite order  [Strang 1968]: two factors fewer than twice as many.
    """
    half = split_kernel(model, grid, replace(settings, time_step=settings.time_step / 2), t)
    last = split_kernel(model, grid, settings, t).factors[-1]
    return SplitKernel((*half.factors[:-1], last, *half.factors[-2::-1]))


def axis_moments(drift: Array, slope: Array, curvature: Array,
                 variance: float | Array) -> tuple[Array, Array]:
    """
    Return mean and variance of a step along an axis, all in cells and steps.

    drift: eps f / dx; slope and curvature: its first and second difference from cell to cell;
    variance: eps g / dx^2.  To second order in eps these are eps f + eps^2 / 2 (f f' + g f'' / 2)
    and g eps (1 + eps f'); for a linear drift they are exact  [Shoji and Ozaki 1998].
    """
    z = np.minimum(slope, GROWTH)
    grown, safe = np.expm1(z), np.where(np.abs(z) < 1e-8, 1.0, z)
    # (exp(z) - 1) / z, (exp(z) - 1 - z) / z^2, and the first of 2 z
    first = np.where(safe == z, grown / safe, 1 + z / 2)
    second = np.where(np.abs(z) < 1e-3, 0.5 + z / 6 + z * z / 24, (first - 1) / safe)
    mean = drift * first + variance * curvature / 2 * second
    return mean, variance * first * (1 + grown / 2)


def _axis_moments(model: StateModel, grid: Grid, settings: KernelSettings, t: float,
                  variance: Array) -> Iterator[tuple[Array, Array]]:
    """Give mean and variance of the step along each axis in cells, (size,) each."""
    n, eps = grid.ndim, settings.time_step
    axes = [low + (np.arange(-2, cells + 2) + 0.5) * width
            for low, cells, width in zip(grid.lower, grid.shape, grid.spacing)]
    x = np.stack(np.meshgrid(*axes, indexing='ij'))
    f = np.asarray(model.drift(x.reshape(n, -1), t + eps / 2), dtype=float).reshape(x.shape)
    for d in range(n):
        inner = [slice(2, -2)] * n
        inner[d] = slice(None)
        along = np.moveaxis(f[d][tuple(inner)], d, 0) * (eps / grid.spacing[d])
        drift, slope, curvature = (np.moveaxis(part, 0, d).ravel() for part in _differences(along))
        _check_finite(drift, grid, d)
        yield axis_moments(drift, slope, curvature, variance[d])


def _differences(F: Array) -> tuple[Array, Array, Array]:
    """
    Return F and its first two derivatives along the first axis, two nodes short at either end.

    By central differences of fourth order; none where F is not smooth from cell to cell, or not
    defined beside the grid.
    """
    far_down, down, at, up, far_up = F[:-4], F[1:-3], F[2:-2], F[3:-1], F[4:]
    with np.errstate(invalid='ignore', over='ignore'):
        slope = (8 * (up - down) - (far_up - far_down)) / 12
        curvature = (16 * (up + down) - (far_up + far_down) - 30 * at) / 12
        smooth = (np.abs(curvature) < ROUGH) & np.isfinite(slope)
    return at, np.where(smooth, slope, 0.0), np.where(smooth, curvature, 0.0)


def _factor(grid: Grid, settings: KernelSettings, step: Integers, mean: Array,
            variance: Array) -> sparse.csc_array | BlockFactor:
    """Return the operator that moves each cell by whole steps with a mean and a variance."""
    mean = np.clip(mean, -FAR, FAR)
    shift = whole_cells(mean)
    rest, tolerance = mean - shift, settings.tolerance
    width = max(1, CHUNK // (2 * half_width(variance, tolerance) + 1))
    chunks = [slice(first, min(first + width, grid.size)) for first in range(0, grid.size, width)]
    halves = [half_width(variance[some], tolerance) for some in chunks]
    room = sum((2 * half + 1) * (some.stop - some.start) for half, some in zip(halves, chunks))
    data, rows = np.empty(room, settings.dtype), np.empty(room, np.int32)
    pointers = np.zeros(grid.size + 1, dtype=np.int64)
    for half, some in zip(halves, chunks):
        w = lattice_weights(rest[some], variance[some], half).T
        if not np.isfinite(w).all():
            raise ValueError('tolerance: expected one that leaves a step weights which are '
                             f'numbers, got {tolerance!r}')
        nodes = np.arange(-half, half + 1)
        targets, keep = _land(grid, step, some, (shift[some, None] + nodes).astype(np.int32))
        keep &= w > 0
        begin = pointers[some.start]
        pointers[some.start + 1:some.stop + 1] = begin + np.cumsum(keep.sum(axis=1))
        found = slice(begin, pointers[some.stop])
        data[found], rows[found] = w[keep], targets[keep]
    if room <= np.iinfo(np.int32).max:
        pointers = pointers.astype(np.int32)
    factor = sparse.csc_array((data[:found.stop], rows[:found.stop], pointers),
                              shape=(grid.size, grid.size))
    if any(grid.periodic[d] and 2 * half_width(variance, tolerance) >= grid.shape[d]
           for d in np.flatnonzero(step)):
        factor.sum_duplicates()
    return compiled(factor)


def _land(grid: Grid, step: Integers, some: slice,
          moves: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
    """Return the flat indices of some cells after moves (cells, K), and which are on the grid."""
    cells = np.arange(some.start, some.stop, dtype=np.int32)
    rows = np.broadcast_to(cells[:, None], moves.shape)
    inside = np.ones(moves.shape, dtype=bool)
    strides = strides_of(np.array(grid.shape)).astype(np.int32)
    for d in np.flatnonzero(step):
        at = cells // strides[d] % grid.shape[d]
        target = at[:, None] + np.int32(step[d]) * moves
        if grid.periodic[d]:
            target %= grid.shape[d]
        else:
            # what is below 0 is a large number without a sign
            inside &= target.view(np.uint32) < grid.shape[d]
        target -= at[:, None]
        target *= strides[d]
        rows = rows + target
    return rows, inside


def _check_finite(drift: Array, grid: Grid, axis: int) -> None:
    undefined = ~np.isfinite(drift)
    if undefined.any():
        at = int(np.argmax(undefined))
        raise ValueError(f'drift: expected finite numbers in every cell, got {drift[at]} on axis '
                         f'{axis} at {grid.points[:, at].tolist()}')
