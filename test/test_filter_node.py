"""The node in this process: what goes in, what comes out, and what nothing can upset."""

import math
import time
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovariance, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.testing import assert_allclose
from pif_ros import conversions, inbox, interface, pace, timekeeper
from pif_ros.config import build_tracker, Config, specifications
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import position_2d, position_sensor
from pif_ros.core.tracker import Tracker
import pytest
from rcl_interfaces.msg import Log
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.clock import ClockType
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros import DEEP, nanoseconds, PLANE, Rig, SECOND, stamp_into
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Empty, Trigger

#: A time long ago, so that no stamp near it is ahead of the clock and no timer forecasts from it.
T = 1_000 * SECOND
MS = 1_000_000
INFO = {'publication_sequence_number': None}

#: The same from messages that may hold any number of values.
LOOSE = {**PLANE, 'measurements.main.type': 'sensor_msgs/msg/JointState',
         'measurements.main.fields': ['position']}
SIMULATED = {**PLANE, 'use_sim_time': True, 'publish.rate': 10.0}
TRACK = [(0, 0.1, -0.2), (70, 0.3, 0.0), (200, -0.1, 0.4), (333, 0.4, 0.9), (500, 0.6, 1.1)]


def fix(stamp_ns, x, y):
    """Return the message of a position."""
    message = PointStamped()
    stamp_into(message.header.stamp, stamp_ns)
    message.point.x, message.point.y = x, y
    return message


def loose(stamp_ns, *values):
    """Return a message with any number of values."""
    message = JointState(position=values)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
    return message


def start(x=0.5, y=0.5, variances=(0.25, 0.25), covariance_xy=0.0, stamp_ns=T, frame='map'):
    """Return a pose to start from."""
    message = PoseWithCovarianceStamped()
    stamp_into(message.header.stamp, stamp_ns)
    message.header.frame_id = frame
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.covariance[0], message.pose.covariance[7] = variances
    message.pose.covariance[1] = message.pose.covariance[6] = covariance_xy
    return message


def library(parameters=PLANE, measurements=()):
    """Return the library's tracker after some measurements of the source main."""
    tracker = build_tracker(Config.from_parameters(
        {k: v for k, v in parameters.items() if k != 'use_sim_time'}))
    for stamp_ns, *values in measurements:
        assert tracker.observe(Measurement(stamp_ns, 'main', tuple(values))) is None
    return tracker


def track(count=len(TRACK)):
    """Return stamps and positions of the first measurements."""
    return [(T + ms * MS, x, y) for ms, x, y in TRACK[:count]]


def follow(rig, measurements, message=fix):
    """Measure, and wait after each until it is accounted for and published."""
    for stamp_ns, *values in measurements:
        before = rig.node.accounts.sources['main'].received
        rig.send('fix', message(stamp_ns, *values))
        rig.handled(before + 1)
        rig.pose_at(stamp_ns)


def belief(rig):
    """Return what the node believes after its newest measurement."""
    return rig.node.tracker.estimate().belief


def check_same(found, expected):
    """Check that two beliefs are the same to the last bit."""
    assert found.grid == expected.grid
    assert found.density.tobytes() == expected.density.tobytes()


def check_pose(message, estimate, frame='map'):
    """Check that a pose in the plane is that of an estimate to the last bit."""
    assert nanoseconds(message.header.stamp) == estimate.stamp_ns
    assert message.header.frame_id == frame
    x, y = estimate.belief.mean()
    position, orientation = message.pose.pose.position, message.pose.pose.orientation
    assert (position.x, position.y, position.z) == (x, y, 0.0)
    assert (orientation.x, orientation.y, orientation.z, orientation.w) == (0.0, 0.0, 0.0, 1.0)
    expected = np.zeros((6, 6))
    expected[:2, :2] = estimate.belief.covariance()
    assert np.array(message.pose.covariance).tobytes() == expected.tobytes()


def check_healthy(rig):
    """Check that the belief is a density, and that every measurement is accounted for."""
    found = belief(rig)
    assert np.all(np.isfinite(found.density)) and np.all(found.density >= 0)
    assert abs(math.fsum(found.density.ravel()) * found.grid.cell_volume - 1) <= 1e-9
    check_balance(rig)
    assert rig.node.faults == 0


def check_balance(rig):
    """Check that received = accepted + rejected + dropped + queued."""
    queued = len(rig.node.inbox.queue)
    accounts = rig.node.accounts.sources.values()
    assert sum(a.received for a in accounts) == queued + sum(
        a.accepted + a.rejected.total() + a.dropped for a in accounts)
    if not queued:
        for a in accounts:
            assert a.received == a.accepted + a.rejected.total() + a.dropped


# Topics and services


TOPICS = {
    '~/pose': ('geometry_msgs/msg/PoseWithCovarianceStamped', 'RELIABLE', 'VOLATILE'),
    '~/pose_unstamped': ('geometry_msgs/msg/PoseWithCovariance', 'RELIABLE', 'VOLATILE'),
    '~/density': ('std_msgs/msg/Float64MultiArray', 'RELIABLE', 'VOLATILE'),
    '~/density_map': ('nav_msgs/msg/OccupancyGrid', 'RELIABLE', 'TRANSIENT_LOCAL'),
    '~/modes': ('std_msgs/msg/Float64MultiArray', 'RELIABLE', 'VOLATILE'),
    '~/markers': ('visualization_msgs/msg/MarkerArray', 'RELIABLE', 'VOLATILE'),
    '/diagnostics': ('diagnostic_msgs/msg/DiagnosticArray', 'RELIABLE', 'VOLATILE')}
HEARD = {
    'initialpose': ('geometry_msgs/msg/PoseWithCovarianceStamped', 'RELIABLE', 'VOLATILE'),
    'fix': ('geometry_msgs/msg/PointStamped', 'BEST_EFFORT', 'VOLATILE')}
SERVICES = {'~/reset': 'std_srvs/srv/Trigger', '~/save_state': 'std_srvs/srv/Trigger',
            '~/load_state': 'std_srvs/srv/Trigger',
            'reinitialize_global_localization': 'std_srvs/srv/Empty'}


@pytest.mark.parametrize(('arguments', 'space', 'name'), [
    ((), '/', 'filter_node'),
    (('-r', '__node:=left'), '/', 'left'),
    (('-r', '__node:=left', '-r', '__ns:=/robot'), '/robot', 'left')])
def test_topics_and_services_are_those_of_the_contract(graph, arguments, space, name):
    full = f'{space.rstrip("/")}/{name}'
    rig = Rig(graph, PLANE, *arguments, name=full)

    def resolved(topic):
        if topic.startswith('/'):
            return topic
        return topic.replace('~', full) if '~' in topic else f'{space.rstrip("/")}/{topic}'

    for contract, infos_of in ((TOPICS, rig.peer.get_publishers_info_by_topic),
                               (HEARD, rig.peer.get_subscriptions_info_by_topic)):
        for topic, expected in contract.items():
            # one, also when the node of the test before is forgotten
            [info] = graph.until(lambda: len(found := infos_of(resolved(topic))) == 1 and found,
                                 f'{topic} is known')
            assert (info.node_namespace, info.node_name) == (space, name)
            assert (info.topic_type, info.qos_profile.reliability.name,
                    info.qos_profile.durability.name) == expected
    published = {resolved(topic) for topic in TOPICS} | {
        '/parameter_events', '/rosout', resolved('~/transition_event')}
    graph.until(lambda: published == {
        topic for topic, _ in rig.peer.get_publisher_names_and_types_by_node(name, space)},
        f'it publishes {published}')
    offered = dict(rig.peer.get_service_names_and_types_by_node(name, space))
    for service, kind in SERVICES.items():
        assert offered.pop(resolved(service)) == [kind]
    assert all(kind.split('/')[0] in (
        'rcl_interfaces', 'type_description_interfaces', 'lifecycle_msgs')
               for [kind] in offered.values())


def test_the_table_of_the_interface_has_what_the_node_has():
    assert {out.name: out.type_name for out in interface.PUBLICATIONS} == {
        name: kind for name, (kind, *_) in TOPICS.items()}
    assert {it.name: it.type_name for it in interface.SUBSCRIPTIONS} == {
        'initialpose': HEARD['initialpose'][0]}
    assert {it.name: it.type_name for it in interface.SERVICES} == SERVICES


