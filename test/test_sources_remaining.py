"""What is said of sources that say nothing, or something else than was meant."""

import math
import re
import time

from geometry_msgs.msg import PointStamped, Twist
import numpy as np
from pif_ros.config import ConfigError, ControlConfig, SourceConfig
from pif_ros.core import filters
from pif_ros.core.models import Sensor
from pif_ros.diagnostics import ERROR, OK, statuses, WARN
from pif_ros.sources import ControlSource, Refused, Source
from proofs.inputs import YARD
import pytest
import rclpy
from rclpy.clock import ClockType
from rclpy.context import Context
from rclpy.parameter import Parameter
from rclpy.time import Time
from ros import PLANE, SECOND, stamp_into
from sensor_msgs.msg import JointState, LaserScan
from std_msgs.msg import Float64, Float64MultiArray

T = 1_000 * SECOND
INFO = {'publication_sequence_number': None}


class Bare:
    """
    A filter node whose callbacks are called without any wire, at times that are set.

    said: what it warned of.
    """

    def __init__(self, graph, parameters=PLANE):
        self.graph, self.said = graph, []
        self.node = graph.filter_node({**parameters, 'use_sim_time': True})
        self.node.report = lambda kind, text: self.said.append(text)
        self._heard = {s.topic_name: s.callback for s in self.node.subscriptions}
        self.at(T)
        self.status()

    def at(self, now_ns):
        """Set the time."""
        self.node.get_clock().set_ros_time_override(
            Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))

    def hear(self, topic, *messages):
        """Let messages come."""
        for message in messages:
            self._heard['/' + topic](message, INFO)

    def switch(self, on):
        """Let the operator want its measurements, or not."""
        self.node.set_parameters([Parameter('measurements.main.enabled', value=on)])

    def status(self, name='main'):
        """Return what is told of a source."""
        return next(s for s in statuses(self.node.facts()) if s.name == name)


@pytest.fixture
def stranger():
    """Return a node that lives for itself: nobody hears a topic of two types from one place."""
    context = Context()
    rclpy.init(context=context, args=[])
    yield rclpy.create_node('stranger', context=context, use_global_arguments=False)
    rclpy.try_shutdown(context=context)


def fix(stamp_ns=T, frame=''):
    """Return a point that is seen."""
    message = PointStamped()
    message.header.frame_id = frame
    stamp_into(message.header.stamp, stamp_ns)
    return message


def test_a_silent_source_and_a_silent_control_say_what_is_listened_to_and_who_is_there(graph):
    # topics of its own: who has just left another is seen there for a while
    bare = Bare(graph, {**YARD, 'measurements.main.topic': 'unheard', 'control.topic': 'undriven'})
    bare.at(T + 4 * SECOND)
    found = bare.status()
    assert (found.level, found.message) == (
        WARN, 'silent for 4.0 s: nothing on /unheard (geometry_msgs/msg/PointStamped); nobody '
        'publishes there')
    assert bare.status('control').message == (
        'silent for 4.0 s: nothing on /undriven (geometry_msgs/msg/TwistStamped); nobody '
        'publishes there')


@pytest.mark.parametrize(('count', 'who'), [(1, '1 publisher'), (2, '2 publishers')])
def test_who_is_there_is_asked_for_on_the_topic_to_which_a_source_was_remapped(
        graph, stranger, count, who):
    topic = f'/elsewhere_{count}'
    node = graph.filter_node(PLANE, '-r', f'fix:={topic}')
    for _ in range(count):
        stranger.create_publisher(Float64, topic, 1)
    graph.until(lambda: node.count_publishers(topic) == count, 'they are there')
    assert node.accounts.sources['main'].there() == (
        f'nothing on {topic} (geometry_msgs/msg/PointStamped); {who} there, of '
        'std_msgs/msg/Float64')


def test_a_silent_source_is_a_line_of_the_log_once_and_none_where_it_is_heard(graph, capfd):
    bare = Bare(graph)
    bare.node._health.tell()
    assert 'main: silent' not in capfd.readouterr().err
    bare.at(T + 4 * SECOND)
    bare.node._health.tell()
    bare.node._health.tell()
    said = capfd.readouterr().err
    assert said.count('main: silent for 4.0 s: nothing on /fix') == 1


def test_who_is_there_is_not_asked_while_a_source_is_heard(graph):
    bare = Bare(graph)
    bare.node.accounts.sources['main'].there = None
    bare.at(T + SECOND)
    assert bare.status().level == OK


