"""The unscented Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.models import Field, Sensor, StateModel
from pif_ros.core.rivals.gaussian import gain_and_log_evidence, GaussianFilter, symmetric

Array = NDArray[np.float64]

#: How far below zero rounding may push an eigenvalue of a covariance, in shares of the largest.
ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class UnscentedKalmanFilter(GaussianFilter):
    """
    The continuous-discrete unscented Kalman filter with scaled sigma points.

    2 n + 1 points at the mean and alpha sqrt(n + kappa) standard deviations from it; beta goes
    into the mean's own weight in covariances  [Wan and van der Merwe 2000; Julier 2002].  kappa is
    3 - n where none is given, but not below 0: with alpha 1 and beta 0 no weight is negative then,
    so that no covariance can be, and the variance of a state squared is exact up to 3 states.
    """

    alpha: float = 1.0
    beta: float = 0.0
    kappa: float | None = None
    _scale: float = field(init=False, repr=False)
    _mean_weights: Array = field(init=False, repr=False)
    _weights: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Refuse constants that place no points, and weigh the points."""
        super().__post_init__()
        n = self.model.ndim
        kappa = max(3.0 - n, 0.0) if self.kappa is None else self.kappa
        scale = self.alpha**2 * (n + kappa)
        if not (0 < self.alpha < np.inf and 0 < scale < np.inf):
            raise ValueError(f'alpha, kappa: expected alpha > 0 and kappa > {-n}, '
                             f'got {self.alpha} and {kappa}')
        weights = np.full(2 * n + 1, 0.5 / scale)
        weights[0] = 1 - n / scale
        put = object.__setattr__
        put(self, '_scale', scale)
        put(self, '_mean_weights', weights.copy())
        weights[0] += 1 - self.alpha**2 + self.beta
        put(self, '_weights', weights)

    def describe(self) -> str:
        """Return what the filter is."""
        return f'unscented Kalman filter with {len(self._weights)} points'

    def _step(self, model: StateModel, m: Array, P: Array, t: float,
              h: float) -> tuple[Array, Array]:
        """
        Return mean and covariance h seconds later.

        Half of the noise, the points through a Runge-Kutta step of the drift, the other half: of
        second order in h for a linear drift and additive noise, else of first.  Noise that
        depends on the state is that of the points, on average.
        """
        x = self._points(m, P + h / 2 * self._mean_diffusion(m, P, t))
        x = runge_kutta(model.ito_drift, x, t, h)
        m = x @ self._mean_weights
        d = x - m[:, None]
        P = symmetric((d * self._weights) @ d.T)
        return m, P + h / 2 * self._mean_diffusion(m, P, t + h)

    def _expected(self, m: Array, P: Array, sensor: Sensor,
                  t: float) -> tuple[Array, Array, Array]:
        d, expected, d_seen = self._seen(m, P, sensor, t)
        return (expected, (d * self._weights) @ d_seen.T,
                symmetric((d_seen * self._weights) @ d_seen.T) + sensor.noise(t))

    def _corrected(self, m: Array, P: Array, y: ArrayLike, sensor: Sensor,
                   t: float) -> tuple[Array, Array, float]:
        R, (d, expected, d_seen) = sensor.noise(t), self._seen(m, P, sensor, t)
        v = sensor.residual(y, expected)
        S = symmetric((d_seen * self._weights) @ d_seen.T) + R
        gain, log_evidence = gain_and_log_evidence((d * self._weights) @ d_seen.T, S, v)
        # P - K S K^T, as a sum of squares  [as Joseph's form is]
        rest = d - gain @ d_seen
        P = symmetric((rest * self._weights) @ rest.T + gain @ R @ gain.T)
        return m + gain @ v, P, log_evidence

    def _seen(self, m: Array, P: Array, sensor: Sensor, t: float) -> tuple[Array, Array, Array]:
        """Return the points less their mean, what is expected (m,), and theirs less that."""
        x = self._points(m, P)
        seen = np.asarray(sensor.function(x, t), dtype=float)
        # angles are averaged as differences from the first, the short way round
        centre = seen[:, :1]
        d_seen = sensor.difference(seen, centre)
        shift = d_seen @ self._mean_weights
        return x - m[:, None], centre[:, 0] + shift, d_seen - shift[:, None]

    def _points(self, m: Array, P: Array) -> Array:
        """Return the sigma points, shape (n, 2 n + 1)."""
        d = np.sqrt(self._scale) * _root(P)
        return m[:, None] + np.concatenate([np.zeros((len(m), 1)), d, -d], axis=1)

    def _mean_diffusion(self, m: Array, P: Array, t: float) -> Array:
        """Return the mean of g over the points."""
        if not self.model.multiplicative:
            return self._diffusion(m, t)
        return symmetric(self._diffusion(self._points(m, P), t) @ self._mean_weights)


def runge_kutta(f: Field, x: Array, t: float, h: float) -> Array:
    """Return states (n, N) after one step of dx/dt = f(x, t)."""
    k1 = f(x, t)
    k2 = f(x + h / 2 * k1, t + h / 2)
    k3 = f(x + h / 2 * k2, t + h / 2)
    k4 = f(x + h * k3, t + h)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _root(P: Array) -> Array:
    """Return L with L L^T = P, by eigenvalues where rounding has spoiled it; NaN for no P >= 0."""
    try:
        return np.asarray(np.linalg.cholesky(P), dtype=float)
    except np.linalg.LinAlgError:
        if not np.all(np.isfinite(P)):
            return np.full_like(P, np.nan)
    size, axes = np.linalg.eigh(P)
    if size[0] < -ROUNDING * size[-1]:
        return np.full_like(P, np.nan)
    return axes * np.sqrt(np.maximum(size, 0.0))