def test_two_nodes_with_two_names_do_not_collide(graph):
    left = Rig(graph, PLANE, '-r', '__node:=left', '-r', 'fix:=left_fix', name='/left')
    right = graph.filter_node(PLANE, '-r', '__node:=right')
    left.send('left_fix', fix(T, 0.0, 0.0))
    left.pose_at(T)
    assert left.node.accounts.sources['main'].accepted == 1
    assert right.accounts.sources['main'].received == 0
    assert right.tracker.stamp_ns is None


@pytest.mark.parametrize('reliability', ['RELIABLE', 'BEST_EFFORT'])
@pytest.mark.parametrize('durability', ['VOLATILE', 'TRANSIENT_LOCAL'])
def test_every_kind_of_publisher_is_heard(graph, reliability, durability):
    rig = Rig(graph, PLANE)
    rig.send('fix', fix(T, 0.0, 0.0), QoSProfile(
        depth=10, reliability=ReliabilityPolicy[reliability],
        durability=DurabilityPolicy[durability]))
    rig.pose_at(T)


# Measurements


def test_every_pose_is_that_of_a_tracker_put_together_by_hand_to_the_last_bit(graph):
    rig = Rig(graph, PLANE)
    grid = Grid((-3.0, -4.0), (3.0, 4.0), (20, 24))
    tracker = Tracker(
        DiracFeynmanFilter(position_2d(0.5).model, grid, {'main': position_sensor(0.3)},
                           KernelSettings(0.1, form='auto')),
        GridBelief.gaussian(grid, [0.5, -0.5], np.diag([1.0, 2.0])))
    for count, (stamp_ns, x, y) in enumerate(track(), 1):
        follow(rig, [(stamp_ns, x, y)])
        tracker.observe(Measurement(stamp_ns, 'main', (x, y)))
        assert len(rig.poses) == count
        check_pose(rig.poses[-1], tracker.estimate())
    check_same(belief(rig), tracker.estimate().belief)
    check_healthy(rig)
    assert rig.node.accounts.sources['main'].accepted == len(TRACK)


@pytest.mark.parametrize('order', [[4, 3, 2, 1, 0], [2, 0, 4, 1, 3], [0, 4, 1, 2, 3]])
def test_late_measurements_are_put_where_they_belong_to_the_last_bit(graph, order):
    rig = Rig(graph, PLANE)
    in_order = track()
    for count, place in enumerate(order, 1):
        rig.send('fix', fix(*in_order[place]))
        graph.until(lambda: len(rig.poses) == count, 'a pose')
    expected = library(measurements=in_order)
    check_same(belief(rig), expected.estimate().belief)
    check_pose(rig.poses[-1], expected.estimate())
    assert rig.stamps == sorted(rig.stamps)
    check_healthy(rig)


def test_several_sources_of_several_types_make_one_belief(graph):
    parameters = {
        **PLANE, 'measurements.names': ['main', 'tower', 'mast'],
        'measurements.tower.topic': 'tower/range', 'measurements.tower.sensor': 'range',
        'measurements.tower.type': 'sensor_msgs/msg/Range', 'measurements.tower.fields': ['range'],
        'measurements.tower.params.landmark': [3.0, 4.0], 'measurements.tower.params.sigma': 0.5,
        'measurements.mast.topic': 'mast', 'measurements.mast.sensor': 'bearing',
        'measurements.mast.type': 'sensor_msgs/msg/JointState',
        'measurements.mast.fields': ['position[1]'],
        'measurements.mast.params.landmark': [-3.0, 4.0], 'measurements.mast.params.sigma': 0.1}
    rig = Rig(graph, parameters)
    seen = Range(range=4.25)
    stamp_into(seen.header.stamp, T + 100 * MS)
    rig.send('fix', fix(T, 0.25, -0.5))
    rig.pose_at(T)
    rig.send('tower/range', seen)
    rig.pose_at(T + 100 * MS)
    rig.send('mast', loose(T + 250 * MS, 9.0, 2.5))
    rig.pose_at(T + 250 * MS)
    twin = library(parameters)
    for measurement in (Measurement(T, 'main', (0.25, -0.5)),
                        Measurement(T + 100 * MS, 'tower', (4.25,)),
                        Measurement(T + 250 * MS, 'mast', (2.5,))):
        twin.observe(measurement)
    check_pose(rig.poses[-1], twin.estimate())
    assert {name: a.accepted for name, a in rig.node.accounts.sources.items()} == {
        'main': 1, 'tower': 1, 'mast': 1}
    check_healthy(rig)


def test_a_message_without_a_header_is_stamped_at_its_arrival(graph):
    parameters = {**PLANE, 'measurements.main.type': 'std_msgs/msg/Float64MultiArray',
                  'measurements.main.fields': []}
    rig = Rig(graph, parameters)
    before = time.time_ns()
    rig.send('fix', Float64MultiArray(data=[0.25, 0.75]))
    pose = rig.pose_at(before)
    stamp_ns = nanoseconds(pose.header.stamp)
    assert stamp_ns <= time.time_ns()
    check_pose(pose, library(parameters, [(stamp_ns, 0.25, 0.75)]).estimate())


# Measurements that are none


BAD = {
    'nan': (lambda: loose(T + SECOND, 0.1, float('nan')), 'not finite', 'nan'),
    'inf': (lambda: loose(T + SECOND, float('inf'), 0.0), 'not finite', 'inf'),
    '-inf': (lambda: loose(T + SECOND, 0.0, -float('inf')), 'not finite', '-inf'),
    'too short': (lambda: loose(T + SECOND, 0.1), 'wrong length', 'got 1'),
    'too long': (lambda: loose(T + SECOND, 0.1, 0.2, 0.3), 'wrong length', 'got 3'),
    'empty': (lambda: loose(T + SECOND), 'wrong length', 'got 0'),
    'zero stamp': (lambda: loose(0, 0.1, 0.2), 'no stamp', 'got 0.0 s'),
    'negative stamp': (lambda: loose(-7 * SECOND, 0.1, 0.2), 'no stamp', '-7.0 s'),
    'future': (lambda: loose(time.time_ns() + 100 * SECOND, 0.1, 0.2), 'from the future',
               'time.max_ahead'),
    'before the first': (lambda: loose(T - 1, 0.1, 0.2), 'too late', '0.500 s behind'),
    'beyond the history': (lambda: loose(T - 2 * SECOND, 0.1, 0.2), 'too late', '2.500 s behind'),
    'duplicate': (lambda: loose(T + 70 * MS, 0.3, 0.0), 'duplicate', 'duplicate')}


@pytest.mark.parametrize('kind', BAD)
def test_what_is_no_measurement_gets_its_line_and_its_count_and_changes_nothing(graph, kind):
    make, reason, word = BAD[kind]
    rig = Rig(graph, {**LOOSE, 'time.history': 0.6 if kind != 'before the first' else 5.0})
    if kind == 'before the first':
        # what holds at the first measurement cannot be known before it
        rig.send('initialpose', start(stamp_ns=T))
        rig.pose_at(T)
    follow(rig, track(), loose)
    before, poses = belief(rig), len(rig.poses)
    account = rig.node.accounts.sources['main']
    rig.send('fix', make())
    rig.handled(len(TRACK) + 1)
    assert account.rejected == {reason: 1}
    line = rig.line('main: rejected a measurement', word)
    assert '\n' not in line
    check_same(belief(rig), before)
    check_healthy(rig)
    # and the next good one finds a belief that never knew of it
    follow(rig, [(T + 600 * MS, 0.5, 1.0)], loose)
    assert len(rig.poses) == poses + 1
    if kind != 'before the first':
        check_same(belief(rig), library(
            LOOSE, [*track(), (T + 600 * MS, 0.5, 1.0)]).estimate().belief)
    assert (account.accepted, account.received) == (len(TRACK) + 1, len(TRACK) + 2)
    check_healthy(rig)


