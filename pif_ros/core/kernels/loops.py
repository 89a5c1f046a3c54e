"""The compiled loops over an operator in blocks, of eight cells at a time."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core import compiler

Array = NDArray[np.floating[Any]]
Counts = NDArray[np.int32]

#: Cells that are taken at once.
LANES = 8
#: Blocks of so many cells that are left out together, where nothing comes to any of them.
TILE = 64
#: What the loops call: a compiler makes it, and they look for it here.
add_products: Any = None
receives: Any = None
move_by: Any = None


def blocks(indptr: NDArray[np.integer[Any]], indices: NDArray[np.integer[Any]],
           data: Array) -> tuple[Array, NDArray[np.int32], NDArray[np.int64]]:
    """Return weights, moves and pointers of a BlockFactor from a csr_array's, rows ascending."""
    whole = indptr.astype(np.int64), indices.astype(np.int32, copy=False)
    pointers = np.zeros(-(-(len(indptr) - 1) // LANES) + 1, dtype=np.int64)
    # room for a zero to every four weights; what is not needed of it is never touched
    found, room = 1, 0
    while found > room:
        room = max(found, len(data) // LANES * 5 // 4 + len(pointers))
        weights, moves = np.zeros((room, LANES), data.dtype), np.empty(room, np.int32)
        found = _loops(data.itemsize)[0](*whole, data, pointers, moves, weights)
    return weights[:found], moves[:found], pointers


def move(weights: Array, moves: NDArray[np.int32], pointers: NDArray[np.int64], p: Array,
         reach: int, result: Array) -> None:
    """Write a vector (reach + cells + reach,) after an operator in blocks to result."""
    _loops(weights.itemsize)[1](weights, moves, pointers, p, reach, result)


def move_all(weights: Array, moves: NDArray[np.int32], pointers: NDArray[np.int64], p: Array,
             reach: int, room: Array) -> None:
    """
    Write a vector (cells,) after one operator and another, in one call, to a row of room.

    pointers: a row for each operator; room: (2, reach + cells + reach); the last row where the
    operators are odd in number, else the first.
    """
    _loops(weights.itemsize)[5](weights, moves, pointers, p, reach, room)


def move_mass(weights: Array, moves: NDArray[np.int32], pointers: NDArray[np.int64],
              spans: NDArray[np.int64], p: Array, reach: int, held: Counts,
              result: Array) -> Counts:
    """
    Write the same to zeros, where anything comes from blocks that hold something; return its held.

    p is cleared, to be written next.  spans: the first and the last cell that each TILE of blocks
    takes from, (tiles, 2); held: how many blocks of p hold something before each one,
    (blocks + 1,).
    """
    reached = np.zeros_like(held)
    _loops(weights.itemsize)[2](weights, moves, pointers, spans, p, reach, held, result, reached)
    return reached


def take(density: Array, share: float, most: float, p: Array, reach: int) -> Counts | None:
    """
    Write the blocks of a vector (cells,) that hold anything to zeros (reach + cells + reach,).

    These have more than a share of the largest; returns how many there are before each block, and
    None, with nothing written, where they are more than a share of all, most.
    """
    held = np.zeros(len(p) // LANES + 1, np.int32)
    peaks = np.empty(-(-len(density) // (LANES * TILE)), p.dtype)
    taken = _loops(p.itemsize)[3](np.ascontiguousarray(density, dtype=p.dtype), share, most, peaks,
                                  p, reach, held)
    return held if taken else None


def narrow(density: NDArray[np.float64], share: float) -> tuple[NDArray[np.float32], float]:
    """Return a vector as shares of its largest, 0 for those up to a share, and the largest."""
    shares = np.empty(len(density), np.float32)
    return shares, _loops(4)[4](np.ascontiguousarray(density, dtype=float), share, shares)


def warm_up(size: int) -> None:
    """Compile now, for numbers of 8 or 4 bytes, so that no measurement waits for it."""
    if compiler.is_available():
        _loops(size)


@cache
def _loops(size: int) -> tuple[Callable[..., Any], ...]:
    """Return the loops that make blocks, move, move mass, take, narrow it and move on at once."""
    global add_products, receives, move_by
    numba = compiler.compiler()
    kinds, make = numba.types, partial(numba.njit, cache=True, nogil=True, error_model='numpy')
    add_products, receives = _add_products(), make(_receives)
    move_by = numba.njit(nogil=True, error_model='numpy')(_move)
    real = kinds.float64 if size == 8 else kinds.float32
    vector, table = real[::1], real[:, ::1]
    whole, narrow, count, share = kinds.int64[::1], kinds.int32[::1], kinds.int64, kinds.float64
    operator, whole_rows = (table, narrow, whole), kinds.int64[:, ::1]
    read, taken = (kinds.Array(kind, 1, 'C', readonly=True) for kind in (share, real))
    return (make([(whole, narrow, vector, *operator[::-1])])(_fill),
            make([(*operator, vector, count, vector)])(_move),
            make([(*operator, whole_rows, vector, count, narrow, vector, narrow)])(_move_mass),
            make([(taken, share, share, vector, vector, count, narrow)])(_take),
            make([(read, share, vector)])(_narrow),
            make([(table, narrow, whole_rows, read, count, table)])(_move_all))


def _fill(indptr, indices, data, pointers, moves, weights):  # type: ignore[no-untyped-def]
    # pragma: no cover
    """Merge the diagonals of eight rows at a time, as far as there is room; return how many."""
    size, found, none = indptr.size - 1, 0, np.int64(2**62)
    cursor = np.zeros(8, np.int64)
    for block in range(pointers.size - 1):
        first = 8 * block
        lanes = min(8, size - first)
        for lane in range(lanes):
            cursor[lane] = indptr[first + lane]
        while True:
            least = none
            for lane in range(lanes):
                if cursor[lane] < indptr[first + lane + 1]:
                    least = min(least, indices[cursor[lane]] - (first + lane))
            if least == none:
                break
            for lane in range(lanes):
                row = first + lane
                while cursor[lane] < indptr[row + 1] and indices[cursor[lane]] - row == least:
                    if found < moves.size:
                        weights[found, lane] += data[cursor[lane]]
                    cursor[lane] += 1
            if found < moves.size:
                moves[found] = least
            found += 1
        pointers[block + 1] = found
    return found


def _take(density, share, most, peaks, p, reach, held):  # type: ignore[no-untyped-def]
    # pragma: no cover
    """Copy the blocks with more than a share of the largest size, and count them, if few."""
    best = np.zeros(64, density.dtype)
    for tile in range(peaks.size):
        best[:] = 0
        for start in range(512 * tile, min(512 * tile + 512, density.size), 64):
            some = density[start:start + 64]
            for i in range(some.size):
                size = abs(some[i])
                best[i] = size if size > best[i] else best[i]
        peaks[tile] = best.max()
    least, margin, blocks = share * peaks.max(), reach // 8, (density.size + 7) // 8
    for tile in range(peaks.size):
        for block in range(64 * tile, min(64 * tile + 64, blocks)):
            found = False
            if peaks[tile] > least:
                some = density[8 * block:8 * block + 8]
                for i in range(some.size):
                    found |= abs(some[i]) > least
            held[margin + block + 1] = held[margin + block] + found
    held[margin + blocks + 1:] = held[margin + blocks]
    if 8 * held[-1] > most * density.size:
        return False
    for block in range(blocks):
        if held[margin + block + 1] > held[margin + block]:
            some = density[8 * block:8 * block + 8]
            p[reach + 8 * block:reach + 8 * block + some.size] = some
    return True


def _move(weights, moves, pointers, p, reach, result):  # type: ignore[no-untyped-def]
    # pragma: no cover
    """Write a vector after an operator in blocks."""
    blocks = pointers.size - 1
    result[:reach] = 0
    result[reach + 8 * blocks:] = 0
    for block in range(blocks):
        add_products(result, reach + 8 * block, weights, moves, pointers[block],
                     pointers[block + 1], p)


def _move_all(weights, moves, pointers, p, reach, room):  # type: ignore[no-untyped-def]
    # pragma: no cover
    """Write a vector after all operators, each from one row of room to the other."""
    room[0, :reach] = 0
    room[0, reach:reach + p.size] = p
    room[0, reach + p.size:] = 0
    for k in range(pointers.shape[0]):
        move_by(weights, moves, pointers[k], room[k % 2], reach, room[(k + 1) % 2])


def _move_mass(weights, moves, pointers, spans, p, reach, held,  # type: ignore[no-untyped-def]
               result, reached):  # pragma: no cover
    """Write a vector after an operator where something comes, tell where that is, and clear p."""
    blocks, margin = pointers.size - 1, reach // 8
    for tile in range(spans.shape[0]):
        begin, end = 64 * tile, min(64 * tile + 64, blocks)
        low, high = reach + spans[tile, 0], reach + spans[tile, 1]
        if held[(high >> 3) + 1] == held[low >> 3]:
            reached[margin + begin + 1:margin + end + 1] = reached[margin + begin]
            continue
        for block in range(begin, end):
            first, last, at = pointers[block], pointers[block + 1], reach + 8 * block
            comes = receives(moves, first, last, at, held)
            reached[margin + block + 1] = reached[margin + block] + comes
            if comes:
                add_products(result, at, weights, moves, first, last, p)
    reached[margin + blocks + 1:] = reached[margin + blocks]
    for block in range(margin, margin + blocks):
        if held[block + 1] > held[block]:
            p[8 * block:8 * block + 8] = 0


def _narrow(density, share, shares):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the shares of the largest, and return it."""
    best = np.zeros(64)
    for start in range(0, density.size, 64):
        some = density[start:start + 64]
        for i in range(some.size):
            size = abs(some[i])
            best[i] = size if size > best[i] else best[i]
    largest = best.max()
    factor = 1 / largest if largest > 0 else 1.0
    for i in range(density.size):
        x = density[i] * factor
        shares[i] = x if abs(x) > share else 0.0
    return largest


def _receives(moves, first, last, at, held):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return whether a block is reached from one with something to carry."""
    if first == last or (held[((at + moves[last - 1] + 7) >> 3) + 1]
                         == held[(at + moves[first]) >> 3]):
        return False
    for k in range(first, last):
        low = at + moves[k]
        if held[((low + 7) >> 3) + 1] > held[low >> 3]:
            return True
    return False


def _add_products() -> Any:
    """
    Return what sums weights[k] p[at + moves[k]] over first <= k < last, for eight cells at once.

    In the processor's own vectors, which the compiler does not find by itself: it must assume
    that result and p overlap.  Products and sums are rounded one by one, in this order.
    """
    from llvmlite import ir
    from numba import types
    from numba.extending import intrinsic

    @intrinsic
    def add_products(typing, result, at, weights, moves, first, last, p):  # type: ignore
        def generate(context, builder, signature, arguments):  # type: ignore
            result, at, weights, moves, first, last, p = (
                context.make_array(kind)(context, builder, value).data
                if isinstance(kind, types.Array) else value
                for kind, value in zip(signature.args, arguments))
            vector = ir.VectorType(context.get_data_type(signature.args[-1].dtype), LANES)

            def place(data, i):  # type: ignore
                return builder.bitcast(builder.gep(data, [i]), vector.as_pointer())

            zero, before = ir.Constant(vector, [0.0] * LANES), builder.block
            loop = builder.append_basic_block('diagonal')
            after = builder.append_basic_block('stored')
            builder.cbranch(builder.icmp_signed('<', first, last), loop, after)
            builder.position_at_end(loop)
            k, total = builder.phi(first.type), builder.phi(vector)
            step = builder.sext(builder.load(builder.gep(moves, [k])), at.type)
            x = builder.load(place(p, builder.add(at, step)), align=4)
            w = builder.load(place(weights, builder.mul(k, k.type(LANES))), align=4)
            more = builder.fadd(total, builder.fmul(w, x))
            following = builder.add(k, k.type(1))
            for phi, start, value in ((k, first, following), (total, zero, more)):
                phi.add_incoming(start, before)
                phi.add_incoming(value, loop)
            builder.cbranch(builder.icmp_signed('<', following, last), loop, after)
            builder.position_at_end(after)
            stored = builder.phi(vector)
            stored.add_incoming(zero, before)
            stored.add_incoming(more, loop)
            builder.store(stored, place(result, at), align=4)
            return context.get_dummy_value()
        return types.void(result, at, weights, moves, first, last, p), generate
    return add_products
