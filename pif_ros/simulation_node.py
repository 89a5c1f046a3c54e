"""Plays a simulation onto real topics: truth, controls and measurements of a configuration."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import dataclasses
from dataclasses import dataclass
from importlib.util import find_spec
import math
import sys
import time
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped
import numpy as np
from numpy.typing import NDArray
from pif_ros import conversions, fields, parameters
from pif_ros.config import (Config, ConfigError, ControlConfig, find_system, SourceConfig,
                            state_axes)
from pif_ros.core.filters import NANOSECONDS
from pif_ros.scenario import BEGIN_NS, scenario, Settings
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException, ParameterUninitializedException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

Spin = Callable[[float], None]
Array = NDArray[np.float64]

#: Seconds of silence before the first measurement, in which the clock is heard.
LEAD_IN = 0.5
#: Seconds between two readings of the clock.
TICK = 0.05


@dataclass(frozen=True, eq=False)
class Outlet:
    """A topic of measurements: what is published, and how each source's numbers get into it."""

    publisher: Publisher
    type: Any  # noqa: A003
    writers: Mapping[str, Callable[[Any, Any], None]]


class Simulator(Node):
    """
    Publishes what the sources of a configuration would measure, `truth`, and `truth_state`.

    For a model with inputs also what drives it, on the topic of the configuration's control.
    Where the node is told use_sim_time, it makes the time itself and publishes `/clock`: then the
    stamps too are the same for the same seed.  given: settings that count above the parameters'.
    Raises ConfigError for what cannot be simulated.
    """

    def __init__(self, given: Mapping[str, Any] | None = None, **options: Any) -> None:
        try:
            super().__init__('simulate', start_parameter_services=False, **options)
        except (InvalidParameterTypeException, ParameterUninitializedException):
            raise ConfigError(parameters.mistyped(self)) from None
        told = parameters.told(self)
        self.told = bool(told)
        own = {spec.name: told.pop(spec.name) for spec in dataclasses.fields(Settings)
               if spec.name in told}
        self.settings = Settings.from_values({**own, **(given or {})})
        self.config = Config.from_parameters(told)
        self._makes_time = bool(self.get_parameter('use_sim_time').value)
        model = find_system(self.config).model
        self._names = list(model.names)
        axes = self.config.pose.axes or model.names[:2]
        self._axes = state_axes('pose.axes', axes, model)[:len(conversions.POSE_AXES)]
        self.scenario = scenario(self.config, self.settings)
        self._check_time()
        self._open()

    def play(self, spin: Spin, stopped: Callable[[], bool] = lambda: False) -> None:
        """
        Play to the end, or until stopped; spin(timeout) is to run this node's callbacks.

        TimeoutError in one line where nobody listens, or where the filter falls silent.
        """
        self._meet(spin, stopped)
        begin, elapsed_ns = time.monotonic(), self.scenario.elapsed_ns
        begin_ns = BEGIN_NS if self._makes_time else time.time_ns()
        with _progress(float(elapsed_ns[-1] / NANOSECONDS)) as show:
            for k, elapsed in enumerate(elapsed_ns.tolist()):
                self._await_its_time(begin, elapsed, spin, stopped)
                if stopped():
                    break
                self._send(k, begin_ns + elapsed)
                self._await_pose(begin_ns + elapsed, spin, stopped)
                show(elapsed / NANOSECONDS)
        for outlet in self._outlets:
            outlet.publisher.wait_for_all_acked(Duration(seconds=1))

    def _check_time(self) -> None:
        """Refuse what needs a time of one's own where there is none."""
        if self._makes_time:
            return
        if self.settings.speed != 1.0:
            raise ConfigError('speed: expected 1 where use_sim_time is false, '
                              f'got {self.settings.speed!r}')
        if self.scenario.changes_with_time:
            raise ConfigError('use_sim_time: expected true for what changes with time, got False')

    def _open(self) -> None:
        """Create the topics."""
        qos = QoSProfile(depth=self.config.measurements.queue_length,
                         reliability=ReliabilityPolicy.RELIABLE)
        by_topic: dict[str, dict[str, SourceConfig]] = {}
        for name, source in self.config.measurements.sources.items():
            by_topic.setdefault(source.topic, {})[name] = source
        self._outlets = [self._outlet(topic, sources, qos) for topic, sources in by_topic.items()]
        self._control = self._control_outlet(qos) if self.scenario.controls.values else None
        self._truth = self.create_publisher(PoseStamped, 'truth', qos)
        self._state = self.create_publisher(JointState, 'truth_state', qos)
        self._ticks = self.create_publisher(Clock, '/clock', 10) if self._makes_time else None
        self._pose_ns = -1
        self._follow = self.create_subscription(
            PoseWithCovarianceStamped, self.settings.follow, self._on_pose, 100,
        ) if self.settings.speed == 0.0 else None

    def _outlet(self, topic: str, sources: Mapping[str, SourceConfig], qos: QoSProfile) -> Outlet:
        """Return the topic of some sources; several of one topic share its message."""
        writers, message = {}, None
        first = next(iter(sources.values()))
        for name, source in sources.items():
            if source.type != first.type:
                raise ConfigError(f'measurements.{name}.type: expected {first.type!r}, as all on '
                                  f'topic {topic!r}, got {source.type!r}')
            message, writers[name] = self._writer(f'measurements.{name}', source,
                                                  self.scenario.measurements[name])
        return Outlet(self.create_publisher(message, topic, qos), message, writers)

    def _control_outlet(self, qos: QoSProfile) -> Outlet:
        config = self.config.control
        values = np.array(self.scenario.controls.values)
        message, write = self._writer('control', config, values)
        return Outlet(self.create_publisher(message, config.topic, qos), message,
                      {'control': write})

    def _writer(self, prefix: str, config: SourceConfig | ControlConfig,
                values: Array) -> tuple[Any, Callable[[Any, Any], None]]:
        """Return the class of a message, and what puts one of some (T, m) into its fields."""
        try:
            message = fields.message_class(config.type)
        except ValueError as error:
            raise ConfigError(f'{prefix}.type: {error}') from None
        try:
            write = fields.field_writer(message, config.fields, values.shape[1])
            undefined = values[~np.isfinite(values).all(axis=1)]
            for hard in (np.fmin.reduce(values), np.fmax.reduce(values), *undefined[:1]):
                write(message(), hard)
        except ValueError as error:
            raise ConfigError(f'{prefix}.fields: {error}') from None
        if self.settings.speed == 0.0 and not fields.has_header(message):
            raise ConfigError('speed: expected one above 0 where messages bear no stamp '
                              f'({config.type}), got 0.0')
        return message, write

    def _on_pose(self, msg: PoseWithCovarianceStamped) -> None:
        self._pose_ns = max(self._pose_ns, conversions.stamp_to_ns(msg.header.stamp))

    def _meet(self, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Wait until somebody listens, and until that has heard of the time."""
        deadline = time.monotonic() + self.settings.timeout
        announce = time.monotonic() + LEAD_IN
        while (missing := self._missing()) and not stopped():
            if time.monotonic() > deadline:
                raise TimeoutError(f'nobody at {", ".join(missing)} after '
                                   f'{self.settings.timeout:g} s: is the filter running, with the '
                                   'same parameters, in this ROS domain?')
            if time.monotonic() > announce:
                self.get_logger().info(f'waiting for the other end of {", ".join(missing)}')
                announce = math.inf
            spin(TICK)
        begin = time.monotonic()
        while self._makes_time and time.monotonic() < begin + LEAD_IN and not stopped():
            self._tick(BEGIN_NS - 1)
            spin(TICK)

    def _missing(self) -> list[str]:
        """Return the topics at which the other end has not been met yet."""
        outlets = [*self._outlets, *([self._control] if self._control is not None else [])]
        missing = [outlet.publisher.topic_name for outlet in outlets
                   if not outlet.publisher.get_subscription_count()]
        # this node too hears the clock, since it is told to
        if self._ticks is not None and self._ticks.get_subscription_count() < 2:
            missing.append(self._ticks.topic_name)
        if self._follow is not None and not self._follow.get_publisher_count():
            missing.append(self._follow.topic_name)
        return missing

    def _await_its_time(self, begin: float, elapsed_ns: int, spin: Spin,
                        stopped: Callable[[], bool]) -> None:
        """Let the time run on to just before a measurement."""
        speed = self.settings.speed
        if speed == 0.0:
            return
        due = begin + elapsed_ns / NANOSECONDS / speed
        while (left := due - time.monotonic()) > 0.0 and not stopped():
            spin(min(left, TICK))
            now_ns = round((time.monotonic() - begin) * speed * NANOSECONDS)
            self._tick(BEGIN_NS + min(now_ns, elapsed_ns - 1))

    def _tick(self, now_ns: int) -> None:
        if self._ticks is not None:
            self._ticks.publish(Clock(clock=conversions.stamp_from_ns(now_ns)))

    def _send(self, k: int, stamp_ns: int) -> None:
        """
        Send what is true and what is measured at a time; the clock stops a nanosecond short of it.

        Thereby no forecast of the filter can bear the stamp of a measurement, and a pose with that
        stamp has seen it.
        """
        self._tick(stamp_ns - 1)
        state = self.scenario.truth[k]
        pose = PoseWithCovariance()
        conversions.fill_pose(pose, state, np.zeros((len(state), len(state))), self._axes, 0.0)
        truth = PoseStamped(pose=pose.pose)
        named = JointState(name=self._names, position=state.tolist())
        for message, publisher in ((truth, self._truth), (named, self._state)):
            publisher.publish(self._stamped(message, stamp_ns))
        if self._control is not None:
            message = self._control.type()
            self._control.writers['control'](message, self.scenario.controls.values[k])
            self._control.publisher.publish(self._stamped(message, stamp_ns))
        for outlet in self._outlets:
            message = outlet.type()
            for source, write in outlet.writers.items():
                write(message, self.scenario.measurements[source][k])
            outlet.publisher.publish(self._stamped(message, stamp_ns))

    def _stamped(self, message: Any, stamp_ns: int) -> Any:
        """Return a message with its stamp and frame, where it has room for them."""
        if fields.has_header(message):
            message.header.stamp = conversions.stamp_from_ns(stamp_ns)
            message.header.frame_id = self.config.frame_id
        return message

    def _await_pose(self, stamp_ns: int, spin: Spin, stopped: Callable[[], bool]) -> None:
        """Wait until the filter has seen the measurements of a time."""
        if self._follow is None:
            return
        deadline = time.monotonic() + self.settings.timeout
        while self._pose_ns < stamp_ns and not stopped():
            if time.monotonic() > deadline:
                raise TimeoutError(f'no pose on {self._follow.topic_name} for the measurement at '
                                   f'{stamp_ns / NANOSECONDS:.3f} s within '
                                   f'{self.settings.timeout:g} s')
            spin(0.1)


@contextmanager
def _progress(total: float) -> Iterator[Callable[[float], None]]:
    """Show on a terminal how many seconds have been played, where tqdm is there."""
    if not sys.stderr.isatty() or find_spec('tqdm') is None:
        yield lambda seconds: None
        return
    from tqdm import tqdm
    with tqdm(total=total, desc='simulation', bar_format='{desc} {percentage:3.0f}%|{bar}| '
              '{n:.0f}/{total:.0f} s [{elapsed}]') as bar:
        yield lambda seconds: bar.update(seconds - bar.n)