def test_all_of_them_in_a_row_leave_a_belief_that_never_saw_them(graph):
    rig = Rig(graph, LOOSE)
    bad = [make for kind, (make, *_) in BAD.items()
           if kind not in ('before the first', 'duplicate')]
    sent = 0
    for stamp_ns, x, y in track():
        rig.send('fix', loose(stamp_ns, x, y))
        rig.send('fix', loose(stamp_ns, x, y))
        for make in bad:
            rig.send('fix', make())
        sent += len(bad) + 2
        rig.handled(sent)
        check_balance(rig)
    check_same(belief(rig), library(LOOSE, track()).estimate().belief)
    account = rig.node.accounts.sources['main']
    assert account.accepted == len(TRACK)
    assert account.rejected == {'not finite': 15, 'wrong length': 15, 'no stamp': 10,
                                'from the future': 5, 'duplicate': 5, 'too late': 5}
    assert account.rejected.total() == sent - len(TRACK)
    check_healthy(rig)


def test_like_lines_do_not_flood_the_log(graph):
    rig = Rig(graph, LOOSE)
    for _ in range(50):
        rig.send('fix', loose(T, float('nan'), 0.0))
    rig.handled(50)
    rig.line('finite', 'nan')
    rig.send('fix', loose(T, 0.0))
    rig.line('expected 2 numbers')
    assert sum('nan' in line for line in rig.lines) <= 2
    assert rig.node.accounts.sources['main'].rejected == {'not finite': 50, 'wrong length': 1}


def test_an_outlier_of_fifty_standard_deviations_is_told_and_counted_and_survived(graph):
    rig = Rig(graph, PLANE)
    sure = [(T + i * MS, 0.5, -0.5) for i in range(20)]
    follow(rig, sure)
    spread = math.sqrt(belief(rig).covariance()[0, 0])
    outlier = (T + 30 * MS, 0.5 + 50 * 0.3, -0.5)
    assert outlier[1] - 0.5 > 50 * spread
    follow(rig, [outlier])
    rig.line('main', 'standard deviations', 'believed')
    account = rig.node.accounts.sources['main']
    assert (account.accepted, account.outliers, account.rejected.total()) == (21, 1, 0)
    check_same(belief(rig), library(measurements=[*sure, outlier]).estimate().belief)
    check_healthy(rig)
    follow(rig, [(T + 40 * MS + i * MS, 0.0, 0.5) for i in range(20)])
    assert_allclose(belief(rig).mean(), [0.0, 0.5], atol=0.5)
    check_healthy(rig)


def test_a_measurement_that_no_state_allows_is_rejected_and_changes_nothing(graph):
    rig = Rig(graph, PLANE)
    sure = [(T + i * MS, 0.5, -0.5) for i in range(20)]
    # its square is no number any more
    impossible = (T + 20 * MS, 1e200, -0.5)
    follow(rig, [*sure, impossible])
    rig.line('main', 'rejected', 'no state of the belief')
    account = rig.node.accounts.sources['main']
    assert (account.accepted, account.outliers, account.rejected) == (20, 0, {'off the grid': 1})
    check_same(belief(rig), library(measurements=[*sure, impossible]).estimate().belief)
    assert_allclose(belief(rig).mean(), [0.5, -0.5], atol=0.1)
    check_healthy(rig)


def test_an_ordinary_measurement_is_no_outlier(graph):
    rig = Rig(graph, PLANE)
    rng = np.random.default_rng(5)
    follow(rig, [(T + i * 20 * MS, *rng.normal([0.5, -0.5], 0.3)) for i in range(100)])
    assert rig.node.accounts.sources['main'].outliers == 0
    assert not any('believed' in line for line in rig.lines)


# Restarts


def test_an_initial_pose_restarts_the_belief_there_and_publishes_it(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track())
    later = T + 2 * SECOND
    rig.send('initialpose', start(1.0, -2.0, (0.5, 0.75), 0.25, later))
    pose = rig.pose_at(later)
    expected = GridBelief.gaussian(rig.node.tracker.prior.grid, [1.0, -2.0],
                                   [[0.5, 0.25], [0.25, 0.75]])
    check_same(belief(rig), expected)
    assert nanoseconds(pose.header.stamp) == later
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == tuple(expected.mean())
    rig.send('fix', fix(later - 1, 0.0, 0.0))
    rig.line('too late')
    follow(rig, [(later + 300 * MS, 1.2, -1.8)])
    twin = library()
    twin.reset(expected, later)
    twin.observe(Measurement(later + 300 * MS, 'main', (1.2, -1.8)))
    check_same(belief(rig), twin.estimate().belief)
    assert rig.node.accounts.initial_pose.accepted == 1
    check_healthy(rig)


@pytest.mark.parametrize('stamp_ns', [0, -3 * SECOND])
@pytest.mark.parametrize('frame', ['', 'map'])
def test_an_initial_pose_without_a_time_holds_now(graph, stamp_ns, frame):
    rig = Rig(graph, PLANE)
    message = start(frame=frame)
    message.header.stamp.sec = stamp_ns // SECOND
    message.header.stamp.nanosec = 0
    before = time.time_ns()
    rig.send('initialpose', message)
    rig.pose_at(before)
    assert before <= rig.stamps[0] <= time.time_ns()


def test_an_initial_pose_of_the_future_holds_now(graph):
    rig = Rig(graph, PLANE)
    rig.send('initialpose', start(stamp_ns=time.time_ns() + 50 * SECOND))
    rig.pose_at(1)
    assert rig.stamps[0] <= time.time_ns()


NO_START = {
    'indefinite': (start(covariance_xy=0.5), 'positive definite', 'bad covariance'),
    'negative': (start(variances=(-0.25, 0.25)), 'positive definite', 'bad covariance'),
    'zero': (start(variances=(0.0, 0.0)), 'positive definite', 'bad covariance'),
    'nan covariance': (start(variances=(float('nan'), 0.25)), 'finite', 'not finite'),
    'infinite covariance': (start(variances=(0.25, float('inf'))), 'finite', 'not finite'),
    'nan position': (start(x=float('nan')), 'finite', 'not finite'),
    'infinite position': (start(y=-float('inf')), 'finite', 'not finite'),
    'off grid': (start(x=3.5), 'on the grid', 'off the grid'),
    'other frame': (start(frame='odom'), "'odom'", 'other frame'),
}


@pytest.mark.parametrize('kind', NO_START)
def test_an_initial_pose_that_is_none_gets_its_line_and_its_count_and_changes_nothing(graph, kind):
    message, word, reason = NO_START[kind]
    rig = Rig(graph, PLANE)
    follow(rig, track())
    before, account = belief(rig), rig.node.accounts.initial_pose
    rig.send('initialpose', message)
    line = rig.line('initialpose: ', 'expected', word)
    assert '\n' not in line
    assert (account.received, account.accepted, account.rejected) == (1, 0, {reason: 1})
    check_same(belief(rig), before)
    assert rig.node.tracker.stamp_ns == track()[-1][0]
    follow(rig, [(T + 600 * MS, 0.5, 1.0)])
    check_same(belief(rig), library(
        measurements=[*track(), (T + 600 * MS, 0.5, 1.0)]).estimate().belief)
    check_healthy(rig)


def test_an_initial_pose_that_is_not_symmetric_is_refused(graph):
    rig = Rig(graph, PLANE)
    message = start(covariance_xy=0.1)
    message.pose.covariance[6] = -0.1
    rig.send('initialpose', message)
    rig.line('initialpose', 'symmetric')
    assert rig.node.tracker.stamp_ns is None


def test_a_reset_goes_back_to_the_prior_which_holds_at_the_next_measurement(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track())
    answer = graph.call(rig.client(Trigger, '/filter_node/reset'), Trigger.Request())
    assert answer.success and answer.message
    check_same(belief(rig), library().prior)
    assert rig.node.tracker.stamp_ns is None
    poses = len(rig.poses)
    again = [(T + 10 * SECOND, 0.2, 0.2), (T + 10 * SECOND + 50 * MS, 0.1, 0.3)]
    follow(rig, again)
    check_same(belief(rig), library(measurements=again).estimate().belief)
    assert len(rig.poses) == poses + 2
    check_healthy(rig)


