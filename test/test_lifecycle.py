"""A lifecycle manager drives the node, as nav2's does: by its services alone."""

import time

from geometry_msgs.msg import PoseWithCovarianceStamped
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from pif_ros.config import ConfigError
from pif_ros.core.estimates import Measurement
import pytest
from ros import PLANE, Rig
from test_filter_node import belief, check_same, fix, follow, library, MS, T, track

MANAGED = {**PLANE, 'autostart': False}


class Manager:
    """What nav2's lifecycle manager does: ask for transitions, and look at the state."""

    def __init__(self, graph, name='/filter_node'):
        """Take the node's name, before it is there."""
        self._graph, self._peer = graph, graph.peer('lifecycle_manager')
        self._change = self._peer.create_client(ChangeState, f'{name}/change_state')
        self._get = self._peer.create_client(GetState, f'{name}/get_state')

    def ask(self, transition):
        """Ask for a transition, and return whether it was made."""
        request = ChangeState.Request(transition=Transition(id=transition))
        return self._graph.call(self._change, request).success

    @property
    def state(self):
        """Return the node's state."""
        return self._graph.call(self._get, GetState.Request()).current_state.id


def spin(graph):
    """Let a fifth of a second pass, in which a timer of 50 Hz would beat ten times."""
    end = time.monotonic() + 0.2
    while time.monotonic() < end:
        graph.executor.spin_once(timeout_sec=0.02)


def entities(node):
    """Return how many of all that a node has on the graph."""
    return tuple(len(list(some)) for some in (
        node.publishers, node.subscriptions, node.services, node.timers, node.guards))


def test_it_starts_by_itself_and_is_active(graph):
    rig = Rig(graph, PLANE)
    assert Manager(graph).state == State.PRIMARY_STATE_ACTIVE
    follow(rig, track(1))


def test_a_manager_takes_it_from_nothing_to_work_and_back_and_round_again(graph):
    node = graph.filter_node(MANAGED)
    manager, bare = Manager(graph), entities(node)
    assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
    for _ in range(2):
        assert manager.ask(Transition.TRANSITION_CONFIGURE)
        assert manager.state == State.PRIMARY_STATE_INACTIVE
        assert manager.ask(Transition.TRANSITION_ACTIVATE)
        assert manager.state == State.PRIMARY_STATE_ACTIVE
        node.tracker.observe(Measurement(T, 'main', (0.1, 0.2)))
        assert node.tracker.estimate().stamp_ns == T
        assert manager.ask(Transition.TRANSITION_DEACTIVATE)
        assert manager.ask(Transition.TRANSITION_CLEANUP)
        assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
        assert entities(node) == bare
    assert manager.ask(Transition.TRANSITION_UNCONFIGURED_SHUTDOWN)
    assert manager.state == State.PRIMARY_STATE_FINALIZED
    assert node.faults == 0


def test_while_it_is_inactive_it_counts_what_comes_and_believes_and_publishes_nothing(graph):
    rig, manager = Rig(graph, {**PLANE, 'publish.rate': 50.0}), Manager(graph)
    now = time.time_ns()
    before = [(now - 100 * MS, 0.2, 0.1), (now - 50 * MS, 0.3, 0.1)]
    follow(rig, before)
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    # poses that were on their way
    spin(graph)
    count = len(rig.poses)
    rig.send('fix', fix(now, 2.0, 2.0))
    rig.handled(3)
    account = rig.node.accounts.sources['main']
    assert (account.accepted, account.rejected) == (2, {'inactive': 1})
    check_same(belief(rig), library(measurements=before).estimate().belief)
    spin(graph)
    assert len(rig.poses) == count
    assert manager.ask(Transition.TRANSITION_ACTIVATE)
    after = (time.time_ns(), 0.25, 0.1)
    follow(rig, [after])
    check_same(belief(rig), library(measurements=[*before, after]).estimate().belief)


@pytest.mark.parametrize('state', ['unconfigured', 'inactive', 'active'])
def test_it_can_be_shut_down_from_every_state_for_ever(graph, state):
    node, manager = graph.filter_node(MANAGED), Manager(graph)
    transition = Transition.TRANSITION_UNCONFIGURED_SHUTDOWN
    if state != 'unconfigured':
        assert manager.ask(Transition.TRANSITION_CONFIGURE)
        transition = Transition.TRANSITION_INACTIVE_SHUTDOWN
    if state == 'active':
        assert manager.ask(Transition.TRANSITION_ACTIVATE)
        transition = Transition.TRANSITION_ACTIVE_SHUTDOWN
    assert manager.ask(transition)
    assert manager.state == State.PRIMARY_STATE_FINALIZED
    assert not manager.ask(Transition.TRANSITION_CONFIGURE)
    node.finish()
    assert node.faults == 0


def test_what_makes_no_filter_is_said_and_leaves_it_unconfigured(graph):
    node = graph.filter_node({**MANAGED, 'measurements.main.sensor': 'sonar'})
    bare = entities(node)
    manager = Manager(graph)
    assert not manager.ask(Transition.TRANSITION_CONFIGURE)
    assert manager.state == State.PRIMARY_STATE_UNCONFIGURED
    assert entities(node) == bare
    with pytest.raises(ConfigError, match='sonar'):
        graph.filter_node({**PLANE, 'measurements.main.sensor': 'sonar'})


def test_parameters_and_faults_of_a_node_that_is_not_configured_harm_nobody(graph):
    node = graph.filter_node(MANAGED)
    node.report('kind', 'a line')
    node.finish()
    assert str(node.accounts) == ''
    assert node.faults == 0


def test_a_cleaned_up_node_saves_its_state_and_goes_on_from_it(graph, tmp_path):
    rig = Rig(graph, {**PLANE, 'state_file': str(tmp_path / 'state')})
    manager = Manager(graph)
    follow(rig, track(3))
    believed = belief(rig)
    assert manager.ask(Transition.TRANSITION_DEACTIVATE)
    assert manager.ask(Transition.TRANSITION_CLEANUP)
    assert manager.ask(Transition.TRANSITION_CONFIGURE)
    check_same(rig.node.tracker.estimate().belief, believed)


def test_what_was_made_is_let_go_of_though_its_end_fails(graph):
    node = graph.filter_node(MANAGED)
    bare = entities(node)
    node.trigger_configure()
    once = entities(node)
    node._keeper.close = lambda published_ns: 1 / 0
    node.trigger_cleanup()
    assert not node.is_made and entities(node) == bare
    node.trigger_configure()
    assert node.is_made and entities(node) == once


def test_while_it_is_inactive_nobody_sets_it_down(graph):
    node = graph.filter_node(PLANE)
    node.trigger_deactivate()
    node._starting._on_initial_pose(PoseWithCovarianceStamped())
    account = node.accounts.initial_pose
    assert (account.received, account.rejected) == (1, {'inactive': 1}) and not node.restarts
