"""What a simulator plays: a truth, what drives it, and what sensors make of it; no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass
import itertools
import math

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.config import build_tracker, Config, ConfigError, OF_A_PATH
from pif_ros.config.kinds import (BOOL, COUNT, FREQUENCY, Kind, NAME, NOT_NEGATIVE, NUMBERS,
                                  parameter, POSITIVE, taken, Value)
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import StateModel
from pif_ros.core.simulation import measure, measure_path, refined, simulate_inside

Array = NDArray[np.float64]

#: Seconds after which the wandering of a control has forgotten itself to a third.
MEMORY = 5.0
#: Paths that are drawn before it is given up that one stays on the grid.
ATTEMPTS = 100
#: Numbers that a truth, with its substeps, may have.
MOST_NUMBERS = 2e8
#: The stamp at which a simulation begins on a clock of its own; 0 would be none.
BEGIN_NS = NANOSECONDS


def _seed(value: Value) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError
    return value


@dataclass(frozen=True)
class Settings:
    """What a user may set of a simulation."""

    seed: int = parameter(1, Kind('a whole number, 0 or more', _seed), 'seed of all that is drawn')
    duration: float = parameter(20.0, POSITIVE, 'length of the simulation', 's')
    rate: float = parameter(0.0, FREQUENCY, 'measurements; 0: one for each kernel.time_step', 'Hz')
    start: tuple[float, ...] = parameter((), NUMBERS, 'states at the first measurement; none: '
                                         'drawn from the prior')
    inside: bool = parameter(True, BOOL, 'draw anew a truth that leaves the grid')
    substeps: int = parameter(10, COUNT, 'steps of the simulation in a kernel.time_step')
    drive: tuple[float, ...] = parameter((), NUMBERS, 'mean of each input of the model; none: 0')
    wander: tuple[float, ...] = parameter((), NUMBERS, 'standard deviation with which each input '
                                          'wanders about that; none: 1')
    path: bool = parameter(False, BOOL, 'measure the path of dy = h dt + n dw, as for filter.type '
                           f'{" and ".join(OF_A_PATH)} in any case')
    speed: float = parameter(1.0, NOT_NEGATIVE, 'against real time; 0: as fast as the filter keeps'
                             ' up')
    follow: str = parameter('/filter_node/pose', NAME, "topic of the filter's poses, heard at "
                            'speed 0')
    timeout: float = parameter(30.0, POSITIVE, 'how long to wait for the filter', 's')

    @classmethod
    def from_values(cls, values: Mapping[str, Value]) -> Settings:
        """Return the settings of some values by name; ConfigError for what cannot be."""
        specs = {spec.name: spec for spec in dataclasses.fields(cls)}
        for name in values:
            if name not in specs:
                raise ConfigError(f'{name}: expected one of {", ".join(specs)}')
        return cls(**{name: taken(name, value, specs[name]) for name, value in values.items()})


@dataclass(frozen=True, eq=False)
class Scenario:
    """
    A truth, and what is measured of it.

    elapsed_ns: since the first measurement, (T,); truth: (T, n); measurements: by source, (T, m);
    changes_with_time: whether they hold for a beginning at BEGIN_NS only; controls: those of a
    model with inputs, a new one at each measurement from BEGIN_NS on.
    """

    elapsed_ns: NDArray[np.int64]
    truth: Array
    measurements: Mapping[str, Array]
    changes_with_time: bool
    controls: Controls = NO_CONTROLS


def measures_paths(config: Config, settings: Settings) -> bool:
    """Return whether a measurement is the value of a path, and not of a state."""
    return settings.path or config.filter.type in OF_A_PATH


def scenario(config: Config, settings: Settings) -> Scenario:
    """
    Return what is simulated: the same for the same seed, to the last bit.

    Every source has numbers of its own, so that the truth is the same whatever is measured of it.
    Time begins at BEGIN_NS for what depends on it.  Raises ConfigError.
    """
    filter_ = build_tracker(config).filter
    interval_ns = _interval_ns(config, settings)
    count = math.floor(min(settings.duration * NANOSECONDS / interval_ns, 1e18)) + 1
    substeps = math.ceil(interval_ns * settings.substeps
                         / (config.kernel.time_step * NANOSECONDS))
    if count * substeps * filter_.model.ndim > MOST_NUMBERS:
        raise ConfigError('duration: expected a truth of at most '
                          f'{MOST_NUMBERS:.0e} numbers, got one of '
                          f'{float(count) * substeps * filter_.model.ndim:.0e}')
    elapsed_ns = interval_ns * np.arange(count)
    fine = refined((BEGIN_NS + elapsed_ns) / NANOSECONDS, substeps)
    of_truth, *of_sources, of_controls = np.random.default_rng(settings.seed).spawn(
        2 + len(filter_.sensors))
    controls = _controls(config, settings, filter_.model.inputs, elapsed_ns, of_controls)
    truth = _truth(config, settings, filter_.model, controls, fine, of_truth)
    measurements = {}
    for (name, sensor), rng in zip(filter_.sensors.items(), of_sources):
        if measures_paths(config, settings):
            measurements[name] = measure_path(sensor, truth, fine, rng)[::substeps]
        else:
            measurements[name] = np.array([measure(sensor, x, t, rng) for x, t in zip(
                truth[::substeps], fine[::substeps])])
    changes = filter_.model.changes_with_time or any(
        s.time_dependent or callable(s.covariance) for s in filter_.sensors.values())
    return Scenario(elapsed_ns, truth[::substeps], measurements, changes, controls)


def drawn(config: Config, rng: Generator) -> Array:
    """Return a state (n,) out of the prior, which may lie off the grid where it is Gaussian."""
    if config.prior.type == 'uniform':
        return rng.uniform(config.grid.lower, config.grid.upper)
    return rng.normal(config.prior.mean, np.sqrt(config.prior.covariance_diagonal))


def _interval_ns(config: Config, settings: Settings) -> int:
    """Return the nanoseconds between measurements."""
    seconds = 1 / settings.rate if settings.rate else config.kernel.time_step
    if seconds > settings.duration:
        raise ConfigError(f'duration: expected at least the {seconds:g} s between measurements, '
                          f'got {settings.duration!r}')
    return max(round(seconds * NANOSECONDS), 1)


def _controls(config: Config, settings: Settings, inputs: Sequence[str],
              elapsed_ns: NDArray[np.int64], rng: Generator) -> Controls:
    """Return controls that wander slowly, a new one at each measurement."""
    for name in ('drive', 'wander'):
        given = getattr(settings, name)
        if given and len(given) != len(inputs):
            raise ConfigError(f'{name}: expected {len(inputs)} values, one for each input '
                              f'({", ".join(inputs) or "the model has none"}), got {list(given)}')
    if not inputs:
        return NO_CONTROLS
    # a stationary Ornstein-Uhlenbeck process, exact at its stamps
    kept = math.exp(-float(elapsed_ns[min(1, len(elapsed_ns) - 1)]) / (MEMORY * NANOSECONDS))
    fresh = math.sqrt(1 - kept**2)
    noise = rng.standard_normal((len(elapsed_ns), len(inputs)))
    wanders = np.array(list(itertools.accumulate(noise, lambda u, z: kept * u + fresh * z)))
    values = (np.array(settings.drive or (0.0,) * len(inputs))
              + np.array(settings.wander or (1.0,) * len(inputs)) * wanders)
    return Controls(tuple((BEGIN_NS + elapsed_ns).tolist()), tuple(map(tuple, values.tolist())),
                    round(config.control.hold * NANOSECONDS))


def _truth(config: Config, settings: Settings, model: StateModel, controls: Controls,
           times: Array, rng: Generator) -> Array:
    """Return a sample path at some times, (len(times), n)."""
    start = settings.start
    if start and len(start) != model.ndim:
        raise ConfigError(f'start: expected {model.ndim} values, one for each state '
                          f'({", ".join(model.names)}), got {list(start)}')
    wide = np.array([periodic or not settings.inside for periodic in _periodic(config, model)])
    lower = np.where(wide, -np.inf, config.grid.lower)
    upper = np.where(wide, np.inf, config.grid.upper)
    if start and not np.all((lower <= start) & (start <= upper)):
        raise ConfigError('start: expected a state on the grid, or inside: false, '
                          f'got {list(start)}')
    try:
        with np.errstate(over='ignore', invalid='ignore'):
            return simulate_inside(model, lambda generator: start or drawn(config, generator),
                                   times, rng, lower, upper, attempts=ATTEMPTS,
                                   controls=controls)
    except RuntimeError:
        if not settings.inside:
            raise ConfigError('substeps: expected more, since the simulated path does not stay '
                              f'finite, got {settings.substeps}') from None
        raise ConfigError('duration: expected a truth that stays on the grid for so long, got '
                          f'none of {ATTEMPTS} that does for {settings.duration:g} s (inside: '
                          'false lets it leave)') from None


def _periodic(config: Config, model: StateModel) -> Sequence[bool]:
    return config.grid.periodic or (False,) * model.ndim
