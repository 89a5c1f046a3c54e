"""A kernel in a wavelet basis, where few of its elements may matter  [Sensors, section 4.3]."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from scipy import sparse

Array = NDArray[np.float64]

#: Elements that are worked on at a time.
CHUNK = 1 << 20
#: A filter whose shifts are orthonormal but for this is as good as its printed digits.
ORTHONORMAL = 1e-10
#: Between the two sides of W K W^T, elements below this share of the threshold are dropped.
SAFETY = 1e-3
#: Mass that is not missed.
ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class WaveletBasis:
    """
    An orthonormal, periodic wavelet basis on a grid: the tensor product of its axes' bases.

    axes: one matrix for each axis, (padded, cells).  An axis is padded with empty cells to a
    multiple of 2**level, so that W^T W = 1 holds always, and W W^T = 1 where nothing is padded.
    """

    axes: tuple[sparse.csr_array, ...]

    @classmethod
    def make(cls, grid: Grid, wavelet: str, level: int) -> WaveletBasis:
        """
        Return the basis of one of PyWavelets' orthogonal wavelets, halved level times.

        Raises ValueError for a name that is none, or a level beyond the grid's cells, ImportError
        where PyWavelets is not installed.
        """
        if not (isinstance(level, (int, np.integer)) and 1 <= level <= math.log2(min(grid.shape))):
            raise ValueError(f'level: expected a whole number from 1 to '
                             f'{int(math.log2(min(grid.shape)))} on a grid of '
                             f'{" x ".join(map(str, grid.shape))} cells, got {level!r}')
        filters = _filters(wavelet)
        return cls(tuple(_transform(*filters, -(-cells // 2**level) * 2**level, level)[:, :cells]
                         for cells in grid.shape))

    @property
    def cells(self) -> tuple[int, ...]:
        """Return the cells on each axis."""
        return tuple(W.shape[1] for W in self.axes)

    @property
    def padded(self) -> tuple[int, ...]:
        """Return the coefficients on each axis."""
        return tuple(W.shape[0] for W in self.axes)

    def analyse(self, values: Array) -> Array:
        """Return the coefficients W v (coefficients, ...) of values v (cells, ...)."""
        return _along_axes(self.axes, values)

    def synthesise(self, coefficients: Array) -> Array:
        """Return the values W^T c (cells, ...) of coefficients c (coefficients, ...)."""
        return _along_axes(self._transposed, coefficients)

    @cached_property
    def _transposed(self) -> tuple[sparse.csr_array, ...]:
        return tuple(W.T.tocsr() for W in self.axes)


@dataclass(frozen=True, eq=False)
class WaveletKernel:
    """
    A kernel by its significant elements in a wavelet basis: K @ p moves a density p (size,).

    coefficients: W K W^T without the elements below a threshold.  What is left of a column is
    shifted a little so that 1^T W^T W K W^T = 1^T K W^T still holds: mass is kept, or lost over
    the edges, exactly as the kernel does.  A density may dip below 0, by about the threshold;
    there it is cut to 0, and scaled to the mass it had.  Elsewhere it rises by as much: about a
    threshold of mass lies all over the grid after each product.  For many steps without a look at
    the density between: ``synthesise(coefficients @ ... @ analyse(p))``.
    """

    basis: WaveletBasis
    coefficients: sparse.csr_array

    @classmethod
    def make(cls, kernel: sparse.csr_array, grid: Grid, wavelet: str = 'db4', level: int = 2,
             threshold: float = 1e-4) -> WaveletKernel:
        """
        Return a kernel (size, size) in a basis of PyWavelets, without elements below a threshold.

        Raises ValueError for what is no wavelet, level or threshold, ImportError where PyWavelets
        is not installed.
        """
        if not 0 <= threshold < 1:
            raise ValueError(f'threshold: expected a number from 0 to below 1, got {threshold!r}')
        basis = WaveletBasis.make(grid, wavelet, level)
        # column j of K W^T is where the kernel carries wavelet j
        carried = _thinned(_analysed(basis, kernel.T.tocsc()), SAFETY * threshold).T.tocsc()
        ones = basis.analyse(np.ones(grid.size))
        mass = basis.analyse(np.asarray(kernel.sum(axis=0), dtype=float).ravel())
        return cls(basis, _keeping_mass(_analysed(basis, carried), threshold, ones, mass))

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Return the shape of the kernel."""
        size = math.prod(self.basis.cells)
        return size, size

    @property
    def nnz(self) -> int:
        """Return the number of stored elements."""
        return int(self.coefficients.nnz)

    def analyse(self, density: Array) -> Array:
        """Return the coefficients of a density (size,)."""
        return self.basis.analyse(density)

    def synthesise(self, coefficients: Array) -> Array:
        """Return the density (size,) of coefficients, nowhere negative, of their mass."""
        p = self.basis.synthesise(coefficients)
        mass = p.sum()
        np.maximum(p, 0.0, out=p)
        held = p.sum()
        return p * (max(mass, 0.0) / held) if held > 0 else p

    def __matmul__(self, density: Array) -> Array:
        """Return the density (size,) after the kernel."""
        return self.synthesise(self.coefficients @ self.analyse(density))


