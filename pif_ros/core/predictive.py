"""
What is expected to be measured: the density of the next measurement given all before, its tails.

p(y | past) = sum_i w_i N(y; h(x_i), R) over the cells, or particles, of a belief: the evidence of
a measurement [Sensors, Eq. 27] as a function of it.  Nothing is said of its shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
import itertools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.likelihood import cell_widths, FINEST, RESOLVED, SIGNIFICANT
from pif_ros.core.models import Sensor
from scipy import ndimage, special

Array = NDArray[np.float64]

#: Points with less than this share of the heaviest one's weight are not looked at.
NEGLIGIBLE = 1e-12
#: Cells that are wider than a sensor resolves are cut into this many points in all at most.
MOST_POINTS = 1 << 20
#: Cells of the lattice in a standard deviation, by how many numbers there are in a measurement.
FINENESS = {1: 16, 2: 3}
#: So many cells it has at most: over a wider span they are coarser.
LARGEST_LATTICE = 1 << 17
#: How far around what is expected the lattice goes, in standard deviations: beyond it is 1e-15.
REACH = 8.0
#: What stands for more points in a sample, how many are drawn, and how widely, in deviations.
CROWD, DRAWN, SCALES = 512, 1536, (1.0, 2.0, 4.0)


@dataclass(frozen=True, eq=False)
class Predictive:
    """
    A density sum_i w_i N(y; h_i, S) of measurements.

    sensor: whose angles are compared on the circle; weights: (N,), scaled to sum to 1; expected:
    (m, N); covariance: S, (m, m).
    """

    sensor: Sensor
    weights: Array
    expected: Array
    covariance: Array

    @classmethod
    @np.errstate(all='ignore')
    def of_points(cls, sensor: Sensor, weights: Array, points: Array, t: float) -> Predictive:
        """Return that of states (n, N) with weights (N,); where h is undefined it has none."""
        expected = np.asarray(sensor.function(points, t), dtype=float)
        sound = np.isfinite(expected).all(axis=0) & (
            weights > NEGLIGIBLE * weights.max(initial=0.0))
        w = weights[sound]
        return cls(sensor, w / w.sum(), expected[:, sound], sensor.noise(t))

    @classmethod
    @np.errstate(all='ignore')
    def of_cells(cls, sensor: Sensor, weights: Array, centres: Array, spacing: Array, t: float,
                 average: bool = True, width: Array | None = None) -> Predictive:
        """
        Return that of cells about centres (n, N) with weights (N,).

        spacing: (n,) or (n, N), 0 on axes that the sensor does not see; average: whether cells
        that are wider than it resolves are cut, as a likelihood is averaged over them; width: how
        far they reach, (N,), where that is known, as by cell_widths.
        """
        keep = weights > NEGLIGIBLE * weights.max(initial=0.0)
        w, x = weights[keep], centres[:, keep]
        if average and len(w):
            cells = spacing if spacing.ndim == 1 else spacing[:, keep]
            width = cell_widths(sensor, x, cells, t) if width is None else width[keep]
            wide = (width > RESOLVED) & (w > SIGNIFICANT * w.max())
            if wide.any():
                w, x = _cut(w, x, np.broadcast_to(cells.reshape(len(x), -1), x.shape), wide,
                            float(width[wide].max()))
        return cls.of_points(sensor, w, x, t)

    @classmethod
    def gaussian(cls, sensor: Sensor, expected: Array, covariance: Array) -> Predictive:
        """Return a single Gaussian, mean (m,) and covariance (m, m)."""
        return cls(sensor, np.ones(1), expected[:, None], covariance)

    @np.errstate(all='ignore')
    def log_density(self, y: ArrayLike) -> float:
        """Return log p(y), -inf where nothing is expected at all."""
        if not self._is_sound:
            return -math.inf
        square = np.nan_to_num(np.square(self._around(y)), nan=np.inf, posinf=np.inf).sum(axis=0)
        constant = np.log(self._whiten.diagonal()).sum() - 0.5 * len(self.expected) * np.log(
            2 * np.pi)
        return float(special.logsumexp(-0.5 * square, b=self.weights) + constant)

    @np.errstate(over='ignore', invalid='ignore')
    def tail(self, y: ArrayLike) -> float:
        """
        Return P(p(Y) <= p(y)) for a Y that is drawn from p: how often y is surprised like that.

        Whatever p is, it is uniform on [0, 1] for a y that is drawn from it.  A single Gaussian's
        is that of chi-square.  One or two numbers: on a lattice of whitened y about the given one,
        to a few percent of its value; more: by importance sampling with fixed numbers, to a
        quarter down to 1e-5, where few points are expected; many are smoothed, so that it comes
        out too large.  0 beyond eight standard deviations of all that is expected, and where
        nothing is.
        """
        if not self._is_sound:
            return 0.0
        v = self._around(y)
        if not np.all(np.isfinite(v)):
            # so far out that the difference is no number
            return 0.0
        if len(self.weights) == 1:
            return float(special.chdtrc(len(v), np.square(v).sum()))
        if np.any((v.min(axis=1) > REACH) | (v.max(axis=1) < -REACH)):
            return 0.0
        box = self._lattice(v)
        return _sampled_tail(self.weights, v) if box is None else self._lattice_tail(v, *box)

    def _around(self, y: ArrayLike) -> Array:
        """Return what is expected, as whitened differences from a measurement, (m, N)."""
        given = np.asarray(y, dtype=float)[:, None]
        with np.errstate(over='ignore', invalid='ignore'):
            v: Array = self._whiten @ self.sensor.difference(self.expected, given)
        # inf - inf: beyond all numbers is beyond all that is expected
        return np.where(np.isnan(v), np.inf, v)

    @cached_property
    def _whiten(self) -> Array:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.covariance)), dtype=float)

    @cached_property
    def _is_sound(self) -> bool:
        parts = self.weights, self.expected, self.covariance
        if not len(self.weights) or not all(np.all(np.isfinite(part)) for part in parts):
            return False
        try:
            return bool(np.all(np.isfinite(self._whiten)))
        except np.linalg.LinAlgError:
            # a Kalman filter whose covariance is none any more
            return False

    def _lattice(self, v: Array) -> tuple[Array, NDArray[np.intp]] | None:
        """Return width and number of a lattice's cells on each axis, None where it is no use."""
        fineness, round_ = FINENESS.get(len(v)), any(self.sensor.angular)
        if fineness is None or (round_ and len(v) > 1):
            return None
        if round_:
            turn = 2 * np.pi * self._whiten[0, 0]
            count = np.array([max(math.ceil(turn * fineness), 8)])
            return turn / count, count
        span = np.maximum(v.max(axis=1), 0.0) - np.minimum(v.min(axis=1), 0.0) + 2 * REACH
        coarser = (np.prod(span * fineness) / LARGEST_LATTICE)**(1 / len(v))
        width = np.full(len(v), max(coarser, 1.0) / fineness)
        return width, np.ceil(span / width).astype(np.intp) + 3

    def _lattice_tail(self, v: Array, width: Array, count: NDArray[np.intp]) -> float:
        """Return the tail by the masses in the cells of a lattice, of which one has y in it."""
        origin = np.ceil((REACH - np.minimum(v.min(axis=1), 0.0)) / width).astype(np.intp)
        mode = 'wrap' if any(self.sensor.angular) else 'constant'
        mass = _shared(self.weights, v / width[:, None] + origin[:, None], count)
        # to be shared by neighbours has spread it already, by a sixth of a cell squared on average
        blur = np.sqrt(np.maximum(1 / width**2 - 1 / 6, 0.0))
        mass = ndimage.gaussian_filter(mass, blur, mode=mode, truncate=REACH)
        log_p = np.log(np.maximum(mass, 1e-300))
        slopes = np.gradient(log_p)
        steep = np.sqrt(sum(s * s for s in (slopes if len(count) > 1 else [slopes])))
        # of the cell on which the boundary lies, the share beyond it
        level = log_p[tuple(origin % count)]
        below = np.clip(0.5 + (level - log_p) / np.maximum(steep, 1e-12), 0, 1)
        return float(np.clip((mass * below).sum() / mass.sum(), 0.0, 1.0))


