"""Listens to a filter: every pose that it publishes, and the densities of telling moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import re
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
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

    def mean(self) -> NDArray[np.float64]:
        """Return the mean, shape (2,)."""
        p = self.values / self.values.sum()
        return np.array([p.sum(axis=1) @ self.x, p.sum(axis=0) @ self.y])


class Recorder(Node):
    """
    Keeps what a filter publishes.

    windows_ns: the times, first and last stamp, whose densities are wanted; it listens to the
    densities only about then, since a filter makes them only for those who listen.
    """

    def __init__(self, filter_name: str, windows_ns: Sequence[tuple[int, int]],
                 **options: Any) -> None:
        """Subscribe to the topics of the filter of that name."""
        super().__init__('plaza_recorder', start_parameter_services=False, **options)
        self._windows_ns = windows_ns
        self._poses: list[tuple[int, NDArray[np.float64], NDArray[np.float64]]] = []
        self._densities: list[tuple[int, Density]] = []
        self.create_subscription(
            PoseWithCovarianceStamped, f'{filter_name}/pose', self._on_pose, _RELIABLE)
        self._density_topic = f'{filter_name}/density'
        self._density: Subscription | None = None
        self._listen(-1)

    @property
    def stamp_ns(self) -> int:
        """Return the newest stamp of a pose, -1 before there is one."""
        return self._poses[-1][0] if self._poses else -1

    def track(self) -> Track:
        """Return all poses as they were first published for their stamp, in their order."""
        first: dict[int, int] = {}
        for i, (stamp, _, _) in enumerate(self._poses):
            first.setdefault(stamp, i)
        chosen = [self._poses[first[stamp]] for stamp in sorted(first)]
        return Track(np.array([p[0] for p in chosen], dtype=np.int64),
                     np.array([p[1] for p in chosen]).reshape(-1, 2),
                     np.array([p[2] for p in chosen]).reshape(-1, 2, 2))

    def densities(self) -> list[tuple[int, Density]]:
        """
        Return the densities with their stamps, in the order of these.

        A density bears no stamp: its own is that of the pose with the same mean.
        """
        means = np.array([p[1] for p in self._poses]).reshape(-1, 2)
        found = {}
        for i, density in self._densities:
            near = np.arange(max(i - 50, 0), min(i + 50, len(means)))
            distance = np.linalg.norm(means[near] - density.mean(), axis=1)
            if distance.min() < 1e-3:
                found[self._poses[near[distance.argmin()]][0]] = density
        return sorted(found.items(), key=lambda pair: pair[0])

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        stamp = msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec
        p = msg.pose.pose.position
        covariance = np.array(msg.pose.covariance).reshape(6, 6)[:2, :2]
        self._poses.append((stamp, np.array([p.x, p.y]), covariance))
        self._listen(stamp)

    def _on_density(self, msg: Float64MultiArray) -> None:
        self._densities.append((len(self._poses), Density.from_message(msg)))

    def _listen(self, stamp_ns: int) -> None:
        """Begin or end listening to the densities."""
        wanted = stamp_ns < 0 or any(
            first - _EARLY_NS <= stamp_ns <= last + _LATE_NS for first, last in self._windows_ns)
        if wanted and self._density is None:
            self._density = self.create_subscription(
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
