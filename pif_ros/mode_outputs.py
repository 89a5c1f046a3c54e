"""What the node tells of the humps of its belief, and which point of it is the pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from numpy.typing import NDArray
from pif_ros import interface, mode_messages
from pif_ros.config import Config
from pif_ros.pace import Pace
from rclpy.node import Node

#: Finding the modes has this share of the time at most, the rest is for measurements.
TAKE = 0.1


def estimate(belief: Any, estimator: str, share: float) -> tuple[NDArray, NDArray]:
    """
    Return the point (n,) that stands for a belief, and the covariance (n, n) that belongs to it.

    mean: the mean and the covariance; mode: the densest point and the second moments about it;
    heaviest_mode: mean and covariance of the heaviest hump, of the region with a share of the
    mass.
    """
    if estimator == 'heaviest_mode':
        heaviest = belief.modes(share)[0]
        return heaviest.mean, heaviest.covariance
    point = belief.mode() if estimator == 'mode' else belief.mean()
    return point, belief.covariance(about=point)


class ModeOutputs:
    """
    The publishers of the modes: ~/modes, and ~/markers where x or y of the pose is estimated.

    names: those of the states; axes: the states that are x, y and z of the pose, None for none.
    """

    def __init__(self, node: Node, config: Config, names: Sequence[str],
                 axes: Sequence[int | None], live: Mapping[str, Any]) -> None:
        self._names, self._axes = names, axes
        self._share, self._frame = config.modes.share, config.frame_id
        self._pace = Pace(live, 'modes.rate', TAKE)
        self._shown = 0
        drawn = any(axis is not None for axis in axes[:2])
        self._publishers = {
            out: node.create_publisher(out.type, out.name, out.qos)
            for out in (interface.MODES, *([interface.MARKERS] if drawn else []))}

    def restart(self) -> None:
        """Let the next modes go out at once."""
        self._pace.restart()

    def publish(self, belief: Any, stamp_ns: int) -> None:
        """Publish the modes of a belief that holds at a stamp, when due and where heard."""
        if not self._pace.is_due(stamp_ns):
            return
        with self._pace.making(stamp_ns):
            heard = {out: publisher for out, publisher in self._publishers.items()
                     if publisher.get_subscription_count()}
            modes = belief.modes(self._share) if heard else []
            if interface.MODES in heard:
                heard[interface.MODES].publish(mode_messages.modes_message(modes, self._names))
            if interface.MARKERS in heard:
                heard[interface.MARKERS].publish(mode_messages.markers_message(
                    modes, self._axes, self._shown, stamp_ns, self._frame))
                # also later ones delete them: whoever missed a message is put right by the next
                self._shown = max(self._shown, len(modes))