def test_after_a_reset_an_older_recording_may_be_played_but_stamps_do_not_go_back(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track())
    graph.call(rig.client(Trigger, '/filter_node/reset'), Trigger.Request())
    older = T - 100 * MS
    rig.send('fix', fix(older, 0.2, 0.2))
    graph.until(lambda: len(rig.poses) == len(TRACK) + 1, 'a pose')
    check_same(belief(rig), library(measurements=[(older, 0.2, 0.2)]).estimate().belief)
    newest = track()[-1][0]
    assert rig.stamps[-2:] == [newest, newest]
    check_pose(rig.poses[-1], library(measurements=[(older, 0.2, 0.2)]).forecast(newest))


def test_global_localization_spreads_the_belief_over_the_grid(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track())
    client = rig.client(Empty, '/reinitialize_global_localization')
    assert graph.call(client, Empty.Request()) is not None
    found = belief(rig)
    assert_allclose(found.density, 1 / (6.0 * 8.0), rtol=1e-12)  # all of [-3, 3] x [-4, 4]
    follow(rig, [(T + 9 * SECOND, 1.0, 2.0)])
    assert_allclose(belief(rig).mean(), [1.0, 2.0], atol=0.02)
    check_healthy(rig)


def test_what_would_make_all_of_a_world_that_does_not_fit_is_refused_in_a_line(
        graph, monkeypatch):
    rig = Rig(graph, {**PLANE, 'region.kind': 'active', 'grid.shape': [2000, 2000],
                      'grid.lower': [-300.0, -300.0], 'grid.upper': [300.0, 300.0]})
    follow(rig, track())
    before = rig.node.tracker.newest
    # four million cells are 1.28 GB at work
    monkeypatch.setattr('pif_ros.config.filters._available_memory', lambda: 500_000_000)
    graph.call(rig.client(Empty, '/reinitialize_global_localization'), Empty.Request())
    rig.line('reinitialize_global_localization: expected', 'memory', 'got [2000, 2000]')
    rig.send('initialpose', start(variances=(1e6, 1e6)))
    rig.line('initialpose: covariance: expected', 'memory', 'got [2000, 2000]')
    assert rig.node.accounts.initial_pose.rejected == {'too wide': 1}
    assert rig.node.tracker.newest is before and rig.node.restarts == rig.node.faults == 0


# What goes out besides


def test_an_unstamped_pose_goes_out_with_every_pose(graph):
    rig = Rig(graph, PLANE)
    unstamped = []
    rig.hear(PoseWithCovariance, '/filter_node/pose_unstamped', unstamped)
    follow(rig, track())
    graph.until(lambda: len(unstamped) == len(TRACK), 'all unstamped poses')
    assert unstamped == [pose.pose for pose in rig.poses]


def test_what_costs_is_made_only_where_someone_listens(graph, monkeypatch):
    made = []
    for name in ('density_message', 'map_message'):
        real = getattr(conversions, name)
        monkeypatch.setattr(conversions, name, lambda *given, real=real, name=name: (
            made.append(name), real(*given))[1])
    rig = Rig(graph, {**PLANE, 'density.rate': 1000.0})
    follow(rig, track(2))
    assert made == []
    maps = []
    rig.hear(OccupancyGrid, '/filter_node/density_map', maps)
    follow(rig, track()[2:3])
    assert made == ['map_message']
    rig.hear(Float64MultiArray, '/filter_node/density', [])
    follow(rig, track()[3:4])
    assert made == ['map_message', 'density_message', 'map_message']
    graph.until(lambda: len(maps) == 2, 'both maps')


def test_density_and_map_show_the_belief_of_the_pose(graph):
    rig = Rig(graph, {**PLANE, 'frame_id': 'yard', 'density.rate': 1000.0})
    densities, maps = [], []
    rig.hear(Float64MultiArray, '/filter_node/density', densities)
    rig.hear(OccupancyGrid, '/filter_node/density_map', maps)
    for count, measurement in enumerate(track(), 1):
        follow(rig, [measurement])
        graph.until(lambda: len(densities) == len(maps) == count, 'density and map')
    expected = library(measurements=track()).estimate().belief
    found = np.reshape(densities[-1].data, (20, 24))
    assert found.tobytes() == (expected.density / expected.mass).tobytes()
    assert [dim.label for dim in densities[-1].layout.dim] == [
        f'x first={-3 + 0.15} spacing={6 / 20} unit=m',
        f'y first={expected.grid.axes[1][0]} spacing={8 / 24} unit=m']
    shown = maps[-1]
    assert (shown.header.frame_id, rig.poses[-1].header.frame_id) == ('yard', 'yard')
    assert nanoseconds(shown.header.stamp) == track()[-1][0]
    # columns of 0.3 m as they are, rows of 1/3 m shown as 27 of 0.3 m
    assert (shown.info.width, shown.info.height) == (20, 27)
    row, column = np.unravel_index(np.argmax(shown.data), (27, 20))
    x, y = expected.mode()
    assert shown.info.origin.position.x + (column + 0.5) * 0.3 == pytest.approx(x, abs=1e-5)
    assert shown.info.origin.position.y + (row + 0.5) * 0.3 == pytest.approx(y, abs=1 / 3)


def test_axes_of_pose_and_density_may_be_chosen(graph):
    rig = Rig(graph, {**PLANE, 'pose.axes': ['y', '', 'x'], 'density.axes': ['y'],
                      'pose.unestimated_variance': 1e6})
    densities = []
    rig.hear(Float64MultiArray, '/filter_node/density', densities)
    assert rig.peer.count_publishers('/filter_node/density_map') == 0
    follow(rig, track(1))
    graph.until(lambda: densities, 'a density')
    expected = library(measurements=track(1)).estimate().belief
    position = rig.poses[0].pose.pose.position
    assert (position.x, position.y, position.z) == (expected.mean()[1], 0.0, expected.mean()[0])
    covariance = np.array(rig.poses[0].pose.covariance).reshape(6, 6)
    assert covariance[0, 2] == expected.covariance()[1, 0]
    assert np.diag(covariance)[[1, 3, 4, 5]].tolist() == [1e6] * 4
    assert [dim.label.split()[0] for dim in densities[0].layout.dim] == ['y']
    assert_allclose(densities[0].data, expected.density.sum(axis=0) * 6 / 20, rtol=1e-9)


@pytest.mark.parametrize(('rate', 'count'), [(2.0, 5), (5.0, 11), (0.0, 0)])
def test_densities_are_as_far_apart_as_their_rate_says(graph, rate, count):
    rig = Rig(graph, {**PLANE, 'density.rate': rate})
    densities = []
    rig.hear(Float64MultiArray, '/filter_node/density', densities)
    seen = []
    for i in range(21):  # two seconds, ten measurements in each, one at either end
        follow(rig, [(T + i * 100 * MS, 0.1, 0.1)])
        for _ in range(5):
            graph.executor.spin_once(timeout_sec=0)
        seen.append(len(densities))
    graph.until(lambda: len(densities) >= count, 'all densities')
    assert len(densities) == count


# Parameters that live


def value(given):
    """Return a parameter's value as a request holds it."""
    return Parameter('x', value=given).to_parameter_msg().value


def set_parameters(rig, atomically=False, **given):
    """Ask the node to set parameters, and return its answers."""
    parameters = [ParameterMessage(name=name.replace('__', '.'), value=value(what))
                  for name, what in given.items()]
    if atomically:
        client = rig.client(SetParametersAtomically, '/filter_node/set_parameters_atomically')
        return [rig.graph.call(
            client, SetParametersAtomically.Request(parameters=parameters)).result]
    client = rig.client(SetParameters, '/filter_node/set_parameters')
    return rig.graph.call(client, SetParameters.Request(parameters=parameters)).results


def test_the_estimator_may_be_changed_while_the_node_runs(graph):
    rig = Rig(graph, {**PLANE, 'measurements.main.params.sigma': 2.0})
    follow(rig, track(1))
    [answer] = set_parameters(rig, pose__estimator='mode')
    assert answer.successful
    follow(rig, track()[1:2])
    expected = belief(rig)
    pose = rig.poses[-1].pose
    assert (pose.pose.position.x, pose.pose.position.y) == tuple(expected.mode())
    assert expected.mode().tolist() != expected.mean().tolist()
    # the covariance is about the point that is published
    lean = expected.mean() - expected.mode()
    assert_allclose(np.array(pose.covariance).reshape(6, 6)[:2, :2],
                    expected.covariance() + np.outer(lean, lean), rtol=1e-12)


