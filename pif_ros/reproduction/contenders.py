"""Who takes part: filters with their priors, on the same model and sensors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike
from pif_ros.core.active import ActiveGridFilter
from pif_ros.core.continuous import DiracFeynmanYauFilter, ExtendedKalmanBucyFilter
from pif_ros.core.filters import DiracFeynmanFilter, Filter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, OperatorSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, ParticleFilter, UnscentedKalmanFilter
from pif_ros.reproduction.filtering import Contender
from pif_ros.reproduction.path_particles import PathParticleFilter
from pif_ros.reproduction.study import Entry
from pif_ros.reproduction.tracks import Reading

Sensors = Mapping[str, Sensor]
#: Returns the prior of a filter.
Prior = Callable[[Any], Any]


def gaussian(mean: ArrayLike, covariance: ArrayLike) -> Prior:
    """Return what gives every filter the same Gaussian prior."""
    return lambda filter_: filter_.gaussian(mean, covariance)


def uniform(filter_: Filter[Any]) -> Any:
    """Return the belief that knows nothing but the filter's box."""
    return filter_.uniform()


@dataclass(frozen=True, eq=False)
class Problem:
    """What all contenders of a case share."""

    model: StateModel
    sensors: Sensors
    prior: Prior

    def grid(self, name: str, role: str, grid: Grid, kernel: KernelSettings,
             average_cells: bool = True, shown: Mapping[str, Reading] | None = None,
             prior: Prior | None = None, file: Path | None = None,
             significance: float = 0.0) -> Contender:
        """
        Return the Dirac-Feynman filter; it is the same for all seeds, and made once.

        file: where its kernel is kept, for whoever makes the same one.
        """
        @cache
        def start() -> tuple[Filter[Any], Any]:
            operator = OperatorSettings(file=str(file or ''))
            filter_ = DiracFeynmanFilter(self.model, grid, self.sensors, kernel, average_cells,
                                         significance, operator)
            filter_.describe()
            return filter_, (prior or self.prior)(filter_)
        entry = Entry(name, role, f'{_cells(grid)}, {_kernel(kernel)}')
        return Contender(entry, lambda seed: start(), shown or {})

    def active(self, name: str, role: str, world: Grid, step: float,
               prior: Prior | None = None) -> Contender:
        """Return the filter that keeps the active cells of a world, halved where it is narrow."""
        @cache
        def start() -> tuple[Filter[Any], Any]:
            filter_ = ActiveGridFilter(self.model, world, self.sensors, step)
            filter_.describe()
            return filter_, (prior or self.prior)(filter_)
        entry = Entry(name, role, f'active ones of {_cells(world)}, steps of {step:g} s')
        return Contender(entry, lambda seed: start())

    def particles(self, name: str, role: str, count: int, step: float,
                  box: Grid | None = None, shown: Mapping[str, Reading] | None = None,
                  prior: Prior | None = None, salt: int = 0) -> Contender:
        """Return the bootstrap particle filter, whose random numbers go with the seed and salt."""
        def start(seed: int) -> tuple[Filter[Any], Any]:
            filter_ = ParticleFilter(self.model, self.sensors, step, box, count,
                                     1_000_003 * (seed + 1) + salt)
            return filter_, (prior or self.prior)(filter_)
        entry = Entry(name, role, f'{count:,} particles, steps of {step:g} s')
        return Contender(entry, start, shown or {})

    def extended(self, step: float, prior: Prior | None = None) -> Contender:
        """Return the extended Kalman filter."""
        filter_ = ExtendedKalmanFilter(self.model, self.sensors, step)
        return Contender(Entry('EKF', 'ekf', f'steps of {step:g} s'),
                         lambda seed: (filter_, (prior or self.prior)(filter_)))

    def unscented(self, step: float, prior: Prior | None = None) -> Contender:
        """Return the unscented Kalman filter."""
        filter_ = UnscentedKalmanFilter(self.model, self.sensors, step)
        return Contender(Entry('UKF', 'ukf', f'steps of {step:g} s'),
                         lambda seed: (filter_, (prior or self.prior)(filter_)))


@dataclass(frozen=True, eq=False)
class PathProblem:
    """What all contenders share where a path is measured."""

    model: StateModel
    sensors: Sensors
    prior: Prior

    def grid(self, name: str, role: str, grid: Grid, kernel: KernelSettings, scheme: str,
             average_cells: bool = True, shown: Mapping[str, Reading] | None = None) -> Contender:
        """Return the Dirac-Feynman-Yau filter by a scheme; it is the same for all seeds."""
        @cache
        def start() -> tuple[Filter[Any], Any]:
            filter_ = DiracFeynmanYauFilter(self.model, grid, self.sensors, kernel, scheme,
                                            average_cells)
            filter_.describe()
            return filter_, self.prior(filter_)
        entry = Entry(name, role, f'{scheme}, {_cells(grid)}, {_kernel(kernel)}')
        return Contender(entry, lambda seed: start(), shown or {})

    def particles(self, name: str, role: str, count: int, step: float) -> Contender:
        """Return the particle filter of a path."""
        def start(seed: int) -> tuple[Filter[Any], Any]:
            filter_ = PathParticleFilter(self.model, self.sensors, step, count,
                                         1_000_003 * (seed + 1))
            return filter_, self.prior(filter_)
        return Contender(Entry(name, role, f'{count:,} particles, steps of {step:g} s'), start)

    def extended(self, step: float) -> Contender:
        """Return the extended Kalman-Bucy filter."""
        filter_ = ExtendedKalmanBucyFilter(self.model, self.sensors, step)
        return Contender(Entry('EKF', 'ekf', f'continuous, steps of {step:g} s'),
                         lambda seed: (filter_, self.prior(filter_)))


def _cells(grid: Grid) -> str:
    box = ' x '.join(f'[{low:g}, {high:g}]' for low, high in zip(grid.lower, grid.upper))
    return f'{" x ".join(map(str, grid.shape))} cells in {box}'


def _kernel(kernel: KernelSettings) -> str:
    parts = [f'steps of {kernel.time_step:g} s', f'r = {kernel.r:g}']
    if kernel.r:
        parts.append(kernel.jacobian)
    if kernel.extent:
        parts.append(f'extent {kernel.extent}')
    if kernel.noise_inflation:
        parts.append(f'noise inflation {kernel.noise_inflation:g}')
    return ', '.join([*parts, f'{kernel.weights} weights'])
