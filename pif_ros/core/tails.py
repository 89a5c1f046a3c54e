"""
How much of a density lies where it is no larger than at a place.

The density is p = sum_i w_i N(v; v_i, 1), the place 0: whitened measurements, as seen from the one
that came.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

#: Cells of a lattice in a standard deviation, by how many numbers there are in a measurement.
FINENESS = {1: 16, 2: 3}
#: So many cells there are at most: over a wider span each cluster of points has a lattice of its
#: own, the heaviest first, and what is left has coarser cells.
LARGEST_LATTICE = 1 << 17
#: How far around what is expected a lattice goes, in standard deviations: beyond it is 1e-15.
REACH = 8.0
#: Clusters are so many standard deviations apart; where the span has more tiles of that size than
#: the second, further.
APART, MOST_TILES = 24.0, 1 << 16
#: What stands for more points in a sample, how many are drawn, and how widely, in deviations.
CROWD, DRAWN, SCALES = 1024, 1536, (1.0, 2.0, 4.0)
#: Points in a tile of this many deviations are one; a tile of more than the second has points that
#: are too far apart for a density.
TILE, LOOSE = 0.5, 1.5
#: Of points further than this, in deviations, a sample's squares have no digits left.
FARTHEST = 1e7
#: So many points are put into tiles at most.
MOST_TILED = 1 << 16
#: How much larger tiles are at least where there are still too many.
GROWTH = 1.3


def tail(weights: Array, v: Array, turn: float = 0.0) -> float:
    """
    Return P(p(V) <= p(0)) for a V that is drawn from p, points v (m, N) with weights (N,).

    turn: the circle that a single number is on; 0 for a line, inf for more numbers with an angle
    among them.
    """
    fineness = FINENESS.get(len(v))
    if fineness is None or math.isinf(turn):
        return _sampled_tail(weights, v)
    if 0 < turn * fineness <= LARGEST_LATTICE:
        return _lattice_tail([_circle(weights, v, turn, fineness)])
    if turn and (line := unrolled(v[0], turn, 2 * REACH)) is not None:
        v = line[None]
    if _cells(v, 1 / fineness) <= LARGEST_LATTICE:
        return _lattice_tail([_lattice(weights, v, np.full(len(v), 1 / fineness))])
    return _lattice_tail(list(_lattices(weights, v, 1 / fineness)))


@dataclass(frozen=True)
class _Lattice:
    """Masses in cells of a width, (m,); origin: which cell has the place in its centre, (m,)."""

    mass: Array
    width: Array
    origin: Array

    def density(self) -> float:
        """Return the density at the place."""
        if not np.all((self.origin >= 0) & (self.origin < self.mass.shape)):
            return 0.0
        return float(self.mass[tuple(self.origin.astype(np.intp))] / self.width.prod())

    def no_denser_than(self, level: float) -> float:
        """Return the mass where the density is a level at most."""
        log_p = np.log(np.maximum(self.mass, 1e-300))
        slopes = np.gradient(log_p)
        steep = np.sqrt(sum(s * s for s in (slopes if len(self.width) > 1 else [slopes])))
        # of the cell on which the boundary lies, the share beyond it
        above = log_p - math.log(level * self.width.prod())
        return float((self.mass * np.clip(0.5 - above / np.maximum(steep, 1e-12), 0, 1)).sum())


def _lattice_tail(lattices: list[_Lattice]) -> float:
    level = sum(lattice.density() for lattice in lattices)
    if not level > 0:
        return 0.0
    mass = sum(float(lattice.mass.sum()) for lattice in lattices)
    return min(sum(lattice.no_denser_than(level) for lattice in lattices) / mass, 1.0)


def _lattices(weights: Array, v: Array, width: float) -> Iterator[_Lattice]:
    """Give a lattice for each of the heaviest clusters, and a coarser one for all others."""
    cluster = _clusters(v)
    order, room = np.argsort(cluster, kind='stable'), float(LARGEST_LATTICE)
    parts = np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1)
    left = []
    for part in sorted(parts, key=lambda part: -float(weights[part].sum())):
        cells = _cells(v[:, part], width)
        if cells <= room:
            room -= cells
            yield _lattice(weights[part], v[:, part], np.full(len(v), width))
        else:
            left.append(part)
    if left:
        rest = np.concatenate(left)
        yield _lattice(weights[rest], v[:, rest], _coarse(v[:, rest], width))


def _coarse(v: Array, width: float) -> Array:
    """Return widths, (m,), of which no more cells than the largest lattice's span some points."""
    extent = np.ptp(v, axis=1) + 2 * REACH
    count, left = extent / width, float(LARGEST_LATTICE)
    for done, axis in enumerate(np.argsort(count)):
        # a narrow axis keeps its cells
        count[axis] = min(count[axis], left**(1 / (len(v) - done)))
        left /= count[axis]
    return np.asarray(extent / count)


