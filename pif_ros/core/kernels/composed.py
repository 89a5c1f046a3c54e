"""Several kernel steps in one operator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

Array = NDArray[np.float64]

#: Weights that are worked on at a time: a product is never there before it is pruned.
CHUNK = 1 << 20
#: Columns of a product that are made first, to see how many weights they have.
FIRST = 16


def composed(kernel: sparse.csr_array, steps: int, tolerance: float) -> sparse.csr_array:
    """
    Return the operator of several steps of a kernel (size, size), pruned.

    tolerance: how far a column may be from that of the whole power, in L1; 0 keeps everything.
    Weights stay positive, and a column keeps the mass that it has after so many steps, so that
    what leaves the grid is counted.  Raises ValueError for what is no number of steps or no
    tolerance.
    """
    if not (isinstance(steps, (int, np.integer)) and steps >= 1):
        raise ValueError(f'steps: expected a whole number, 1 or more, got {steps!r}')
    if not 0 <= tolerance <= 0.1:
        raise ValueError(f'tolerance: expected a number from 0 to 0.1, got {tolerance!r}')
    if steps == 1:
        return kernel
    # a row of the transpose is a column of the operator
    one = power = kernel.T.tocsr()
    bits = [int(bit) for bit in f'{int(steps):b}'[1:]]
    share, made = tolerance / (2 * (len(bits) + sum(bits))), 1
    for bit in bits:
        # an error in m steps comes n / m times into n, and once more when mass is put right
        made *= 2
        power = _product(power, power, share * made / steps)
        if bit:
            made += 1
            power = _product(power, one, share * made / steps)
    mass = np.ones(len(kernel.indptr) - 1)
    for _ in range(int(steps)):
        mass = one @ mass
    held = _row_sums(power)
    factor = np.divide(mass, held, out=np.ones_like(held), where=held > 0)
    power.data *= np.repeat(factor, np.diff(power.indptr))
    return power.T.tocsr()


def _product(a: sparse.csr_array, b: sparse.csr_array, share: float) -> sparse.csr_array:
    """Return a @ b without the least weights of each row, which hold this share of it."""
    parts, first, count, size = [], 0, FIRST, a.shape[0]
    while first < size:
        part = _pruned(a[first:first + count] @ b, share)
        parts.append(part)
        first += count
        count = max(1, min(4 * count, CHUNK * part.shape[0] // max(part.nnz, 1)))
    return _stacked(parts)


def _stacked(parts: list[sparse.csr_array]) -> sparse.csr_array:
    """Return the rows of some arrays one below the other."""
    counts = np.concatenate([np.diff(part.indptr) for part in parts])
    return sparse.csr_array(
        (np.concatenate([part.data for part in parts]),
         np.concatenate([part.indices for part in parts]), np.append(0, np.cumsum(counts))),
        shape=(len(counts), parts[0].shape[1]))


def _pruned(rows: sparse.csr_array, share: float) -> sparse.csr_array:
    """Drop the least weights of each row, up to a share of its mass."""
    if not share or not rows.nnz:
        return rows
    counts = np.diff(rows.indptr)
    # each row's weights in order, least first, after zeros
    ordered = np.zeros((len(counts), counts.max()))
    ordered[np.arange(counts.max()) >= counts.max() - counts[:, None]] = rows.data
    ordered.sort(axis=1)
    dropped = (np.cumsum(ordered, axis=1) <= share * _row_sums(rows)[:, None]).sum(axis=1)
    least = np.take_along_axis(
        ordered, np.minimum(dropped, counts.max() - 1)[:, None], axis=1)[:, 0]
    keep = rows.data >= np.repeat(least, counts)
    ends = np.concatenate([[0], np.cumsum(keep)])[rows.indptr].astype(rows.indptr.dtype)
    return sparse.csr_array((rows.data[keep], rows.indices[keep], ends), shape=rows.shape)


def _row_sums(rows: sparse.csr_array) -> Array:
    return np.asarray(rows.sum(axis=1), dtype=float).ravel()
