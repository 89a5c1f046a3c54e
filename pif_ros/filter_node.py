"""The node: callbacks of a few lines around one Tracker."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
import functools
import math
import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from pif_ros import conversions, interface, parameters
from pif_ros.accounts import Accounts, Throttle
from pif_ros.config import build_tracker, ConfigError, describe, find_grid, find_system
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import CorrectionFailed, Estimate, Measurement
from pif_ros.outputs import Outputs
from pif_ros.process import guarded
from pif_ros.sources import Refused, Source
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockChange, ClockType, JumpThreshold, TimeJump
from rclpy.duration import Duration
from rclpy.exceptions import InvalidParameterTypeException, ParameterUninitializedException
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Empty, Trigger

#: The belief hardly allows a measurement whose likelihood, averaged over the belief, is less than
#: that of ten standard deviations.
OUTLIER = -0.5 * 10**2
#: Replays that have not come to an end for so long, in seconds, take no more late measurements.
OVERLOAD = 5.0
#: So many corrections of a replay are made before signals, services and messages have their turn.
SLICE = 32
#: A replay of more corrections than this waits until a burst of late measurements has ended ...
LONG_REPLAY = 4
#: ... but no longer than this, in seconds.
PATIENCE = 0.2
#: Predicting the pose to now has one in so many parts of the time at most, the rest is for
#: measurements.
FORECASTS_TAKE = 4


class FilterNode(Node):
    """
    Measurements in; pose, covariance and density out, on the topics of interface.py.

    Raises ConfigError for parameters that make no filter.
    """

    def __init__(self, **kwargs: Any) -> None:
        try:
            super().__init__('filter_node', **kwargs)
        except (InvalidParameterTypeException, ParameterUninitializedException):
            raise ConfigError(parameters.mistyped(self)) from None
        self.told = bool(parameters.told(self))
        self.config = parameters.declare(self)
        self.tracker = build_tracker(self.config)
        self.accounts = Accounts(self.config.measurements.names)
        self.faults = 0
        self._throttle = Throttle()
        self._queue: deque[Measurement] = deque()
        self._unjudged: set[Measurement] = set()
        self._behind_since: float | None = None
        self._burst_since: float | None = None
        self._arrivals = self._arrivals_seen = 0
        self._published_ns = -1
        self._next_forecast = 0.0
        self._max_gap_ns = round(self.config.time.max_gap * NANOSECONDS)
        self._live: dict[str, Any] = {'pose.estimator': self.config.pose.estimator,
                                      'density.rate': self.config.density.rate}
        model = find_system(self.config).model
        self._outputs = Outputs(self, self.config, model, find_grid(self.config, model),
                                self._live)
        self._warm_up()
        self._connect()

    # What comes in

    @guarded
    def _on_measurement(self, source: Source, msg: Any, info: Mapping[str, Any]) -> None:
        account = self.accounts.sources[source.name]
        account.received += 1
        lost = source.lost(info['publication_sequence_number'])
        topic = self.resolve_topic_name(source.topic)
        if lost and self.count_publishers(topic) == 1:
            # several publishers count each for themselves, and which one sent is not told
            account.received += lost
            account.dropped += lost
            self.report(f'{source.name}: DDS',
                        f'{source.name}: the queue in DDS dropped {lost} measurements')
        try:
            measurement = source.measurement(msg, self._now(), self._arrival(info))
        except Refused as refused:
            self._reject(source.name, refused.reason, str(refused))
            return
        except Exception:
            account.rejected['fault'] += 1
            raise
        if len(self._queue) >= self.config.measurements.queue_length:
            oldest = self._queue.popleft().source
            self.accounts.sources[oldest].dropped += 1
            self.report('dropped', f'{oldest}: dropped the oldest measurement of a full queue')
        self._queue.append(measurement)
        self._arrivals += 1
        self._wake.trigger()

    @guarded
    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        now_ns, account = self._now(), self.accounts.initial_pose
        frame = msg.header.frame_id
        prior = self.tracker.prior
        account.received += 1
        try:
            if now_ns is None:
                raise ValueError('expected a /clock before it')
            if frame not in ('', self.config.frame_id):
                raise ValueError(f'frame_id: expected {self.config.frame_id!r}, got {frame!r}')
            stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
            stamp_ns = stamp_ns if 0 < stamp_ns < now_ns else now_ns
            if stamp_ns < self._published_ns - self._max_gap_ns:
                raise ValueError('stamp: expected one at most time.max_gap before the last pose, '
                                 f'got {stamp_ns / NANOSECONDS} s')
            mean, covariance = conversions.gaussian_from_pose(
                msg.pose, self._outputs.pose_axes, prior.mean(), prior.covariance())
            belief = self.tracker.filter.gaussian(mean, covariance)
        except ValueError as error:
            account.rejected['no belief'] += 1
            self.report('initialpose', f'initialpose: {error}')
            return
        account.accepted += 1
        self._restart(belief, stamp_ns)
        self._publish(self.tracker.estimate())

    @guarded
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._restart(None, None)
        response.success, response.message = True, 'the prior holds at the next measurement'
        return response

    @guarded
    def _on_global(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        self._restart(self.tracker.filter.uniform(), None)
        return response

    @guarded
    def _on_jump(self, jump: TimeJump) -> None:
        if jump.delta.nanoseconds >= 0 and jump.clock_change == ClockChange.ROS_TIME_NO_CHANGE:
            return
        self.get_logger().info(f'the clock jumped by {jump.delta.nanoseconds / NANOSECONDS:.3f} s:'
                               ' back to the prior')
        self._published_ns = -1
        self._restart(None, None)

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._live.update(parameters.live_values(changes, self.config.measurements.names))
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    # What is done with it

    @guarded
    def _work(self) -> None:
        self.drain()
        if self.tracker.backlog > LONG_REPLAY and self._burst_goes_on():
            self._wake.trigger()
            return
        self._burst_since = None
        if not self.tracker.backlog:
            return
        try:
            estimate = self.tracker.estimate(at_most=SLICE)
        except CorrectionFailed as failed:
            self._wake.trigger()
            account = self.accounts.sources[failed.measurement.source]
            account.accepted -= 1
            account.rejected['fault'] += 1
            self._unjudged.discard(failed.measurement)
            raise
        finally:
            self._judge()
        if self.tracker.backlog or self._queue:
            self._behind_since = self._behind_since or time.monotonic()
            self._wake.trigger()
            return
        self._behind_since = None
        self._publish(estimate)

    @guarded
    def _on_timer(self) -> None:
        now_ns, newest_ns = self._now(), self.tracker.stamp_ns
        if now_ns is None or newest_ns is None or self.tracker.backlog:
            return
        if now_ns > newest_ns + self.config.time.max_forecast * NANOSECONDS:
            age = (now_ns - newest_ns) / NANOSECONDS
            self.report('stale', f'the newest measurement is {age:.0f} s old, more than '
                        'time.max_forecast: no pose until the next one')
            return
        if now_ns > self._published_ns and time.monotonic() >= self._next_forecast:
            began = time.monotonic()
            self._publish(self.tracker.forecast(now_ns))
            took = FORECASTS_TAKE * (time.monotonic() - began)
            if took * self.config.publish.rate > 1:
                self._next_forecast = began + took

    def drain(self) -> None:
        """Put what waits in the queue where it belongs, as far as the work can take it."""
        while self._queue and self.tracker.backlog < self.config.measurements.queue_length:
            measurement = self._queue.popleft()
            if self._is_overload(measurement):
                self._reject(measurement.source, 'overload', 'late, and the replays of late ones '
                             f'have not come to an end for {OVERLOAD:g} s')
                continue
            self._bridge(measurement)
            rejection = self.tracker.observe(measurement)
            if rejection is None:
                self.accounts.sources[measurement.source].accepted += 1
                self._unjudged.add(measurement)
            else:
                behind = (self.tracker.stamp_ns or 0) - measurement.stamp_ns
                self._reject(measurement.source, rejection.value,
                             f'{rejection.value}, {behind / NANOSECONDS:.3f} s behind the newest')

    def _is_overload(self, measurement: Measurement) -> bool:
        """Return whether a late measurement would keep replays going that never end."""
        newest_ns, since = self.tracker.stamp_ns, self._behind_since
        return (since is not None and time.monotonic() - since > OVERLOAD
                and newest_ns is not None and measurement.stamp_ns < newest_ns)

    def _bridge(self, measurement: Measurement) -> None:
        """Begin anew where a gap is so long that predicting through it would take for ever."""
        newest_ns = self.tracker.stamp_ns
        if newest_ns is not None and measurement.stamp_ns - newest_ns > self._max_gap_ns:
            gap = (measurement.stamp_ns - newest_ns) / NANOSECONDS
            self.report('gap', f'{measurement.source}: a gap of {gap:.0f} s, more than '
                        'time.max_gap: back to the prior')
            self._unjudged.clear()
            self.tracker.reset()

    def _judge(self) -> None:
        """Count and tell which of the new measurements the belief hardly allows, or not at all."""
        for made in self.tracker.corrections:
            measurement, surprise = made.measurement, made.log_evidence - made.log_peak
            if measurement not in self._unjudged:
                continue
            self._unjudged.remove(measurement)
            if surprise < OUTLIER:
                self.accounts.sources[measurement.source].outliers += 1
                self.report(f'{measurement.source}: outlier', f'{measurement.source}: ' + (
                    'a measurement that no state of the belief allows: the belief stays as it was'
                    if surprise == -math.inf else 'a measurement about '
                    f'{math.sqrt(-2 * surprise):.0f} standard deviations from all that is believed'
                ))
        self.tracker.corrections.clear()

    def _burst_goes_on(self) -> bool:
        """Return whether measurements still arrive; a replay is best made once, after them."""
        now, since = time.monotonic(), self._burst_since
        self._burst_since = now if since is None else since
        arriving, self._arrivals_seen = self._arrivals != self._arrivals_seen, self._arrivals
        return arriving and now - self._burst_since < PATIENCE

    def _restart(self, belief: Any, stamp_ns: int | None) -> None:
        self.drain()
        self._unjudged.clear()
        self._outputs.restart()
        self.tracker.reset(belief, stamp_ns)

    # What goes out

    def _publish(self, estimate: Estimate[Any]) -> None:
        """Publish an estimate, but never with an older stamp than the last."""
        if estimate.stamp_ns is None:
            return
        stamp_ns = max(estimate.stamp_ns, self._published_ns)
        if estimate.stamp_ns < stamp_ns:
            if self._is_left_to_the_timer(estimate.stamp_ns):
                return
            estimate = self.tracker.forecast(stamp_ns)
        belief = estimate.belief
        if not belief.mass > 0:
            self.report('off the grid', 'all of the belief has left the grid: back to the prior')
            self._restart(None, None)
            return
        self._published_ns = stamp_ns
        self._outputs.publish(belief, stamp_ns)

    def _is_left_to_the_timer(self, stamp_ns: int) -> bool:
        """Return whether an estimate lies so far back that predicting each to now takes long."""
        rate, now_ns = self.config.publish.rate, self._now()
        return bool(rate and now_ns is not None and now_ns > self._published_ns
                    and self._published_ns - stamp_ns > NANOSECONDS / rate)

    def report(self, kind: str, text: str) -> None:
        """Warn of something, at most one line of a kind every few seconds."""
        line = self._throttle.line(kind, text)
        if line is not None:
            self.get_logger().warning(line)

    def _reject(self, source: str, reason: str, sentence: str) -> None:
        self.accounts.sources[source].rejected[reason] += 1
        self.report(f'{source}: {reason}', f'{source}: rejected a measurement: {sentence}')

    # How it is set up

    def _warm_up(self) -> None:
        """Do before the first measurement what need not be done at it."""
        began = time.perf_counter()
        what = describe(self.config, self.tracker.filter)
        self.get_logger().info(f'{self.config.model.name}: {what}, made in '
                               f'{time.perf_counter() - began:.2f} s')
        for remark in [*self.tracker.filter.remarks(), *self._speed()]:
            self.get_logger().warning(remark)

    def _speed(self) -> list[str]:
        """Return a sentence where prediction is slower than time."""
        filter_ = self.tracker.filter
        step = filter_.time_step_ns / NANOSECONDS
        needed = []
        for k in range(3):
            began = time.perf_counter()
            filter_.predict(self.tracker.prior, k * filter_.time_step_ns,
                            (k + 1) * filter_.time_step_ns)
            needed.append(time.perf_counter() - began)
        return [] if min(needed) < step / 2 else [
            f'kernel.time_step: a step of {step:g} s takes {min(needed):.2g} s to compute: the '
            'filter cannot keep up; take a longer step or a coarser grid']

    def _connect(self) -> None:
        config = self.config
        known = {self.resolve_topic_name(own.name): own.type
                 for own in (*interface.PUBLICATIONS, *interface.SUBSCRIPTIONS)}
        for name, source_config in config.measurements.sources.items():
            self._listen(Source(name, source_config, self.tracker.filter.sensors[name],
                                config.time.max_ahead), known)
        start = interface.INITIAL_POSE
        self.create_subscription(start.type, start.name, self._on_initial_pose, start.qos)
        for service, callback in ((interface.RESET, self._on_reset),
                                  (interface.GLOBAL, self._on_global)):
            self.create_service(service.type, service.name, callback)
        self.add_on_set_parameters_callback(self._on_parameters)
        self._wake = self.create_guard_condition(self._work)
        self._jump = self.get_clock().create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=self._on_jump)
        if config.publish.rate:
            # a timer on the system's clock stands still when that clock is set back
            simulated = self.get_parameter('use_sim_time').value
            clock = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
            self.create_timer(1 / config.publish.rate, self._on_timer, clock=clock)

    def _listen(self, source: Source, known: dict[str, Any]) -> None:
        """Subscribe to a source, given the types of the topics that are known so far."""
        try:
            topic = self.resolve_topic_name(source.topic)
            if known.setdefault(topic, source.type) is not source.type:
                raise ValueError(f'its messages are of type {known[topic].__name__}')
            self.create_subscription(
                source.type, source.topic, functools.partial(self._on_measurement, source),
                interface.measurement_qos(self.config.measurements.queue_length))
        except Exception as error:  # noqa: B902  rclpy's own have no common base
            raise ConfigError(f'measurements.{source.name}.topic: expected a topic for messages '
                              f'of type {source.type.__name__}, got {source.topic!r} '
                              f'({str(error).splitlines()[0]})') from None

    def _arrival(self, info: Mapping[str, Any]) -> int | None:
        """Return when a message arrived, None where the node does not live in that time."""
        if self.get_parameter('use_sim_time').value:
            return None
        return info.get('received_timestamp') or None

    def _now(self) -> int | None:
        """Return the time in nanoseconds, None before there is a /clock."""
        return int(self.get_clock().now().nanoseconds) or None