def test_the_rate_of_densities_may_be_changed_while_the_node_runs(graph):
    rig = Rig(graph, {**PLANE, 'density.rate': 0.0})
    densities = []
    rig.hear(Float64MultiArray, '/filter_node/density', densities)
    follow(rig, track(2))
    [answer] = set_parameters(rig, density__rate=100)
    assert answer.successful
    follow(rig, track()[2:3])
    graph.until(lambda: densities, 'a density')
    assert len(densities) == 1


@pytest.mark.parametrize(('name', 'bad'), [
    ('pose__estimator', 'median'), ('pose__estimator', 1), ('density__rate', float('nan')),
    ('density__rate', float('inf')), ('density__rate', -1.0), ('density__rate', 'fast'),
    ('density__rate', True), ('density__rate', None), ('pose__estimator', [1.0])])
def test_a_live_parameter_refuses_what_the_file_could_not_have_said_either(graph, name, bad):
    rig = Rig(graph, PLANE)
    full = name.replace('__', '.')
    before = rig.node.get_parameter(full).value
    [answer] = set_parameters(rig, **{name: bad})
    assert not answer.successful
    assert answer.reason.startswith(f'{full}: expected ')
    assert f', got {bad!r}' in answer.reason
    assert rig.node.get_parameter(full).value == before
    assert rig.node._live[full] == before


def test_of_parameters_set_together_none_is_set_where_one_is_refused(graph):
    rig = Rig(graph, PLANE)
    [answer] = set_parameters(rig, atomically=True, density__rate=7.0, pose__estimator='median')
    assert not answer.successful
    assert rig.node.get_parameter('density.rate').value == 1.0
    assert rig.node._live == {'density.rate': 1.0, 'modes.rate': 5.0, 'pose.estimator': 'mean',
                              'measurements.main.enabled': True}


def test_what_needs_a_rebuild_is_read_only_and_says_so(graph):
    rig = Rig(graph, PLANE)
    fixed = {name.replace('.', '__') for name, spec in specifications().items()
             if not spec.metadata['live']} | {'model__params__diffusion'}
    before = rig.node.config
    answers = set_parameters(rig, **{
        name: rig.node.get_parameter(name.replace('__', '.')).value for name in fixed})
    assert len(answers) == len(fixed) > 25
    for answer in answers:
        assert not answer.successful
        assert 'read-only' in answer.reason
    assert rig.node.config == before


def test_a_parameter_that_nobody_knows_is_refused_while_running_too(graph):
    rig = Rig(graph, PLANE)
    [answer] = set_parameters(rig, grid__lowr=[1.0])
    assert not answer.successful


# The time of /clock


def test_nothing_happens_before_the_first_clock(graph):
    rig = Rig(graph, SIMULATED)
    rig.send('fix', fix(T, 0.1, 0.1))
    rig.handled(1)
    rig.send('initialpose', start())
    graph.until(lambda: rig.node.accounts.initial_pose.rejected.total(), 'a refusal')
    rig.line('main: rejected', '/clock')
    rig.line('initialpose: ', '/clock')
    assert rig.node.accounts.sources['main'].rejected == {'no clock': 1}
    assert rig.node.tracker.stamp_ns is None
    rig.tick(T + SECOND)
    follow(rig, [(T + SECOND, 0.1, 0.1)])
    assert rig.stamps == [T + SECOND]
    check_same(belief(rig), library(measurements=[(T + SECOND, 0.1, 0.1)]).estimate().belief)
    check_healthy(rig)


def test_the_timer_predicts_to_now_and_commits_to_nothing(graph):
    rig = Rig(graph, SIMULATED)
    rig.tick(T)
    follow(rig, track(1))
    twin = library(measurements=track(1))
    committed = twin.estimate().belief
    now = T
    for step in (100, 130, 250, 101, 999, 150):
        now += step * MS
        rig.tick(now)
        rig.pose_at(now)
        check_pose(rig.poses[-1], twin.forecast(now))
        check_same(belief(rig), committed)
    assert rig.stamps == sorted(set(rig.stamps))


@pytest.mark.parametrize('seed', range(3))
def test_any_pattern_of_ticks_leaves_the_posterior_as_it_is_to_the_last_bit(graph, seed):
    rig = Rig(graph, SIMULATED)
    rng, now = np.random.default_rng(seed), T
    rig.tick(now)
    for stamp_ns, x, y in track():
        while now < stamp_ns + 40 * MS:
            now += int(rng.integers(1, 150 * MS))
            rig.tick(now)
        follow(rig, [(stamp_ns, x, y)])
    assert len(rig.stamps) > len(TRACK)
    assert rig.stamps == sorted(rig.stamps)
    check_same(belief(rig), library(measurements=track()).estimate().belief)


def test_a_pause_of_the_clock_is_a_pause_of_the_node(graph):
    rig = Rig(graph, SIMULATED)
    rig.tick(T)
    follow(rig, track(1))
    rig.tick(T + 200 * MS)
    rig.pose_at(T + 200 * MS)
    for _ in range(20):
        rig.tick(T + 200 * MS)
        graph.executor.spin_once(timeout_sec=0.01)
    rig.tick(T + 400 * MS)
    rig.pose_at(T + 400 * MS)
    assert rig.stamps == [T, T + 200 * MS, T + 400 * MS]


def test_a_jump_forward_of_the_clock_is_no_reset(graph):
    rig = Rig(graph, SIMULATED)
    rig.tick(T)
    follow(rig, track(2))
    rig.tick(T + 30 * SECOND)
    rig.pose_at(T + 30 * SECOND)
    check_pose(rig.poses[-1], library(measurements=track(2)).forecast(T + 30 * SECOND))
    check_same(belief(rig), library(measurements=track(2)).estimate().belief)


def test_a_jump_back_of_the_clock_resets_to_the_prior_with_one_line(graph):
    rig = Rig(graph, SIMULATED)
    logged = []
    rig.peer.create_subscription(
        Log, '/rosout', logged.append, DEEP)
    rig.tick(T)
    follow(rig, track(3))
    earlier = T - 500 * SECOND
    rig.tick(earlier)
    check_same(belief(rig), library().prior)
    assert rig.node.tracker.stamp_ns is None
    again = [(earlier, 0.3, 0.3), (earlier + 50 * MS, 0.2, 0.1)]
    rig.tick(earlier + 60 * MS)
    count = len(rig.poses)
    for stamp_ns, x, y in again:
        rig.send('fix', fix(stamp_ns, x, y))
    graph.until(lambda: rig.node.accounts.sources['main'].accepted == 5
                and len(rig.poses) > count and rig.stamps[-1] == again[-1][0], 'poses')
    check_same(belief(rig), library(measurements=again).estimate().belief)
    graph.until(lambda: any('jumped' in log.msg for log in logged), 'a line')
    assert sum('jumped' in log.msg for log in logged) == 1
    check_healthy(rig)


def test_a_jump_back_no_further_than_stamps_may_be_ahead_keeps_the_belief_with_one_line(graph):
    rig = Rig(graph, SIMULATED)
    logged = []
    rig.peer.create_subscription(Log, '/rosout', logged.append, DEEP)
    rig.tick(T + SECOND)
    follow(rig, track(3))
    rig.tick(T + 700 * MS)
    late = (T + 710 * MS, 0.3, 0.3)
    follow(rig, [late])
    check_same(belief(rig), library(measurements=[*track(3), late]).estimate().belief)
    graph.until(lambda: any('jumped' in log.msg for log in logged), 'a line')
    assert sum('jumped' in log.msg for log in logged) == 1
    check_healthy(rig)


#: How far a simulated clock jumps, and whether the belief goes on then.
JUMPS = {'+3600 s': (3600.0, True), '-0.3 s': (-0.3, True), '-1 s': (-1.0, True),
         '-50 s': (-50.0, False), 'back to 0': (-T / SECOND, False)}


