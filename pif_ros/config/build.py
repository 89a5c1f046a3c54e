"""The filter that a configuration describes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import dataclasses
from importlib.metadata import entry_points, EntryPoint
import inspect
import math
from typing import Any, TypeVar

import numpy as np
from pif_ros.config.filters import gaussian_of, make_filter, uniform_of
from pif_ros.config.guard import make_guard
from pif_ros.config.kinds import ConfigError, named
from pif_ros.config.probe import check_functions, said
from pif_ros.config.table import Config
from pif_ros.core.filters import Filter
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import System, SYSTEMS
from pif_ros.core.tracker import Tracker

Made = TypeVar('Made')

#: Cells on an axis beyond which they cannot be numbered, halved and told apart.
MOST_CELLS = 2**40
#: By what share of it a full turn may be off: pi may be written as 3.1416.
FULL_TURN = 1e-5


def build_tracker(config: Config, filter_: Filter[Any] | None = None,
                  kind: type[Tracker[Any]] = Tracker) -> Tracker[Any]:
    """
    Return the tracker of a configuration; ConfigError names the parameter that is wrong.

    filter_: the filter of this configuration where there is one already.
    """
    system = find_system(config)
    grid, sensors = find_grid(config, system.model), find_sensors(config, system)
    check_functions(config.model.name, system.model, grid, sensors)
    if filter_ is None:
        filter_ = build_filter(config, system)
    prior = _prior(config, filter_, system.model)
    guard = make_guard(config, filter_, prior, grid, sensors)
    return kind(filter_, prior, config.time.history, config.time.history_memory * 1e6,
                config.control.hold, guard, config.time.max_gap)


def build_filter(config: Config, system: System) -> Filter[Any]:
    """Return the filter of a configuration over a system."""
    model = _in_sense(config, system.model)
    _check_control(config, model)
    return make_filter(config, model, find_grid(config, model), find_sensors(config, system))


def find_sensors(config: Config, system: System) -> dict[str, Sensor]:
    """Return the sensors of a configuration's sources by name."""
    return {name: _sensor(config, name, system) for name in config.measurements.names}


def find_grid(config: Config, model: StateModel) -> Grid:
    """Return the grid of a configuration for the states of a model."""
    states = ', '.join(model.names)
    for name in ('shape', 'lower', 'upper', 'periodic'):
        given = getattr(config.grid, name)
        if len(given) != model.ndim and not (name == 'periodic' and not given):
            raise ConfigError(f'grid.{name}: expected {model.ndim} values, one for each '
                              f'state ({states}), got {list(given)}')
    if max(config.grid.shape) > MOST_CELLS:
        raise ConfigError(f'grid.shape: expected at most {MOST_CELLS} cells on an axis, '
                          f'got {list(config.grid.shape)}')
    with named('grid'):
        grid = Grid(config.grid.lower, config.grid.upper, config.grid.shape,
                    config.grid.periodic)
    _check_turns(grid, model)
    return grid


def _check_turns(grid: Grid, model: StateModel) -> None:
    """Refuse an angle that comes round again after anything else than a full turn."""
    for i in model.angles:
        low, high = grid.lower[i], grid.upper[i]
        if grid.periodic[i] and not math.isclose(high - low, 2 * math.pi, rel_tol=FULL_TURN):
            raise ConfigError(f'grid.upper: expected 2 pi above grid.lower for {model.names[i]!r},'
                              f' an angle in radians, got {high!r} above {low!r}')


def find_system(config: Config) -> System:
    """Return the system that is named, with its constants."""
    name = config.model.name
    system = _made('model.params', _maker(name), config.model.params, f'model.name {name!r}')
    if not isinstance(system, System):
        raise ConfigError(f'model.name: expected an entry point that makes a System, got {name!r},'
                          f' which makes {system!r}')
    return system


def plain(config: Config) -> Config:
    """
    Return the same configuration without what model, sensors and grid are without being told.

    Two that make the same filter are the same then, as long as the defaults are.
    """
    model, system = config.model, find_system(config)
    first, sources = next(iter(system.sensors)), {}
    for name, source in config.measurements.sources.items():
        maker = system.sensors.get(source.sensor or first)
        # one that is not known is refused where sensors are made
        params = _told(maker, source.params) if maker else source.params
        sources[name] = dataclasses.replace(
            source, params=params, sensor='' if source.sensor == first else source.sensor)
    return dataclasses.replace(
        config, model=dataclasses.replace(model, params=_told(_maker(model.name), model.params)),
        grid=config.grid if any(config.grid.periodic) else dataclasses.replace(
            config.grid, periodic=()),
        measurements=dataclasses.replace(config.measurements, sources=sources))


def _told(maker: Callable[..., Any], params: Mapping[str, Any]) -> dict[str, Any]:
    """Return the constants that are not a maker's defaults."""
    defaults = inspect.signature(maker).parameters
    return {name: value for name, value in params.items()
            if name not in defaults or not np.array_equal(value, defaults[name].default)}


def _maker(name: str) -> Callable[..., System]:
    """Return what makes the system of a name."""
    known: dict[str, Callable[..., System]] = dict(SYSTEMS)
    installed = {entry.name: entry for entry in entry_points(group='pif_ros.systems')}
    if name not in known and name in installed:
        known[name] = _loaded(installed[name])
    if name not in known:
        raise ConfigError(f'model.name: expected one of {", ".join(sorted({*known, *installed}))},'
                          f' got {name!r}')
    return known[name]


