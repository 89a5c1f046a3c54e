"""Stone Soup's particle filter behind the methods of a contestant of the step."""

from __future__ import annotations

from typing import Any

from benchmarks.peers import EPOCH, INTERVAL
from benchmarks.problem import PRIOR_COVARIANCE, PRIOR_MEAN, SYSTEM, TIME_STEP
from benchmarks.reference import Means
import numpy as np
from numpy.typing import NDArray
from stonesoup.predictor.particle import ParticlePredictor
from stonesoup.resampler.particle import SystematicResampler
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import ParticleState
from stonesoup.updater.particle import ParticleUpdater

Array = NDArray[np.float64]


class StoneSoupParticles:
    """The bootstrap filter of Stone Soup, with systematic resampling at every step."""

    def __init__(self, count: int) -> None:
        """Take the number of particles."""
        self._count, self._sensor = count, _Squares()
        self._predictor = ParticlePredictor(_Euler())
        self._updater = ParticleUpdater(self._sensor, SystematicResampler())

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self._predictor.transition_model.rng = np.random.default_rng(11)
        np.random.seed(11)  # the resampler has no generator of its own
        x = np.random.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE, self._count).T
        self._state = ParticleState(StateVectors(x), timestamp=EPOCH,
                                    weight=np.full(self._count, 1 / self._count))
        self._detections = [Detection(StateVector(y), timestamp=EPOCH + (k + 1) * INTERVAL,
                                      measurement_model=self._sensor)
                            for k, y in enumerate(measurements)]

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        moved = self._predictor.predict(self._state, timestamp=EPOCH + (k + 1) * INTERVAL)
        self._state = self._updater.update(SingleHypothesis(moved, self._detections[k]))

    def means(self) -> Means:
        """Return the means of x and |x|."""
        x = np.asarray(self._state.state_vector, dtype=float)
        w = np.exp(np.asarray(self._state.log_weight, dtype=float))
        return Means(x @ w / w.sum(), np.abs(x) @ w / w.sum())

    def predicted(self, steps: int) -> None:
        """Return nothing: there is no density to compare."""


class _Euler:
    """What the predictor asks of a transition model: one Euler step."""

    def __init__(self) -> None:
        self.rng = np.random.default_rng()

    def function(self, state: Any, **_: Any) -> StateVectors:
        """Return where the particles are a time step later."""
        x = np.asarray(state.state_vector, dtype=float)
        noise = np.sqrt(TIME_STEP) * self.rng.standard_normal(x.shape)
        return StateVectors(x + TIME_STEP * SYSTEM.model.drift(x, 0.0) + noise)


class _Squares:
    """What the updater asks of a measurement model: log p(y | x) for h(x) = x^2, R = 1."""

    def logpdf(self, measurement: Any, state: Any, **_: Any) -> Array:
        """Return the log likelihood of each particle, up to a constant."""
        x = np.asarray(state.state_vector, dtype=float)
        y = np.asarray(measurement.state_vector, dtype=float)
        return np.asarray(-0.5 * np.sum((y - x**2)**2, axis=0))