def _filters(wavelet: str) -> tuple[Array, Array]:
    """Return the low and the high pass of an orthogonal wavelet, in the order of the cells."""
    try:
        import pywt
    except ModuleNotFoundError as error:
        raise ImportError('wavelet: expected the package PyWavelets, which pip install '
                          '"pif_ros[wavelets]" brings, got none') from error
    if wavelet not in pywt.wavelist(kind='discrete'):
        raise ValueError(f'wavelet: expected the name of a discrete wavelet, got {wavelet!r}')
    low, high = (np.array(taps[::-1]) for taps in pywt.Wavelet(wavelet).filter_bank[:2])
    products = [low[2 * k:] @ low[:len(low) - 2 * k] for k in range(len(low) // 2)]
    if np.abs(np.array(products) - np.eye(len(products))[0]).max() > ORTHONORMAL:
        raise ValueError(f'wavelet: expected an orthogonal one, got {wavelet!r}')
    return low, high


def _transform(low: Array, high: Array, cells: int, level: int) -> sparse.csr_array:
    """Return the matrix (cells, cells) of a transform, coarsest coefficients first."""
    if level == 0:
        return sparse.csr_array(np.eye(cells))
    coarse = _transform(low, high, cells // 2, level - 1)
    return sparse.csr_array(
        sparse.vstack([coarse @ _halving(low, cells), _halving(high, cells)]))


def _halving(taps: Array, cells: int) -> sparse.csr_array:
    """Return the matrix (cells / 2, cells) with a filter in each row, two cells further on."""
    row = np.repeat(np.arange(cells // 2), len(taps))
    column = (2 * row + np.tile(np.arange(len(taps)), cells // 2) + 1 - len(taps) // 2) % cells
    return sparse.coo_array((np.tile(taps, cells // 2), (row, column)),
                            shape=(cells // 2, cells)).tocsr()


def _along_axes(matrices: Sequence[sparse.csr_array], values: Array) -> Array:
    """Apply a matrix to each axis of values (product of the matrices' columns, ...)."""
    rest = values.shape[1:]
    for matrix in matrices:
        # the first axis, which then becomes the last but the rest
        moved = matrix @ values.reshape(matrix.shape[1], -1)
        values = np.moveaxis(moved.reshape(len(moved), -1, *rest), 0, 1)
    return values.reshape(-1, *rest)


def _analysed(basis: WaveletBasis, matrix: sparse.csc_array) -> Iterator[Array]:
    """Give the coefficients of some columns of a matrix (cells, N) at a time."""
    step = max(1, CHUNK // math.prod(basis.padded))
    for first in range(0, matrix.shape[1], step):
        yield basis.analyse(matrix[:, first:first + step].toarray())


def _thinned(blocks: Iterator[Array], least: float) -> sparse.csc_array:
    """Return the matrix whose columns come in blocks, without elements up to a size."""
    return sparse.csc_array(sparse.hstack(
        [sparse.csc_array(np.where(np.abs(block) > least, block, 0.0)) for block in blocks]))


def _keeping_mass(blocks: Iterator[Array], threshold: float, ones: Array,
                  mass: Array) -> sparse.csr_array:
    """Drop a matrix's elements below a threshold, but leave ones @ matrix = mass."""
    parts, first = [], 0
    # rows that bear mass: those of the coarsest means, but for some at a padded edge
    bearing = np.flatnonzero(np.abs(ones) > 0.5 * np.abs(ones).max())
    u = ones[bearing, None]
    for block in blocks:
        wanted, first = mass[first:first + block.shape[1]], first + block.shape[1]
        whole = block[bearing]
        block[np.abs(block) < threshold] = 0.0
        bears = block[bearing] != 0
        # a column that lost all that bears mass, and misses it, gets it where it had most of it
        bare = np.flatnonzero(~bears.any(axis=0) & (np.abs(wanted - ones @ block) > ROUNDING))
        bears[np.abs(whole[:, bare]).argmax(axis=0), bare] = True
        square = (bears * u**2).sum(axis=0)
        missing = wanted - ones @ block
        block[bearing] += bears * u * np.divide(missing, square, out=np.zeros_like(missing),
                                                where=square > 0)
        parts.append(sparse.csc_array(block))
    return sparse.csr_array(sparse.hstack(parts))
