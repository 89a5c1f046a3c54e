"""A mean and a covariance, and the filters that keep no more of a density than that."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import check_covariance, gaussian_on, GridBelief
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import scale_of, Sensor, StateModel
from pif_ros.core.modes import Mode, MOST, SHARE
from pif_ros.core.predictive import Predictive
from pif_ros.core.rivals.passage import (check_box, driven_steps, known, LARGEST,
                                         short_way, step_ns, wrapped)

Array = NDArray[np.float64]

#: No derivative is taken for a narrower deviation, against which rounding would be too large.
NARROWEST = 1e-8


@dataclass(frozen=True, eq=False)
class GaussianBelief:
    """
    A mean (n,) and a covariance (n, n), and nothing else.

    box: what tells which states go round.  Numbers that are not finite stand for a belief that
    was lost: its mass is 0.
    """

    location: Array
    spread: Array
    box: Grid | None = None

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return self.location.nbytes + self.spread.nbytes

    @property
    def mass(self) -> float:
        """Return 1, or 0 where mean and covariance are no numbers any more."""
        return float(np.all(np.isfinite(self.location)) and np.all(np.isfinite(self.spread)))

    def mean(self) -> Array:
        """Return the mean, shape (n,)."""
        return self.location

    def mode(self) -> Array:
        """Return the densest point, which is the mean, shape (n,)."""
        return self.location

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""
        if about is None:
            return self.spread
        d = short_way(self.location - np.asarray(about, dtype=float), self.box)
        return self.spread + np.outer(d, d)

    def entropy(self) -> float:
        """Return the differential entropy in nats, log det(2 pi e P) / 2."""
        return float(np.linalg.slogdet(2 * np.pi * math.e * self.spread)[1]) / 2

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """Return the one hump that there is, none where the belief was lost."""
        return [Mode(1.0, self.location, self.spread)] if self.mass else []

    def on(self, grid: Grid, axes: Sequence[int]) -> GridBelief:
        """
        Return the density of some axes on their cells of a grid; its mass is what lies there.

        A periodic axis gets the sum over all turns.  A standard deviation below half a cell is
        widened to it; a lost belief has no density anywhere.
        """
        cells, axes = grid.select(axes), list(axes)
        if not self.mass:
            return GridBelief(cells, np.zeros(cells.shape))
        density = gaussian_on(cells, self.location[axes], self.spread[np.ix_(axes, axes)])
        # sampled at the cells' centres it may come to a little more than all
        return GridBelief(cells, density / max(density.sum() * cells.cell_volume, 1.0))


@dataclass(frozen=True, eq=False)
class GaussianFilter(ABC):
    """
    What the filters that keep a mean and a covariance have in common.

    time_step: seconds per step; box: what a uniform belief fills, and which states go round.  A
    prediction that blows up, or a covariance that is none any more, makes a belief of mass 0;
    nothing brings that back but a new start.
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    time_step: float
    box: Grid | None = None
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds, and refuse a box that does not fit the model."""
        object.__setattr__(self, 'time_step_ns', step_ns(self.time_step))
        check_box(self.box, self.model.ndim)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> GaussianBelief:
        """Return a belief to begin with; ValueError for a covariance that is none."""
        mean, covariance = np.array(mean, dtype=float), np.array(covariance, dtype=float)
        if mean.shape != (self.model.ndim,) or not np.all(np.isfinite(mean)):
            raise ValueError(f'mean: expected {self.model.ndim} finite numbers, '
                             f'got {mean.tolist()}')
        check_covariance('covariance', covariance, self.model.ndim)
        return GaussianBelief(wrapped(mean, self.box), covariance, self.box)

    def uniform(self) -> GaussianBelief:
        """Return the belief with the mean and the covariance of the uniform one in the box."""
        box = known(self.box)
        low, high = np.array(box.lower), np.array(box.upper)
        return GaussianBelief((low + high) / 2, np.diag((high - low)**2 / 12), box)

    @np.errstate(over='ignore', invalid='ignore', divide='ignore')
    def predict(self, belief: GaussianBelief, from_ns: int, to_ns: int,
                controls: Controls = NO_CONTROLS) -> GaussianBelief:
        """Return mean and covariance carried to a later stamp; ValueError for an earlier one."""
        m, P = belief.location, belief.spread
        for start, length, model in driven_steps(self.model, controls, from_ns, to_ns,
                                                 self.time_step_ns):
            m, P = self._step(model, m, P, start / NANOSECONDS, length / NANOSECONDS)
            m = wrapped(m, self.box)
            if not _sound(m, P):
                return GaussianBelief(np.full_like(m, np.nan), np.full_like(P, np.nan), self.box)
        return GaussianBelief(m, P, self.box)

    @np.errstate(over='ignore', invalid='ignore', divide='ignore')
    def correct(self, belief: GaussianBelief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[GaussianBelief, float]:
        """
        Return mean and covariance given a measurement, and its log evidence.

        Where one of them would be no number, the belief stays as it was and the evidence is -inf.
        """
        m, P, log_evidence = self._corrected(belief.location, belief.spread, y,
                                             self.sensors[sensor], at_ns / NANOSECONDS)
        m = wrapped(m, self.box)
        if not (_sound(m, P) and math.isfinite(log_evidence)):
            return belief, -math.inf
        return GaussianBelief(m, P, self.box), log_evidence

    def log_peak(self, belief: GaussianBelief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement just as the belief is sure it is."""
        return self.sensors[sensor].log_peak(at_ns / NANOSECONDS)

    @np.errstate(over='ignore', invalid='ignore', divide='ignore')
    def predictive(self, belief: GaussianBelief, sensor: str, at_ns: int) -> Predictive:
        """Return what is expected of a sensor: a Gaussian, whose tail is Mahalanobis' gate."""
        seen = self.sensors[sensor]
        expected, _, S = self._expected(belief.location, belief.spread, seen, at_ns / NANOSECONDS)
        return Predictive.gaussian(seen, expected, S)

    def mixed(self, belief: GaussianBelief, other: GaussianBelief, share: float,
              at_ns: int) -> GaussianBelief:
        """Return the moments of (1 - share) of a belief and a share of another."""
        if not belief.mass:
            return other
        d = short_way(other.location - belief.location, self.box)
        P = ((1 - share) * belief.spread + share * other.spread
             + share * (1 - share) * np.outer(d, d))
        return GaussianBelief(wrapped(belief.location + share * d, self.box), P, self.box)

    def remarks(self) -> list[str]:
        """Return nothing: it has no grid that could be too coarse."""
        return []

    def _diffusion(self, x: Array, t: float) -> Array:
        """Return g at states (n, ...), shape (n, n, ...), or (n, n) where it is the same there."""
        model = self.model
        if model.multiplicative:
            return model.diffusion_at(x, t)
        if callable(model.vielbein) or callable(model.noise_covariance):
            return model.diffusion(t)
        return self._constant_diffusion

    @cached_property
    def _constant_diffusion(self) -> Array:
        return self.model.diffusion(0.0)

    @abstractmethod
    def _step(self, model: StateModel, m: Array, P: Array, t: float,
              h: float) -> tuple[Array, Array]:
        """Return mean and covariance h seconds later; the model is that of the step."""

    @abstractmethod
    def _expected(self, m: Array, P: Array, sensor: Sensor,
                  t: float) -> tuple[Array, Array, Array]:
        """Return what is expected (m,), its covariance with the state (n, m) and its own."""

    @abstractmethod
    def _corrected(self, m: Array, P: Array, y: ArrayLike, sensor: Sensor,
                   t: float) -> tuple[Array, Array, float]:
        """Return mean, covariance and log evidence."""


