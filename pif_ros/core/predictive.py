"""
What is expected to be measured: the density of the next measurement given all before, its tails.

p(y | past) = sum_i w_i N(y; h(x_i), R) over the cells, or particles, of a belief: the evidence of
a measurement [Sensors, Eq. 27] as a function of it.  Nothing is said of its shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.likelihood import cell_widths, RESOLVED, SIGNIFICANT
from pif_ros.core.models import Sensor
from pif_ros.core.tails import REACH, tail
from scipy import special

Array = NDArray[np.float64]

#: Points with less than this share of the heaviest one's weight are not looked at.
NEGLIGIBLE = 1e-12
#: Cells that are wider than a sensor resolves are cut into points so many standard deviations
#: apart, a Gaussian sampled at which sums to 0.03 %, but into this many in all at most.
APART, MOST_POINTS = 1.5, 1 << 16


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
        is that of chi-square.  One or two numbers: on lattices of whitened y about the given one,
        to a few percent of its value, but where what is expected spreads over more than those
        hold; more: by importance sampling with fixed numbers, to a quarter down to 1e-5, where
        few points are expected; many are smoothed, so that it comes out too large.  0 beyond eight
        standard deviations of all that is expected, and where nothing is.
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
        if not any(self.sensor.angular):
            return tail(self.weights, v)
        return tail(self.weights, v, 2 * np.pi * self._whiten[0, 0] if len(v) == 1 else math.inf)

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


def _cut(w: Array, x: Array, spacing: Array, wide: NDArray[np.bool_],
         width: float) -> tuple[Array, Array]:
    """Return weights and points with those of wide cells spread evenly over these."""
    seen = np.flatnonzero(spacing.any(axis=1))
    count = min(math.ceil(width / APART),
                max(int((MOST_POINTS / wide.sum())**(1 / len(seen))), 1))
    steps = (np.arange(count) + 0.5) / count - 0.5
    inner = np.zeros((len(x), count**len(seen)))
    inner[seen] = np.stack(np.meshgrid(*[steps] * len(seen), indexing='ij')).reshape(
        len(seen), -1)
    finer = (x[:, wide, None] + inner[:, None, :] * spacing[:, wide, None]).reshape(len(x), -1)
    return (np.concatenate([w[~wide], np.repeat(w[wide] / inner.shape[1], inner.shape[1])]),
            np.concatenate([x[:, ~wide], finer], axis=1))
