"""The table of parameters as ROS 2 knows it: declared, read, and held to what it says."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pif_ros.config import Config, ConfigError, specifications
from pif_ros.config.kinds import taken
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

#: Parameters of rclpy itself, which the table does not hold.
FOREIGN = ('use_sim_time', 'start_type_description_service')


def declare(node: Node) -> Config:
    """
    Declare every parameter of the table on a node, and return what it was given.

    The node must have been made with automatically_declare_parameters_from_overrides, so that a
    name that nobody knows is found.  ConfigError names the first parameter that cannot be.
    """
    given = {name: parameter.value
             for name, parameter in node.get_parameters_by_prefix('').items() if not _ours(name)}
    config = Config.from_parameters(given)
    if not isinstance(node.get_parameter('use_sim_time').value, bool):
        raise ConfigError('use_sim_time: expected true or false, '
                          f"got {node.get_parameter('use_sim_time').value!r}")
    specs = specifications(config.measurements.names)
    for name in given:
        node.undeclare_parameter(name)
    for name in {**specs, **given}:
        spec = specs.get(name)
        live = bool(spec is not None and spec.metadata['live'])
        value = given[name] if given.get(name) is not None else spec and spec.default
        node.declare_parameter(name, _plain(value), _descriptor(spec, live), ignore_override=True)
    return config


def live_values(changes: Sequence[Parameter], sources: Sequence[str]) -> dict[str, Any]:
    """Return the new values of live parameters by name; ConfigError for what cannot be."""
    specs = specifications(sources)
    return {change.name: taken(change.name, change.value, specs[change.name])
            for change in changes if change.name in specs}


def _ours(name: str) -> bool:
    return name in FOREIGN or name.startswith('qos_overrides.')


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
