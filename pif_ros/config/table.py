"""
What a user may set: the one table of parameters.

The fields of the classes below are the parameters, their defaults the parameters' defaults; the
node declares them, and the README prints them, from here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
import re
from typing import Any

from pif_ros.config.kinds import (BOOL, BOOLS, ConfigError, COUNT, DURATION, FREQUENCY, INTEGER,
                                  INTEGERS, NAME, NAMES, NOT_NEGATIVE, NUMBER, NUMBERS, one_of,
                                  parameter, PART, POSITIVE, SEED, SHARE, STEPS, taken, TEXT,
                                  Value)
from pif_ros.core.continuous import SCHEMES
import yaml


@dataclass(frozen=True)
class ModelConfig:
    """How the world moves."""

    name: str = parameter('coupled_trigonometric', NAME, 'a named system, or an entry point of '
                          'group `pif_ros.systems` of an installed package')
    params: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class GridConfig:
    """Where the density lives."""

    lower: tuple[float, ...] = parameter((-6.0, -6.0), NUMBERS, 'lower edge on each axis, '
                                         'in the units of the state')
    upper: tuple[float, ...] = parameter((6.0, 6.0), NUMBERS, 'upper edge on each axis, '
                                         'in the units of the state')
    shape: tuple[int, ...] = parameter((62, 62), INTEGERS, 'cells on each axis')
    periodic: tuple[bool, ...] = parameter((), BOOLS, 'axes on which the upper edge is the lower '
                                           'again; empty: none')


@dataclass(frozen=True)
class PriorConfig:
    """What is believed before the first measurement."""

    type: str = parameter(  # noqa: A003
        'gaussian', one_of('gaussian', 'uniform'), 'shape of the prior')
    mean: tuple[float, ...] = parameter((0.0, 0.0), NUMBERS, 'mean, where gaussian, '
                                        'in the units of the state')
    covariance_diagonal: tuple[float, ...] = parameter(
        (10.0, 10.0), NUMBERS, 'variances, where gaussian, in these units squared')


@dataclass(frozen=True)
class FilterConfig:
    """Which filter."""

    type: str = parameter(  # noqa: A003
        'df', one_of('df', 'dfy', 'particle', 'ekf', 'ekf_continuous', 'ukf'), 'Dirac-Feynman '
        'filter, the same for a measured path y(t) (Dirac-Feynman-Yau), or what they are compared '
        'with: bootstrap particle filter, extended Kalman filter, the same for a measured path, '
        'unscented Kalman filter')
    average_cells: bool = parameter(True, BOOL, 'df, dfy: average a likelihood that is narrower '
                                    'than a cell over the cell, instead of taking it at the '
                                    'centre')
    significance: float = parameter(0.0, PART, 'df: correct only cells with more than '
                                    "this share of the densest one's density, and empty the "
                                    'others; 0: all')
    scheme: str = parameter('symmetric', one_of(*SCHEMES), "dfy: how the path's increments and "
                            'the steps are put together')
    particles: int = parameter(5000, COUNT, 'particle: how many')
    seed: int = parameter(0, SEED, 'particle: what its random numbers start from')
    resample_below: float = parameter(0.5, SHARE, 'particle: effective size, as a share of '
                                      'the particles, below which they are resampled')


@dataclass(frozen=True)
class KernelConfig:
    """How one step is made."""

    time_step: float = parameter(0.01, POSITIVE, 'length of a step', 's')
    r: float = parameter(0.5, NUMBER, 'where between the two ends of a step the drift is taken, '
                         '0 to 1')
    s: float = parameter(-1.0, NUMBER, 'the same of a vielbein that depends on the state, which '
                         "decides what the model means: 0 is Ito's sense, 0.5 Stratonovich's; -1: "
                         'as the model has it')
    jacobian: str = parameter('determinant', one_of('determinant', 'exponential'),
                              "exact Jacobian, or the papers' expansion of it")
    extent: int = parameter(0, INTEGER, "largest move on each axis, the papers' setting; 0: as "
                            'wide as the kernel needs', 'cells')
    weights: str = parameter('auto', one_of('auto', 'sampled', 'moments'), 'density at the '
                             "cells' centres, or exact moments where the noise is thin")
    tolerance: float = parameter(1e-5, POSITIVE, "share of a step's tail that is left out")
    noise_inflation: float = parameter(0.0, NOT_NEGATIVE, "alpha of the papers' way with thin "
                                       "noise, g = alpha dx instead of the model's; 0: none")


@dataclass(frozen=True)
class OperatorConfig:
    """What saves work with a kernel."""

    steps: int = parameter(1, STEPS, 'df: kernel steps that are composed into one operator')
    file: str = parameter('', TEXT, 'df: where the kernel is kept: loaded if it is there, made '
                          'and saved if not; it serves any sensor; empty: nowhere')
    wavelet: str = parameter('', TEXT, 'df: wavelet of PyWavelets in whose basis the operator is '
                             'applied, such as `sym8`; empty: none')
    level: int = parameter(2, COUNT, 'df: how often that basis is halved')
    threshold: float = parameter(1e-4, PART, 'df: elements below it are left out in that '
                                 'basis')


@dataclass(frozen=True)
class SourceConfig:
    """Where a measurement comes from; every name in measurements.names has one."""

    topic: str = parameter('measurement', NAME, 'topic to subscribe to')
    type: str = parameter(  # noqa: A003
        'std_msgs/msg/Float64MultiArray', NAME, 'any installed message type')
    fields: tuple[str, ...] = parameter((), NAMES, 'paths of the fields that make y, such as '
                                        '`pose.pose.position.x` or `ranges[0]`; empty: `data`')
    sensor: str = parameter('', TEXT, "which of the system's sensors; empty: its first")
    params: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class MeasurementsConfig:
    """All that is measured."""

    names: tuple[str, ...] = parameter(('main',), NAMES, 'names of the sources')
    queue_length: int = parameter(1000, COUNT, 'measurements that may wait, here and in DDS; '
                                  'the oldest is dropped and counted')
    sources: Mapping[str, SourceConfig] = field(default_factory=lambda: {'main': SourceConfig()})


@dataclass(frozen=True)
class PoseConfig:
    """What is published as a pose."""

    axes: tuple[str, ...] = parameter((), NAMES, 'states that are x, y, z, roll, pitch, yaw, in '
                                      "that order; '': not estimated; empty: the first two")
    estimator: str = parameter('mean', one_of('mean', 'mode'), 'point that is published; the '
                               'covariance is about it', live=True)
    unestimated_variance: float = parameter(0.0, NOT_NEGATIVE, 'variance on the axes of the pose '
                                            'that are not estimated')


@dataclass(frozen=True)
class PublishConfig:
    """How often the pose is predicted to now."""

    rate: float = parameter(20.0, FREQUENCY, 'poses predicted to now; 0: only after '
                            'corrections', 'Hz')


@dataclass(frozen=True)
class DensityConfig:
    """How often the density goes out, and what of it."""

    rate: float = parameter(1.0, NOT_NEGATIVE, 'densities, where someone listens; 0: none', 'Hz',
                            live=True)
    axes: tuple[str, ...] = parameter((), NAMES, 'states whose marginal is published; empty: all')


@dataclass(frozen=True)
class TimeConfig:
    """How far time may be out of order."""

    history: float = parameter(1.0, DURATION, 'how late a measurement may be and still be put '
                               'where it belongs', 's')
    history_memory: float = parameter(256.0, POSITIVE, 'most memory for the beliefs kept for that',
                                      'MB')
    max_ahead: float = parameter(1.0, DURATION, 'how far a stamp may be ahead of the clock', 's')
    max_forecast: float = parameter(60.0, DURATION, 'how far beyond the newest measurement the '
                                    'pose is predicted', 's')
    max_gap: float = parameter(600.0, DURATION, 'longest gap between measurements that is '
                               'predicted through; after a longer one the prior holds again', 's')


@dataclass(frozen=True)
class Config:
    """All that the node is told."""

    model: ModelConfig = field(default_factory=ModelConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    prior: PriorConfig = field(default_factory=PriorConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)  # noqa: A003
    kernel: KernelConfig = field(default_factory=KernelConfig)
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    measurements: MeasurementsConfig = field(default_factory=MeasurementsConfig)
    frame_id: str = parameter('map', NAME, 'frame of the poses and the density')
    pose: PoseConfig = field(default_factory=PoseConfig)
    publish: PublishConfig = field(default_factory=PublishConfig)
    density: DensityConfig = field(default_factory=DensityConfig)
    time: TimeConfig = field(default_factory=TimeConfig)

    @classmethod
    def from_parameters(cls, given: Mapping[str, Value]) -> Config:
        """Return the configuration of some dotted names; ConfigError for what cannot be."""
        left = dict(given)
        names = _take(left, 'measurements.names', _spec(MeasurementsConfig, 'names'))
        _check_names(names)
        sources = {name: _section(SourceConfig, f'measurements.{name}', left) for name in names}
        config = _section(cls, '', left)
        config = dataclasses.replace(config, measurements=dataclasses.replace(
            config.measurements, names=names, sources=sources))
        if left:
            name = min(left)
            source = name.split('.')[1] if name.startswith('measurements.') else names[0]
            if name.count('.') > 1 and source not in names:
                raise ConfigError(f'{name}: expected a known parameter, and {source} among '
                                  f'measurements.names, got {left[name]!r}')
            raise ConfigError(f'{name}: expected a known parameter{_similar(name, names)}, '
                              f'got {left[name]!r}')
        return config

    @classmethod
    def from_yaml(cls, path: str | Path, node: str = 'filter_node') -> Config:
        """Return the configuration that a parameter file has for a node."""
        tree = yaml.safe_load(Path(path).read_text(encoding='utf-8')) or {}
        given: dict[str, Value] = {}
        for name in ('/**', node, f'/{node}'):
            given.update(_flat((tree.get(name) or {}).get('ros__parameters') or {}))
        given.pop('use_sim_time', None)
        return cls.from_parameters(given)


def specifications(source_names: Sequence[str] = ('main',)) -> dict[str, dataclasses.Field[Any]]:
    """Return every parameter's field by its full name, in the order of the table."""
    found: dict[str, dataclasses.Field[Any]] = {}

    def walk(section: type, prefix: str) -> None:
        for spec in dataclasses.fields(section):
            name = f'{prefix}{spec.name}'
            if 'kind' in spec.metadata:
                found[name] = spec
            elif spec.name == 'sources':
                for source in source_names:
                    walk(SourceConfig, f'{prefix}{source}.')
            elif spec.name in _SECTIONS:
                walk(_SECTIONS[spec.name], f'{name}.')

    walk(Config, '')
    return found


