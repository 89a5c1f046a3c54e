"""
The loops over the cells of a patch, compiled where numba is installed.

numpy and scipy do the same, to the rounding of a sum, in transport; these do it in one pass.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.compiler import compiler, is_available

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: Axes that the loops are written for; a patch has so many, some of a single cell.
AXES = 4


def share(p: Array, moves: Sequence[Array], least: float, spread: Array, circles: Sequence[bool],
          cells: tuple[int, ...], offset: tuple[int, ...]) -> tuple[Integers, Array]:
    """
    Return the first cell that is landed on, relative to that of p, and what lies from there on.

    p: masses, (cells of each axis); moves: how far each goes along each axis, in cells, shapes
    that broadcast to that of p; least: what is not worth carrying; spread: see transport; circles,
    cells, offset: which axes are periodic, after how many cells, and where p begins on them.
    """
    n = p.ndim
    extra = AXES - n
    shape = (1,) * extra + p.shape
    masses = p.reshape(shape)
    still = np.broadcast_to(0.0, shape)
    places = [still] * extra + [
        np.broadcast_to(move.reshape((1,) * extra + move.shape), shape) for move in moves]
    bounds, shared, _ = _loops()
    lows, highs = bounds(masses, *places, least)
    first = np.rint(lows).astype(np.int64) - 1
    count = np.rint(highs).astype(np.int64) + 1 - first + 1
    first[:extra], count[:extra] = 0, 1
    turns = np.zeros(AXES, dtype=np.int64)
    for i in range(n):
        if circles[i] and count[extra + i] >= cells[i]:
            first[extra + i], count[extra + i] = -offset[i], cells[i]
            turns[extra + i] = cells[i]
    result = np.zeros(tuple(count))
    shared(masses, *places, least, np.concatenate([np.zeros(extra), spread]), first, turns,
           extra, result)
    return first[extra:], result.reshape(tuple(count[extra:]))


def convolved(p: Array, weights: Array, axis: int) -> Array:
    """
    Return p with each cell shared along an axis, moves -K to K with weights (2 K + 1,).

    It is K cells longer at either end of the axis.
    """
    before, count, after = (math.prod(p.shape[:axis]), p.shape[axis],
                            math.prod(p.shape[axis + 1:]))
    longer = count + len(weights) - 1
    if after == 1:
        # short lines end to end, with room between them, are one long line
        room = np.zeros((before, longer))
        room[:, :count] = p.reshape(before, count)
        planes = room.reshape(1, -1, 1)[:, :before * longer - len(weights) + 1]
    else:
        planes = np.ascontiguousarray(p).reshape(before, count, after)
    result = np.zeros((len(planes), planes.shape[1] + len(weights) - 1, after))
    _loops()[2](planes, weights, result)
    return result.reshape(*p.shape[:axis], longer, *p.shape[axis + 1:])


def warm_up() -> None:
    """Compile now, so that no measurement waits for it."""
    if is_available():
        _loops()


@cache
def _loops() -> tuple[Callable[..., Any], ...]:
    """Return the loops, compiled for arrays of any layout."""
    numba = compiler()
    kinds = numba.types
    read = kinds.Array(kinds.float64, AXES, 'A', readonly=True)
    vector, whole = kinds.float64[::1], kinds.int64[::1]
    bounds = (read,) * (1 + AXES) + (kinds.float64,)
    share = bounds + (vector, whole, whole, kinds.int64, kinds.float64[:, :, :, ::1])
    planes = kinds.Array(kinds.float64, 3, 'C', readonly=True)
    convolve = (planes, vector, kinds.float64[:, :, ::1])
    return tuple(numba.njit([signature], cache=True, nogil=True)(loop) for signature, loop in
                 ((bounds, _bounds), (share, _share), (convolve, _convolve)))


def _bounds(p, a, b, c, d, least):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return the least and the greatest place on each axis."""
    low, high = np.full(4, np.inf), np.full(4, -np.inf)
    for i in range(p.shape[0]):
        for j in range(p.shape[1]):
            for k in range(p.shape[2]):
                for m in range(p.shape[3]):
                    if p[i, j, k, m] > least:
                        x = (i + a[i, j, k, m], j + b[i, j, k, m], k + c[i, j, k, m],
                             m + d[i, j, k, m])
                        for axis in range(4):
                            low[axis] = min(low[axis], x[axis])
                            high[axis] = max(high[axis], x[axis])
    return low, high


def _share(p, a, b, c, d, least, spread, first, turns, extra,  # type: ignore[no-untyped-def]
           result):  # pragma: no cover
    """Add to result what the cells of p give to the nodes around the places where they land."""
    flat, stride = result.reshape(-1), np.ones(4, dtype=np.int64)
    for axis in range(2, -1, -1):
        stride[axis] = stride[axis + 1] * result.shape[axis + 1]
    node, w, x = np.zeros((4, 3), dtype=np.int64), np.zeros((4, 3)), np.zeros(4)
    w[:extra, 0] = 1.0
    few = np.full(4, 3)
    few[:extra] = 1
    for i in range(p.shape[0]):
        for j in range(p.shape[1]):
            for k in range(p.shape[2]):
                for m in range(p.shape[3]):
                    mass = p[i, j, k, m]
                    if not mass > least:
                        continue
                    x[0], x[1] = i + a[i, j, k, m], j + b[i, j, k, m]
                    x[2], x[3] = k + c[i, j, k, m], m + d[i, j, k, m]
                    for axis in range(extra, 4):
                        middle = np.rint(x[axis])
                        off = x[axis] - middle
                        v = max(spread[axis], abs(off) * (1 - abs(off))) + off * off
                        w[axis, 0] = max((v - off) / 2, 0.0)
                        w[axis, 1] = 1 - v
                        w[axis, 2] = max((v + off) / 2, 0.0)
                        place = int(middle) - 1 - first[axis]
                        for s in range(3):
                            there = (place + s) % turns[axis] if turns[axis] else place + s
                            node[axis, s] = there * stride[axis]
                    # the last axis apart, in the processor's registers
                    before, at, after = node[3, 0], node[3, 1], node[3, 2]
                    left, middle, right = w[3, 0], w[3, 1], w[3, 2]
                    for s0 in range(few[0]):
                        w0 = mass * w[0, s0]
                        for s1 in range(few[1]):
                            w1 = w0 * w[1, s1]
                            for s2 in range(few[2]):
                                w2 = w1 * w[2, s2]
                                row = node[0, s0] + node[1, s1] + node[2, s2]
                                flat[row + before] += w2 * left
                                flat[row + at] += w2 * middle
                                flat[row + after] += w2 * right


def _convolve(p, weights, result):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Add to result each p[:, j] times weights[k] at j + k."""
    count = p.shape[1]
    for i in range(p.shape[0]):
        # in one line, whatever lies along the axis and beyond it
        here = p[i].reshape(-1)
        for k in range(len(weights)):
            there = result[i, k:k + count].reshape(-1)
            for j in range(len(here)):
                there[j] += weights[k] * here[j]