def state_axes(name: str, given: Sequence[str], model: StateModel) -> tuple[int | None, ...]:
    """Return the index of each state that is named, None for ''."""
    for state in given:
        if state and state not in model.names:
            raise ConfigError(f'{name}: expected states out of {", ".join(model.names)}, '
                              f'got {state!r}')
    if len({state for state in given if state}) < sum(map(bool, given)):
        raise ConfigError(f'{name}: expected each state once, got {list(given)}')
    return tuple(model.names.index(state) if state else None for state in given)


def _check_control(config: Config, model: StateModel) -> None:
    """Refuse a control that nothing would listen to, and a model that nothing would drive."""
    kind, name = config.filter.type, config.model.name
    if model.inputs and kind == 'dfy':
        raise ConfigError(f'filter.type: expected one that takes the inputs of {name} '
                          f'({", ".join(model.inputs)}), got {kind!r}')
    for spec in dataclasses.fields(config.control):
        given = getattr(config.control, spec.name)
        if not model.inputs and given != spec.default:
            raise ConfigError(f'control.{spec.name}: expected {spec.default!r} where the model '
                              f'has no inputs ({name}), got {given!r}')


def _in_sense(config: Config, model: StateModel) -> StateModel:
    """Return a model with its noise in the sense that is asked for."""
    s = config.kernel.s
    if s != -1 and not 0 <= s <= 1:
        raise ConfigError(f'kernel.s: expected a number from 0 to 1, or -1, got {s}')
    return model if s == -1 else dataclasses.replace(model, s=s)


def _prior(config: Config, filter_: Filter[Any], model: StateModel) -> Any:
    if config.prior.type == 'uniform':
        return uniform_of(filter_, 'grid.shape: expected a grid whose uniform prior fits')
    for name in ('mean', 'covariance_diagonal'):
        given = getattr(config.prior, name)
        if len(given) != model.ndim:
            raise ConfigError(f'prior.{name}: expected {model.ndim} values, one for each state, '
                              f'got {list(given)}')
    if min(config.prior.covariance_diagonal) <= 0:
        raise ConfigError('prior.covariance_diagonal: expected positive numbers, got '
                          f'{list(config.prior.covariance_diagonal)}')
    with named('prior'):
        return gaussian_of(filter_, config.prior.mean, np.diag(config.prior.covariance_diagonal),
                           'grid.shape: expected a grid on which the prior fits')


def _sensor(config: Config, source: str, system: System) -> Sensor:
    given = config.measurements.sources[source]
    prefix = f'measurements.{source}'
    name = given.sensor or next(iter(system.sensors))
    if name not in system.sensors:
        raise ConfigError(f'{prefix}.sensor: expected one of {", ".join(system.sensors)}, '
                          f'got {name!r}')
    first = '' if given.sensor else (f' (of sensor {name!r}, the first, since {prefix}.sensor is '
                                     'not set)')
    sensor = _made(f'{prefix}.params', system.sensors[name], given.params, f'{prefix}.sensor',
                   first)
    if not isinstance(sensor, Sensor):
        raise ConfigError(f'{prefix}.sensor: expected one that is made as a Sensor, got {name!r}, '
                          f'which is made as {sensor!r}')
    return sensor


def _loaded(entry: EntryPoint) -> Callable[..., System]:
    try:
        maker = entry.load()
    except Exception as error:  # noqa: B902  whatever an import of foreign code may raise
        raise ConfigError(f'model.name: expected an entry point that loads, got {entry.name!r} '
                          f'({type(error).__name__}: {error})') from None
    if not callable(maker):
        raise ConfigError(f'model.name: expected an entry point that makes a System, '
                          f'got {entry.name!r}, which is {maker!r}')
    return maker


def _made(prefix: str, maker: Callable[..., Made], params: Mapping[str, Any], owner: str,
          which: str = '') -> Made:
    """
    Return what a maker makes of some constants; ConfigError where they do not suit it.

    owner: what is to blame where none of the constants is; which: what else to say of the maker.
    """
    wanted = inspect.signature(maker).parameters
    for name in params:
        if name not in wanted:
            raise ConfigError(f'{prefix}.{name}: expected one of '
                              f'{", ".join(wanted) or "no constants"}{which}, '
                              f'got {params[name]!r}')
    for name, spec in wanted.items():
        if spec.default is spec.empty and name not in params:
            raise ConfigError(f'{prefix}.{name}: expected a value{which}, got none')
    values = {name: _constant(f'{prefix}.{name}', value, wanted[name].default)
              for name, value in params.items()}
    try:
        return maker(**values)
    except ArithmeticError as error:
        raise ConfigError(f'{prefix}: expected constants that can be reckoned with, '
                          f'got {dict(params)} ({error.args[-1]})') from None
    except Exception as error:  # noqa: B902  whatever foreign code may raise
        if str(error).partition(':')[0] in wanted:
            raise ConfigError(f'{prefix}.{error}') from None
        raise ConfigError(f'{owner}: {said(error)}') from None


def _constant(name: str, value: Any, default: Any) -> Any:
    """Return a constant as numbers where it is numeric; it must be of its default's kind."""
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    if isinstance(default, (int, float)) and not isinstance(default, bool) and not numeric:
        raise ConfigError(f'{name}: expected a number, got {value!r}')
    if numeric:
        if not math.isfinite(value):
            raise ConfigError(f'{name}: expected a finite number, got {value!r}')
        return float(value)
    return tuple(value) if hasattr(value, '__iter__') and not isinstance(value, str) else value
