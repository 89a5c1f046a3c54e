"""The extended Kalman-Bucy filter: a mean and a covariance, given a measured path."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.continuous.increments import Increments
from pif_ros.core.continuous.path import correct_by_path, path_log_peak, PathBelief
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, GaussianBelief
from pif_ros.core.rivals.passage import wrapped

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class ExtendedKalmanBucyFilter:
    """
    The continuous extended Kalman filter, of a path that is known at some stamps.

    dm = f dt + P H^T C^-1 (dy - h dt), dP = (F P + P F^T + g - P H^T C^-1 H P) dt  [PMC, Eq. 44]
    is what remains of it as the stamps come close.  Over eps seconds between two of them the state
    and the integral of h are carried together, linearised about a mean that knows nothing of dy,
    and dy = that integral + N(0, C eps) corrects both: exact for a linear model however far apart
    the stamps are, and a covariance stays one.  time_step: seconds per step; box: as of
    ExtendedKalmanFilter.
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    time_step: float
    box: Grid | None = None
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Refuse all but one sensor, and a box that does not fit the model."""
        Increments.of_the_only(self.sensors)
        object.__setattr__(self, 'time_step_ns', self._state.time_step_ns)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> PathBelief[GaussianBelief]:
        """Return a belief before the first point of the path; ValueError where it is none."""
        return PathBelief.before_the_path(self._state.gaussian(mean, covariance))

    def uniform(self) -> PathBelief[GaussianBelief]:
        """Return the belief with the moments of the uniform one in the box, before the path."""
        return PathBelief.before_the_path(self._state.uniform())

    def predict(self, belief: PathBelief[GaussianBelief], from_ns: int,
                to_ns: int, controls: Controls = NO_CONTROLS) -> PathBelief[GaussianBelief]:
        """Return what is believed of a later stamp; ValueError for an earlier one."""
        return belief.forecast(self._state.predict(belief.now, from_ns, to_ns, controls), controls)

    def correct(self, belief: PathBelief[GaussianBelief], y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[PathBelief[GaussianBelief], float]:
        """
        Return the belief given the path's values y (m,) at a stamp, and log p(dy | all before).

        As with DiracFeynmanYauFilter, from the last point of the path on.
        """
        return correct_by_path(belief, y, self.sensors[sensor], at_ns,
                               partial(self._advanced, belief.controls))

    def log_peak(self, belief: PathBelief[GaussianBelief], sensor: str, at_ns: int) -> float:
        """Return the log evidence of an increment just as the belief is sure it is."""
        return path_log_peak(belief, self.sensors[sensor], at_ns)

    def describe(self) -> str:
        """Return what the filter is."""
        return 'extended Kalman-Bucy filter'

    def remarks(self) -> list[str]:
        """Return nothing: it has no grid that could be too coarse."""
        return []

    def _advanced(self, controls: Controls, anchor: GaussianBelief, dy: Array, from_ns: int,
                  to_ns: int) -> tuple[GaussianBelief, GaussianBelief, float]:
        n, m, both = self.model.ndim, len(dy), self._with_path(to_ns - from_ns)
        belief = GaussianBelief(np.append(anchor.location, np.zeros(m)),
                                np.pad(anchor.spread, (0, m)))
        belief = both.predict(belief, from_ns, to_ns, controls)
        belief, log_evidence = both.correct(belief, dy, 'path', to_ns)
        now = GaussianBelief(wrapped(belief.location[:n], self.box), belief.spread[:n, :n],
                             self.box)
        return now, now, log_evidence

    @cached_property
    def _state(self) -> ExtendedKalmanFilter:
        return ExtendedKalmanFilter(self.model, self.sensors, self.time_step, self.box)

    @cached_property
    def _with_path(self) -> Callable[[int], ExtendedKalmanFilter]:
        """Return, by nanoseconds, the filter of the state and what its path has gone since."""
        increments, n = Increments.of_the_only(self.sensors), self.model.ndim
        model = with_path(self.model, increments.path)
        return lru_cache(maxsize=16)(lambda ns: ExtendedKalmanFilter(model, {'path': Sensor(
            lambda x, t: x[n:], increments.sensor(ns).covariance)}, self.time_step))


def with_path(model: StateModel, sensor: Sensor) -> StateModel:
    """Return the model of the states, and below them of the path without noise, dy = h dt."""
    n, m, e, Q = model.ndim, sensor.size, model.vielbein, model.noise_covariance

    # of (x, t), or of (x, u, t) where the model has inputs
    def drift(x: Array, *at: Any) -> Array:
        return np.concatenate([model.drift(x[:n], *at), sensor.function(x[:n], at[-1])])

    def vielbein(x: Array, t: float) -> Array:
        return np.pad(model.vielbein_at(x[:n], t), [(0, m)] + [(0, 0)] * x.ndim)

    def additive(t: float) -> Array:
        return vielbein(np.zeros(n), t)

    if model.multiplicative:
        e = vielbein
    else:
        e = additive if callable(e) else additive(0.0)
    names = model.names + tuple(f'path {k}' for k in range(m))
    return StateModel(names, drift, e, Q, multiplicative=model.multiplicative, s=model.s,
                      time_dependent=model.time_dependent or sensor.time_dependent,
                      inputs=model.inputs, scale=model.scale and model.scale + (1.0,) * m)
