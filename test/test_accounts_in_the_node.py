"""What waits, is replayed or comes out of a file is accounted for once, whatever happens then."""

from contextlib import closing
import itertools
import math
import os

from pif_ros import diagnostics, state_file, timekeeper
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.sources import Control, ControlSource
from pif_ros.timekeeper import ClockSet
import pytest
from ros import Graph, PLANE, Rig, SECOND, stamp_into
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger
from test_filter_node import fix, MS, T
from test_state_in_the_node import YARD

GATED = {**PLANE, 'measurements.main.gate.tail_probability': 1e-4}
HERE, FAR = (0.5, -0.5), (2.5, 3.0)


def inlets(node):
    """Return what a node listens with."""
    return [made.callback.args[0] for made in node.subscriptions if hasattr(made.callback, 'args')]


def put(node, stamp_ns, values):
    """Let a measurement wait that the node has received."""
    [inlet] = [each for each in inlets(node) if not isinstance(each, ControlSource)]
    inlet.account.received += 1
    node.inbox.put(inlet, Measurement(stamp_ns, 'main', values))
    return inlet.account


def steer(node, stamp_ns, values):
    """Let a control wait that the node has received."""
    [inlet] = [each for each in inlets(node) if isinstance(each, ControlSource)]
    inlet.account.received += 1
    node.inbox.put(inlet, Control(stamp_ns, values))


def work(node):
    """Let the node do all that there is to do."""
    while node.inbox.has_work:
        node._work()


def failing(monkeypatch, at_ns):
    """Let the correction at a stamp fail."""
    correct = DiracFeynmanFilter.correct

    def broken(self, belief, y, sensor, stamp_ns):
        if stamp_ns == at_ns:
            raise ArithmeticError('such a number')
        return correct(self, belief, y, sensor, stamp_ns)

    monkeypatch.setattr(DiracFeynmanFilter, 'correct', broken)


def answer(service):
    """Return what a service of a node answers."""
    return service(Trigger.Request(), Trigger.Response())


def counts(account):
    return account.received, account.accepted, account.outliers, dict(+account.rejected)


def test_a_full_queue_before_a_full_backlog_is_forgotten_by_a_reset_too(graph):
    node = Rig(graph, {**PLANE, 'measurements.queue_length': 10}).node
    for k in range(10):
        put(node, T + k * MS, HERE)
    node.drain()
    for k in range(10, 20):
        account = put(node, T + k * MS, HERE)
    assert answer(node._starting._on_reset).success
    assert not node.inbox.has_work and node.tracker.stamp_ns is None
    assert counts(account) == (20, 20, 0, {})


def test_after_a_reset_the_node_is_not_behind(graph):
    node = Rig(graph, PLANE).node
    for k in range(100):
        put(node, T + k * MS, HERE)
    # the first time it waits for the end of the burst
    node._work()
    node._work()
    assert node.tracker.backlog and node.inbox.behind_since is not None
    answer(node._starting._on_reset)
    assert node.facts().behind == 0.0


def test_who_has_nothing_left_to_do_is_not_behind_though_the_last_thing_failed(graph, monkeypatch):
    node = Rig(graph, PLANE).node
    failing(monkeypatch, T + 99 * MS)
    for k in range(100):
        account = put(node, T + k * MS, HERE)
    work(node)
    assert node.faults == 1 and node.inbox.behind_since is None
    assert counts(account) == (100, 99, 0, {'fault': 1})


def test_a_verdict_is_remembered_as_long_as_its_measurement_waits_to_be_replayed(graph):
    node = Rig(graph, {**GATED, 'measurements.main.gate.max_consecutive_rejections': 10_000,
                       'time.history': 5.0, 'measurements.queue_length': 1000}).node
    for k in range(10):
        put(node, T + (100 + k) * MS, (-2.5, -3.0))
    work(node)
    for k in range(60):
        put(node, T + (200 + k) * MS, (2.5, 3.5))
    work(node)
    # late: all of these are replayed; the last is further on than the history
    for k in range(20):
        put(node, T + k * MS, HERE)
    account = put(node, T + 8 * SECOND, HERE)
    work(node)
    assert account.received == account.accepted + account.rejected.total() == 91
    assert account.accepted == 21