def _shared(weights: Array, places: Array, count: NDArray[np.intp]) -> Array:
    """Return what the cells of a lattice get of weights at places (m, N), means kept."""
    first = np.floor(places).astype(np.intp)
    rest, mass = places - first, np.zeros(int(np.prod(count)))
    for corner in itertools.product((0, 1), repeat=len(places)):
        up = np.array(corner)[:, None]
        flat = np.ravel_multi_index(tuple(first + up), tuple(count), mode='wrap')
        share = np.prod(np.where(up, rest, 1 - rest), axis=0)
        mass += np.bincount(flat, weights * share, len(mass))
    return mass.reshape(tuple(count))


def _cut(w: Array, x: Array, spacing: Array, wide: NDArray[np.bool_],
         width: float) -> tuple[Array, Array]:
    """Return weights and points with those of wide cells spread evenly over these."""
    seen = np.flatnonzero(spacing.any(axis=1))
    count = min(math.ceil(width) + 1, FINEST[len(seen)],
                max(int((MOST_POINTS / wide.sum())**(1 / len(seen))), 1))
    steps = (np.arange(count) + 0.5) / count - 0.5
    inner = np.zeros((len(x), count**len(seen)))
    inner[seen] = np.stack(np.meshgrid(*[steps] * len(seen), indexing='ij')).reshape(
        len(seen), -1)
    finer = (x[:, wide, None] + inner[:, None, :] * spacing[:, wide, None]).reshape(len(x), -1)
    return (np.concatenate([w[~wide], np.repeat(w[wide] / inner.shape[1], inner.shape[1])]),
            np.concatenate([x[:, ~wide], finer], axis=1))