@pytest.mark.parametrize('kind', JUMPS)
def test_after_a_jump_of_the_clock_the_next_measurement_is_a_pose_and_the_policy_holds(
        graph, kind):
    by, goes_on = JUMPS[kind]
    rig = Rig(graph, {**SIMULATED, 'time.max_gap': 5000.0})
    logged = []
    rig.peer.create_subscription(Log, '/rosout', logged.append, DEEP)
    before = [(T - 100 * MS, 0.2, 0.1), (T - MS, 0.3, 0.1)]
    rig.tick(T)
    follow(rig, before)
    now = T + round(by * SECOND)
    rig.tick(now)
    rig.tick(now + 50 * MS)
    after = (now + 40 * MS, 0.25, 0.15)
    count = len(rig.poses)
    rig.send('fix', fix(*after))
    rig.handled(3)
    graph.until(lambda: len(rig.poses) > count, 'a pose')
    taken = [*before, after] if goes_on else [after]
    check_same(belief(rig), library({**PLANE, 'time.max_gap': 5000.0}, taken).estimate().belief)
    lines = 1 if by < 0 else 0
    graph.until(lambda: sum('clock jumped' in log.msg for log in logged) >= lines, 'a line')
    assert sum('clock' in log.msg for log in logged) == lines
    check_healthy(rig)


def test_a_recording_that_is_looped_three_times_is_the_same_three_times(graph):
    rig = Rig(graph, SIMULATED)
    logged, found = [], []
    rig.peer.create_subscription(Log, '/rosout', logged.append, DEEP)
    for _ in range(3):
        rig.tick(T)
        for stamp_ns, x, y in track():
            rig.tick(stamp_ns + 10 * MS)
            before = rig.node.accounts.sources['main'].received
            rig.send('fix', fix(stamp_ns, x, y))
            rig.handled(before + 1)
        found.append(belief(rig))
        rig.tick(T + 2 * SECOND)
    expected = library(measurements=track()).estimate().belief
    for each in found:
        check_same(each, expected)
    assert rig.node.accounts.sources['main'].accepted == 3 * len(TRACK)
    graph.until(lambda: sum('jumped' in log.msg for log in logged) == 2, 'two lines')
    check_healthy(rig)


@pytest.mark.parametrize('speed', [0.1, 10.0])
def test_forecasts_are_as_far_apart_as_their_rate_says_however_fast_the_clock_goes(graph, speed):
    rig = Rig(graph, SIMULATED)
    rig.tick(T)
    follow(rig, track(1))
    # a tick every hundredth of a second of the wall's time
    step = round(speed * 10 * MS)
    now = T
    while now < T + SECOND:
        now += step
        rig.tick(now)
    rig.pose_at(now - 200 * MS)
    gaps = np.diff(rig.stamps)
    assert rig.stamps == sorted(set(rig.stamps))
    # a timer of 0.1 s beats at the first tick after each
    assert np.all(gaps[1:] <= 100 * MS + step) and np.median(gaps[1:]) >= 100 * MS - step
    check_healthy(rig)


@pytest.mark.parametrize('by', [-5, 65, -3600, 86400])
def test_a_system_clock_that_is_set_takes_the_belief_along_with_one_line(graph, monkeypatch, by):
    logged, steady_ns = [], timekeeper.steady_ns
    rig = Rig(graph, {**PLANE, 'publish.rate': 20.0})
    rig.peer.create_subscription(Log, '/rosout', logged.append, DEEP)
    # the clock of today is the one that was set: until then it was as much behind
    before_ns = time.time_ns() - by * SECOND
    twin = library(measurements=[(before_ns - SECOND, 0.1, 0.2), (before_ns - MS, 0.3, 0.2)])
    for stamp_ns, *values in [(before_ns - SECOND, 0.1, 0.2), (before_ns - MS, 0.3, 0.2)]:
        rig.node.tracker.observe(Measurement(stamp_ns, 'main', tuple(values)))
    rig.node._poses.epoch.newest_ns = before_ns
    rig.node.now()
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady_ns() - by * SECOND)
    now = time.time_ns()
    rig.send('fix', fix(now, 0.2, 0.2))
    rig.handled(1)
    rig.pose_at(now)
    moved = twin.estimate()
    again = library()
    again.reset(moved.belief, moved.stamp_ns + rig.node.tracker.memory().anchor.stamp_ns
                - moved.stamp_ns)
    assert abs(again.stamp_ns - (before_ns - MS + by * SECOND)) < SECOND // 10
    again.observe(Measurement(now, 'main', (0.2, 0.2)))
    check_same(belief(rig), again.estimate().belief)
    count = len(rig.poses)
    graph.until(lambda: len(rig.poses) > count, 'a forecast')
    assert rig.stamps == sorted(rig.stamps)
    graph.until(lambda: any('was set by' in log.msg for log in logged), 'a line')
    [told] = [log.msg for log in logged if 'was set by' in log.msg]
    found = float(told.split('was set by ')[1].split(' s')[0])
    assert found == pytest.approx(by, abs=0.1)
    check_healthy(rig)


def test_a_small_disorder_of_stamps_is_no_jump(graph):
    rig = Rig(graph, SIMULATED)
    rig.tick(T + SECOND)
    follow(rig, [track()[4]])
    rig.send('fix', fix(*track()[0]))
    rig.handled(2)
    graph.until(lambda: rig.node.tracker.backlog == 0 and len(rig.poses) >= 2, 'a pose')
    check_same(belief(rig), library(
        measurements=[track()[0], track()[4]]).estimate().belief)


def test_beyond_the_furthest_forecast_there_is_a_line_and_no_pose(graph):
    rig = Rig(graph, {**SIMULATED, 'time.max_forecast': 2.0})
    rig.tick(T)
    follow(rig, track(1))
    rig.tick(T + 2 * SECOND)
    rig.pose_at(T + 2 * SECOND)
    rig.tick(T + 3 * SECOND)
    rig.line('3 s old', 'time.max_forecast')
    follow(rig, [(T + 3 * SECOND, 0.1, 0.1)])
    assert rig.stamps == [T, T + 2 * SECOND, T + 3 * SECOND]


def test_without_simulated_time_the_timer_goes_on_by_itself(graph):
    rig = Rig(graph, {**PLANE, 'publish.rate': 50.0})
    first = time.time_ns()
    follow(rig, [(first, 0.1, 0.1)])
    graph.until(lambda: len(rig.poses) >= 6, 'five forecasts')
    assert rig.stamps == sorted(set(rig.stamps))
    assert rig.stamps[-1] <= time.time_ns()
    twin = library(measurements=[(first, 0.1, 0.1)])
    for pose in rig.poses:
        check_pose(pose, twin.forecast(nanoseconds(pose.header.stamp)))
    check_same(belief(rig), twin.estimate().belief)


@pytest.mark.parametrize(('simulated', 'kind'), [
    (False, ClockType.STEADY_TIME), (True, ClockType.ROS_TIME)])
def test_the_timer_is_steady_unless_time_is_simulated(graph, simulated, kind):
    node = graph.filter_node({**PLANE, 'use_sim_time': simulated, 'publish.rate': 4.0})
    [timer] = forecasts(node)
    assert (timer.clock.clock_type, timer.timer_period_ns) == (kind, 250 * MS)


def test_without_a_rate_there_is_no_timer(graph):
    assert forecasts(graph.filter_node({**PLANE, 'publish.rate': 0})) == []