def test_how_many_outliers_there_are_does_not_depend_on_who_comes_first(tmp_path):
    track = [(T + k * MS, HERE) for k in range(20)]
    # the second one of two that agree is none any more, once both are known
    odd = [(T + 40 * MS, (3.9, 0.5)), (T + 41 * MS, (3.9, 0.5)), (T + 300 * MS, FAR)]
    found = []
    for order in ([*track, *odd], [*track, *odd[::-1]], [*odd, *track]):
        with closing(Graph(tmp_path)) as graph:
            node = graph.filter_node({**PLANE, 'time.history': 5.0})
            for stamp_ns, values in order:
                account = put(node, stamp_ns, values)
                work(node)
            found.append(counts(account))
    assert found[0] == found[1] == found[2] and found[0][2] >= 1


@pytest.mark.parametrize('again', [False, True], ids=['another process', 'the same'])
def test_what_comes_out_of_a_file_is_not_accounted_for_again(graph, tmp_path, again):
    parameters = {**GATED, 'state_file': str(tmp_path / 'state')}
    node = Rig(graph, parameters).node
    for k in range(20):
        put(node, T + k * MS, HERE)
    for k in range(2):
        account = put(node, T + (30 + k) * MS, FAR)
    work(node)
    before = counts(account)
    assert before == (22, 20, 0, {'gate': 2})
    assert answer(node._resuming._on_save).success
    if not again:
        node = Rig(graph, parameters).node
        before = (0, 0, 0, {})
    assert answer(node._resuming._on_load).success
    work(node)
    assert counts(node.accounts.sources['main']) == before
    assert node.tracker.newest.stamp_ns == T + 31 * MS


@pytest.mark.parametrize('fails', [False, True])
def test_what_waits_when_the_clock_is_set_is_judged_and_the_belief_moves_along(
        graph, monkeypatch, fails):
    node = Rig(graph, GATED).node
    for k in range(20):
        put(node, T + k * MS, HERE)
    work(node)
    put(node, T + 30 * MS, FAR)
    account = put(node, T + 40 * MS, HERE)
    if fails:
        failing(monkeypatch, T + 40 * MS)
    node._on_clock_set(ClockSet(3600 * SECOND, 'the system clock was set', True))
    assert counts(account) == ((22, 20, 0, {'gate': 1, 'fault': 1}) if fails
                               else (22, 21, 0, {'gate': 1}))
    assert node.faults == fails
    assert node.tracker.stamp_ns == T + 3600 * SECOND + (30 if fails else 40) * MS


def test_a_clock_that_is_set_during_the_work_moves_no_pose_ahead(graph, monkeypatch):
    rig = Rig(graph, {**PLANE, 'publish.rate': 20.0})
    node, steady, shift = rig.node, timekeeper.steady_ns, [0]
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady() + shift[0])
    now_ns = node.get_clock().now().nanoseconds
    rig.send('fix', fix(now_ns, *HERE))
    rig.handled(1)
    graph.until(lambda: node._poses.epoch.newest_ns > now_ns, 'a forecast')
    estimate = node.tracker.estimate()
    shift[0] = 60 * SECOND
    node.tell(estimate)
    assert node.restarts == 1 and node._poses.epoch.newest_ns == -1


def test_how_long_a_source_is_silent_counts_from_when_the_clock_was_set(graph, monkeypatch):
    rig = Rig(graph, PLANE)
    node, steady, shift = rig.node, timekeeper.steady_ns, [0]
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: steady() + shift[0])
    rig.send('fix', fix(node.get_clock().now().nanoseconds, *HERE))
    rig.handled(1)
    node.facts()
    # as if the node had run for an hour
    node._since_ns -= 3600 * SECOND
    shift[0] = -SECOND
    node._on_diagnostics()
    status = diagnostics.source_status('main', node.accounts.sources['main'], node.facts())
    assert node.restarts == 1 and status.level == diagnostics.OK


