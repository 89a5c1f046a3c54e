"""
What is expected to be measured: the density of the next measurement given all before, its tails.

p(y | past) = sum_i w_i N(y; h(x_i), R) over the cells, or particles, of a belief: the evidence of
a measurement [Sensors, Eq. 27] as a function of it.  Nothing is said of its shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.likelihood import cell_widths, RESOLVED, SIGNIFICANT, widths_along
from pif_ros.core.models import Sensor
from pif_ros.core.tails import REACH, tail, unrolled
from scipy import special

Array = NDArray[np.float64]

#: Points with less than this share of the heaviest one's weight are not looked at.
NEGLIGIBLE = 1e-12
#: Cells that are wider than a sensor resolves are cut into points so many standard deviations
#: apart, a Gaussian sampled at which sums to 0.03 %, but into so many in all at most.
APART, MOST_POINTS = 1.5, 1 << 16
#: The share of the cells, the narrowest ones, that says how wide such points are made.
NARROW = 0.25


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
    def of_points(cls, sensor: Sensor, weights: Array, points: Array, t: float,
                  covariance: Array | float = 0.0) -> Predictive:
        """
        Return that of states (n, N) with weights (N,); where h is undefined it has none.

        covariance: what is added to the sensor's own, (m, m).
        """
        expected = np.asarray(sensor.function(points, t), dtype=float)
        sound = np.isfinite(expected).all(axis=0) & (
            weights > NEGLIGIBLE * weights.max(initial=0.0))
        w = weights[sound]
        return cls(sensor, w / w.sum(), expected[:, sound], sensor.noise(t) + covariance)

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
                cells = np.broadcast_to(cells.reshape(len(x), -1), x.shape)[:, wide]
                *finer, covariance = _cut(sensor, w[wide], x[:, wide], cells, t)
                w, x = (np.concatenate([a, b], axis=-1)
                        for a, b in zip((w[~wide], x[:, ~wide]), finer))
                return cls.of_points(sensor, w, x, t, covariance)
        return cls.of_points(sensor, w, x, t)

    @classmethod
    def of_marginal(cls, sensor: Sensor, marginal: GridBelief, seen: Sequence[int], grid: Grid,
                    t: float, average: bool = True) -> Predictive:
        """Return that of a belief over the states that a sensor sees, out of all of a grid's."""
        box, spacing = np.array([grid.lower, grid.upper]), np.zeros(grid.ndim)
        centres = np.repeat(box.mean(axis=0)[:, None], marginal.grid.size, axis=1)
        centres[list(seen)], spacing[list(seen)] = marginal.grid.points, marginal.grid.spacing
        return cls.of_cells(sensor, marginal.density.ravel(), centres, spacing, t, average)

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
        is that of chi-square.  One or two numbers: on lattices of whitened y about the given one,
        to a few percent of its value, but where what is expected spreads over more than those
        hold; more, or two with an angle that may be any: by importance sampling with fixed
        numbers, to a factor of two, a little too large where what is expected spreads far.  0
        beyond eight standard deviations of all that is expected, and where nothing is.
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
        if len(v) == 1:
            return tail(self.weights, v, any(self.sensor.angular) * 2 * np.pi * self._whiten[0, 0])
        if any(self.sensor.angular):
            v, is_line = self._on_lines(y)
            return tail(self.weights, v, 0.0 if is_line else math.inf)
        return tail(self.weights, v)

    def _on_lines(self, y: ArrayLike) -> tuple[Array, bool]:
        """Return the same with angles unrolled, and whether each has a gap in which to cut it."""
        difference = self.sensor.difference(self.expected, np.asarray(y, dtype=float)[:, None])
        is_line = True
        for i in np.flatnonzero(self.sensor.angular):
            found = unrolled(difference[i], 2 * np.pi, 2 * REACH * math.sqrt(
                self.covariance[i, i]))
            is_line &= found is not None
            difference[i] = difference[i] if found is None else found
        return np.asarray(self._whiten @ difference, dtype=float), is_line

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


def _cut(sensor: Sensor, w: Array, x: Array, spacing: Array,
         t: float) -> tuple[Array, Array, Array]:
    """
    Return weights and points that stand for wide cells (n, N), and a covariance (m, m).

    That is 0 where the points are close enough.  Else they must be no comb: for a single number
    they are strewn over the cells, and of more numbers each point is made a Gaussian.
    """
    wanted = np.maximum(np.ceil(widths_along(sensor, x, spacing, t).max(axis=1) / APART), 1)
    counts = _affordable(wanted, MOST_POINTS / len(w))
    inner = np.stack(np.meshgrid(*[(np.arange(count) + 0.5) / count - 0.5 for count in counts],
                                 indexing='ij')).reshape(len(x), 1, -1)
    covariance = np.zeros((sensor.size,) * 2)
    if sensor.size > 1:
        for axis in np.flatnonzero(counts < wanted):
            covariance += _blur(sensor, w, x, spacing, int(axis), t) / counts[axis]**2
    elif np.any(counts < wanted):
        rng = np.random.Generator(np.random.Philox(key=1))
        strewn = rng.random((*x.shape, inner.shape[2])) - 0.5
        inner = inner + strewn / counts[:, None, None]
    finer = x[:, :, None] + inner * spacing[:, :, None]
    share = inner.shape[2]
    return np.repeat(w / share, share), finer.reshape(len(x), -1), covariance


def _blur(sensor: Sensor, w: Array, x: Array, spacing: Array, axis: int, t: float) -> Array:
    """Return a covariance (m, m) with which narrow cells in a row along an axis are flat."""
    half = np.zeros(x.shape)
    half[axis] = spacing[axis] / 2
    d = np.nan_to_num(sensor.difference(sensor.function(x + half, t),
                                        sensor.function(x - half, t)))
    narrow = w * (_lengths(d) <= _lengths(d)[_ranked(w, _lengths(d), NARROW)])
    # Gaussians of this variance in a row sum to 7 % of their mean
    return np.asarray(d * narrow @ d.T / (6 * narrow.sum()), dtype=float)


def _lengths(d: Array) -> Array:
    """Return the lengths of vectors (m, N), (N,)."""
    return np.sqrt(np.square(d).sum(axis=0))


def _ranked(weights: Array, values: Array, share: float) -> int:
    """Return which value has a share of the weights at or below it."""
    order = np.argsort(values)
    return int(order[np.searchsorted(np.cumsum(weights[order]), share * weights.sum())])


def _affordable(counts: Array, most: float) -> Array:
    """Return counts of which the product is no more than that, the small ones as they are."""
    found, left = counts.copy(), max(most, 1.0)
    for done, axis in enumerate(np.argsort(counts)):
        found[axis] = min(counts[axis], max(int(left**(1 / (len(counts) - done)) + 1e-9), 1))
        left /= found[axis]
    return found