def test_a_source_that_is_switched_off_may_be_silent_and_is_told_of_once(graph):
    bare = Bare(graph)
    bare.switch(False)
    for k in range(3):
        bare.at(T + 2 * k * SECOND)
        bare.hear('fix', fix(T + k))
    assert bare.status().values['rate'] == '0.5 Hz'
    bare.at(T + 20 * SECOND)
    assert (bare.status().level, bare.status().message) == (
        OK, 'disabled: 3 received, 0 accepted, 3 rejected (3 disabled), 0 dropped')
    assert bare.said == ['main: it is disabled: its measurements are counted, and not taken']
    assert bare.status().values['rejected, disabled'] == '3'
    bare.switch(True)
    assert bare.status().level == ERROR
    bare.hear('fix', fix(T + 20 * SECOND))
    bare.switch(False)
    bare.hear('fix', fix(T + 21 * SECOND))
    assert len(bare.said) == 2


@pytest.mark.parametrize(('frames', 'warnings'), [
    (('', 'map', ''), 0), (('map', 'odom', 'odom', 'base'), 1)], ids=['own', 'others'])
def test_positions_in_another_frame_are_taken_and_warned_of_once(graph, frames, warnings):
    bare = Bare(graph)
    bare.hear('fix', *(fix(T + k, frame) for k, frame in enumerate(frames)))
    assert len(bare.said) == warnings
    assert all("expected 'map'" in line and "got 'odom'" in line for line in bare.said)
    assert bare.node.accounts.sources['main'].rejected.total() == 0


def test_the_frame_of_what_is_no_place_is_nobodys_business(graph):
    bare = Bare(graph, {**PLANE, 'measurements.main.type': 'sensor_msgs/msg/JointState',
                        'measurements.main.fields': ['position']})
    message = JointState(position=[1.0, 2.0])
    message.header.frame_id = 'arm'
    stamp_into(message.header.stamp, T)
    bare.hear('fix', message)
    assert bare.said == [] and bare.node.inbox.has_work


@pytest.mark.parametrize(('sensor', 'angles', 'warnings'), [
    ('heading', (-2 * math.pi, 3.2, float(np.float32(2 * math.pi))), 0),
    ('heading', (3.2, 90.0, -180.0), 1), ('heading', (-6.3, 90.0), 1),
    # a distance may be anything
    ('range', (3.0, 90.0), 0)])
def test_an_angle_of_more_than_a_turn_is_taken_and_warned_of_once(
        graph, sensor, angles, warnings):
    bare = Bare(graph, {
        **YARD, 'measurements.main.sensor': sensor, 'measurements.main.fields': ['position'],
        'measurements.main.type': 'sensor_msgs/msg/JointState', 'filter.type': 'ekf',
        **({'measurements.main.params.landmark': [1.0, 2.0]} if sensor == 'range' else {})})
    for k, angle in enumerate(angles):
        message = JointState(position=[angle])
        stamp_into(message.header.stamp, T + k)
        bare.hear('fix', message)
    assert len(bare.said) == warnings
    assert all('radians' in line and re.search(r'got \[(90.0|-6.3)\]', line)
               for line in bare.said)
    bare.node.drain()
    account = bare.node.accounts.sources['main']
    assert (account.accepted, account.rejected.total()) == (len(angles), 0)


@pytest.mark.parametrize(('kind', 'path', 'words'), [
    ('PointStamped', 'point', []),
    ('PoseWithCovarianceStamped', 'pose.pose.position', ['main: pose.covariance is checked'])])
def test_a_covariance_that_comes_with_a_measurement_is_said_not_to_be_used(
        graph, capfd, kind, path, words):
    graph.filter_node({**PLANE, 'measurements.main.type': f'geometry_msgs/msg/{kind}',
                       'measurements.main.fields': [f'{path}.x', f'{path}.y']})
    assert re.findall(r'main: .* is checked(?=, not used)', capfd.readouterr().err) == words


def scan_of(values, low=0.1, high=30.0):
    """Return a scan of some distances."""
    message = LaserScan(range_min=low, range_max=high, ranges=values)
    stamp_into(message.header.stamp, T)
    return message


def beam(index):
    """Return a source that measures one distance of a scan."""
    return Source('beam', SourceConfig('scan', 'sensor_msgs/msg/LaserScan', (f'ranges[{index}]',)),
                  Sensor(lambda x, t: x[:1], np.eye(1)), 1.0)


