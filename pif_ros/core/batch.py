"""
Many beliefs through one kernel at a time: K @ P with a column of P for each.

Each weight is fetched once for all of them, where one by one each fetches all.  Products of sparse
arrays sum a column of P in the same order as a vector, so that each belief is the same to the bit,
whoever else is predicted with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.kernels import Operator, SplitKernel
from scipy import sparse

Array = NDArray[np.float64]
#: From which stamp to which, in nanoseconds.
Span = tuple[int, int]
#: An operator K, a share a of it, and the columns that take it: p becomes (1 - a) p + a K p.
Step = tuple[Operator, float, Sequence[int]]

#: Cells, about, that are worked on at a time: with some ten densities they stay in the cache, and
#: what they become needs no new memory.
ROWS = 2048


@dataclass(frozen=True, eq=False)
class Cut:
    """
    A sparse operator in blocks of rows.

    is_local: whether each block needs the cells of its own rows only, and takes no others.
    """

    blocks: Sequence[sparse.csr_array]
    is_local: bool


class Batch:
    """
    Predicts many beliefs at a time with a filter, each as the filter does it alone, to the bit.

    Keeps two arrays of the size of all densities, and the kernel by rows where the filter has it
    by columns.  Where its operators are not sparse arrays of doubles, but compiled, of single
    precision or in a wavelet basis, one density at a time is as good.
    """

    def __init__(self, filter_: DiracFeynmanFilter) -> None:
        self.filter = filter_
        self._rows = list(_slices(filter_.grid.size, _block_length(filter_.grid.shape)))
        self._cuts: dict[int, tuple[object, Cut]] = {}
        self._spare = np.empty(0), np.empty(0)

    def predict(self, beliefs: Sequence[GridBelief], spans: Sequence[Span]) -> list[GridBelief]:
        """
        Return densities, each carried from the first to the second stamp of a span of its own.

        Step by step those whose next step has the same operator take it together: all, where the
        spans are the same, or where the model does not change with time, but for the order of a
        split kernel.  Raises ValueError for a span that runs back.
        """
        for from_ns, to_ns in spans:
            if to_ns < from_ns:
                raise ValueError(f'spans: expected stamps from {from_ns} on, got {to_ns}')
        if not self._pays:
            return [self.filter.predict(belief, *span) for belief, span in zip(beliefs, spans)]
        found, grid = list(beliefs), self.filter.grid
        moving = [i for i, (from_ns, to_ns) in enumerate(spans) if to_ns > from_ns]
        P, other = self._work_space(len(moving))
        _put_side_by_side([beliefs[i].density.ravel() for i in moving], P)
        lanes: dict[Span, list[int]] = {}
        for column, i in enumerate(moving):
            lanes.setdefault(spans[i], []).append(column)
        for steps in zip_longest(*(self.filter.steps(*span) for span in lanes)):
            P, other = self._stepped(P, other, [
                (step[1](step[0]), step[2], columns)
                for step, columns in zip(steps, lanes.values()) if step is not None])
        for i, p in zip(moving, _apart(P)):
            found[i] = GridBelief(grid, p.reshape(grid.shape))
        return found

    @cached_property
    def _pays(self) -> bool:
        return all(sparse.issparse(factor) and factor.dtype == float
                   for K in (self.filter.operator_at(0), self.filter.kernel_at(0))
                   for factor in _factors(K))

    def _stepped(self, P: Array, other: Array, steps: Sequence[Step]) -> tuple[Array, Array]:
        """Return the columns after a step of some of them, and what is spare then."""
        groups: dict[int, list[Step]] = {}
        for step in steps:
            groups.setdefault(id(step[0]), []).append(step)
        for group in groups.values():
            K, columns = group[0][0], [column for *_, some in group for column in some]
            a = np.concatenate([np.full(len(some), share) for _, share, some in group])
            if len(columns) == P.shape[1]:
                # all of them, in whatever order
                order = np.empty(len(columns))
                order[columns] = a
                return self._mixed(K, order, P, other)
            part = np.take(P, columns, axis=1)
            P[:, columns] = self._mixed(K, a, part, other.ravel()[:part.size].reshape(part.shape)
                                        )[0]
        return P, other

    def _mixed(self, K: Operator, a: Array, P: Array, other: Array) -> tuple[Array, Array]:
        """Return (1 - a) P + a K P with a share for each column, and what is spare then."""
        if np.all(a == 1):
            return self._product(K, P, other)
        rest = P * (1 - a)
        moved, other = self._product(K, P, other)
        moved *= a
        moved += rest
        return moved, other

    def _product(self, K: Operator, P: Array, other: Array) -> tuple[Array, Array]:
        """Return K @ P and what is spare then; P is not kept."""
        for stage in _stages([self._cut(factor) for factor in _factors(K)]):
            for k, rows in enumerate(self._rows):
                x = P[rows] if stage[0].is_local else P
                for cut in stage:
                    x = cut.blocks[k] @ x
                other[rows] = x
            P, other = other, P
        return P, other

    def _cut(self, factor: sparse.sparray) -> Cut:
        """Return a sparse operator in blocks of rows."""
        if id(factor) in self._cuts:
            return self._cuts[id(factor)][1]
        cut = _cut(factor.tocsr(), self._rows)
        if not self.filter.model.changes_with_time:
            self._cuts[id(factor)] = factor, cut
        return cut

    def _work_space(self, count: int) -> tuple[Array, Array]:
        """Return two arrays (size, count) to work in."""
        needed = self.filter.grid.size * count
        if self._spare[0].size < needed:
            self._spare = np.empty(needed), np.empty(needed)
        first, second = (each[:needed].reshape(-1, max(count, 1)) for each in self._spare)
        return first, second


def _factors(K: Operator) -> Sequence[Any]:
    return K.factors if isinstance(K, SplitKernel) else (K,)


def _stages(cuts: Sequence[Cut]) -> list[list[Cut]]:
    """Return operators by what a block of rows can go through at once, in the order given."""
    stages: list[list[Cut]] = []
    for cut in cuts:
        if not stages or not cut.is_local:
            stages.append([])
        stages[-1].append(cut)
    return stages


def _cut(kernel: sparse.csr_array, slices: Sequence[slice]) -> Cut:
    """Return a kernel in blocks of rows, whose weights are the kernel's own."""
    pointers, blocks = kernel.indptr, []
    held = [slice(pointers[rows.start], pointers[rows.stop]) for rows in slices]
    is_local = all(rows.start <= kernel.indices[some].min(initial=rows.start)
                   and kernel.indices[some].max(initial=rows.start) < rows.stop
                   for rows, some in zip(slices, held))
    for rows, some in zip(slices, held):
        count = rows.stop - rows.start
        data, indices = kernel.data[some], kernel.indices[some]
        if is_local:
            indices = indices - indices.dtype.type(rows.start)
        block = sparse.csr_array(
            (data, indices, pointers[rows.start:rows.stop + 1] - pointers[rows.start]),
            shape=(count, count if is_local else kernel.shape[1]))
        # scipy copies what is less than half of an array
        block.data, block.indices = data, indices
        blocks.append(block)
    return Cut(blocks, is_local)


def _block_length(shape: Sequence[int]) -> int:
    """Return about ROWS cells: of as many of the last axes as fit, whole ones."""
    whole = [math.prod(shape[d:]) for d in range(1, len(shape) + 1)]
    slab = next(cells for cells in whole if cells <= 2 * ROWS or cells == 1)
    return slab * max(1, ROWS // slab)


def _slices(size: int, length: int) -> Iterator[slice]:
    for first in range(0, size, length):
        yield slice(first, min(first + length, size))


def _put_side_by_side(densities: Sequence[Array], P: Array) -> None:
    """Make densities the columns of P."""
    for rows in _slices(len(P), ROWS):
        P[rows] = np.array([p[rows] for p in densities]).T


def _apart(P: Array) -> list[Array]:
    """Return the columns of P, an array for each."""
    found = [np.empty(len(P)) for _ in range(P.shape[1])]
    for rows in _slices(len(P), ROWS):
        for p, column in zip(found, P[rows].T):
            p[rows] = column
    return found