@pytest.mark.parametrize('order', list(itertools.permutations('cm')), ids=''.join)
def test_a_control_just_before_a_gap_ends_holds_whichever_comes_first(graph, order):
    node = graph.filter_node({**YARD, 'time.max_gap': 10.0, 'publish.rate': 0.0})
    put(node, T, (0.1, 0.1))
    work(node)
    end_ns = T + 100 * SECOND
    for which in order:
        if which == 'c':
            steer(node, end_ns, (0.5, 0.5))
        else:
            put(node, end_ns + 50 * MS, (0.1, 0.1))
    work(node)
    assert node.inbox.gaps == 1
    turned = node.tracker.forecast(end_ns + 550 * MS).belief.mean()[2] - 3.0
    # the prior holds at the measurement, and the control for 0.45 s from there on
    assert turned % (2 * math.pi) == pytest.approx(0.5 * 0.45, abs=0.02)


SLEEPS = {**PLANE, 'use_sim_time': True}


def saved(file, graph):
    """Leave the state of a node in a file, and return its parameters and its mean."""
    parameters = {**SLEEPS, 'state_file': str(file), 'checkpoint_period': 0.1}
    rig = Rig(graph, parameters)
    rig.tick(T + 500 * MS)
    for k in range(5):
        rig.send('fix', fix(T + k * MS, 1.5, 2.0))
        rig.handled(k + 1)
    rig.node.finish()
    return parameters, rig.node.tracker.newest.belief.mean()


@pytest.mark.parametrize('what', ['checkpoint', 'end', 'save'])
def test_a_state_that_was_not_gone_on_from_yet_is_not_replaced(graph, tmp_path, what):
    with closing(Graph(tmp_path)) as before:
        parameters, mean = saved(tmp_path / 'state', before)
    content = (tmp_path / 'state').read_bytes()
    rig = Rig(graph, parameters)
    node = rig.node
    if what == 'checkpoint':
        node._resuming._on_checkpoint()
        node._keeper._settle()
    elif what == 'end':
        node.finish()
    else:
        refused = answer(node._resuming._on_save)
        assert not refused.success and 'expected a /clock first' in refused.message
    assert not (tmp_path / 'state.refused').exists()
    assert (tmp_path / 'state').read_bytes() == content
    if what == 'checkpoint':
        rig.tick(T + 600 * MS)
        graph.until(lambda: node.tracker.stamp_ns is not None, 'it goes on')
        work(node)
        assert node.tracker.newest.belief.mean() == pytest.approx(mean)


def test_a_clean_up_before_the_first_clock_leaves_nothing_that_a_clock_calls(graph, tmp_path):
    file = tmp_path / 'state'
    file.write_bytes(b'no state')
    node = graph.filter_node({**SLEEPS, 'state_file': str(file), 'autostart': False})
    node.trigger_configure()
    first, called = node._resuming, []
    first._start = lambda: called.append(first)
    node.trigger_cleanup()
    node.trigger_configure()
    peer, message = graph.peer(), Clock()
    sender = peer.create_publisher(Clock, '/clock', 10)
    graph.until(sender.get_subscription_count, 'the clock is heard')
    stamp_into(message.clock, T)
    sender.publish(message)
    graph.until(lambda: node.get_clock().now().nanoseconds == T, 'the time')
    assert not called and node.faults == 0


def test_a_folder_that_cannot_be_told_of_a_new_name_makes_no_save_fail(
        graph, tmp_path, monkeypatch):
    folder, opened = tmp_path / 'folder', os.open
    folder.mkdir()
    node = graph.filter_node({**PLANE, 'state_file': str(folder / 'state')})

    def refusing(path, flags, *more, **others):
        if os.path.isdir(path):
            raise OSError(24, 'Too many open files')
        return opened(path, flags, *more, **others)

    monkeypatch.setattr(state_file.os, 'open', refusing)
    for k in range(3):
        put(node, T + k * MS, HERE)
        work(node)
        assert answer(node._resuming._on_save).success
    assert os.listdir(folder) == ['state']


def test_a_save_that_failed_is_told_until_one_succeeds(graph, tmp_path):
    folder = tmp_path / 'folder'
    folder.mkdir()
    node = graph.filter_node({**PLANE, 'state_file': str(folder / 'state')})
    folder.rename(tmp_path / 'elsewhere')
    assert not answer(node._resuming._on_save).success
    told = diagnostics.filter_status(node.facts()).values['state saved']
    assert 'No such file' in told
    (tmp_path / 'elsewhere').rename(folder)
    assert answer(node._resuming._on_save).success
    assert 'ago' in diagnostics.filter_status(node.facts()).values['state saved']
