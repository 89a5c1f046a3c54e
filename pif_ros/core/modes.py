"""The humps of a density, from its cells: which hang together, and what lies in each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import itertools

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from scipy import sparse
from scipy.sparse import csgraph

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: First row, first column and last column of some runs, and which runs they are.
Stretch = tuple[Integers, Integers, Integers, Integers]

#: A region of highest density that says where the humps are holds this share of the mass.
SHARE = 0.95
#: No more humps than these are told apart, the heaviest.
MOST = 32
#: What lies further out than this share of the mass is too thin to belong to any hump.
NEARLY_ALL = 0.9999


@dataclass(frozen=True, eq=False)
class Mode:
    """A hump of a density: its share of the mass, its mean (n,) and covariance (n, n)."""

    mass: float
    mean: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class Pieces:
    """
    A density in pieces: the mass (N,) at points (n, N), and how dense it is there (N,).

    grid: a lattice, which may be too large to be made; cell: the flat index of the lattice's cell
    in which each piece lies, (N,).  The masses sum to 1, less what is too thin to belong to any
    hump and left out.
    """

    grid: Grid
    cell: Integers
    points: Array
    mass: Array
    density: Array

    def some(self, which: Mask) -> Pieces:
        """Return some of the pieces, (N,) which."""
        return Pieces(self.grid, self.cell[which], self.points[:, which], self.mass[which],
                      self.density[which])


def modes(pieces: Pieces, share: float = SHARE, most: int = MOST) -> list[Mode]:
    """
    Return the humps of a density, heaviest first, the most that are wanted.

    A hump is a connected part of the smallest region that holds this share of the mass, over
    sides, corners and periodic edges; and with it what of the other pieces belongs to it rather
    than to another.
    """
    inside = densest(pieces.density, pieces.mass, share)
    inner = pieces.some(inside)
    part = np.empty(len(inside), np.int64)
    # what is too light is one hump together, to which something may belong too
    part[inside] = np.minimum(_by_weight(inner.mass, _hang_together(inner)), most)
    if len(inner.mass) < len(inside):
        cores = _moments(inner, part[inside])
        part[~inside] = _nearest(pieces.some(~inside), cores)
    return sorted(_moments(pieces, part)[:most], key=lambda mode: -mode.mass)


def densest(density: Array, mass: Array, amount: float) -> Mask:
    """
    Return the fewest pieces, the densest of all, that hold an amount of mass, (N,).

    Of equally dense ones the first; none that is empty, and all others where there is not so much.
    """
    # the bits of numbers that are not negative rise with them: so many steps to each power of two
    step = (density + 0.0).view(np.int64) >> 46
    above = np.cumsum(np.bincount(step, mass)[::-1])[::-1]
    amount = min(amount, float(above[0]))
    edge = int(np.flatnonzero(above >= amount)[-1])
    found: Mask = step > edge
    at = np.flatnonzero(step == edge)
    at = at[np.argsort(-density[at], kind='stable')]
    missing = amount - (above[edge + 1] if edge + 1 < len(above) else 0.0)
    at = at[:np.searchsorted(np.cumsum(mass[at]), missing) + 1]
    found[at] = density[at] > 0
    return found


def _hang_together(pieces: Pieces) -> Integers:
    """Return which pieces lie in cells that hang together, numbers from 0 on, (N,)."""
    if np.all(np.diff(pieces.cell) > 0):
        return connected(pieces.cell, pieces.grid)
    cells, places = np.unique(pieces.cell, return_inverse=True)
    return connected(cells, pieces.grid)[places.reshape(-1)]


def connected(cells: Integers, grid: Grid) -> Integers:
    """
    Return which cells of a grid hang together, numbers from 0 on, (N,).

    cells: flat indices, rising; neighbours share a side or a corner, also across periodic edges.
    """
    width = grid.shape[-1]
    row, column = np.divmod(cells, width)
    # cells that follow each other along the last axis are a run, which is linked as one
    starts = np.flatnonzero((np.diff(cells, prepend=-2) != 1) | (column == 0))
    ends = np.append(starts[1:], len(cells)) - 1
    first, last = cells[starts], cells[ends]
    links = [_links(first, last, width, stretch) for stretch in _neighbours(
        row[starts], column[starts], column[ends], grid)]
    pairs = np.concatenate([np.zeros((2, 0), np.int64), *links], axis=1)
    graph = sparse.coo_array((np.ones(pairs.shape[1], np.int8), (pairs[0], pairs[1])),
                             shape=(len(starts),) * 2)
    _, part = csgraph.connected_components(graph, directed=False)
    return np.repeat(part.astype(np.int64), ends - starts + 1)


def _neighbours(row: Integers, first: Integers, last: Integers, grid: Grid) -> Iterator[Stretch]:
    """Give the stretches of cells on which runs border, each pair of rows from one side only."""
    shape, width = grid.shape[:-1], grid.shape[-1]
    runs = np.arange(len(row))
    place = np.array(np.unravel_index(row, shape)) if shape else np.zeros((0, len(row)), np.int64)
    middle = (0,) * len(shape)
    for shift in itertools.product((-1, 0, 1), repeat=len(shape)):
        if shift < middle:
            continue
        beside, there = place + np.array(shift, dtype=np.int64)[:, None], np.ones(len(row), bool)
        for i, cells in enumerate(shape):
            if grid.periodic[i]:
                beside[i] %= cells
            there &= (0 <= beside[i]) & (beside[i] < cells)
        other = (np.ravel_multi_index(tuple(beside[:, there]), shape) if shape
                 else np.zeros(np.count_nonzero(there), np.int64))
        if shift != middle:
            yield (other, np.maximum(first[there] - 1, 0),
                   np.minimum(last[there] + 1, width - 1), runs[there])
        if grid.periodic[-1]:
            for at, seam in ((first[there] == 0, width - 1), (last[there] == width - 1, 0)):
                here = np.full(np.count_nonzero(at), seam)
                yield other[at], here, here, runs[there][at]


def _links(first: Integers, last: Integers, width: int, stretch: Stretch) -> Integers:
    """Return the pairs (2, L) of runs and those that lie on the stretches they border on."""
    row, low, high, runs = stretch
    begin = np.searchsorted(last, row * width + low, 'left')
    count = np.maximum(np.searchsorted(first, row * width + high, 'right') - begin, 0)
    before = np.cumsum(count) - count
    others = np.arange(count.sum()) + np.repeat(begin - before, count)
    return np.stack([np.repeat(runs, count), others])


def _by_weight(mass: Array, part: Integers) -> Integers:
    """Return the parts of pieces numbered by weight, the heaviest 0, (N,)."""
    order = np.argsort(-np.bincount(part, mass), kind='stable')
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return rank[part]


def _moments(pieces: Pieces, part: Integers) -> list[Mode]:
    """Return the parts of some pieces, which are numbered from 0 on."""
    grid, x, w = pieces.grid, pieces.points, pieces.mass
    mass = np.bincount(part, w)
    mean = np.array([np.bincount(part, w * row) for row in x]) / mass
    for i, round_ in enumerate(grid.periodic):
        if round_:
            low, period = grid.lower[i], grid.upper[i] - grid.lower[i]
            angle = 2 * np.pi / period * (x[i] - low)
            turn = np.arctan2(np.bincount(part, w * np.sin(angle)),
                              np.bincount(part, w * np.cos(angle)))
            mean[i] = low + (turn / (2 * np.pi) % 1.0) * period
    d = grid.wrap(x - mean[:, part])
    covariance = np.empty((len(mass), len(x), len(x)))
    for i, j in itertools.combinations_with_replacement(range(len(x)), 2):
        covariance[:, i, j] = covariance[:, j, i] = np.bincount(part, w * d[i] * d[j]) / mass
    return [Mode(float(m), mean[:, k], covariance[k]) for k, m in enumerate(mass)]


def _nearest(pieces: Pieces, cores: Sequence[Mode]) -> Integers:
    """
    Return to which hump each piece belongs most probably, were they Gaussians, (N,).

    log m_k - 1/2 log det C_k - 1/2 d^T C_k^-1 d, with C_k no narrower than a cell.
    """
    width = np.diag(pieces.grid.spacing**2 / 12)
    best = np.zeros(len(pieces.mass), np.int64)
    if len(cores) == 1:
        return best
    highest = np.full(len(pieces.mass), -np.inf)
    for k, core in enumerate(cores):
        C = core.covariance + width
        whiten = np.linalg.inv(np.linalg.cholesky(C))
        z = whiten @ pieces.grid.wrap(pieces.points - core.mean[:, None])
        score = np.log(core.mass) + np.log(whiten.diagonal()).sum() - 0.5 * (z * z).sum(axis=0)
        better = score > highest
        best[better], highest[better] = k, score[better]
    return best
