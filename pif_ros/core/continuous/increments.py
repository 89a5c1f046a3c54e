"""What a path has gone from one stamp to the next, as a measurement of the state."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor


@dataclass(frozen=True, eq=False)
class Increments:
    """The increments dy ~ N(h eps, C eps) of a sensor's path over eps seconds  [PMC, Eq. 1]."""

    path: Sensor

    @classmethod
    def of_the_only(cls, sensors: Mapping[str, Sensor]) -> Increments:
        """Return those of the one sensor there is; ValueError where there is not just one."""
        if len(sensors) != 1:
            names = f' ({", ".join(sensors)})' if sensors else ''
            raise ValueError('sensors: expected exactly one, whose path is measured, '
                             f'got {len(sensors)}{names}')
        return cls(next(iter(sensors.values())))

    @property
    def changes_with_time(self) -> bool:
        """Return whether h or C depend on time."""
        return self.path.time_dependent or callable(self.path.covariance)

    def sensor(self, ns: int, share: float = 1.0) -> Sensor:
        """
        Return the sensor of an increment over some nanoseconds.

        share: with C eps / share for C eps its likelihood is that power of the increment's own, up
        to a factor that is the same for all states.
        """
        path, seconds = self.path, ns / NANOSECONDS
        scale, C = seconds / share, path.covariance
        return Sensor(lambda x, t: seconds * np.asarray(path.function(x, t), dtype=float),
                      (lambda t: scale * path.noise(t)) if callable(C) else scale * np.asarray(C),
                      time_dependent=path.time_dependent)

    def log_peak(self, ns: int, at_ns: int) -> float:
        """Return log N(0; 0, C eps) for some nanoseconds at a stamp."""
        return self._log_peaks(ns, at_ns if callable(self.path.covariance) else 0)

    @cached_property
    def _log_peaks(self) -> Callable[[int, int], float]:
        return lru_cache(maxsize=64)(lambda ns, at_ns: float(
            self.path.log_peak(at_ns / NANOSECONDS)
            - 0.5 * self.path.size * np.log(ns / NANOSECONDS)))
