"""What a node, and a bank of them, must not do where it begins anew, ends, or looks ahead."""

from contextlib import closing
from types import SimpleNamespace

from pif_ros import bank as fleet, node as single
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.diagnostics import belief_status
from pif_ros.filter_bank import FilterBank
from pif_ros.filter_node import FORECASTS_TAKE
from pif_ros.pace import Rest
import pytest
from rclpy.clock import ClockType
from rclpy.time import Time
from ros import Graph, PLANE, Rig, SECOND, write_parameters
from std_srvs.srv import Trigger
from test_accounts_in_the_node import answer, HERE, put, steer, work
from test_filter_node import MS, start, T
from test_state_in_the_node import YARD

#: A robot just inside the edge of its yard.
EDGE = {**YARD, 'filter.type': 'df', 'publish.rate': 0.0,
        'control.hold': 30.0, 'prior.mean': [7.0, 0.0, 0.0],
        'prior.covariance_diagonal': [0.05, 0.05, 0.001], 'model.params.sigma_position': 0.05}


def bank_of(graph, tmp_path, **more):
    """Return a bank of two targets, with further parameters."""
    path = write_parameters(tmp_path / 'bank.yaml',
                            {**PLANE, 'targets': ['alpha', 'bravo'], **more})
    return graph.add(FilterBank(context=graph.context, use_global_arguments=False,
                                cli_args=['--ros-args', '--params-file', str(path)]))


def told(node):
    """Return the stamps of all poses, and the kinds of all lines, that a node tells from now."""
    poses, lines, publish, report = [], [], node._outputs.publish, node.report
    node._outputs.publish = lambda belief, stamp_ns: (poses.append(stamp_ns),
                                                      publish(belief, stamp_ns))
    node.report = lambda kind, text: (lines.append(kind), report(kind, text))
    return poses, lines


def test_a_forecast_off_the_grid_is_not_published_and_takes_nothing_from_the_belief(graph):
    node, tracker = graph.filter_node(EDGE), build_tracker(Config.from_parameters(EDGE))
    poses, lines = told(node)
    for target in (T, T + 500 * MS):
        steer(node, target, (2.0 if target == T else 0.0, 0.0))
        put(node, target, (7.0, 0.0))
        work(node)
        if target == T:
            node.tell(node.tracker.forecast(T + 100 * MS))
            node.tell(node.tracker.forecast(T + 4 * SECOND))
    tracker.control(T, (2.0, 0.0))
    tracker.control(T + 500 * MS, (0.0, 0.0))
    for stamp_ns in (T, T + 500 * MS):
        tracker.observe(Measurement(stamp_ns, 'main', (7.0, 0.0)))
    assert (poses, lines) == ([T, T + 100 * MS, T + 500 * MS], ['forecast'])
    assert node.restarts == 0
    assert (node.tracker.estimate().belief.mean() == tracker.estimate().belief.mean()).all()


def test_a_belief_that_has_left_the_grid_where_it_was_measured_begins_anew(graph):
    node = graph.filter_node(EDGE)
    poses, lines = told(node)
    steer(node, T, (2.0, 0.0))
    for stamp_ns in (T, T + 4 * SECOND):
        put(node, stamp_ns, (7.0, 0.0))
        work(node)
    assert (poses, node.restarts, node.tracker.stamp_ns) == ([T], 1, None)
    assert 'off the grid' in lines


def spans(tracker):
    """Return the nanoseconds of each prediction that a tracker is asked for, from now on."""
    found, carried = [], tracker._carried

    def recorded(before, stamp_ns):
        found.append(stamp_ns - (before.stamp_ns or stamp_ns))
        return carried(before, stamp_ns)

    tracker._carried = recorded
    return found


def is_followed(node, stamps):
    """Return whether measurements at some stamps are poses at once, and nothing is predicted."""
    (poses, _), asked = told(node), spans(node.tracker)
    for stamp_ns in stamps:
        put(node, stamp_ns, HERE)
        work(node)
    return poses == list(stamps) and max(asked) <= 100 * MS


AGAIN = [T + k * 100 * MS for k in range(3)]


