"""
Sparse operators without column indices, for compiled loops.

Eight rows at a time, and for these one diagonal after the other: what cell i gets from cell i + k
for i in the block, with a single k.  A step along an axis moves neighbours by about the same, so
that nearly all eight hold something, and the processor takes them at once.  A weight is 8 bytes
(4 in single precision) and an eighth of an offset's 4, where a sparse array takes 12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core import compiler
from pif_ros.core.kernels import loops
from scipy import sparse

Array = NDArray[np.float64]
#: Double or single precision.
Weights = NDArray[np.floating[Any]]

#: With more zeros than this to a weight an operator is better off with its indices.
MOST_FILL = 2.0
#: What is below this share of the densest cell's density is not carried.  A step loses no more
#: than size times this share of the densest cell's mass: nothing, against the rounding of its sum.
#: A hypothesis has to be 69 nats behind another to be given up, a Gaussian's tail 11.7 deviations
#: out.
LEAST_SHARE = 1e-30
#: With fewer cells than this to look for them takes as long as to carry them all.
SPARED = 20_000
#: Likewise where more than this share of them holds something.
MOST_HELD = 0.5


@dataclass(frozen=True, eq=False)
class BlockFactor:
    """
    A square operator of blocks of eight rows by their diagonals.

    weights: (diagonals, 8); moves: column less row of each diagonal (diagonals,), ascending
    within a block; pointers: where each block's diagonals begin, (blocks + 1,); size: of rows.
    """

    weights: Weights
    moves: NDArray[np.int32]
    pointers: NDArray[np.int64]
    size: int

    @classmethod
    def of(cls, array: sparse.sparray) -> BlockFactor:
        """Return a sparse array's weights in blocks."""
        rows = array.tocsr()
        rows.sort_indices()
        weights, moves, pointers = loops.blocks(rows.indptr, rows.indices, rows.data)
        return cls(weights, moves, pointers, rows.shape[0])

    @property
    def shape(self) -> tuple[int, int]:
        """Return the shape as of a matrix, (size, size)."""
        return self.size, self.size

    @property
    def dtype(self) -> np.dtype[Any]:
        """Return the type of a weight."""
        return self.weights.dtype

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return self.weights.nbytes + self.moves.nbytes + self.pointers.nbytes

    @cached_property
    def nnz(self) -> int:
        """Return the number of weights that are not zero."""
        return int(np.count_nonzero(self.weights))

    @cached_property
    def reach(self) -> int:
        """Return the longest move, in whole blocks of cells, and a block more."""
        longest = int(np.abs(self.moves).max(initial=0))
        return (longest // loops.LANES + 2) * loops.LANES

    @cached_property
    def spans(self) -> NDArray[np.int64]:
        """Return the first and the last cell that each tile of blocks takes from, (tiles, 2)."""
        blocks = np.flatnonzero(np.diff(self.pointers))
        first = loops.LANES * blocks + self.moves[self.pointers[blocks]]
        last = loops.LANES * (blocks + 1) - 1 + self.moves[self.pointers[blocks + 1] - 1]
        spans = np.full((-(-(len(self.pointers) - 1) // loops.TILE), 2), (0, -1))
        tiles, begin = np.unique(blocks // loops.TILE, return_index=True)
        if len(blocks):
            spans[tiles, 0] = np.minimum.reduceat(first, begin)
            spans[tiles, 1] = np.maximum.reduceat(last, begin)
        return spans

    @cached_property
    def T(self) -> BlockFactor:  # noqa: N802
        """Return the transpose."""
        return BlockFactor.of(self.tocsr().T)

    def __matmul__(self, density: Any) -> Any:
        """Return what becomes of vectors (size,) or (size, targets)."""
        return product((self,), density)

    def tocsr(self) -> sparse.csr_array:
        """Return the same as a sparse array."""
        block = np.repeat(np.arange(len(self.pointers) - 1), np.diff(self.pointers))
        diagonal, lane = np.nonzero(self.weights)
        rows = block[diagonal] * loops.LANES + lane
        return sparse.csr_array((self.weights[diagonal, lane],
                                 (rows, rows + self.moves[diagonal])), shape=self.shape)

    def toarray(self) -> Weights:
        """Return the same as a dense matrix."""
        return np.asarray(self.tocsr().toarray())


@dataclass(frozen=True, eq=False)
class Chain:
    """Factors of few cells in one piece, which one call goes through: there it is what counts."""

    weights: Weights
    moves: NDArray[np.int32]
    pointers: NDArray[np.int64]
    reach: int

    @classmethod
    def of(cls, factors: Sequence[BlockFactor]) -> Chain:
        """Return factors in one piece, the one that moves first in front."""
        before = np.cumsum([0, *(len(factor.moves) for factor in factors[:-1])])
        return cls(np.concatenate([factor.weights for factor in factors]),
                   np.concatenate([factor.moves for factor in factors]),
                   np.stack([factor.pointers + count for factor, count in zip(factors, before)]),
                   max(factor.reach for factor in factors))

    def __matmul__(self, density: Array) -> Array:
        """Return what becomes of a vector (size,)."""
        count, cells = self.pointers.shape
        room = np.empty((2, loops.LANES * (cells - 1) + 2 * self.reach))
        p = np.ascontiguousarray(density, dtype=float)
        loops.move_all(self.weights, self.moves, self.pointers, p, self.reach, room)
        return room[count % 2, self.reach:self.reach + len(density)]


def compiled(array: sparse.csc_array) -> sparse.csc_array | BlockFactor:
    """Return an operator in blocks, or as it is where that would not make it faster."""
    if not compiler.is_available():
        return array
    factor = BlockFactor.of(array)
    return factor if factor.weights.size <= (1 + MOST_FILL) * array.nnz else array


def product(factors: Sequence[BlockFactor], density: Any) -> Any:
    """
    Return vectors (size,) or (size, targets) after one factor and another, the first one first.

    Of SPARED cells and more, what is below LEAST_SHARE of the largest is not carried, if that is
    most of them.
    """
    if density.ndim > 1:
        return np.stack([product(factors, column) for column in density.T], axis=1)
    size, reach = factors[0].size, max(factor.reach for factor in factors)
    # room on either side for what is weighed with zero
    room = -(-size // loops.LANES) * loops.LANES + 2 * reach
    p = np.zeros(room, factors[0].dtype)
    held = loops.take(density, LEAST_SHARE, MOST_HELD, p, reach) if size >= SPARED else None
    if held is None:
        p[reach:reach + size], moved = density, np.empty_like(p)
    else:
        moved = np.zeros(room, p.dtype)
    for factor in factors:
        operator = factor.weights, factor.moves, factor.pointers
        if held is None:
            loops.move(*operator, p, reach, moved)
        else:
            held = loops.move_mass(*operator, factor.spans, p, reach, held, moved)
        p, moved = moved, p
    return p[reach:reach + size]
