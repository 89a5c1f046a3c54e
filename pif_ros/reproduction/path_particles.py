"""A particle filter for a measured path: what the continuous filters are held against."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.continuous import PathBelief
from pif_ros.core.continuous.kalman_bucy import with_path
from pif_ros.core.continuous.path import correct_by_path, path_log_peak
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ParticleBelief, ParticleFilter

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PathParticleFilter:
    """
    The bootstrap particle filter of a measured path dy = h(x, t) dt + n dw  [PMC, Eq. 1].

    The path's noise must not change with time.

    A particle carries its state and the integral of h since the last point of the path, by which
    the increment dy ~ N(integral, C eps) weighs it: exact, as the particles become many and the
    steps of time_step seconds short, however far apart the points are.  Further fields: as of
    ParticleFilter.
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    time_step: float
    particles: int = 5000
    seed: int = 0
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds."""
        object.__setattr__(self, 'time_step_ns', self._state.time_step_ns)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> PathBelief[ParticleBelief]:
        """Return particles drawn from a Gaussian, before the first point of the path."""
        return PathBelief.before_the_path(self._state.gaussian(mean, covariance))

    def predict(self, belief: PathBelief[ParticleBelief], from_ns: int,
                to_ns: int, controls: Controls = NO_CONTROLS) -> PathBelief[ParticleBelief]:
        """Return what is believed of a later stamp while the path is not known any further."""
        return belief.forecast(self._state.predict(belief.now, from_ns, to_ns))

    def correct(self, belief: PathBelief[ParticleBelief], y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[PathBelief[ParticleBelief], float]:
        """Return the belief given the path's values y (m,) at a stamp, and log p(dy | before)."""
        return correct_by_path(belief, y, self.sensors[sensor], at_ns, self._advanced)

    def log_peak(self, belief: PathBelief[ParticleBelief], sensor: str, at_ns: int) -> float:
        """Return the log evidence of an increment that is just as the belief is sure it is."""
        return path_log_peak(belief, self.sensors[sensor], at_ns)

    def uniform(self) -> PathBelief[ParticleBelief]:
        """Return particles drawn evenly from the box, before the first point of the path."""
        return PathBelief.before_the_path(self._state.uniform())

    def describe(self) -> str:
        """Return what the filter is."""
        return f'particle filter of a path with {self.particles:,} particles'

    def remarks(self) -> list[str]:
        """Return nothing: it has no grid that could be too coarse."""
        return []

    def _advanced(self, anchor: ParticleBelief, dy: Array, from_ns: int,
                  to_ns: int) -> tuple[ParticleBelief, ParticleBelief, float]:
        n, both = self.model.ndim, self._with_path(to_ns - from_ns)
        points = np.concatenate([anchor.points, np.zeros((len(dy), anchor.points.shape[1]))])
        moved = both.predict(ParticleBelief(points, anchor.log_weights), from_ns, to_ns)
        moved, log_evidence = both.correct(moved, dy, 'path', to_ns)
        now = ParticleBelief(moved.points[:n], moved.log_weights)
        return now, now, log_evidence

    @cached_property
    def _state(self) -> ParticleFilter:
        return ParticleFilter(self.model, self.sensors, self.time_step, None, self.particles,
                              self.seed)

    @cached_property
    def _with_path(self) -> Callable[[int], ParticleFilter]:
        """Return, by nanoseconds, the filter of the state and what its path has gone since."""
        [sensor], n = self.sensors.values(), self.model.ndim
        model, C = with_path(self.model, sensor), sensor.noise(0.0)
        return lru_cache(maxsize=16)(lambda ns: ParticleFilter(
            model, {'path': Sensor(lambda x, t: x[n:], ns / NANOSECONDS * C)}, self.time_step,
            None, self.particles, self.seed))
