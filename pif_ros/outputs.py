"""What the node publishes: an estimate as pose, density and map; and its modes."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

from pif_ros import conversions, interface
from pif_ros.config import Config, ConfigError, state_axes
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from pif_ros.mode_outputs import estimate, ModeOutputs
from pif_ros.pace import Pace
from rclpy.node import Node

#: A density is made of so many cells at most: a world of active cells may have any number.
MOST_CELLS = 10_000_000


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
        self._too_many = {out for out, axes in ((interface.DENSITY, self._density_axes),
                                                (interface.DENSITY_MAP, self._plane))
                          if math.prod(grid.shape[axis] for axis in axes) > MOST_CELLS}
        for out in self._too_many:
            node.get_logger().warning(
                f'{out.name}: the grid has more than {MOST_CELLS} cells on its axes, which are '
                'not published')
        # one for all, since to make it takes as long as to send it
        self._pose = interface.POSE.type()
        self._pose.header.frame_id = config.frame_id
        self._pace = Pace(live, 'density.rate')
        self._modes = ModeOutputs(node, config, model.names, self.pose_axes[:3], live)
        wanted = [interface.POSE, interface.POSE_UNSTAMPED, interface.DENSITY]
        if len(self._plane) == 2:
            wanted.append(interface.DENSITY_MAP)
        self._publishers = {
            out: node.create_publisher(out.type, out.name, out.qos) for out in wanted}

    def publish(self, belief: Any, stamp_ns: int) -> None:
        """Publish a belief that holds at a stamp; a density when it is due and on the grid."""
        message = self._pose
        point, covariance = estimate(belief, self._live['pose.estimator'],
                                     self._config.modes.share)
        conversions.fill_pose(message.pose, point, covariance, self.pose_axes,
                              self._config.pose.unestimated_variance)
        message.header.stamp = conversions.stamp_from_ns(stamp_ns)
        self._publishers[interface.POSE].publish(message)
        if self._is_heard(interface.POSE_UNSTAMPED):
            self._publishers[interface.POSE_UNSTAMPED].publish(message.pose)
        self._modes.publish(belief, stamp_ns)
        if self._pace.is_due(stamp_ns):
            with self._pace.making(stamp_ns):
                self._publish_density(belief, stamp_ns)

    def restart(self) -> None:
        """Let the next density and the next modes go out at once."""
        self._pace.restart()
        self._modes.restart()

    def _publish_density(self, belief: Any, stamp_ns: int) -> None:
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
                    conversions.map_message(density, stamp_ns, self._config.frame_id))

    def _is_heard(self, out: interface.Endpoint) -> bool:
        publisher = self._publishers.get(out)
        return (publisher is not None and out not in self._too_many
                and publisher.get_subscription_count() > 0)


def _pose_axes(config: Config, model: StateModel) -> tuple[int | None, ...]:
    given = config.pose.axes or model.names[:2]
    axes = state_axes('pose.axes', given, model)
    missing = len(conversions.POSE_AXES) - len(axes)
    if missing < 0:
        raise ConfigError(f'pose.axes: expected at most {len(conversions.POSE_AXES)} states, '
                          f'got {list(given)}')
    return axes + (None,) * missing
