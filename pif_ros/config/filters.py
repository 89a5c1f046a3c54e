"""Which filter a configuration asks for, and whether it fits into the memory."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import os
from pathlib import Path
import re
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike
from pif_ros.config.kinds import ConfigError, named
from pif_ros.config.table import Config
from pif_ros.core.active import ActiveGridFilter, RegionSettings, unsuited
from pif_ros.core.continuous import DiracFeynmanYauFilter, ExtendedKalmanBucyFilter
from pif_ros.core.filters import DiracFeynmanFilter, Filter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import chosen_form, KernelSettings, OperatorSettings, stored_weights
from pif_ros.core.kernels.lattice import variance_in_cells
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, ParticleFilter, UnscentedKalmanFilter

#: What measures a path, of which there can be one only.
OF_A_PATH = ('dfy', 'ekf_continuous')
#: Standard deviations of the noise of a step, by the width of the grid: a circle may be filled.
WIDEST_STEP = 2
#: Bytes per stored weight while a kernel is made: twice its value and its index.
BYTES_PER_WEIGHT = 24
#: Arrays as large as the grid that a filter works with.
ARRAYS_PER_GRID = 40
#: Arrays as large as the states of all particles that a filter works with.
ARRAYS_PER_CLOUD = 10


def make_filter(config: Config, model: StateModel, grid: Grid,
                sensors: Mapping[str, Sensor]) -> Filter[Any]:
    """Return the filter that a configuration asks for; ConfigError where it cannot be."""
    kind, settings = config.filter.type, _settings(config)
    if kind in OF_A_PATH and len(sensors) != 1:
        raise ConfigError(f'measurements.names: expected one source, whose path is measured, with '
                          f'filter.type {kind!r}, got {list(sensors)}')
    if kind != 'df':
        _refuse_what_is_not_used(config, kind)
    if kind == 'df' and _is_active(config, model):
        return _active_filter(config, model, grid, sensors)
    if kind in ('df', 'dfy'):
        operator = _operator(config, model)
        settings = _with_form(model, grid, settings, operator)
    with named('filter'):
        if kind == 'df':
            return DiracFeynmanFilter(model, grid, sensors, settings, config.filter.average_cells,
                                      config.filter.significance, operator)
        if kind == 'dfy':
            return DiracFeynmanYauFilter(model, grid, sensors, settings, config.filter.scheme,
                                         config.filter.average_cells)
        if kind == 'particle':
            _check_cloud_memory(config, model)
            return ParticleFilter(model, sensors, settings.time_step, grid,
                                  config.filter.particles, config.filter.seed,
                                  config.filter.resample_below)
        if kind == 'ekf':
            return ExtendedKalmanFilter(model, sensors, settings.time_step, grid)
        if kind == 'ekf_continuous':
            return ExtendedKalmanBucyFilter(model, sensors, settings.time_step, grid)
        return UnscentedKalmanFilter(model, sensors, settings.time_step, grid)


def _is_active(config: Config, model: StateModel) -> bool:
    """
    Return whether only the cells where the belief is are worked on.

    Left to itself that is so where a kernel would have to be made anew for every step, unless
    something is said of that kernel.
    """
    if config.region.kind != 'auto':
        return config.region.kind == 'active'
    fleeting = (model.changes_with_time and not model.period and not unsuited(model)
                and not _changed(config.kernel, 'time_step', 's')
                and not _changed(config.operator))
    return bool(model.inputs) or fleeting


def _active_filter(config: Config, model: StateModel, grid: Grid,
                   sensors: Mapping[str, Sensor]) -> ActiveGridFilter:
    """Return the filter that works where the belief is."""
    why = 'where only active cells are worked on'
    _expect_defaults('operator', config.operator, why)
    _expect_defaults('filter', config.filter, why, 'significance')
    if kept := _changed(config.kernel, 'time_step', 's'):
        _expect_defaults('kernel', config.kernel, why, *kept)
    with named('region'):
        region = RegionSettings(config.region.negligible, config.region.resolution,
                                config.region.finest)
    try:
        filter_ = ActiveGridFilter(model, grid, sensors, config.kernel.time_step,
                                   config.filter.average_cells, region)
        _check_step(model, grid, _settings(config))
        return filter_
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(f'region.kind: {str(error).removeprefix("region: ")}') from None


def uniform_of(filter_: Filter[Any], wanted: str) -> Any:
    """
    Return the belief that knows nothing but the grid; ConfigError where that does not fit.

    wanted: how the error's line begins, before 'into the ... of memory'.
    """
    if _has_active_cells(filter_):
        _check_cells(wanted, filter_.grid, filter_.grid.size)
    return filter_.uniform()


def gaussian_of(filter_: Filter[Any], mean: ArrayLike, covariance: ArrayLike,
                wanted: str) -> Any:
    """Return the Gaussian belief of a filter, with the same check of its size."""
    if _has_active_cells(filter_):
        _check_cells(wanted, filter_.grid, filter_.cells_of(mean, covariance))
    return filter_.gaussian(mean, covariance)


def describe(config: Config, filter_: Filter[Any]) -> str:
    """Return what a filter is, once it is ready; ConfigError names the parameter that hinders."""
    try:
        return filter_.describe()
    except (ValueError, OSError, ImportError) as error:
        text = str(error)
        known = {f'{field.name}: ': section
                 for section, settings in (('kernel', KernelSettings),
                                           ('operator', OperatorSettings))
                 for field in dataclasses.fields(settings)}
        section = next((known[start] for start in known if text.startswith(start)), None)
        file = _file(config)
        if isinstance(error, OSError):
            raise ConfigError('operator.file: expected a file that can be read or made, '
                              f'got {file!r} ({error.strerror})') from None
        if text.startswith(f'{file}: '):
            raise ConfigError(f'operator.file: {text[len(file) + 2:]} in {file!r}') from None
        raise ConfigError(f'{section}.{text}' if section else f'model.name: {text}') from None


def remarks(config: Config, filter_: Filter[Any]) -> list[str]:
    """Return what a user should know of how well a filter can work, a sentence each."""
    model, grid = filter_.model, config.grid
    return [f'grid.periodic: {model.names[i]!r} is an angle in radians, but is lost past '
            f'{grid.lower[i]:g} and {grid.upper[i]:g}; where it may turn so far, let it be true, '
            'and 2 pi from lower to upper'
            for i in model.angles if not any(grid.periodic[i:i + 1])] + filter_.remarks()


def _settings(config: Config) -> KernelSettings:
    kernel = config.kernel
    with named('kernel'):
        return KernelSettings(kernel.time_step, kernel.r, kernel.jacobian, kernel.extent,
                              kernel.weights, kernel.tolerance, kernel.noise_inflation,
                              kernel.form if config.filter.type == 'df' else 'tabulated',
                              kernel.macro_error, kernel.precision)


def _operator(config: Config, model: StateModel) -> OperatorSettings:
    how = config.operator
    if model.changes_with_time:
        _expect_defaults('operator', how, 'where the model changes with time')
    with named('operator'):
        return OperatorSettings(how.steps, _file(config), how.wavelet, how.level, how.threshold)


def _file(config: Config) -> str:
    """Return where the kernel is kept, as a path that is written in one way only."""
    return str(Path(config.operator.file).expanduser()) if config.operator.file else ''


def _refuse_what_is_not_used(config: Config, kind: str) -> None:
    """Refuse what is another filter's, and would be left out without a word."""
    why = f'with filter.type {kind!r}'
    _expect_defaults('operator', config.operator, why)
    _expect_defaults('filter', config.filter, why, 'significance')
    _expect_defaults('kernel', config.kernel, why, 'form', 'macro_error', 'precision')
    if kind != 'dfy':
        _expect_defaults('kernel', config.kernel, why, 'extent', 'noise_inflation')