def test_diagnostics_tell_of_the_belief_and_of_every_source(graph):
    rig = Rig(graph, PLANE)
    heard = []
    rig.peer.create_subscription(DiagnosticArray, '/diagnostics', heard.append, 10)
    rig.send('fix', fix(T, 0.2, 0.1))
    rig.pose_at(T)
    graph.until(lambda: len(heard) > 1, 'diagnostics')
    whole, belief, source, timing = heard[-1].status
    assert (belief.name, belief.level, belief.message) == (
        '/filter_node: belief', b'\0',
        'found: the belief is in one place, and the measurements fit')
    # the stamp is of long ago
    assert (whole.name, whole.level) == ('/filter_node: filter', b'\2')
    assert timing.name == '/filter_node: timing'
    assert {'work', 'correct', 'publish'} <= {pair.key.split(',')[0] for pair in timing.values}
    values = {pair.key: pair.value for pair in belief.values}
    newest = rig.node.tracker.newest.belief
    assert float(values['mass']) == pytest.approx(newest.mass, abs=1e-9)
    assert float(values['standard deviation of x']) == pytest.approx(
        np.sqrt(newest.covariance()[0, 0]), rel=1e-5)
    assert source.name == '/filter_node: main'
    counts = {pair.key: pair.value for pair in source.values}
    assert counts | {'received': '1', 'accepted': '1', 'outliers': '0', 'dropped': '0',
                     'lost before us': '0'} == counts


def test_diagnostics_are_told_at_once_where_it_gets_worse(graph):
    # the timer does not beat while this is tested
    rig = Rig(graph, {**PLANE, 'diagnostics.rate': 0.001})
    heard = []
    rig.peer.create_subscription(DiagnosticArray, '/diagnostics', heard.append, 10)
    graph.until(lambda: rig.node.count_subscribers('/diagnostics'), 'a listener')
    now = time.time_ns()
    rig.send('fix', fix(now, 0.2, 0.1))
    rig.handled(1)
    rig.send('fix', fix(now + 1, float('nan'), 0.1))
    graph.until(lambda: heard, 'diagnostics')
    [source] = [status for status in heard[0].status if status.name.endswith('main')]
    assert source.level == b'\2'
    assert '1 not finite' in source.message


# Too much, and too bad


def forecasts(node):
    """Return the timer that predicts poses to now, if there is one; another tells of the node."""
    return [timer for timer in node.timers if timer.callback == node._on_timer]


def corrections(monkeypatch):
    """Return a list that grows with every correction that any filter makes."""
    made, correct = [], DiracFeynmanFilter.correct
    monkeypatch.setattr(DiracFeynmanFilter, 'correct', lambda *given: (
        made.append(given[-1]), correct(*given))[1])
    return made


def test_a_burst_of_late_measurements_is_replayed_in_few_passes(graph, monkeypatch):
    rig = Rig(graph, {**PLANE, 'time.history': 10.0})
    punctual = [(T + i * 40 * MS, 0.2, 0.1) for i in range(200)]
    late = [(stamp_ns - 20 * MS, 0.1, 0.2) for stamp_ns, *_ in punctual[1:]]
    for stamp_ns, x, y in punctual:
        rig.send('fix', fix(stamp_ns, x, y))
    rig.handled(len(punctual))
    rig.pose_at(punctual[-1][0])
    made = corrections(monkeypatch)
    began = time.monotonic()
    for stamp_ns, x, y in late:
        rig.send('fix', fix(stamp_ns, x, y))
    rig.handled(len(punctual) + len(late))
    graph.until(lambda: rig.node.tracker.backlog == 0, 'the replay')
    # one by one it would be 199 replays of 200 to 400 corrections; the node waits for 0.2 s
    passes = 3 + (time.monotonic() - began) / 0.2
    assert len(made) <= passes * (len(punctual) + len(late))
    assert len(made) < 199 * 200 / 2
    expected = library({**PLANE, 'time.history': 10.0}, sorted(punctual + late))
    check_same(belief(rig), expected.estimate().belief)
    assert rig.stamps == sorted(rig.stamps)
    check_healthy(rig)


def test_a_full_queue_drops_the_oldest_and_counts_it(graph):
    rig = Rig(graph, {**PLANE, 'measurements.queue_length': 5})
    [heard] = [s for s in rig.node.subscriptions if s.topic_name == '/fix']
    measurements = [(T + i * MS, 0.1 * i, 0.0) for i in range(8)]
    for measurement in measurements:
        heard.callback(fix(*measurement), INFO)
        check_balance(rig)
    account = rig.node.accounts.sources['main']
    assert (account.received, account.accepted, account.dropped) == (8, 0, 3)
    rig.handled(8)
    rig.line('main', 'dropped')
    rig.pose_at(measurements[-1][0])
    assert (account.received, account.accepted, account.dropped) == (8, 5, 3)
    check_same(belief(rig), library(measurements=measurements[3:]).estimate().belief)
    check_healthy(rig)


def test_a_drop_is_counted_where_the_oldest_came_from(graph):
    rig = Rig(graph, {
        **PLANE, 'measurements.queue_length': 2, 'measurements.names': ['main', 'other'],
        'measurements.other.topic': 'other', 'measurements.other.type':
        'geometry_msgs/msg/PointStamped', 'measurements.other.fields': ['point.x', 'point.y'],
        'measurements.other.params.sigma': 0.3})
    heard = {s.topic_name: s.callback for s in rig.node.subscriptions}
    heard['/other'](fix(T, 0.0, 0.0), INFO)
    for i in range(2):
        heard['/fix'](fix(T + i * MS, 0.0, 0.0), INFO)
    assert rig.node.accounts.sources['other'].dropped == 1
    assert rig.node.accounts.sources['main'].dropped == 0
    check_balance(rig)


def test_a_callback_that_raises_is_told_and_counted_and_does_not_end_the_node(graph, monkeypatch):
    rig = Rig(graph, PLANE)
    follow(rig, track(1))

    def fail(*_):
        raise RuntimeError('two lines\nof it')

    with monkeypatch.context() as broken:
        broken.setattr(conversions, 'fill_pose', fail)
        rig.send('fix', fix(*track()[1]))
        graph.until(lambda: rig.node.faults == 1, 'a fault')
    with monkeypatch.context() as broken:
        broken.setattr(GridBelief, 'gaussian', fail)
        rig.send('initialpose', start(stamp_ns=T + SECOND))
        graph.until(lambda: rig.node.faults == 2, 'a fault')
    with monkeypatch.context() as broken:
        broken.setattr(Tracker, 'reset', fail)
        answer = graph.call(rig.client(Trigger, '/filter_node/reset'), Trigger.Request())
        assert not answer.success
        assert rig.node.faults == 3
    rig.line('RuntimeError')
    follow(rig, track()[2:])
    check_same(belief(rig), library(measurements=track()).estimate().belief)
    check_balance(rig)


def test_a_request_that_rclpy_cannot_read_raises_where_the_executable_can_guard_it(graph):
    rig = Rig(graph, PLANE)
    client = rig.client(SetParameters, '/filter_node/set_parameters')
    graph.until(client.service_is_ready, 'the service')
    client.call_async(SetParameters.Request(parameters=[ParameterMessage(
        name='density.rate', value=ParameterValue(type=99))]))
    with pytest.raises(ValueError, match='99'):
        graph.until(lambda: False, 'the fault')
    follow(rig, track())
    check_healthy(rig)
    assert ParameterType.PARAMETER_STRING_ARRAY < 99


def test_a_fault_while_a_measurement_is_read_is_accounted_for_too(graph, monkeypatch):
    rig = Rig(graph, PLANE)
    follow(rig, track(1))

    def fail(*_):
        raise RuntimeError('unreadable')

    with monkeypatch.context() as broken:
        broken.setattr(conversions, 'stamp_to_ns', fail)
        rig.send('fix', fix(*track()[1]))
        rig.line('RuntimeError', 'unreadable')
    assert rig.node.accounts.sources['main'].rejected == {'fault': 1}
    assert rig.node.faults == 1
    check_balance(rig)
    follow(rig, track()[1:])
    check_same(belief(rig), library(measurements=track()).estimate().belief)


# Gaps and losses


def test_a_gap_beyond_the_longest_begins_anew_with_a_line(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track())
    now = time.time_ns()
    follow(rig, [(now, 0.2, 0.3)])
    rig.line('gap', 'time.max_gap', 'prior')
    check_same(belief(rig), library(measurements=[(now, 0.2, 0.3)]).estimate().belief)
    check_healthy(rig)


def test_a_gap_within_the_longest_is_predicted_through(graph):
    rig = Rig(graph, PLANE)
    across = [*track(), (track()[-1][0] + 599 * SECOND, 0.2, 0.3)]
    follow(rig, across)
    check_same(belief(rig), library(measurements=across).estimate().belief)