@pytest.mark.parametrize(('rate', 'length'), [(0.0, 3600), (20.0, 3600), (20.0, 2)])
def test_after_a_reset_a_recording_may_be_played_again_from_its_beginning(graph, rate, length):
    node = graph.filter_node({**PLANE, 'publish.rate': rate})
    put(node, T + length * SECOND, HERE)
    work(node)
    assert answer(node._starting._on_reset).success
    _, lines = told(node)
    assert is_followed(node, AGAIN) and lines == ['back']


def test_after_a_reset_no_target_is_predicted_to_what_it_published_long_after(graph, tmp_path):
    bank = bank_of(graph, tmp_path)
    targets = list(bank.targets.values())
    for stamp_ns in (T + 3600 * SECOND, T):
        for target in targets:
            answer(target._starting._on_reset)
            put(target, stamp_ns, HERE)
        asked = [leg for target in targets for leg in [spans(target.tracker)]]
        foresee, together = bank._bank.foresee, []
        bank._bank.foresee = lambda pairs: foresee(together.append(p) or p for p in pairs)
        bank._work()
        bank._bank.foresee = foresee
    assert [target._poses.epoch.newest_ns for target in targets] == [T, T]
    assert asked == [[0], [0]] and {stamp_ns for _, stamp_ns in together} == {T}


def test_a_state_of_long_ago_is_published_at_its_stamp(graph, tmp_path):
    node = graph.filter_node({**PLANE, 'state_file': str(tmp_path / 'state')})
    put(node, T, HERE)
    work(node)
    assert answer(node._resuming._on_save).success
    put(node, T + 1000 * SECOND, HERE)
    work(node)
    (poses, lines), asked = told(node), spans(node.tracker)
    assert answer(node._resuming._on_load).success
    node._work()
    assert (poses, lines, asked) == ([T], ['back'], [0])


@pytest.mark.parametrize('times, is_reset', [({}, True), (
    {'time.max_gap': 1.0, 'time.max_forecast': 5.0}, False)],
    ids=['after a reset', 'of longer forecasts than gaps'])
def test_no_pose_goes_back_behind_a_forecast(graph, times, is_reset):
    node = graph.filter_node({**PLANE, 'use_sim_time': True, 'time.history': 10.0, **times})
    if is_reset:
        answer(node._starting._on_reset)
    poses, lines = told(node)
    put(node, T, HERE)
    work(node)
    node.tell(node.tracker.forecast(T + 5 * SECOND))
    put(node, T + 100 * MS, HERE)
    work(node)
    assert (poses, lines) == ([T, T + 5 * SECOND, T + 5 * SECOND], [])


@pytest.mark.parametrize('wish', ['_on_reset', '_on_global'])
def test_who_begins_anew_before_the_first_clock_does_not_go_on_from_the_file(
        graph, tmp_path, wish):
    file, simulated = tmp_path / 'state', {**PLANE, 'use_sim_time': True}
    with closing(Graph(tmp_path)) as before:
        node = before.filter_node({**PLANE, 'state_file': str(file)})
        put(node, T, (2.0, 2.0))
        work(node)
        node.finish()
    content = file.read_bytes()
    rig = Rig(graph, {**simulated, 'state_file': str(file)})
    getattr(rig.node._starting, wish)(Trigger.Request(), Trigger.Response())
    wanted = rig.node.tracker.newest.belief
    rig.tick(T + SECOND)
    rig.node._resuming._on_clock(None)
    assert rig.node.tracker.newest.belief is wanted and rig.node.tracker.stamp_ns is None
    assert answer(rig.node._resuming._on_save).success
    assert (tmp_path / 'state.refused').read_bytes() == content


def test_a_target_is_predicted_to_the_time_that_it_has_heard_itself(graph, tmp_path):
    bank = bank_of(graph, tmp_path, **{'use_sim_time': True, 'publish.rate': 10.0})
    targets, hours = list(bank.targets.values()), (T + 50 * SECOND, T + 100 * MS)
    for target, now_ns in zip(targets, hours):
        target.get_clock().set_ros_time_override(
            Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))
        put(target, now_ns - 50 * MS, HERE)
    bank._work()
    bank._on_timer(Rest(FORECASTS_TAKE, 0.1), targets)
    assert tuple(target._poses.epoch.newest_ns for target in targets) == hours


