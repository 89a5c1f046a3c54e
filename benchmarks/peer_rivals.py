"""Other people's particle, extended and unscented filters, as contestants of the rivals."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from benchmarks.problem import PRIOR_COVARIANCE, PRIOR_MEAN, SENSOR, SYSTEM, TIME_STEP
from benchmarks.reference import Means
from benchmarks.rivals import folded
from filterpy import kalman
from filterpy.monte_carlo import systematic_resample
import numpy as np
from numpy.typing import NDArray
from stonesoup.models.base import GaussianModel
from stonesoup.models.measurement.base import MeasurementModel
from stonesoup.models.transition.base import TransitionModel
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import ESSResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

Array = NDArray[np.float64]

EPOCH = datetime(2000, 1, 1)
INTERVAL = timedelta(seconds=TIME_STEP)
R = np.asarray(SENSOR.covariance)


class StoneSoupParticles:
    """Stone Soup's particle filter, resampled by its effective size, as it comes."""

    def __init__(self, count: int) -> None:
        """Take the number of particles."""
        self._count, self._sensor = count, _Squares()
        self._predictor = ParticlePredictor(_Euler())
        self._updater = ParticleUpdater(self._sensor, ESSResampler())

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        np.random.seed(11)  # it has no generator of its own
        x = np.random.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE, self._count).T
        self._state = ParticleState(StateVectors(x), log_weight=np.full(
            self._count, -np.log(self._count)), timestamp=EPOCH)
        self._detections = [Detection(StateVector(y), timestamp=EPOCH + (k + 1) * INTERVAL,
                                      measurement_model=self._sensor)
                            for k, y in enumerate(measurements)]

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        moved = self._predictor.predict(self._state, timestamp=EPOCH + (k + 1) * INTERVAL)
        self._state = self._updater.update(SingleHypothesis(moved, self._detections[k]))

    def means(self) -> Means:
        """Return the means of x and |x|."""
        x, w = np.asarray(self._state.state_vector, dtype=float), np.exp(self._state.log_weight)
        return Means(x @ w, np.abs(x) @ w)


class FilterPyParticles:
    """A bootstrap filter in a few lines of numpy around FilterPy's systematic resampling."""

    def __init__(self, count: int) -> None:
        """Take the number of particles."""
        self._count = count

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        np.random.seed(11)  # for its resampling
        self._random = np.random.default_rng(11)
        self._measurements = measurements
        self._x = self._random.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE, self._count).T
        self._w = np.full(self._count, 1 / self._count)

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        x, w = self._x, self._w
        if 1 / (w @ w) < self._count / 2:
            x, w = x[:, systematic_resample(w)], np.full(self._count, 1 / self._count)
        x = x + TIME_STEP * SYSTEM.model.drift(x, 0.0) + np.sqrt(
            TIME_STEP) * self._random.standard_normal(x.shape)
        w = w * np.exp(-0.5 * np.sum((self._measurements[k][:, None] - x**2)**2, axis=0))
        self._x, self._w = x, w / w.sum()

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return Means(self._x @ self._w, np.abs(self._x) @ self._w)


class FilterPyExtended:
    """FilterPy's extended Kalman filter; the transition is expanded to second order."""

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self._measurements, self._filter = measurements, kalman.ExtendedKalmanFilter(2, 2)
        self._filter.x, self._filter.P = PRIOR_MEAN.copy(), PRIOR_COVARIANCE.copy()
        self._filter.R, self._filter.Q = R, SYSTEM.model.diffusion(0.0) * TIME_STEP
        self._filter.predict_x = self._move

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        self._filter.predict()
        self._filter.update(self._measurements[k], lambda x: np.diag(2 * x), lambda x: x**2)

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return folded(self._filter.x, self._filter.P)

    def _move(self, u: float = 0) -> None:
        J = TIME_STEP * SYSTEM.model.jacobian(self._filter.x, 0.0)
        self._filter.F = np.eye(2) + J + J @ J / 2
        self._filter.x = _runge_kutta(self._filter.x, TIME_STEP)


class FilterPyUnscented:
    """FilterPy's unscented Kalman filter, with points where ours has them."""

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self._measurements = measurements
        self._filter = kalman.UnscentedKalmanFilter(
            2, 2, TIME_STEP, lambda x: x**2, _runge_kutta,
            kalman.MerweScaledSigmaPoints(2, 1.0, 0.0, 1.0))
        self._filter.x, self._filter.P = PRIOR_MEAN.copy(), PRIOR_COVARIANCE.copy()
        self._filter.R, self._filter.Q = R, SYSTEM.model.diffusion(0.0) * TIME_STEP

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        self._filter.predict()
        self._filter.update(self._measurements[k])

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return folded(self._filter.x, self._filter.P)


class _Euler(TransitionModel):
    """One Euler step, as a transition model."""

    @property
    def ndim_state(self) -> int:
        """Return the number of states."""
        return 2

    def function(self, state: Any, noise: bool = False, **_: Any) -> StateVectors:
        """Return the next states."""
        x = np.asarray(state.state_vector, dtype=float)
        moved = x + TIME_STEP * SYSTEM.model.drift(x, 0.0)
        return StateVectors(moved + self.rvs(x.shape[1]))

    def rvs(self, num_samples: int = 1, **_: Any) -> Array:
        """Return noise."""
        return np.sqrt(TIME_STEP) * np.random.standard_normal((2, num_samples))

    def pdf(self, state1: Any, state2: Any, **_: Any) -> None:
        """Return nothing: nobody asks."""


class _Squares(GaussianModel, MeasurementModel):
    """The sensor, as a Gaussian measurement model."""

    ndim_state = 2
    mapping = (0, 1)

    @property
    def ndim_meas(self) -> int:
        """Return the number of components."""
        return 2

    def function(self, state: Any, noise: bool = False, **_: Any) -> StateVectors:
        """Return x^2."""
        return StateVectors(np.asarray(state.state_vector, dtype=float)**2)

    def covar(self, **_: Any) -> Array:
        """Return R."""
        return R


def _runge_kutta(x: Array, dt: float) -> Array:
    f = SYSTEM.model.drift
    k1 = f(x, 0.0)
    k2 = f(x + dt / 2 * k1, 0.0)
    k3 = f(x + dt / 2 * k2, 0.0)
    k4 = f(x + dt * k3, 0.0)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