def unrolled(v: Array, turn: float, gap: float) -> Array | None:
    """Return points (N,) of a circle on a line, cut where nothing is; None without such a gap."""
    x = np.sort(v)
    gaps = np.diff(x, append=x[0] + turn)
    widest = int(np.argmax(gaps))
    if gaps[widest] < gap:
        return None
    cut = x[widest] + gaps[widest] / 2
    return np.where(v > cut, v - turn, v) if cut > 0 else np.where(v < cut, v + turn, v)


def _clusters(v: Array) -> Integers:
    """Return which cluster each point belongs to, (N,)."""
    low, span = v.min(axis=1, keepdims=True), np.ptp(v, axis=1)
    most = round(MOST_TILES**(1 / len(v)))
    tile = np.maximum(span / most, APART)
    place = tuple(((v - low) / tile[:, None]).astype(np.intp))
    occupied = np.zeros(tuple((span / tile).astype(np.intp) + 1), dtype=bool)
    occupied[place] = True
    labels, _ = ndimage.label(occupied, np.ones((3,) * len(v)))
    return np.asarray(labels[place], dtype=np.intp)


@np.errstate(over='ignore')
def _cells(v: Array, width: float) -> float:
    """Return how many cells a lattice has, but for those at its ends."""
    return float(np.prod((np.ptp(v, axis=1) + 2 * REACH) / width))


def _lattice(weights: Array, v: Array, width: Array) -> _Lattice:
    """Return the lattice of some points and what is around them."""
    # from their own lowest corner, since they may be so far out that no digits are left for a cell
    low, room = v.min(axis=1), np.ceil(REACH / width)
    first = np.floor(low / width)
    start = low / width - first + room
    places = (v - low[:, None]) / width[:, None] + start[:, None]
    count = np.ceil(places.max(axis=1) + room).astype(np.intp) + 2
    return _blurred(weights, places, width, room - first, count, 'constant')


def _circle(weights: Array, v: Array, turn: float, fineness: float) -> _Lattice:
    """Return the lattice of a circle."""
    count = np.array([max(math.ceil(turn * fineness), 8)])
    return _blurred(weights, v * count / turn, turn / count, np.zeros(1), count, 'wrap')


def _blurred(weights: Array, places: Array, width: Array, origin: Array, count: Integers,
             mode: str) -> _Lattice:
    mass = _shared(weights, places, count)
    # to be shared by neighbours has spread it already, by a sixth of a cell squared on average
    blur = np.sqrt(np.maximum(1 / width**2 - 1 / 6, 0.0))
    return _Lattice(ndimage.gaussian_filter(mass, blur, mode=mode, truncate=REACH), width, origin)


def _shared(weights: Array, places: Array, count: Integers) -> Array:
    """Return what the cells of a lattice get of weights at places (m, N), means kept."""
    first = np.floor(places).astype(np.intp)
    rest, mass = places - first, np.zeros(int(np.prod(count)))
    for corner in itertools.product((0, 1), repeat=len(places)):
        up = np.array(corner)[:, None]
        flat = np.ravel_multi_index(tuple(first + up), tuple(count), mode='wrap')
        share = np.prod(np.where(up, rest, 1 - rest), axis=0)
        mass += np.bincount(flat, weights * share, len(mass))
    return mass.reshape(tuple(count))