_SECTIONS: Mapping[str, type] = {
    'model': ModelConfig, 'grid': GridConfig, 'prior': PriorConfig, 'filter': FilterConfig,
    'kernel': KernelConfig, 'operator': OperatorConfig, 'measurements': MeasurementsConfig,
    'pose': PoseConfig, 'publish': PublishConfig, 'density': DensityConfig, 'time': TimeConfig}


def _section(section: type, prefix: str, left: dict[str, Value]) -> Any:
    """Return a section built from the names under a prefix, which are taken out of left."""
    values: dict[str, Any] = {}
    for spec in dataclasses.fields(section):
        name = f'{prefix}.{spec.name}' if prefix else spec.name
        if 'kind' in spec.metadata:
            values[spec.name] = _take(left, name, spec)
        elif spec.name == 'params':
            found = [key for key in left if key.startswith(f'{name}.')]
            values['params'] = {key[len(name) + 1:]: left.pop(key) for key in found}
        elif spec.name in _SECTIONS:
            values[spec.name] = _section(_SECTIONS[spec.name], name, left)
    return section(**values)


def _take(left: dict[str, Value], name: str, spec: dataclasses.Field[Any]) -> Any:
    if name not in left:
        return spec.default
    value = left.pop(name)
    return taken(name, value, spec)


def _check_names(names: Sequence[str]) -> None:
    taken_already = {spec.name for spec in dataclasses.fields(MeasurementsConfig)}
    for name in names:
        if not re.fullmatch('[A-Za-z][A-Za-z0-9_]*', name) or name in taken_already:
            raise ConfigError('measurements.names: expected names of letters, digits and _, none '
                              f'of {", ".join(sorted(taken_already))}, got {name!r}')
    if not names or len(set(names)) < len(names):
        raise ConfigError('measurements.names: expected at least one name, each once, '
                          f'got {list(names)}')


def _spec(section: type, name: str) -> dataclasses.Field[Any]:
    return next(spec for spec in dataclasses.fields(section) if spec.name == name)


def _flat(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Value]:
    flat: dict[str, Value] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(_flat(value, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat


def _similar(name: str, sources: Sequence[str]) -> str:
    close = get_close_matches(name, list(specifications(sources)), n=1)
    return f" ('{close[0]}'?)" if close else ''