def test_a_target_that_is_not_watched_says_so(graph, tmp_path):
    target = bank_of(graph, tmp_path).targets['alpha']
    put(target, T, HERE)
    work(target)
    assert 'not watched' in belief_status(target.facts()).message


def test_the_sums_are_told_once_where_a_node_is_cleaned_up_and_shut_down(graph):
    node = graph.filter_node({**PLANE, 'autostart': False})
    lines = []
    node.get_logger = lambda: SimpleNamespace(
        info=lines.append, warning=lines.append, error=lines.append)
    node.trigger_configure()
    node.trigger_activate()
    put(node, T, HERE)
    for trigger in (node.trigger_deactivate, node.trigger_cleanup, node.trigger_shutdown):
        trigger()
    node.finish()
    assert [line for line in [*lines, str(node.accounts)] if 'received' in line] == [
        'cleaned up; main: 1 received, 1 accepted, 0 rejected, 0 dropped']


@pytest.mark.parametrize(('main', 'arguments', 'stray'), [
    (single.main, ['--params-file', 'robot.yaml'], 'expected ROS arguments after --ros-args, got '
     "'--params-file'"),
    (fleet.main, ['--ros-args', '-p', 'a:=1', '--', 'b'], 'expected ROS arguments after '
     "--ros-args, got 'b'"),
    (single.main, ['--ros-args', 'a.yaml'], 'expected only ROS arguments after --ros-args, got '
     "'a.yaml'")], ids=['forgotten --ros-args', 'after --', 'among those of ROS'])
def test_an_argument_that_is_not_for_ros_is_refused_in_one_line(
        monkeypatch, capsys, main, arguments, stray):
    monkeypatch.setattr(single, 'Signals', lambda: lambda: True)
    monkeypatch.setattr(single, 'logs_to_stdout', lambda: None)
    name = 'filter_bank' if main is fleet.main else 'filter_node'
    assert main([name, *arguments]) == 2
    assert capsys.readouterr() == ('', f'{name}: {stray}\n')


@pytest.mark.parametrize('main', [single.main, fleet.main])
def test_who_asks_for_help_is_told_how_to_use_it(monkeypatch, capsys, main):
    monkeypatch.setattr(single, 'Signals', lambda: lambda: True)
    monkeypatch.setattr(single, 'logs_to_stdout', lambda: None)
    assert main(['node', '--help']) == 0
    out, err = capsys.readouterr()
    assert out.startswith('usage: filter_') and '--ros-args' in out and not err


SECTIONS = """
/**/filter_bank: {ros__parameters: {targets: [alpha, charlie]}}
/alpha/filter_node: {ros__parameters: {frame_id: map}}
bravo: {filter_node: {ros__parameters: {frame_id: map}}}
/**/charlie/filter_node: {ros__parameters: {frame_id: map}}
/*/filter_node: {ros__parameters: {frame_id: map}}
/**/alphaa/filter_node: {ros__parameters: {frame_id: map}}
/delta/filter_node: {ros__parameters: {frame_id: map}}
/amcl: {ros__parameters: {alpha1: 0.2}}
"""


def test_sections_for_filter_nodes_that_are_no_targets_are_named(tmp_path):
    path = tmp_path / 'bank.yaml'
    path.write_text(SECTIONS, encoding='utf-8')
    arguments = ['filter_bank', '--ros-args', '--params-file', str(path)]
    # this process has two targets, and another one has charlie
    assert fleet.nobodys(arguments, '', ['alpha', 'bravo']) == [
        '/**/alphaa/filter_node', '/delta/filter_node']
    assert fleet.nobodys(arguments, '/fleet', ['bravo'])[0] == '/alpha/filter_node'


def test_each_reason_for_which_a_pose_is_refused_is_told(graph):
    node = graph.filter_node(PLANE)
    lines = []
    node.get_logger = lambda: SimpleNamespace(warning=lines.append)
    for wrong in ({'frame': 'odom'}, {'x': 99.0}, {'frame': 'odom'}, {'variances': (-1.0, 1.0)}):
        node._starting._on_initial_pose(start(stamp_ns=0, **wrong))
    assert len(lines) == 3
    assert node.accounts.initial_pose.rejected == {
        'other frame': 2, 'off the grid': 1, 'bad covariance': 1}
