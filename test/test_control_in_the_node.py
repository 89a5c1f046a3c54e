"""What drives the model, in the node in this process."""

import math
import time

from geometry_msgs.msg import PointStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
import numpy as np
from pif_ros.config import build_tracker, Config, ConfigError
from pif_ros.core.estimates import Measurement
import pytest
from ros import DEEP, nanoseconds, Rig, SECOND, stamp_into
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

#: A time long ago, so that no stamp near it is ahead of the clock and no timer forecasts from it.
T = 1_000 * SECOND
MS = 1_000_000
INFO = {'publication_sequence_number': None}

YARD = {
    'model.name': 'unicycle_2d', 'model.params.sigma_position': 0.1, 'filter.type': 'ekf',
    'grid.lower': [-9.0, -9.0, -math.pi], 'grid.upper': [9.0, 9.0, math.pi],
    'grid.shape': [12, 12, 8], 'grid.periodic': [False, False, True],
    'prior.mean': [0.5, -0.5, 0.3], 'prior.covariance_diagonal': [1.0, 2.0, 0.2],
    'kernel.time_step': 0.1, 'publish.rate': 0.0, 'control.hold': 0.5, 'time.history': 2.0,
    'measurements.main.topic': 'fix', 'measurements.main.type': 'geometry_msgs/msg/PointStamped',
    'measurements.main.fields': ['point.x', 'point.y'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}
LOOSE = {**YARD, 'control.type': 'sensor_msgs/msg/JointState', 'control.fields': ['velocity']}
PLANE = {**{k: v for k, v in YARD.items() if 'sigma_p' not in k and 'control' not in k},
         'model.name': 'position_2d', 'grid.lower': [-9.0, -9.0], 'grid.upper': [9.0, 9.0],
         'grid.shape': [12, 12], 'grid.periodic': [False, False], 'prior.mean': [0.5, -0.5],
         'prior.covariance_diagonal': [1.0, 2.0]}

FIXES = [(T, (0.1, -0.2)), (T + 400 * MS, (0.4, 0.0)), (T + 1000 * MS, (0.9, 0.4))]
DRIVE = [(T - 50 * MS, (1.0, 0.3)), (T + 150 * MS, (1.5, -0.4)), (T + 350 * MS, (0.7, 0.9)),
         (T + 900 * MS, (1.2, 0.0))]


def fix(stamp_ns, values):
    """Return the message of a position."""
    message = PointStamped()
    stamp_into(message.header.stamp, stamp_ns)
    message.point.x, message.point.y = values
    return message


def twist(stamp_ns, values):
    """Return the message of a control."""
    message = TwistStamped()
    stamp_into(message.header.stamp, stamp_ns)
    message.twist.linear.x, message.twist.angular.z = values
    return message


def loose(stamp_ns, *values):
    """Return a message with any number of values."""
    message = JointState(velocity=values)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
    return message


def library(parameters=YARD, fixes=(), drive=()):
    """Return the library's tracker after some measurements and controls, in order."""
    tracker = build_tracker(Config.from_parameters(
        {k: v for k, v in parameters.items() if k != 'use_sim_time'}))
    for stamp_ns, values in fixes:
        assert tracker.observe(Measurement(stamp_ns, 'main', values)) is None
    for stamp_ns, values in drive:
        assert tracker.control(stamp_ns, values) is None
    return tracker


def settled(rig, fixes, controls):
    """Wait until so many of each are accounted for, and all of it is worked in."""
    for account, count in ((rig.node.accounts.sources['main'], fixes),
                           (rig.node.accounts.control, controls)):
        rig.graph.until(lambda account=account, count=count: account.accepted + account.dropped
                        + account.rejected.total() >= count, 'all of it is accounted for')
    rig.graph.until(lambda: not rig.node.inbox.has_work, 'all of it is worked in')
    check_balance(rig)


def check_balance(rig):
    """Check that received = accepted + rejected + dropped once nothing waits."""
    for account in (rig.node.accounts.sources['main'], rig.node.accounts.control):
        assert account.received == account.accepted + account.rejected.total() + account.dropped
    assert rig.node.faults == 0


def check_same(rig, tracker):
    """Check that a node believes what a tracker does, to the last bit."""
    found, expected = rig.node.tracker.estimate(), tracker.estimate()
    assert found.stamp_ns == expected.stamp_ns
    np.testing.assert_array_equal(found.belief.mean(), expected.belief.mean())
    np.testing.assert_array_equal(found.belief.covariance(), expected.belief.covariance())


@pytest.mark.parametrize('kind', ['ekf', 'ukf', 'particle'])
@pytest.mark.parametrize('late', [False, True])
def test_whatever_comes_first_the_belief_is_that_of_arrival_in_order(graph, kind, late):
    parameters = {**YARD, 'filter.type': kind}
    rig = Rig(graph, parameters)
    parts = [[('control', twist, item) for item in DRIVE], [('fix', fix, item) for item in FIXES]]
    for part in parts[::-1] if late else parts:
        for topic, message, item in part:
            rig.send(topic, message(*item))
        if late:
            graph.until(lambda: not rig.node.inbox.has_work and rig.node.tracker.stamp_ns, 'work')
    settled(rig, len(FIXES), len(DRIVE))
    check_same(rig, library(parameters, FIXES, DRIVE))
    undriven = library(parameters, FIXES).estimate().belief.mean()
    # a second at about a metre per second
    assert np.abs(rig.node.tracker.estimate().belief.mean() - undriven).max() > 0.1
    assert rig.node.accounts.control.accepted == len(DRIVE)


def test_a_control_alone_publishes_nothing_and_is_seen_in_the_next_pose(graph):
    rig = Rig(graph, YARD)
    for item in FIXES[:2]:
        rig.send('fix', fix(*item))
        rig.pose_at(item[0])
    poses = len(rig.poses)
    for item in DRIVE:
        rig.send('control', twist(*item))
    settled(rig, 2, len(DRIVE))
    rig.send('fix', fix(*FIXES[2]))
    rig.pose_at(FIXES[2][0])
    assert len(rig.poses) == poses + 1
    expected = library(YARD, FIXES, DRIVE).estimate().belief.mean()
    position = rig.poses[-1].pose.pose.position
    assert (position.x, position.y) == (expected[0], expected[1])


def test_a_forecast_drives_on_for_as_long_as_the_control_holds(graph):
    parameters = {**YARD, 'use_sim_time': True, 'publish.rate': 10.0}
    rig = Rig(graph, parameters)
    rig.tick(T)
    rig.send('fix', fix(*FIXES[0]))
    rig.pose_at(T)
    rig.send('control', twist(T, (2.0, 0.0)))
    settled(rig, 1, 1)
    twin = library(parameters, FIXES[:1], [(T, (2.0, 0.0))])
    for ahead in (300 * MS, SECOND, 2 * SECOND):
        rig.tick(T + ahead)
        found = rig.pose_at(T + ahead).pose.pose.position
        expected = twin.forecast(T + ahead).belief.mean()
        assert (found.x, found.y) == (expected[0], expected[1])
    stopped = [twin.forecast(T + ahead).belief.mean() for ahead in (500 * MS, 2 * SECOND)]
    # what holds for half a second takes it no further
    np.testing.assert_allclose(stopped[0], stopped[1], atol=1e-12)


def test_the_twist_of_an_odometry_drives_too(graph):
    rig = Rig(graph, {**YARD, 'control.topic': 'odom', 'control.type': 'nav_msgs/msg/Odometry',
                      'control.fields': ['twist.twist.linear.x', 'twist.twist.angular.z']})
    for stamp_ns, (v, omega) in DRIVE:
        message = Odometry()
        stamp_into(message.header.stamp, stamp_ns)
        message.twist.twist.linear.x, message.twist.twist.angular.z = v, omega
        rig.send('odom', message)
    settled(rig, 0, len(DRIVE))
    for item in FIXES:
        rig.send('fix', fix(*item))
    settled(rig, len(FIXES), len(DRIVE))
    check_same(rig, library(YARD, FIXES, DRIVE))


def test_a_control_without_a_header_holds_from_its_arrival(graph):
    rig = Rig(graph, {**YARD, 'control.type': 'geometry_msgs/msg/Twist',
                      'control.fields': ['linear.x', 'angular.z']})
    message = Twist()
    message.linear.x, message.angular.z = 1.0, 0.5
    before = time.time_ns()
    rig.send('control', message)
    settled(rig, 0, 1)
    [(stamp_ns, values)] = rig.node.tracker.memory().controls
    assert before <= stamp_ns <= time.time_ns() and values == (1.0, 0.5)


BAD = {
    'nan': (lambda: loose(T + SECOND, 0.1, float('nan')), 'not finite', 'nan'),
    'too short': (lambda: loose(T + SECOND, 0.1), 'wrong length', 'got 1'),
    'too long': (lambda: loose(T + SECOND, 0.1, 0.2, 0.3), 'wrong length', 'got 3'),
    'too fast': (lambda: loose(T + SECOND, 1e6, 0.0), 'too fast', 'kernel.time_step'),
    'zero stamp': (lambda: loose(0, 0.1, 0.2), 'no stamp', 'got 0.0 s'),
    'future': (lambda: loose(time.time_ns() + 100 * SECOND, 0.1, 0.2), 'from the future',
               'time.max_ahead'),
    'beyond the history': (lambda: loose(T - 5 * SECOND, 0.1, 0.2), 'too late', '6.000 s behind'),
    'duplicate': (lambda: loose(T + 150 * MS, 1.5, -0.4), 'duplicate', 'duplicate'),
    'less of its stamp': (lambda: loose(T + 150 * MS, 1.4, 9.0), 'duplicate', 'duplicate')}


@pytest.mark.parametrize('kind', BAD)
def test_what_is_no_control_gets_its_line_and_its_count_and_changes_nothing(graph, kind):
    make, reason, word = BAD[kind]
    rig = Rig(graph, LOOSE)
    for stamp_ns, values in DRIVE:
        rig.send('control', loose(stamp_ns, *values))
    for item in FIXES:
        rig.send('fix', fix(*item))
    settled(rig, len(FIXES), len(DRIVE))
    rig.send('control', make())
    settled(rig, len(FIXES), len(DRIVE) + 1)
    account = rig.node.accounts.control
    assert (account.rejected, account.accepted) == ({reason: 1}, len(DRIVE))
    assert '\n' not in rig.line('control: rejected a control', word)
    check_same(rig, library(LOOSE, FIXES, DRIVE))


def test_a_full_queue_drops_the_oldest_control_or_measurement_and_counts_it_where_it_came_from(
        graph):
    rig = Rig(graph, {**YARD, 'measurements.queue_length': 3})
    heard = {s.topic_name: s.callback for s in rig.node.subscriptions}
    for item in DRIVE[:2]:
        heard['/control'](twist(*item), INFO)
    for item in FIXES:
        heard['/fix'](fix(*item), INFO)
    heard['/control'](twist(*DRIVE[3]), INFO)
    assert rig.node.accounts.control.dropped == 2
    assert rig.node.accounts.sources['main'].dropped == 1
    rig.line('control: dropped the oldest control')
    settled(rig, 3, 3)
    check_same(rig, library(YARD, FIXES[1:], DRIVE[3:]))


def test_controls_that_the_queue_in_dds_drops_are_counted_as_lost(graph):
    rig = Rig(graph, {**YARD, 'measurements.queue_length': 10})
    rig.send('control', twist(T, (1.0, 0.0)))
    settled(rig, 0, 1)
    for i in range(1, 101):
        rig.send('control', twist(T + i * MS, (1.0, 0.0)))
    account = rig.node.accounts.control
    graph.until(lambda: account.received + account.lost == 101, 'all of them')
    settled(rig, 0, account.received)
    assert account.lost > 0 and account.accepted == account.received


def test_a_reset_and_a_clock_that_jumps_back_forget_the_controls(graph):
    rig = Rig(graph, {**YARD, 'use_sim_time': True})
    for count, forget in enumerate((
            lambda: graph.call(rig.client(Trigger, '/filter_node/reset'), Trigger.Request()),
            lambda: rig.tick(T - 60 * SECOND)), 1):
        rig.tick(T)
        rig.send('control', twist(T, (1.0, 0.0)))
        settled(rig, 0, count)
        assert len(rig.node.tracker.memory().controls) == 1
        forget()
        assert not rig.node.tracker.memory().controls


def test_a_control_before_the_first_clock_is_refused(graph):
    rig = Rig(graph, {**YARD, 'use_sim_time': True})
    rig.send('control', twist(T, (1.0, 0.0)))
    settled(rig, 0, 1)
    assert rig.node.accounts.control.rejected == {'no clock': 1}


def test_the_accounts_tell_of_controls_where_the_model_has_inputs(graph):
    steered = graph.filter_node(YARD)
    assert 'control: 0 received, 0 accepted, 0 rejected, 0 dropped' in str(steered.accounts)
    [heard] = [s for s in steered.subscriptions if s.topic_name == '/control']
    assert heard.qos_profile.reliability.name == 'BEST_EFFORT'


def test_a_model_without_inputs_hears_no_control(graph):
    plain = graph.filter_node(PLANE)
    assert 'control' not in str(plain.accounts)
    assert not [s for s in plain.subscriptions if s.topic_name == '/control']


@pytest.mark.parametrize(('parameters', 'line'), [
    ({**PLANE, 'control.topic': 'cmd_vel'},
     "control.topic: expected 'control' where the model has no inputs (position_2d), "
     "got 'cmd_vel'"),
    ({**YARD, 'control.fields': ['twist.linear.x']},
     "control.fields: expected fields that hold 2 numbers, got ['twist.linear.x'] for v, omega"),
    ({**YARD, 'control.fields': ['twist.linear.x', 'twist.angular.w']}, 'control.fields: expected '
     "fields out of x, y, z, got 'twist.angular.w'"),
    ({**YARD, 'control.type': 'Twist'}, 'control.type: expected a message type such as '),
    ({**YARD, 'control.topic': 'not a name'}, 'control.topic: expected a topic for messages of '),
    ({**YARD, 'control.topic': 'fix'}, 'measurements.main.topic: expected a topic for messages of '
     "type PointStamped, got 'fix' (its messages are of type TwistStamped)"),
    ({**YARD, 'control.hold': 0.0}, 'control.hold: expected a positive number up to 1e9, got 0.0'),
    ({**YARD, 'filter.type': 'dfy'}, 'filter.type: expected one that takes the inputs of '
     "unicycle_2d (v, omega), got 'dfy'")])
def test_what_cannot_drive_is_refused_in_one_line(graph, parameters, line):
    with pytest.raises(ConfigError) as refused:
        graph.filter_node(parameters)
    assert str(refused.value).startswith(line) and '\n' not in str(refused.value)


def test_stamps_of_published_poses_never_go_back_while_controls_are_replayed(graph):
    rig = Rig(graph, YARD)
    rng = np.random.default_rng(3)
    for k in range(30):
        rig.send('fix', fix(T + k * 100 * MS, rng.normal(size=2)), DEEP)
        rig.send('control', twist(T + k * 100 * MS - 90 * MS, rng.normal(size=2)))
    settled(rig, 30, 30)
    rig.pose_at(T + 2900 * MS)
    assert rig.stamps == sorted(rig.stamps)
    assert nanoseconds(rig.poses[-1].header.stamp) == T + 2900 * MS
