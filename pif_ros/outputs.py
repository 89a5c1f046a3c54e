"""What the node publishes: an estimate as pose, density and map."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pif_ros import conversions, interface
from pif_ros.config import Config, ConfigError, state_axes
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from rclpy.node import Node


class Outputs:
    """
    The publishers of a node, and which states go out on them.

    pose_axes: the state that is x, y, z, roll, pitch and yaw, None for none.  grid: the cells on
    which a density is shown, whatever the filter.  live: the values of
    the parameters that may change.  Raises ConfigError for axes that the model has not.
    """

    def __init__(self, node: Node, config: Config, model: StateModel, grid: Grid,
                 live: Mapping[str, Any]) -> None:
        self._config, self._model, self._grid, self._live = config, model, grid, live
        self.pose_axes = _pose_axes(config, model)
        self._plane = [axis for axis in self.pose_axes[:2] if axis is not None]
        shown = state_axes('density.axes', config.density.axes or model.names, model)
        if None in shown:
            raise ConfigError("density.axes: expected names of states, got ''")
        self._density_axes = [axis for axis in shown if axis is not None]
        self._density_ns: int | None = None
        # one for all, since to make it takes as long as to send it
        self._pose = interface.POSE.type()
        self._pose.header.frame_id = config.frame_id
        wanted = [interface.POSE, interface.POSE_UNSTAMPED, interface.DENSITY]
        if len(self._plane) == 2:
            wanted.append(interface.DENSITY_MAP)
        self._publishers = {
            out: node.create_publisher(out.type, out.name, out.qos) for out in wanted}

    def publish(self, belief: Any, stamp_ns: int) -> None:
        """Publish a belief that holds at a stamp; a density when it is due and on the grid."""
        frame, message = self._config.frame_id, self._pose
        point = belief.mode() if self._live['pose.estimator'] == 'mode' else belief.mean()
        conversions.fill_pose(message.pose, point, belief.covariance(about=point), self.pose_axes,
                              self._config.pose.unestimated_variance)
        message.header.stamp = conversions.stamp_from_ns(stamp_ns)
        self._publishers[interface.POSE].publish(message)
        if self._is_heard(interface.POSE_UNSTAMPED):
            self._publishers[interface.POSE_UNSTAMPED].publish(message.pose)
        if not self._is_due(stamp_ns):
            return
        self._density_ns = stamp_ns
        if self._is_heard(interface.DENSITY):
            names, units = self._model.names, self._model.units
            density = belief.on(self._grid, self._density_axes)
            if density.mass > 0:
                self._publishers[interface.DENSITY].publish(conversions.density_message(
                    density, [names[i] for i in self._density_axes],
                    [units[i] for i in self._density_axes] if units else ()))
        if self._is_heard(interface.DENSITY_MAP):
            density = belief.on(self._grid, self._plane)
            if density.mass > 0:
                self._publishers[interface.DENSITY_MAP].publish(
                    conversions.map_message(density, stamp_ns, frame))

    def restart(self) -> None:
        """Let the next density go out at once."""
        self._density_ns = None

    def _is_due(self, stamp_ns: int) -> bool:
        rate = self._live['density.rate']
        return bool(rate) and (self._density_ns is None
                               or stamp_ns >= self._density_ns + NANOSECONDS / rate)

    def _is_heard(self, out: interface.Endpoint) -> bool:
        publisher = self._publishers.get(out)
        return publisher is not None and publisher.get_subscription_count() > 0


def _pose_axes(config: Config, model: StateModel) -> tuple[int | None, ...]:
    given = config.pose.axes or model.names[:2]
    axes = state_axes('pose.axes', given, model)
    missing = len(conversions.POSE_AXES) - len(axes)
    if missing < 0:
        raise ConfigError(f'pose.axes: expected at most {len(conversions.POSE_AXES)} states, '
                          f'got {list(given)}')
    return axes + (None,) * missing