def test_an_initial_pose_of_long_ago_is_refused(graph):
    rig = Rig(graph, PLANE)
    follow(rig, [(time.time_ns(), 0.2, 0.3)])
    before = belief(rig)
    rig.send('initialpose', start(stamp_ns=SECOND))
    rig.line('initialpose: stamp: expected', 'time.max_gap', 'got 1.0 s')
    check_same(belief(rig), before)


def test_what_the_queue_in_dds_drops_is_counted_as_lost_before_the_node(graph):
    rig = Rig(graph, {**PLANE, 'measurements.queue_length': 10})
    follow(rig, track(1))
    for i in range(1, 101):
        rig.send('fix', fix(T + i * MS, 0.0, 0.0))
    rig.pose_at(T + 100 * MS)
    account = rig.node.accounts.sources['main']
    assert account.received + account.lost == 101 and account.lost > 0
    assert (account.accepted, account.dropped) == (account.received, 0)
    rig.line('main', 'lost before')
    check_healthy(rig)


def test_two_publishers_of_one_source_are_no_loss(graph):
    rig = Rig(graph, PLANE)
    other = rig.peer.create_publisher(PointStamped, 'fix', DEEP)
    graph.until(other.get_subscription_count)
    for i in range(50):
        other.publish(fix(T + i * MS, 0.0, 0.0))
    rig.handled(50)
    for i in range(50, 60):
        rig.send('fix', fix(T + i * MS, 0.0, 0.0))
        other.publish(fix(T + i * MS, 0.1, 0.0))
    rig.handled(70)
    account = rig.node.accounts.sources['main']
    assert (account.received, account.accepted, account.dropped, account.lost) == (70, 70, 0, 0)


def test_a_sensor_that_raises_costs_its_measurement_and_no_other(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track(3))
    sensor = rig.node.tracker.filter._likelihoods['main']
    healthy = type(sensor).terms

    class Moody(type(sensor)):

        def terms(self, y, *rest):
            if y[0] == 7.5:
                raise ArithmeticError('such a number')
            return healthy(self, y, *rest)

    rig.node.tracker.filter._likelihoods['main'] = Moody(
        sensor.grid, sensor.sensor, sensor.average_cells)
    rig.send('fix', fix(track(3)[-1][0] + MS, 7.5, 0.0))
    account = rig.node.accounts.sources['main']
    graph.until(lambda: account.rejected['fault'], 'a fault that is counted')
    later = (track(3)[-1][0] + 2 * MS, 0.3, 0.1)
    follow(rig, [later])
    check_same(belief(rig), library(measurements=[*track(3), later]).estimate().belief)
    assert (account.received, account.accepted) == (5, 4)
    check_balance(rig)


def test_a_node_that_lags_behind_leaves_the_forecasts_to_the_timer(graph):
    rig = Rig(graph, {**SIMULATED, 'time.max_ahead': 10.0})
    rig.tick(T)
    follow(rig, track(1))
    rig.tick(T + 5 * SECOND)
    rig.pose_at(T + 5 * SECOND)
    made, forecast = [], rig.node.tracker.forecast
    rig.node.tracker.forecast = lambda stamp_ns: made.append(stamp_ns) or forecast(stamp_ns)
    # the clock goes on, measurements of seconds ago come in: none is predicted to now by itself
    message = Clock()
    stamp_into(message.clock, T + 6 * SECOND)
    [timer] = forecasts(rig.node)
    rig.node.destroy_timer(timer)
    rig.send('/clock', message)
    graph.until(lambda: rig.node.get_clock().now().nanoseconds == T + 6 * SECOND, 'the clock')
    for k, (stamp_ns, *values) in enumerate(track()[1:]):
        rig.send('fix', fix(stamp_ns, *values))
        rig.handled(k + 2)
    graph.until(lambda: not rig.node.tracker.backlog, 'the corrections')
    assert made == []
    rig.node._on_timer()
    assert made == [T + 6 * SECOND]
    check_pose(rig.pose_at(T + 6 * SECOND),
               library(SIMULATED, track()).forecast(T + 6 * SECOND))


@pytest.mark.parametrize(('takes', 'period', 'made'), [
    (0.25, 0.125, [0.125, 1.125, 2.125, 3.125]),
    # one that needs less than a period of rest waits for none, also where a tick comes early
    (0.015625, 0.0625, [0.0625 * k for k in range(1, 33)])])
def test_slow_forecasts_leave_three_quarters_of_the_time_to_measurements(
        graph, monkeypatch, takes, period, made):
    now, found = [0.0], []
    monkeypatch.setattr(pace, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    node = graph.filter_node({**PLANE, 'publish.rate': 10.0})
    node.tracker.observe(Measurement(time.time_ns() - SECOND, 'main', (0.1, 0.2)))
    node.tracker.estimate()
    forecast = node.tracker.forecast

    def slow(stamp_ns):
        found.append(now[0])
        now[0] += takes
        return forecast(stamp_ns)

    node.tracker.forecast = slow
    for tick in range(1, 33):
        now[0] = max(now[0], period * tick)
        node._on_timer()
    assert found == made and node.skipped == 32 - len(made)


def test_replays_that_never_end_take_no_more_late_measurements(graph):
    rig = Rig(graph, {**PLANE, 'time.history': 5.0})
    follow(rig, track(3))
    # as after five seconds of replays, each overtaken by the next late measurement
    rig.node.inbox.behind_since = time.monotonic() - 6
    [heard] = [s for s in rig.node.subscriptions if s.topic_name == '/fix']
    newest = track(3)[-1][0]
    heard.callback(fix(newest - MS, 0.0, 0.0), INFO)
    # what is as new as the newest is not late
    heard.callback(fix(newest, 0.0, 0.0), INFO)
    heard.callback(fix(newest + MS, 0.0, 0.0), INFO)
    rig.node.drain()
    account = rig.node.accounts.sources['main']
    assert account.rejected == {'overload': 1} and account.accepted == 5
    check_balance(rig)


def test_slow_corrections_are_made_few_at_a_time_so_that_others_have_their_turn(
        graph, monkeypatch):
    node, now, made = graph.filter_node(PLANE), [100.0], []
    monkeypatch.setattr(inbox, 'time', SimpleNamespace(monotonic=lambda: now[0]))
    correct = node.tracker.filter.correct

    def slow(*given):
        now[0] += 0.03
        made.append(given)
        return correct(*given)

    object.__setattr__(node.tracker.filter, 'correct', slow)
    [heard] = [s for s in node.subscriptions if s.topic_name == '/fix']
    for k in range(40):
        heard.callback(fix(T + k * MS, 0.0, 0.0), INFO)
    counts = []
    while node.inbox.has_work:
        made.clear()
        node._work()
        counts.append(len(made))
    assert node.accounts.sources['main'].accepted == 40
    # three fit into a turn of 0.1 s, which is known after the first
    assert [count for count in counts if count] == [1] + 13 * [3]


def test_a_remapped_source_still_counts_what_dds_drops(graph):
    rig = Rig(graph, {**PLANE, 'measurements.queue_length': 10}, '-r', 'fix:=/elsewhere')
    rig.send('/elsewhere', fix(T, 0.0, 0.0))
    rig.pose_at(T)
    for i in range(1, 101):
        rig.send('/elsewhere', fix(T + i * MS, 0.0, 0.0))
    rig.pose_at(T + 100 * MS)
    account = rig.node.accounts.sources['main']
    assert account.received + account.lost == 101 and account.lost > 0
    check_balance(rig)


def test_a_source_that_is_disabled_is_counted_and_not_believed_until_it_is_enabled(graph):
    rig = Rig(graph, PLANE)
    follow(rig, track(1))
    [answer] = set_parameters(rig, measurements__main__enabled=False)
    assert answer.successful
    rig.send('fix', fix(*track(2)[1]))
    rig.handled(2)
    account = rig.node.accounts.sources['main']
    assert account.rejected == {'disabled': 1}
    set_parameters(rig, measurements__main__enabled=True)
    follow(rig, [track(3)[2]])
    check_same(belief(rig), library(measurements=[track(3)[0], track(3)[2]]).estimate().belief)
    check_healthy(rig)
