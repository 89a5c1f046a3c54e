"""The table of parameters as ROS 2 knows it: declared, read, and held to what it says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pif_ros.config import Config, ConfigError, specifications
from pif_ros.config.kinds import taken
from pif_ros.config.table import CLOCK, FOREIGN, is_foreign
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter


def declare(node: Node, given: Mapping[str, Any]) -> Config:
    """
    Declare every parameter of the table on a node, and return what it was given.

    ConfigError names the first parameter that cannot be.
    """
    config = Config.from_parameters(given)
    specs = specifications(config.measurements.names)
    for name in {**specs, **given}:
        spec = specs.get(name)
        live = bool(spec is not None and spec.metadata['live'])
        value = given[name] if name in given else spec and spec.default
        node.declare_parameter(name, _plain(value), _descriptor(spec, live), ignore_override=True)
    return config


def told(node: Node) -> dict[str, Any]:
    """Return what a node was given by name, declared or not; without rclpy's own parameters."""
    # rclpy shows a name that nobody declared, and an empty list, nowhere else
    return {name: [] if parameter.value is None else parameter.value
            for name, parameter in node._parameter_overrides.items() if not is_foreign(name)}


def mistyped(node: Node) -> str:
    """Return in a line which of rclpy's own parameters, all true or false, is neither."""
    given = {name: node._parameter_overrides[name].value
             for name in FOREIGN if name in node._parameter_overrides}
    return next(f'{name}: expected true or false, got {[] if value is None else value!r}'
                for name, value in given.items() if not isinstance(value, bool))


def live_values(changes: Sequence[Parameter], sources: Sequence[str]) -> dict[str, Any]:
    """
    Return the new values of live parameters by name; ConfigError for what cannot be.

    A clock is chosen at the start: who could change it from afar could make the node stand still.
    """
    for change in changes:
        if change.name == CLOCK:
            raise ConfigError(f'{CLOCK}: expected at the start only, got {change.value!r}')
    specs = specifications(sources)
    return {change.name: taken(change.name, change.value, specs[change.name])
            for change in changes if change.name in specs}


def live_at_start(config: Config) -> dict[str, Any]:
    """Return the values by name that live parameters start with."""
    return {'pose.estimator': config.pose.estimator, 'density.rate': config.density.rate,
            'modes.rate': config.modes.rate,
            **{f'measurements.{name}.enabled': source.enabled
               for name, source in config.measurements.sources.items()}}


def _descriptor(spec: Any, live: bool) -> ParameterDescriptor:
    if spec is None:
        return ParameterDescriptor(read_only=True, dynamic_typing=True,
                                   description='a constant of the model or of a sensor')
    meta = spec.metadata
    return ParameterDescriptor(
        description=meta['says'] + (f" [{meta['unit']}]" if meta['unit'] else ''),
        additional_constraints=meta['kind'].wanted, read_only=not live, dynamic_typing=True)


def _plain(value: Any) -> Any:
    """Return a value that a ROS parameter can hold; an empty list has no type there."""
    if isinstance(value, (str, bytes)) or not hasattr(value, '__iter__'):
        return value
    return list(value)
