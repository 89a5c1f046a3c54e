"""Listens to a filter: every pose that it publishes, and the densities of telling moments."""

from __future__ import annotations

import bisect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import re
from typing import Any, cast

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
from pif_ros.conversions import angles
from pif_ros.plaza.report import Track
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from std_msgs.msg import Float64MultiArray

_AXIS = re.compile(r'(?P<name>\S+) first=(?P<first>\S+) spacing=(?P<spacing>\S+)')
_EARLY_NS, _LATE_NS = 20 * 10**9, 3 * 10**9
_RELIABLE = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)


@dataclass(frozen=True, eq=False)
class Density:
    """A density (nx, ny) per square metre, at the centres x (nx,) and y (ny,) in metres."""

    values: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]

    @classmethod
    def from_message(cls, msg: Float64MultiArray) -> Density:
        """Read the axes from the labels; ValueError where they are not two."""
        x, y = (_axis(dim.label, dim.size) for dim in msg.layout.dim)
        return cls(np.array(msg.data).reshape(len(x), len(y)), x, y)


@dataclass(frozen=True, eq=False)
class _Pose:
    """A published pose: when it was sent, and of what time it tells."""

    sent_ns: int
    stamp_ns: int
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]


class Recorder(Node):
    """
    Keeps what a filter publishes.

    windows_ns: the times, first and last stamp, whose densities are wanted; it listens to the
    densities only about then, since a filter makes them only for those who listen; heading:
    whether the poses have a yaw that is estimated.
    """

    def __init__(self, filter_name: str, windows_ns: Sequence[tuple[int, int]],
                 heading: bool = False, **options: Any) -> None:
        """Subscribe to the topics of the filter of that name."""
        super().__init__('plaza_recorder', start_parameter_services=False, **options)
        self._windows_ns = windows_ns
        self._axes = [0, 1, 5] if heading else [0, 1]
        self._poses: list[_Pose] = []
        self._densities: list[tuple[int, Density]] = []
        # rclpy's types know no callback with a second argument
        self._hear = cast(Any, self.create_subscription)
        self._hear(PoseWithCovarianceStamped, f'{filter_name}/pose', self._on_pose, _RELIABLE)
        self._density_topic = f'{filter_name}/density'
        self._density: Subscription | None = None
        self._listen(-1)

    @property
    def stamp_ns(self) -> int:
        """Return the newest stamp of a pose, -1 before there is one."""
        return self._poses[-1].stamp_ns if self._poses else -1

    def track(self) -> Track:
        """Return all poses as they were first published for their stamp, in their order."""
        first: dict[int, _Pose] = {}
        for pose in self._poses:
            first.setdefault(pose.stamp_ns, pose)
        chosen, n = [first[stamp] for stamp in sorted(first)], len(self._axes)
        return Track(np.array([p.stamp_ns for p in chosen], dtype=np.int64),
                     np.array([p.mean for p in chosen]).reshape(-1, n),
                     np.array([p.covariance for p in chosen]).reshape(-1, n, n))

    def densities(self) -> list[tuple[int, Density]]:
        """
        Return the densities with their stamps, in the order of these.

        A density bears no stamp: its own is that of the pose that was sent last before it.
        """
        sent = [pose.sent_ns for pose in self._poses]
        found: dict[int, Density] = {}
        for sent_ns, density in self._densities:
            i = bisect.bisect_right(sent, sent_ns) - 1
            if i >= 0:
                found.setdefault(self._poses[i].stamp_ns, density)
        return sorted(found.items(), key=lambda pair: pair[0])

    def _on_pose(self, msg: PoseWithCovarianceStamped, info: Mapping[str, int]) -> None:
        stamp = msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec
        p = msg.pose.pose.position
        mean = np.array([p.x, p.y, p.z, *angles(msg.pose.pose)])[self._axes]
        covariance = np.array(msg.pose.covariance).reshape(6, 6)[np.ix_(self._axes, self._axes)]
        self._poses.append(_Pose(info['source_timestamp'], stamp, mean, covariance))
        self._listen(stamp)

    def _on_density(self, msg: Float64MultiArray, info: Mapping[str, int]) -> None:
        self._densities.append((info['source_timestamp'], Density.from_message(msg)))

    def _listen(self, stamp_ns: int) -> None:
        """Begin or end listening to the densities."""
        wanted = stamp_ns < 0 or any(
            first - _EARLY_NS <= stamp_ns <= last + _LATE_NS for first, last in self._windows_ns)
        if wanted and self._density is None:
            self._density = self._hear(
                Float64MultiArray, self._density_topic, self._on_density, _RELIABLE)
        elif not wanted and self._density is not None:
            self.destroy_subscription(self._density)
            self._density = None


def _axis(label: str, size: int) -> NDArray[np.float64]:
    """Return the centres of the cells that a label such as 'x first=0.5 spacing=1.0' tells."""
    told = _AXIS.match(label)
    if told is None:
        raise ValueError(f"expected '<axis> first=<float> spacing=<float> ...', got {label!r}")
    first, spacing = float(told['first']), float(told['spacing'])
    return first + spacing * np.arange(size, dtype=np.float64)
