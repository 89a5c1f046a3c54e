"""Filters to compare with, behind the same two verbs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor, StateModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class GaussianBelief:
    """A mean (n,) and a covariance (n, n), and nothing else."""

    location: Array
    spread: Array

    def mean(self) -> Array:
        """Return the mean, shape (n,)."""
        return self.location

    def covariance(self) -> Array:
        """Return the covariance, shape (n, n)."""
        return self.spread


@dataclass(frozen=True, eq=False)
class ExtendedKalmanFilter:
    """
    The continuous-discrete extended Kalman filter, time_step in seconds per Runge-Kutta step.

    Between measurements dm/dt = f(m), dP/dt = F P + P F^T + g with F = df/dx at the mean; at one,
    the linearised update in Joseph's form.  [Jazwinski 1970, section 8.3]
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    time_step: float
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds."""
        object.__setattr__(self, 'time_step_ns', max(round(self.time_step * NANOSECONDS), 1))

    def predict(self, belief: GaussianBelief, from_ns: int, to_ns: int) -> GaussianBelief:
        """Return mean and covariance carried to a later stamp; ValueError for an earlier one."""
        if to_ns < from_ns:
            raise ValueError(f'to_ns: expected a stamp from {from_ns} on, got {to_ns}')
        m, P, t = belief.location, belief.spread, from_ns
        while t < to_ns:
            step = min(self.time_step_ns, to_ns - t)
            m, P = self._step(m, P, t / NANOSECONDS, step / NANOSECONDS)
            t += step
        return GaussianBelief(m, P)

    def correct(self, belief: GaussianBelief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[GaussianBelief, float]:
        """Return mean and covariance given a measurement, and its log evidence."""
        m, P, t = belief.location, belief.spread, at_ns / NANOSECONDS
        seen = self.sensors[sensor]
        H, R = seen.jacobian(m, t), seen.noise(t)
        v = seen.residual(y, np.asarray(seen.function(m, t), dtype=float))
        S = H @ P @ H.T + R
        gain = np.linalg.solve(S, H @ P).T
        rest = np.eye(len(m)) - gain @ H
        log_evidence = -0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1])
        return (GaussianBelief(m + gain @ v, rest @ P @ rest.T + gain @ R @ gain.T),
                float(log_evidence))

    def describe(self) -> str:
        """Return what the filter is."""
        return 'extended Kalman filter'

    def remarks(self) -> list[str]:
        """Return nothing: it has no grid that could be too coarse."""
        return []

    def _step(self, m: Array, P: Array, t: float, h: float) -> tuple[Array, Array]:
        def slope(m: Array, P: Array, t: float) -> tuple[Array, Array]:
            F = self.model.jacobian(m, t)
            return (np.asarray(self.model.drift(m, t), dtype=float),
                    F @ P + P @ F.T + self.model.diffusion(t))

        k1 = slope(m, P, t)
        k2 = slope(m + h / 2 * k1[0], P + h / 2 * k1[1], t + h / 2)
        k3 = slope(m + h / 2 * k2[0], P + h / 2 * k2[1], t + h / 2)
        k4 = slope(m + h * k3[0], P + h * k3[1], t + h)
        return (m + h / 6 * (k1[0] + 2 * k2[0] + 2 * k3[0] + k4[0]),
                P + h / 6 * (k1[1] + 2 * k2[1] + 2 * k3[1] + k4[1]))
