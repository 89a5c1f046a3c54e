"""Plays a Plaza recording onto real topics: a Range topic per beacon, odometry, truth, clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import fields
import math
import time
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, TwistStamped
from pif_ros import parameters
from pif_ros.plaza.progress import Progress
from pif_ros.plaza.recording import load, Recording
from pif_ros.plaza.schedule import Step, steps
from pif_ros.plaza.settings import Settings
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, ParameterUninitializedException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Range

Spin = Callable[[float], None]

# A block of 120 ranges may arrive at once; nothing of it may be lost.
_BURST = QoSProfile(depth=500, reliability=ReliabilityPolicy.RELIABLE)
_LEAD_IN = 0.5
_PATIENCE = 2.0
# Seconds in which a filter that has nothing else to do takes some controls.
_TAKING = 0.01
# A filter may skip a forecast when it has just been at work for long; so it has more than one
# chance to show that it makes any.
_CHANCES = 2


class Player(Node):
    """
    Publishes a recording: `beacon_<id>/range`, `control`, `truth` and `/clock`.

    The stamps are the recording's own, and late ranges arrive as late as they did.  A TwistStamped
    on `control` bears the start of the interval for which it holds.  Odometry knows an interval at
    its end only: it arrives then, one interval after its stamp.
    """

    def __init__(self, recording: Recording | None = None, settings: Settings | None = None,
                 **options: Any) -> None:
        """
        Create the topics; what is not given comes from the ROS parameters.

        ValueError or FileNotFoundError in one line where that cannot be played.
        """
        try:
            super().__init__('plaza_player', start_parameter_services=False, **options)
        except (InvalidParameterTypeException, ParameterUninitializedException):
            raise ValueError(parameters.mistyped(self)) from None
        self.settings = settings or self._declared()
        self.recording = recording or load(self.settings.recording, self.settings.path)
        self.settings.span.limits_ns(self.recording)
        self.sent = Counter(ranges=0)
        self._ticks = self.create_publisher(Clock, '/clock', 10)
        self._truth = self.create_publisher(PoseStamped, 'truth', _BURST)
        self._control = self.create_publisher(TwistStamped, 'control', _BURST)
        self._beacons = {
            b: self.create_publisher(Range, f'beacon_{b}/range', _BURST)
            for b in self.recording.beacons}
        self._longest = math.ceil(float(self.recording.ranges.max()))
        self._pose_ns = -1
        self._chances: float = _CHANCES
        self._taken = 0
        self._follow = self.create_subscription(
            PoseWithCovarianceStamped, self.settings.follow, self._on_pose, 100,
        ) if self.settings.speed == 0.0 else None

    def play(self, spin: Spin, stopped: Callable[[], bool] = lambda: False) -> None:
        """
        Play to the end, or until stopped; spin(timeout) is to run this node's callbacks.

        TimeoutError in one line where nobody listens, or where the follower falls silent.
        """
        schedule = list(steps(self.recording, self.settings.span, self._quiet(),
                              self.settings.odometry))
        self._meet(spin, stopped)
        self._lead_in(schedule[0], spin, stopped)
        progress = Progress(schedule[0].stamp_ns, schedule[-1].stamp_ns)
        begin = time.monotonic()
        for step in schedule:
            self._await_its_time(begin, step.stamp_ns - schedule[0].stamp_ns, spin, stopped)
            if stopped():
                break
            self._await_controls(step, spin)
            self._send(step)
            if step.ranges:
                self._await_pose(step, spin, stopped)
            elif step.quiet:
                self._await_forecast(step, spin, stopped)
            progress.show(step.stamp_ns)
        progress.close()

    def _declared(self) -> Settings:
        names = {field.name: field.default for field in fields(Settings)}
        for name, default in names.items():
            self.declare_parameter(
                name, default, ParameterDescriptor(dynamic_typing=True, read_only=True))
        told = parameters.told(self)
        return Settings.from_values({name: told[name] for name in sorted(told)})

    def _quiet(self) -> float:
        return 1.0 if self.settings.speed == 0.0 else 0.1

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        stamp = msg.header.stamp
        self._pose_ns = max(self._pose_ns, stamp.sec * 10**9 + stamp.nanosec)

    def _missing(self) -> list[str]:
        """Return the topics at which the other end has not been met yet."""
        publishers: list[Publisher] = [self._ticks, *self._beacons.values()]
        missing = [p.topic_name for p in publishers if p.get_subscription_count() == 0]
        if self._follow is not None and self._follow.get_publisher_count() == 0:
            missing.append(self._follow.topic_name)
        return missing

    def _meet(self, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Wait until somebody listens, and until the follower speaks."""
        deadline = time.monotonic() + self.settings.timeout
        announce = time.monotonic() + 0.5
        while (missing := self._missing()) and not stopped():
            if time.monotonic() > deadline:
                raise TimeoutError(
                    f'nobody at {", ".join(missing)} after {self.settings.timeout:g} s:'
                    ' is the filter running, with use_sim_time, in this ROS domain?')
            if time.monotonic() > announce:
                self.get_logger().info(f'waiting for the other end of {", ".join(missing)}')
                announce = math.inf
            spin(0.05)

    def _lead_in(self, first: Step, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Repeat the first time: a best-effort listener of /clock may yet have to match."""
        begin = time.monotonic()
        while time.monotonic() < begin + _LEAD_IN and not stopped():
            self._ticks.publish(Clock(clock=_time(first.stamp_ns - 1)))
            spin(0.05)

    def _await_its_time(self, begin: float, elapsed_ns: int, spin: Spin,
                        stopped: Callable[[], bool]) -> None:
        if self.settings.speed == 0.0:
            return
        due = begin + elapsed_ns * 1e-9 / self.settings.speed
        while (left := due - time.monotonic()) > 0.0 and not stopped():
            spin(min(left, 0.1))

    def _send(self, step: Step) -> None:
        """
        Send one step; the clock stops a nanosecond short of an arrival.

        Thereby no forecast of the follower can bear the stamp of a range, and a pose with that
        stamp has seen it.  The clock of a follower waits for what is answered.
        """
        short = 1 if step.ranges else 0
        if self._follow is None or _is_answered(step) or not step.odometry:
            self._ticks.publish(Clock(clock=_time(step.stamp_ns - short)))
        for i in step.truths:
            self._truth.publish(self._pose(i))
        for i in step.odometry:
            self._control.publish(self._twist(i))
            self.sent['controls'] += 1
        for i in step.ranges:
            publisher: Publisher = self._beacons[int(self.recording.beacon_ids[i])]
            publisher.publish(self._range(i))
            self.sent['ranges'] += 1

    def _await_controls(self, step: Step, spin: Spin) -> None:
        """Let the follower take the controls before what it answers; to them it says nothing."""
        if self._follow is None or not _is_answered(step):
            return
        until = time.monotonic() + (_TAKING if self.sent['controls'] > self._taken else 0.0)
        while (left := until - time.monotonic()) > 0.0:
            spin(left)
        self._taken = self.sent['controls']

    def _await_pose(self, step: Step, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Wait until the follower has seen the ranges of a step."""
        if self._follow is None:
            return
        deadline = time.monotonic() + self.settings.timeout
        while self._pose_ns < step.stamp_ns and not stopped():
            if time.monotonic() > deadline:
                seconds = float(self.recording.seconds(step.stamp_ns))
                raise TimeoutError(
                    f'no pose on {self._follow.topic_name} for the range at {seconds:.3f} s'
                    f' within {self.settings.timeout:g} s')
            spin(0.1)

    def _await_forecast(self, step: Step, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Let a follower that has begun foresee a quiet step, unless it seems to foresee none."""
        if self._follow is None or self._pose_ns < 0 or self._chances == 0:
            return
        deadline = time.monotonic() + _PATIENCE
        while self._pose_ns < step.stamp_ns and not stopped():
            if time.monotonic() > deadline:
                self._chances -= 1
                if self._chances == 0:
                    self.get_logger().info('no forecasts from the follower: not waiting for them')
                return
            spin(0.1)
        self._chances = math.inf

    def _range(self, i: int) -> Range:
        beacon = int(self.recording.beacon_ids[i])
        msg = Range()
        msg.header.stamp = _time(int(self.recording.range_stamps_ns[i]))
        msg.header.frame_id = f'beacon_{beacon}'
        msg.radiation_type = Range.ULTRASOUND  # the message knows no radio
        msg.field_of_view = float(2.0 * math.pi)
        msg.min_range = 0.0
        msg.max_range = float(self._longest)
        msg.range = float(self.recording.ranges[i])
        return msg

    def _twist(self, i: int) -> TwistStamped:
        msg = TwistStamped()
        msg.header.stamp = _time(int(self.recording.odometry_stamps_ns[i]))
        msg.header.frame_id = 'base_link'
        msg.twist.linear.x, msg.twist.angular.z = (float(v) for v in self.recording.odometry[i])
        return msg

    def _pose(self, i: int) -> PoseStamped:
        x, y, heading = (float(v) for v in self.recording.truth[i])
        msg = PoseStamped()
        msg.header.stamp = _time(int(self.recording.truth_stamps_ns[i]))
        msg.header.frame_id = 'map'
        msg.pose.position.x, msg.pose.position.y = x, y
        msg.pose.orientation.z = math.sin(heading / 2.0)
        msg.pose.orientation.w = math.cos(heading / 2.0)
        return msg


def _is_answered(step: Step) -> bool:
    """Return whether a filter publishes a pose for a step."""
    return bool(step.ranges) or step.quiet


def _time(stamp_ns: int) -> Time:
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