def _changed(settings: Any, *spared: str) -> list[str]:
    """Return the names of the settings that are not their defaults."""
    return [field.name for field in dataclasses.fields(settings)
            if field.name not in spared and getattr(settings, field.name) != field.default]


def _expect_defaults(section: str, settings: Any, why: str, *names: str) -> None:
    """Raise ConfigError where one of some settings (of all where none is named) was changed."""
    for name in _changed(settings):
        if not names or name in names:
            default = type(settings).__dataclass_fields__[name].default
            raise ConfigError(f'{section}.{name}: expected {default!r} {why}, '
                              f'got {getattr(settings, name)!r}')


def _with_form(model: StateModel, grid: Grid, settings: KernelSettings,
               operator: OperatorSettings) -> KernelSettings:
    """Return settings with the form of kernel that is asked for, or suits, or else fits."""
    if settings.form == 'auto' and operator != OperatorSettings():
        settings = dataclasses.replace(settings, form='tabulated')
    # before a form is chosen, for which a kernel may have to be made
    _check_grid_memory(model, grid, settings, operator)
    if settings.form != 'tabulated' and not model.multiplicative:
        _check_step(model, grid, settings)
    with named('kernel'):
        form = chosen_form(model, grid, settings, operator)
    try:
        _check_grid_memory(model, grid, dataclasses.replace(settings, form=form), operator)
    except ConfigError:
        # the other form does, and is possible; where it is not good it says so
        form = 'split'
    return dataclasses.replace(settings, form=form)