@pytest.mark.parametrize(('value', 'reason'), [
    (math.inf, 'out of range'), (-math.inf, 'out of range'), (math.nan, 'not finite')])
@pytest.mark.parametrize('limits', [(0.1, 30.0), (0.0, 0.0), (0.1, math.inf)], ids=str)
def test_a_beam_without_a_return_is_out_of_range_and_an_error_is_not_finite(
        value, reason, limits):
    with pytest.raises(Refused) as refused:
        beam(0).item(scan_of([value], *limits), T)
    assert refused.value.reason == reason and f'{value:g}' in str(refused.value)


def test_beams_without_a_return_are_no_fault_of_the_scanner(graph):
    bare = Bare(graph, {
        **PLANE, 'measurements.main.type': 'sensor_msgs/msg/LaserScan',
        'measurements.main.fields': ['ranges[0]', 'ranges[1]']})
    bare.hear('fix', *[scan_of([3.0, math.inf])] * 9)
    found = bare.status()
    assert found.level == OK and found.values['rejected, out of range'] == '9'
    bare.hear('fix', *[scan_of([3.0, math.nan])] * 9)
    assert bare.status().level == ERROR


@pytest.mark.parametrize(('wrong', 'line'), [
    ({'type': 'geometry_msgs/msg/Pointed'}, 'measurements.main.type: '),
    ({'fields': ['point.x', 'point.w']}, 'measurements.main.fields: '),
    ({'topic': 'no name'}, 'measurements.main.topic: '),
    ({'topic': 'initialpose'}, 'measurements.main.topic: '),
    ({}, 'ArithmeticError: a kernel')], ids=str)
def test_a_source_that_cannot_be_is_refused_before_a_kernel_is_made(
        graph, monkeypatch, wrong, line):
    def kernel(*given):
        raise ArithmeticError('a kernel')

    monkeypatch.setattr(filters, 'step_kernel', kernel)
    with pytest.raises(ConfigError, match=f'^{line}'):
        graph.filter_node({**PLANE, **{f'measurements.main.{k}': v for k, v in wrong.items()}})


def test_an_array_that_is_too_short_is_told_with_the_path_and_its_length():
    with pytest.raises(Refused, match=r'^expected ranges\[500\], got an array that is too short: '
                                      'it has 360$') as refused:
        beam(500).item(scan_of([1.0] * 360), T)
    assert refused.value.reason == 'wrong length'
    assert beam(359).item(scan_of([1.0] * 360), T).values == (1.0,)


def test_of_unstamped_controls_within_one_tick_of_a_clock_the_last_one_holds(graph):
    bare = Bare(graph, {**YARD, 'control.type': 'geometry_msgs/msg/Twist',
                        'control.fields': ['linear.x', 'angular.z']})
    drive, stop = Twist(), Twist()
    drive.linear.x = 1.0
    bare.hear('fix', fix(T))
    bare.hear('control', drive, stop, drive, stop)
    graph.until(lambda: not bare.node.inbox.has_work, 'the work')
    still = bare.node.tracker.forecast(T + SECOND // 2).belief.mean()
    assert bare.node.accounts.control.accepted == 4
    # without a control the mean of a robot that only diffuses stays where it is
    assert still == pytest.approx(bare.node.tracker.newest.belief.mean(), abs=1e-3)


def test_what_has_no_stamp_holds_when_it_arrived_however_long_it_waited(graph):
    node = graph.filter_node({**PLANE, 'measurements.main.type': 'std_msgs/msg/Float64MultiArray',
                              'measurements.main.fields': []})
    [heard] = [s for s in node.subscriptions if s.topic_name == '/fix']
    arrived_ns = time.time_ns() - SECOND
    heard.callback(Float64MultiArray(data=[0.1, 0.2]),
                   {**INFO, 'received_timestamp': arrived_ns})
    node.drain()
    assert [m.stamp_ns for m in node.tracker.memory().measurements] == [arrived_ns]


def test_unstamped_controls_at_times_of_their_own_keep_them():
    source = ControlSource(ControlConfig('drive', 'geometry_msgs/msg/Twist',
                                         ('linear.x', 'angular.z')),
                           ('v', 'omega'), 1.0, lambda values, seconds: False)
    times = [T, T, T, T + 5, T + 5, T, T - SECOND]
    assert [source.item(Twist(), now).stamp_ns for now in times] == [
        T, T + 1, T + 2, T + 5, T + 6, T, T - SECOND]
