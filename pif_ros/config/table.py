"""
What a user may set: the one table of parameters.

The fields of Config and of its sections are the parameters, their defaults the parameters'
defaults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
import re
from typing import Any

from pif_ros.config.kinds import BOOL, ConfigError, NAME, parameter, PERIOD, taken, TEXT, Value
from pif_ros.config.sections import (ControlConfig, DensityConfig, DiagnosticsConfig, FilterConfig,
                                     GateConfig, GridConfig, KernelConfig, LostConfig,
                                     MeasurementsConfig, ModelConfig, ModesConfig, OperatorConfig,
                                     PoseConfig, PriorConfig, PublishConfig, RecoveryConfig,
                                     RegionConfig, SourceConfig, TimeConfig)
import yaml

#: What the node tells of at /diagnostics besides its sources.
TASKS = frozenset(('filter', 'belief', 'control', 'initialpose', 'timing'))

#: Parameters of rclpy itself, which the table does not hold, and what others of its begin with.
CLOCK = 'use_sim_time'
FOREIGN = (CLOCK, 'start_type_description_service')
OVERRIDES = 'qos_overrides.'


@dataclass(frozen=True)
class Config:
    """All that the node is told."""

    model: ModelConfig = field(default_factory=ModelConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    region: RegionConfig = field(default_factory=RegionConfig)
    prior: PriorConfig = field(default_factory=PriorConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)  # noqa: A003
    kernel: KernelConfig = field(default_factory=KernelConfig)
    operator: OperatorConfig = field(default_factory=OperatorConfig)
    measurements: MeasurementsConfig = field(default_factory=MeasurementsConfig)
    recovery: RecoveryConfig = field(default_factory=RecoveryConfig)
    lost: LostConfig = field(default_factory=LostConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    frame_id: str = parameter('map', NAME, 'frame of the poses and the density')
    autostart: bool = parameter(True, BOOL, 'configure and activate at the start; if not, a '
                                'lifecycle manager does')
    pose: PoseConfig = field(default_factory=PoseConfig)
    publish: PublishConfig = field(default_factory=PublishConfig)
    density: DensityConfig = field(default_factory=DensityConfig)
    modes: ModesConfig = field(default_factory=ModesConfig)
    time: TimeConfig = field(default_factory=TimeConfig)
    diagnostics: DiagnosticsConfig = field(default_factory=DiagnosticsConfig)
    state_file: str = parameter('', TEXT, 'where the state outlasts a restart: at the start the '
                                'node goes on from it; saved every `checkpoint_period`, at '
                                '`~/save_state` and at the end; empty: nowhere')
    checkpoint_period: float = parameter(10.0, PERIOD, 'how often what is new is saved; 0: only '
                                         'when asked for and at the end', 's')

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
        return cls.from_parameters({name: value for name, value in given.items()
                                    if not is_foreign(name)})


def is_foreign(name: str) -> bool:
    """Return whether a parameter is one of rclpy itself."""
    return name in FOREIGN or name.startswith(OVERRIDES)


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
    'model': ModelConfig, 'grid': GridConfig, 'region': RegionConfig, 'prior': PriorConfig,
    'filter': FilterConfig, 'kernel': KernelConfig, 'operator': OperatorConfig,
    'measurements': MeasurementsConfig, 'gate': GateConfig, 'recovery': RecoveryConfig,
    'lost': LostConfig, 'control': ControlConfig, 'pose': PoseConfig, 'publish': PublishConfig,
    'density': DensityConfig, 'modes': ModesConfig, 'time': TimeConfig,
    'diagnostics': DiagnosticsConfig}


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
    taken_already = {spec.name for spec in dataclasses.fields(MeasurementsConfig)} | TASKS
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
