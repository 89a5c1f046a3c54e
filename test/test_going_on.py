"""What goes on when a clock or a pose is set, a correction fails, or a publisher leaves."""

from dataclasses import replace
import math

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from pif_ros.core.lost import Watch
from pif_ros.timekeeper import ClockSet
import pytest
from rclpy.lifecycle import TransitionCallbackReturn
from ros import nanoseconds, PLANE, Rig, SECOND, stamp_into
from std_msgs.msg import Float64MultiArray
from test_accounts_in_the_node import failing, HERE, put, steer, work
from test_filter_node import fix, MS, T
from test_sources import source
from test_state_in_the_node import YARD

DRIVEN = {**YARD, 'publish.rate': 0.0, 'control.hold': 20.0}
DEACTIVATED = {**PLANE, 'publish.rate': 0.0}


def driven(node):
    """Steer a node, measure, and return how far its next second is to lead."""
    steer(node, T, (1.0, 0.2))
    for k in range(3):
        put(node, T + k * 100 * MS, (0.1 + 0.1 * k, 0.1))
    work(node)
    return next_second(node)


def next_second(node):
    newest = node.tracker.newest
    there = node.tracker.forecast(newest.stamp_ns + SECOND).belief
    return (there.mean() - newest.belief.mean()).tolist()


@pytest.mark.parametrize('by_ns', [3600 * SECOND, -50 * SECOND])
def test_a_robot_that_is_driven_is_driven_on_when_the_clock_is_set(graph, by_ns):
    node = graph.filter_node(DRIVEN)
    before = driven(node)
    assert abs(before[0]) > 0.1
    node._on_clock_set(ClockSet(by_ns, 'the system clock was set', True))
    assert node.tracker.stamp_ns == T + 200 * MS + by_ns
    assert next_second(node) == pytest.approx(before, abs=1e-9)


def test_what_is_known_of_how_measurements_fit_goes_on_when_the_clock_is_set(graph):
    node = graph.filter_node(PLANE)
    put(node, T, HERE)
    work(node)
    known = replace(node.tracker.newest, watch=Watch(11.0, True, (('main', 4),), 3))
    node.tracker._posteriors[-1] = known
    node._on_clock_set(ClockSet(SECOND, 'the system clock was set', True))
    assert node.tracker.newest.watch == known.watch
    assert node.tracker.newest.total_log_evidence == known.total_log_evidence != 0


def test_a_robot_that_is_driven_is_driven_on_from_a_pose_that_is_set(graph):
    rig = Rig(graph, {**DRIVEN, 'use_sim_time': True})
    rig.tick(T + 200 * MS)
    driven(rig.node)
    message = PoseWithCovarianceStamped()
    message.header.frame_id = 'map'
    stamp_into(message.header.stamp, T + 200 * MS)
    message.pose.pose.orientation.w = 1.0
    message.pose.covariance[0] = message.pose.covariance[7] = message.pose.covariance[35] = 0.04
    rig.send('initialpose', message)
    graph.until(lambda: rig.node.accounts.initial_pose.accepted, 'the pose')
    # 1 m/s along the prior's heading, 3 rad or a little more, which the pose says nothing of
    forward, _, turned = next_second(rig.node)
    assert forward < -0.9 and turned % (2 * math.pi) == pytest.approx(0.2, abs=0.01)


def test_what_a_failed_correction_leaves_to_tell_is_told(graph, monkeypatch):
    rig = Rig(graph, {**PLANE, 'publish.rate': 0.0})
    failing(monkeypatch, T + 20 * MS)
    put(rig.node, T + 10 * MS, HERE)
    put(rig.node, T + 20 * MS, HERE)
    rig.node._wake.trigger()
    assert nanoseconds(rig.pose_at(T + 10 * MS).header.stamp) == T + 10 * MS
    assert rig.node.faults == 1 and not rig.node.tracker._unwatched
    assert not rig.node.inbox.wants_a_turn


def test_a_pose_that_was_found_while_it_slept_is_told_when_it_wakes(graph):
    rig = Rig(graph, DEACTIVATED)
    put(rig.node, T, HERE)
    assert rig.node.trigger_deactivate() is TransitionCallbackReturn.SUCCESS
    work(rig.node)
    assert rig.node.tracker.stamp_ns == T and not rig.poses
    assert rig.node.trigger_activate() is TransitionCallbackReturn.SUCCESS
    rig.pose_at(T)
    # but nothing is told twice
    rig.node.trigger_deactivate()
    rig.node.trigger_activate()
    rig.send('fix', fix(T + 100 * MS, *HERE))
    rig.pose_at(T + 100 * MS)
    assert len(rig.poses) == 2


def test_the_modes_of_another_belief_are_not_told(graph):
    node = graph.filter_node(PLANE)
    node._health._masses, node._health._rest._until = (0.5, 0.5), float('inf')
    node._restart(None, None, 'anew')
    assert node.facts().masses == pytest.approx((1.0,), abs=1e-3)