def _sampled_tail(weights: Array, v: Array) -> float:
    """
    Return the same by importance sampling.

    Drawn from q, the mean over some scales s of sum_i w_i N(v_i, s^2), of which p is at most as
    many times as there are scales: so the tails are drawn often, and their weights are small.
    """
    m = len(v)
    weights, v, covariance = _merged(weights, v.clip(-FARTHEST, FARTHEST))
    v = np.asarray(np.linalg.solve(np.linalg.cholesky(np.eye(m) + covariance), v), dtype=float)
    comb, noise, scale = _draws(m)
    drawn = v[:, _picked(weights, comb)] + noise * scale
    drawn = np.concatenate([drawn, np.zeros((m, 1))], axis=1)
    square = np.maximum(np.square(drawn).sum(axis=0)[:, None] + np.square(v).sum(axis=0)
                        - 2 * drawn.T @ v, 0.0)
    # exp(-|.|^2 / 2 s^2) for the scales from the widest on, each the fourth power of the next
    densities, falloff = [], np.exp(-0.5 / SCALES[-1]**2 * square)
    for s in reversed(SCALES):
        densities.append(falloff @ weights / s**m)
        falloff = np.square(np.square(falloff))
    p, q = densities[-1], sum(densities)[:-1] / len(SCALES)
    return float(min(np.where(p[:-1] <= p[-1], p[:-1] / q, 0.0).mean(), 1.0))


def _merged(weights: Array, v: Array) -> tuple[Array, Array, Array]:
    """
    Return no more than a crowd of points that stand for all, (m, N), their weights, (N,).

    And the covariance that each has of those it stands for, (m, m), on average; twice that where
    they are so far apart that they would be a comb.
    """
    if len(weights) > MOST_TILED:
        v = v[:, _picked(weights, (np.arange(MOST_TILED) + 0.5) / MOST_TILED)]
        weights = np.full(MOST_TILED, 1 / MOST_TILED)
    m, side, lost = len(v), TILE, np.zeros((len(v), len(v)))
    while len(weights) > CROWD:
        which = _tiles(v, side)
        w = np.asarray(np.bincount(which, weights), dtype=float)
        centres = np.stack([np.bincount(which, weights * row)
                            for row in v]) / np.maximum(w, 1e-300)
        d = v - centres[:, which]
        lost += d * weights @ d.T
        weights, v = w, centres
        side *= max(GROWTH, (len(weights) / CROWD)**(1 / m))
    return weights, v, 2 * lost if side > LOOSE else lost


def _tiles(v: Array, side: float) -> Integers:
    """Return which tile each point is in, (N,)."""
    # by numbers that no two tiles have in common, all but certainly
    factors = np.random.Generator(np.random.Philox(key=1)).integers(
        1 << 62, size=(len(v), 1), dtype=np.int64) | 1
    with np.errstate(over='ignore', invalid='ignore'):
        numbers = (np.floor(v / side).astype(np.int64) * factors).sum(axis=0)
    return np.unique(numbers, return_inverse=True)[1]


def _picked(weights: Array, shares: Array) -> Integers:
    """Return the points in whose weights some shares of all fall."""
    return np.searchsorted(np.cumsum(weights), shares).clip(0, len(weights) - 1)


@lru_cache(maxsize=8)
def _draws(m: int) -> tuple[Array, Array, Array]:
    """Return which point each draw is about, as a share of all, its noise and the scale of it."""
    rng = np.random.Generator(np.random.Philox(key=m))
    comb = (rng.permutation(DRAWN) + 0.5) / DRAWN
    return comb, rng.standard_normal((m, DRAWN)), np.resize(SCALES, DRAWN)