def _sampled_tail(weights: Array, v: Array) -> float:
    """
    Return P(p(Y) <= p(0)) by importance sampling, p = sum_i w_i N(v_i, 1).

    Drawn from q, the mean over some scales s of sum_i w_i N(v_i, s^2), of which p is at most as
    many times as there are scales: so the tails are drawn often, and their weights are small.
    Where a crowd stands for more points, each is as wide as suits a crowd of that spread,
    standard deviation * N^(-1 / (m + 4))  [Scott 1992, section 6.3].
    """
    m = len(v)
    if len(weights) > CROWD:
        width = CROWD**(-1 / (m + 4))
        S = np.eye(m) + width**2 * np.atleast_2d(np.cov(v, aweights=weights, ddof=0))
        v = v[:, _picked(weights, (np.arange(CROWD) + 0.5) / CROWD)]
        weights = np.full(CROWD, 1 / CROWD)
        v = np.asarray(np.linalg.solve(np.linalg.cholesky(S), v), dtype=float)
    comb, noise, scale = _draws(m)
    drawn = v[:, _picked(weights, comb)] + noise * scale
    drawn = np.concatenate([drawn, np.zeros((m, 1))], axis=1)
    square = (np.square(drawn).sum(axis=0)[:, None] + np.square(v).sum(axis=0)
              - 2 * drawn.T @ v)
    p = np.exp(-0.5 * square) @ weights
    q = sum(np.exp(-0.5 / s**2 * square[:-1]) @ weights / s**m for s in SCALES) / len(SCALES)
    return float(min(np.where(p[:-1] <= p[-1], p[:-1] / q, 0.0).mean(), 1.0))


def _picked(weights: Array, shares: Array) -> NDArray[np.intp]:
    """Return the points in whose weights some shares of all fall."""
    return np.searchsorted(np.cumsum(weights), shares).clip(0, len(weights) - 1)


@lru_cache(maxsize=8)
def _draws(m: int) -> tuple[Array, Array, Array]:
    """Return which point each draw is about, as a share of all, its noise and the scale of it."""
    rng = np.random.Generator(np.random.Philox(key=m))
    comb = (rng.permutation(DRAWN) + 0.5) / DRAWN
    return comb, rng.standard_normal((m, DRAWN)), np.resize(SCALES, DRAWN)