def test_no_age_is_told_by_another_clock(graph):
    rig = Rig(graph, {**PLANE, 'use_sim_time': True})
    rig.tick(T + SECOND)
    rig.node.accounts.initial_pose.accept(T + SECOND)
    put(rig.node, T, HERE)
    rig.tick(T - 100 * SECOND)
    for account in (*rig.node.accounts, rig.node.accounts.initial_pose):
        assert account.traffic.age(T - 100 * SECOND) is None


def test_a_message_before_the_first_clock_came_at_no_time(graph):
    rig = Rig(graph, {**PLANE, 'use_sim_time': True})
    rig.send('fix', fix(T, *HERE))
    rig.handled(1)
    rig.tick(T + SECOND)
    for k in range(5):
        rig.send('fix', fix(T + k * MS, *HERE))
        rig.handled(k + 2)
        rig.tick(T + SECOND + (k + 1) * 100 * MS)
    assert rig.node.accounts.sources['main'].traffic.rate == pytest.approx(10.0)


def test_what_the_user_switched_off_is_no_sign_that_something_is_wrong(graph):
    account = graph.filter_node(PLANE).accounts.sources['main']
    for _ in range(10):
        account.reject('disabled')
    assert account.rejected == {'disabled': 10} and account.traffic.refused == 0
    account.reject('too late')
    assert account.traffic.refused == 1


@pytest.mark.parametrize('heard, lost', [
    ([(1, 1), (2, 1), (5, 1)], 2),
    # a publisher that begins anew counts from 1
    ([(7, 1), (1, 1), (2, 1), (4, 1)], 1),
    # two of them alternate, and one leaves: what it left behind is no gap
    ([(1, 1), (2, 1), (40, 2), (3, 2), (41, 2), (4, 2), (42, 1), (43, 1), (46, 1)], 2),
    ([(1, 1), (40, 2), (2, 2), (41, 2), (3, 1), (4, 1), (9, 1)], 4),
    ([(100, 2), (5, 2), (6, 1), (7, 1), (101, 1)], 93),
    ([(1, 1), (40, 2), (2, 2), (3, 2), (4, 1), (9, 1)], 4),
    # one that was there for a moment, and had left before it was heard
    ([(100, 1), (1, 1), (101, 1), (103, 1)], 1)])
def test_gaps_are_counted_where_one_publisher_is_heard(heard, lost):
    inlet = source('std_msgs/msg/Float64MultiArray')
    assert sum(inlet.lost(number, lambda n=n: n) for number, n in heard) == lost


def test_what_cannot_be_used_tells_no_pose_anew(graph, monkeypatch):
    rig = Rig(graph, {**PLANE, 'publish.rate': 0.0})
    put(rig.node, T, HERE)
    rig.node._wake.trigger()
    rig.pose_at(T)
    for k in range(1, 4):
        with monkeypatch.context() as broken:
            failing(broken, T + k * MS)
            put(rig.node, T + k * MS, HERE)
            work(rig.node)
            rig.node._work()
    assert rig.node.faults == 3 and not rig.node.inbox.wants_a_turn
    put(rig.node, T + 9 * MS, HERE)
    work(rig.node)
    rig.pose_at(T + 9 * MS)
    assert len(rig.poses) == 2


def test_what_waits_when_the_clock_is_set_is_told_by_the_new_clock(graph):
    rig = Rig(graph, {**PLANE, 'publish.rate': 0.0})
    put(rig.node, T, HERE)
    rig.node._on_clock_set(ClockSet(3600 * SECOND, 'the system clock was set', True))
    assert nanoseconds(rig.pose_at(T + SECOND).header.stamp) == T + 3600 * SECOND


def test_what_was_found_while_it_slept_is_told_also_where_it_is_no_newer(graph):
    rig = Rig(graph, DEACTIVATED)
    put(rig.node, T, HERE)
    rig.node._wake.trigger()
    rig.pose_at(T)
    assert rig.node.trigger_deactivate() is TransitionCallbackReturn.SUCCESS
    put(rig.node, T - 10 * MS, HERE)
    work(rig.node)
    assert rig.node.trigger_activate() is TransitionCallbackReturn.SUCCESS
    graph.until(lambda: len(rig.poses) == 2, 'what the late one changed')


@pytest.mark.parametrize('topic, kind', [
    ('density', Float64MultiArray), ('density_map', OccupancyGrid)])
def test_of_a_vast_world_no_density_is_made(graph, topic, kind):
    rig = Rig(graph, {**PLANE, 'region.kind': 'active', 'density.rate': 10.0,
                      'grid.lower': [-5e4, -5e4], 'grid.upper': [5e4, 5e4],
                      'grid.shape': [100_000, 100_000]})
    heard = []
    rig.hear(kind, f'/filter_node/{topic}', heard)
    put(rig.node, T, HERE)
    rig.node._wake.trigger()
    rig.pose_at(T)
    assert rig.node.faults == 0 and not heard
