"""A stand-in for the filter: it answers ranges with poses that know nothing."""

from collections.abc import Callable

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range

DEEP = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
SENSORS = QoSProfile(depth=500, reliability=ReliabilityPolicy.BEST_EFFORT)


class Follower(Node):
    """
    Notes everything that is played, in the order of its coming.

    respond: how many of the ranges are answered by a pose, 'all' of them where None; foresee: one
    of how many seconds of silence, from the second on, is answered by a forecast, none where 0.
    """

    def __init__(self, respond: int | None = None, foresee: int = 0) -> None:
        """Subscribe to the topics of the four beacons, the truth and the clock."""
        super().__init__('filter_node')
        self.ranges: list[tuple[int, str, float]] = []
        self.truths: list[tuple[int, float, float]] = []
        self.clocks: list[int] = []
        self.controls: list[tuple[int, float, float, int]] = []
        self._respond, self._newest = respond, -1
        self._foresee, self._seconds = foresee, 0
        self.poses = self.create_publisher(PoseWithCovarianceStamped, '~/pose', 10)
        for beacon in (0, 1, 5, 6):
            self.create_subscription(Range, f'beacon_{beacon}/range', self._on_range, SENSORS)
        self.create_subscription(TwistStamped, 'control', self._on_control, SENSORS)
        self.create_subscription(PoseStamped, 'truth', self._on_truth, DEEP)
        self.create_subscription(Clock, '/clock', self._on_clock, DEEP)

    def _on_range(self, msg: Range) -> None:
        self.ranges.append((nanoseconds(msg.header.stamp), msg.header.frame_id, msg.range))
        self._newest = max(self._newest, self.ranges[-1][0])
        if self._respond is None or len(self.ranges) <= self._respond:
            self._publish(self._newest)

    def _on_control(self, msg: TwistStamped) -> None:
        self.controls.append((nanoseconds(msg.header.stamp), msg.twist.linear.x,
                              msg.twist.angular.z, len(self.ranges)))

    def _on_truth(self, msg: PoseStamped) -> None:
        p = msg.pose.position
        self.truths.append((nanoseconds(msg.header.stamp), p.x, p.y))

    def _on_clock(self, msg: Clock) -> None:
        self.clocks.append(nanoseconds(msg.clock))
        if self._foresee and 0 <= self._newest < self.clocks[-1] - 10**9 // 2:
            if self._seconds % self._foresee == 1 % self._foresee and self._seconds:
                self._publish(self.clocks[-1])
            self._seconds += 1

    def _publish(self, stamp_ns: int) -> None:
        pose = PoseWithCovarianceStamped()
        pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        self.poses.publish(pose)


def nanoseconds(stamp: object) -> int:
    """Return the time of a message."""
    return stamp.sec * 10**9 + stamp.nanosec


def until(spin: Callable[[float], None], happened: Callable[[], bool], turns: int = 200) -> None:
    """Spin until something has happened, for ten seconds at most."""
    for _ in range(turns):
        if happened():
            return
        spin(0.05)
    raise AssertionError('it did not happen within ten seconds')
