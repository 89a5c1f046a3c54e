"""The guard that a configuration describes: gates, outliers, recovery and the watch."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pif_ros.config.filters import OF_A_PATH, uniform_of
from pif_ros.config.kinds import ConfigError, named
from pif_ros.config.table import Config
from pif_ros.core.clutter import clutter_of
from pif_ros.core.filters import Filter
from pif_ros.core.grid import Grid
from pif_ros.core.guard import Gate, Guard, Recovery
from pif_ros.core.lost import Alarm
from pif_ros.core.models import Sensor


def make_guard(config: Config, filter_: Filter[Any], prior: Any, grid: Grid,
               sensors: Mapping[str, Sensor]) -> Guard:
    """Return what stands before a filter; ConfigError where it cannot be."""
    gates = {name: _gate(config, name, sensor, grid) for name, sensor in sensors.items()}
    if config.filter.type in OF_A_PATH:
        _refuse_what_is_of_single_measurements(config)
        return Guard()
    rate = config.lost.false_alarm_rate
    if config.recovery.when_lost and not rate:
        raise ConfigError('recovery.when_lost: expected false where lost.false_alarm_rate is 0, '
                          'got true')
    wanted = config.recovery.when_lost or any(gate.tail_probability for gate in gates.values())
    recovery = (Recovery(_belief(config, filter_, prior), config.recovery.share,
                         config.recovery.when_lost) if wanted else None)
    return Guard(gates, recovery, Alarm(rate) if rate else None)


def _belief(config: Config, filter_: Filter[Any], prior: Any) -> Any:
    """Return what a recovery mixes in."""
    if config.recovery.belief == 'prior':
        return prior
    return uniform_of(filter_, "recovery.belief: expected 'prior', or a grid whose uniform belief "
                      'fits')


def _gate(config: Config, name: str, sensor: Sensor, grid: Grid) -> Gate:
    source, prefix = config.measurements.sources[name], f'measurements.{name}'
    with named(f'{prefix}.outlier_probability'):
        clutter = clutter_of(sensor, grid) if source.outlier_probability else None
    with named(f'{prefix}.gate'):
        return Gate(source.gate.tail_probability, source.gate.max_consecutive_rejections,
                    source.outlier_probability, clutter)


def _refuse_what_is_of_single_measurements(config: Config) -> None:
    """Refuse what a filter of a path, whose points are not measured one by one, cannot do."""
    why = f'with filter.type {config.filter.type!r}'
    for name, source in config.measurements.sources.items():
        for what, given in (('gate.tail_probability', source.gate.tail_probability),
                            ('outlier_probability', source.outlier_probability)):
            if given:
                raise ConfigError(f'measurements.{name}.{what}: expected 0 {why}, got {given}')
    if config.recovery.when_lost:
        raise ConfigError(f'recovery.when_lost: expected false {why}, got true')