@dataclass(frozen=True, eq=False)
class ExtendedKalmanFilter(GaussianFilter):
    """
    The continuous-discrete extended Kalman filter.

    Between measurements dm/dt = f(m), dP/dt = F P + P F^T + g(m) with f the drift in Ito's sense
    and F = df/dx at the mean; at one, the linearised update in Joseph's form, which keeps P
    positive definite.  [Jazwinski 1970, section 8.3]
    """

    def describe(self) -> str:
        """Return what the filter is."""
        return 'extended Kalman filter'

    def _step(self, model: StateModel, m: Array, P: Array, t: float,
              h: float) -> tuple[Array, Array]:
        """
        Return mean and covariance h seconds later, of fourth order in h.

        P'' = A P A^T + the integral of B g B^T, with A and B what takes an error over the step
        and from a moment of it to its end: a Runge-Kutta step for m and A, Hermite's cubics for
        the middle, Simpson's rule for the integral.  It is positive definite for any h.
        """
        g = self._diffusion
        start = g(m, t)
        model = model.at_scale(_widths(P + h * start))
        f, F, one = model.ito_drift, model.ito_jacobian, np.eye(len(m))

        def slopes(x: Array, A: Array, t: float) -> tuple[Array, Array]:
            return f(x, t), F(x, t) @ A

        k1, K1 = slopes(m, one, t)
        k2, K2 = slopes(m + h / 2 * k1, one + h / 2 * K1, t + h / 2)
        k3, K3 = slopes(m + h / 2 * k2, one + h / 2 * K2, t + h / 2)
        k4, K4 = slopes(m + h * k3, one + h * K3, t + h)
        end = m + h / 6 * (k1 + 2 * (k2 + k3) + k4)
        A = one + h / 6 * (K1 + 2 * (K2 + K3) + K4)
        k5, K5 = slopes(end, one, t + h)
        middle = (m + end) / 2 + h / 8 * (k1 - k5)
        # dB/ds = -B F, from A at the start to 1 at the end
        B = (A + one) / 2 + h / 8 * (K5 - A @ K1)
        P = (A @ (P + h / 6 * start) @ A.T + h * 2 / 3 * (B @ g(middle, t + h / 2) @ B.T)
             + h / 6 * g(end, t + h))
        return end, symmetric(P)

    def _expected(self, m: Array, P: Array, sensor: Sensor,
                  t: float) -> tuple[Array, Array, Array]:
        H = sensor.jacobian(m, t, scale_of(_widths(P)))
        C = P @ H.T
        return np.asarray(sensor.function(m, t), dtype=float), C, H @ C + sensor.noise(t)

    def _corrected(self, m: Array, P: Array, y: ArrayLike, sensor: Sensor,
                   t: float) -> tuple[Array, Array, float]:
        H, R = sensor.jacobian(m, t, scale_of(_widths(P))), sensor.noise(t)
        v = sensor.residual(y, np.asarray(sensor.function(m, t), dtype=float))
        C = P @ H.T
        gain, log_evidence = gain_and_log_evidence(C, H @ C + R, v)
        rest = np.eye(len(m)) - gain @ H
        return m + gain @ v, symmetric(rest @ P @ rest.T + gain @ R @ gain.T), log_evidence


def gain_and_log_evidence(C: Array, S: Array, v: Array) -> tuple[Array, float]:
    """
    Return C S^-1 and log N(v; 0, S) for the covariance C (n, m) of state and measurement.

    NaN where S is no covariance.
    """
    try:
        L = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        return np.full_like(C, np.nan), math.nan
    whiten = np.linalg.inv(L)
    w = whiten @ v
    log_evidence = (np.log(whiten.diagonal()).sum()
                    - 0.5 * (w @ w + len(v) * math.log(2 * math.pi)))
    return (C @ whiten.T) @ whiten, float(log_evidence)


def symmetric(P: Array) -> Array:
    """Return a matrix made symmetric to the last bit."""
    return (P + P.T) / 2


def _widths(P: Array) -> Array:
    """Return the deviations (n,) of a covariance, of any length that is worth a derivative."""
    variance = P.diagonal()
    return np.where(variance > 0, np.sqrt(np.maximum(variance, NARROWEST**2)), np.inf)


def _sound(m: Array, P: Array) -> bool:
    # a comparison with NaN is false
    return bool(np.abs(m).max() < LARGEST and np.abs(P).max() < LARGEST
                and P.diagonal().min() >= 0)