def _check_step(model: StateModel, grid: Grid, settings: KernelSettings) -> None:
    """
    Refuse a step whose noise is much wider than the grid: nothing would be known after it.

    To make an operator along an axis, or to spread active cells, would take ages.
    """
    variance = np.diagonal(variance_in_cells(model, grid, settings, 0.0)[..., 0])
    widest = float(np.max(np.sqrt(variance) / grid.shape))
    if widest > WIDEST_STEP:
        raise ConfigError('kernel.time_step: expected a step whose noise is at most '
                          f'{WIDEST_STEP} times as wide as the grid, got {settings.time_step!r} '
                          f'({widest:.3g} times)')


def _check_grid_memory(model: StateModel, grid: Grid, settings: KernelSettings,
                       operator: OperatorSettings) -> None:
    """Refuse a grid or a kernel that would not fit, before anything of its size is made."""
    cells, where = float(np.prod(np.array(grid.shape, dtype=float))), list(grid.shape)
    fits = cells < np.iinfo(np.int32).max
    needed = 8 * ARRAYS_PER_GRID * cells
    if fits:
        # an operator of several steps has about as many weights as a kernel of one long step
        longer = dataclasses.replace(settings, time_step=settings.time_step * operator.steps)
        needed += BYTES_PER_WEIGHT * stored_weights(model, grid, longer, settings.form)
    _check('grid.shape: expected a grid whose kernel fits', where, needed, fits)


def _check_cloud_memory(config: Config, model: StateModel) -> None:
    """Refuse more particles than fit."""
    needed = 8.0 * ARRAYS_PER_CLOUD * (model.ndim + 1) * config.filter.particles
    _check('filter.particles: expected so many that they fit', config.filter.particles, needed)


def _check(wanted: str, given: Any, needed: float, fits: bool = True) -> None:
    free = _available_memory()
    if needed > 0.8 * free or not fits:
        raise ConfigError(f'{wanted} into the {free / 1e9:.1f} GB of memory that are free, '
                          f'got {given} ({needed / 1e9:.3g} GB)')


def _has_active_cells(filter_: Any) -> TypeGuard[ActiveGridFilter]:
    """Return whether a filter works on active cells, even where it is one that is timed."""
    return isinstance(getattr(filter_, 'region', None), RegionSettings)


def _check_cells(wanted: str, grid: Grid, cells: int) -> None:
    """Refuse a belief of more cells of a grid than fit, which was never made as a whole."""
    _check(wanted, list(grid.shape), 8.0 * ARRAYS_PER_GRID * cells)


def _available_memory() -> int:
    """Return the bytes that a process may still have; what the kernel caches counts as free."""
    try:
        found = re.search(r'MemAvailable:\s*(\d+) kB', Path('/proc/meminfo').read_text())
    except OSError:
        found = None
    return (int(found[1]) * 1024 if found
            else os.sysconf('SC_AVPHYS_PAGES') * os.sysconf('SC_PAGE_SIZE'))
