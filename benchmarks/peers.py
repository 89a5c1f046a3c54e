"""Other people's filters on the same problem, behind the methods of a contestant of the step."""

from __future__ import annotations

from datetime import datetime, timedelta
from typing import Any

from benchmarks.problem import PRIOR_COVARIANCE, PRIOR_MEAN, SENSOR, SYSTEM, TIME_STEP
from benchmarks.reference import Cells, Means
import numpy as np
from numpy.typing import NDArray
import particles
from particles import distributions
from particles import state_space_models
from scipy.linalg import expm
from stonesoup.functions import grid_creation
from stonesoup.predictor.pointmass import PointMassPredictor
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.detection import Detection
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import PointMassState
from stonesoup.updater.pointmass import PointMassUpdater

Array = NDArray[np.float64]

EPOCH = datetime(2000, 1, 1)
INTERVAL = timedelta(seconds=TIME_STEP)


class PointMass:
    """
    Stone Soup's point mass filter, which is for linear models.

    The drift is linearised about the posterior mean at each step; what the linear model leaves of
    the drift, a constant, is added to the predicted grid.  The grid moves and turns with the
    belief, four standard deviations to each side.
    """

    _state: PointMassState

    def __init__(self, cells: int) -> None:
        """Take an odd number of points per axis, as its convolution needs."""
        self._cells = np.array([cells, cells])
        self._model = _Linearised()
        self._sensor = _Squares()
        self._predictor = PointMassPredictor(self._model)
        self._updater = PointMassUpdater(self._sensor)

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self._detections = [Detection(StateVector(y), timestamp=EPOCH + (k + 1) * INTERVAL,
                                      measurement_model=self._sensor)
                            for k, y in enumerate(measurements)]
        self._begin(PRIOR_COVARIANCE)

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        self._predict()
        self._state = self._updater.update(SingleHypothesis(self._state, self._detections[k]))

    def means(self) -> Means:
        """Return the means of x and |x|."""
        x = np.asarray(self._state.state_vector, dtype=float)
        w = np.ravel(self._state.weight) / np.sum(self._state.weight)
        return Means(x @ w, np.abs(x) @ w)

    def predicted(self, steps: int) -> Cells:
        """Return the density some steps from N(0, I) without a measurement."""
        self._begin(np.eye(2))
        for _ in range(steps):
            self._predict()
        return Cells(np.asarray(self._state.state_vector, dtype=float),
                     np.ravel(self._state.weight), float(np.prod(self._state.grid_delta)))

    def _begin(self, covariance: Array) -> None:
        points, delta, axes, centre, turn = grid_creation(
            PRIOR_MEAN[:, None], covariance, 4.0, 2, self._cells)
        d = points - PRIOR_MEAN[:, None]
        weight = np.exp(-0.5 * np.einsum('ik,ij,jk->k', d, np.linalg.inv(covariance), d))
        self._state = PointMassState(
            state_vector=StateVectors(points), weight=weight / (weight.sum() * np.prod(delta)),
            grid_delta=delta, grid_dim=axes, center=centre, eigVec=turn, Npa=self._cells,
            timestamp=EPOCH)

    def _predict(self) -> None:
        mean = np.asarray(self._state.mean, dtype=float)
        self._model.linearise(mean)
        self._state = self._predictor.predict(
            self._state, timestamp=self._state.timestamp + INTERVAL)
        offset = self._model.offset[:, None]
        self._state.state_vector = StateVectors(self._state.state_vector + offset)
        self._state.center = self._state.center + offset


class Particles:
    """The bootstrap filter of the package particles, as it comes (systematic resampling)."""

    def __init__(self, count: int) -> None:
        """Take the number of particles."""
        self._count = count

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        np.random.seed(11)  # it has no generator of its own
        model = state_space_models.Bootstrap(
            ssm=_EulerModel(), data=list(measurements[:, None]))
        self._filter = particles.SMC(fk=model, N=self._count)

    def step(self, k: int) -> None:
        """Predict, and correct with the next measurement, which is the k-th."""
        next(self._filter)

    def means(self) -> Means:
        """Return the means of x and |x|."""
        w, x = self._filter.W, self._filter.X
        return Means(w @ x, w @ np.abs(x))

    def predicted(self, steps: int) -> None:
        """Return nothing: there is no density to compare."""


class _Linearised:
    """What the predictor asks of a transition model: F and Q of one time step."""

    ndim_state = 2

    def linearise(self, mean: Array) -> None:
        """Take the drift's tangent at a state (2,)."""
        J = SYSTEM.model.jacobian(mean[:, None], 0.0)[..., 0]
        f = SYSTEM.model.drift(mean[:, None], 0.0)[:, 0]
        self._F = expm(J * TIME_STEP)
        self.offset = mean + f * TIME_STEP - self._F @ mean
        self._Q = SYSTEM.model.diffusion(0.0) * TIME_STEP

    def matrix(self, **_: Any) -> Array:
        """Return F."""
        return self._F

    def covar(self, **_: Any) -> Array:
        """Return Q."""
        return self._Q


class _Squares:
    """What the updater asks of a measurement model: h(x) = x^2 and R."""

    def function(self, state: Any, **_: Any) -> StateVectors:
        """Return x^2."""
        return StateVectors(np.asarray(state.state_vector, dtype=float)**2)

    def covar(self, **_: Any) -> Array:
        """Return R."""
        return np.asarray(SENSOR.covariance)


class _FirstState(distributions.ProbDist):
    """The state at the first measurement: the prior, one time step later."""

    dim = 2

    def rvs(self, size: int | None = None) -> Array:
        """Return draws (size, 2)."""
        x = np.random.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE, size)
        return _moved(x).rvs(size=size)


class _EulerModel(state_space_models.StateSpaceModel):
    """The problem as a state space model: one Euler step between measurements."""

    def PX0(self) -> distributions.ProbDist:  # noqa: N802
        """Return the law of the state at the first measurement."""
        return _FirstState()

    def PX(self, t: int, xp: Array) -> distributions.ProbDist:  # noqa: N802
        """Return the law of the next state."""
        return _moved(xp)

    def PY(self, t: int, xp: Array, x: Array) -> distributions.ProbDist:  # noqa: N802
        """Return the law of the measurement."""
        return distributions.IndepProd(distributions.Normal(loc=x[:, 0]**2),
                                       distributions.Normal(loc=x[:, 1]**2))


def _moved(x: Array) -> distributions.ProbDist:
    f = SYSTEM.model.drift(x.T, 0.0)
    return distributions.IndepProd(
        *(distributions.Normal(loc=x[:, i] + TIME_STEP * f[i], scale=np.sqrt(TIME_STEP))
          for i in range(2)))
