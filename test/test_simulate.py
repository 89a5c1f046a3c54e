"""The simulator, heard over DDS."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
import signal
import sys
import time
from typing import Any

from geometry_msgs.msg import PointStamped, PoseStamped, PoseWithCovarianceStamped, TwistStamped
import numpy as np
from pif_ros.config import ConfigError
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import System, SYSTEMS
from pif_ros.scenario import BEGIN_NS
from pif_ros.simulate import understood
from pif_ros.simulation_node import Simulator
import pytest
from rclpy.node import Node
from ros import (DEEP, Executable, executable, Graph, nanoseconds, SECOND, stamp_into,
                 write_parameters)
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, Range
from std_msgs.msg import Float64MultiArray

#: A plane, small and soon simulated, in the simulator's own time and much faster than that.
PLANE = {
    'use_sim_time': True, 'model.name': 'position_2d', 'frame_id': 'hall',
    'grid.lower': [-9.0, -9.0], 'grid.upper': [9.0, 9.0], 'grid.shape': [20, 20],
    'prior.covariance_diagonal': [1.0, 1.0], 'kernel.time_step': 0.1,
    'measurements.main.topic': 'fix', 'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}
FAST = {'speed': 100.0, 'duration': 1.0, 'timeout': 10.0}


class Listener(Node):
    """
    Notes everything that is played, in the order of its coming.

    respond: how many of the measurements are answered by a pose of their stamp.
    """

    def __init__(self, graph: Graph, respond: int = 0, **topics: type) -> None:
        """Subscribe to the topics of some types, and to what each simulation has."""
        super().__init__('filter_node', context=graph.context, use_global_arguments=False)
        self.measured: list[tuple[str, Any]] = []
        self.truths: list[PoseStamped] = []
        self.states: list[JointState] = []
        self.clocks: list[int] = []
        self._respond = respond
        self._poses = self.create_publisher(PoseWithCovarianceStamped, '~/pose', 10)
        for topic, kind in topics.items():
            self.create_subscription(
                kind, topic, lambda msg, topic=topic: self._on_measurement(topic, msg), DEEP)
        self.create_subscription(PoseStamped, 'truth', self.truths.append, DEEP)
        self.create_subscription(JointState, 'truth_state', self.states.append, DEEP)
        self.create_subscription(Clock, '/clock', lambda msg: self.clocks.append(
            nanoseconds(msg.clock)), DEEP)

    def _on_measurement(self, topic: str, msg: Any) -> None:
        self.measured.append((topic, msg))
        if len(self.measured) <= self._respond:
            pose = PoseWithCovarianceStamped()
            stamp_into(pose.header.stamp, nanoseconds(msg.header.stamp))
            self._poses.publish(pose)


def simulator(graph: Graph, parameters: Mapping[str, Any] = PLANE, **settings: Any) -> Simulator:
    """Return a simulator of some parameters."""
    path = write_parameters(graph._folder / 'parameters.yaml', parameters)
    with graph.refusals():
        return graph.add(Simulator({**FAST, **settings}, context=graph.context,
                                   use_global_arguments=False,
                                   cli_args=['--ros-args', '--params-file', str(path)]))


def spinner(graph: Graph) -> Callable[[float], None]:
    """Return what runs all callbacks of a graph that are due, after the time for the first."""
    def spin(timeout: float) -> None:
        for seconds in [timeout, *[0.0] * 20]:
            graph.executor.spin_once(timeout_sec=seconds)
    return spin


def play(graph: Graph, listener: Listener, parameters: Mapping[str, Any] = PLANE,
         **settings: Any) -> Simulator:
    """Play to a listener until it has heard everything."""
    player = simulator(graph, parameters, **settings)
    player.play(spinner(graph))
    count = len(player.scenario.truth)
    graph.until(lambda: len(listener.measured) >= count * len(player._outlets)
                and len(listener.truths) == len(listener.states) == count, 'all is heard')
    return player


def stamps(messages: Any) -> list[int]:
    """Return the stamps of some messages."""
    return [nanoseconds(message.header.stamp) for message in messages]


def test_every_measurement_and_the_truth_are_heard_once_with_stamp_frame_and_value(graph):
    listener = graph.add(Listener(graph, fix=JointState))
    played = play(graph, listener).scenario
    expected = [BEGIN_NS + 100_000_000 * k for k in range(11)]
    fixes = [message for _, message in listener.measured]
    assert stamps(fixes) == stamps(listener.truths) == stamps(listener.states) == expected
    assert {m.header.frame_id for m in [*fixes, *listener.truths, *listener.states]} == {'hall'}
    assert [list(m.position) for m in fixes] == played.measurements['main'].tolist()
    assert [list(m.position) for m in listener.states] == played.truth.tolist()
    assert all(m.name == ['x', 'y'] for m in listener.states)
    for message, (x, y) in zip(listener.truths, played.truth):
        position, orientation = message.pose.position, message.pose.orientation
        assert (position.x, position.y, position.z, orientation.w) == (x, y, 0.0, 1.0)


def test_the_same_seed_is_heard_alike_to_the_last_bit_and_another_is_not(graph):
    heard = []
    for seed in (5, 5, 6):
        listener = graph.add(Listener(graph, fix=JointState))
        play(graph, listener, seed=seed)
        heard.append([(m.header.stamp, m.position) for _, m in listener.measured]
                     + [(m.header.stamp, m.position) for m in listener.states])
        graph.executor.remove_node(listener)
    assert heard[0] == heard[1] != heard[2]


def test_the_clock_never_runs_back_and_reaches_no_stamp_that_has_not_been_sent(graph):
    listener = graph.add(Listener(graph, fix=JointState))
    play(graph, listener, speed=2.0)
    graph.until(lambda: listener.clocks[-1] == BEGIN_NS + SECOND - 1, 'the last clock')
    clocks = listener.clocks
    sent = stamps(message for _, message in listener.measured)
    assert np.diff(clocks).min() >= 0 and not set(clocks) & set(sent)
    assert {stamp - 1 for stamp in sent} <= set(clocks)
    # between two measurements, 50 ms of a listener's time apart, it goes on
    assert max(np.diff(sorted(set(clocks)))) <= 100_000_000


def test_a_second_at_double_speed_takes_half_a_second(graph):
    listener = graph.add(Listener(graph, fix=JointState))
    player = simulator(graph, speed=2.0)
    graph.until(lambda: not player._missing())
    began = time.monotonic()
    player.play(spinner(graph))
    assert 0.5 <= time.monotonic() - began - 0.5 < 1.5  # the other half is the clock's lead
    graph.until(lambda: len(listener.measured) == 11)


def test_without_a_time_of_its_own_the_stamps_are_those_of_the_system(graph):
    listener = graph.add(Listener(graph, fix=JointState))
    before = time.time_ns()
    play(graph, listener, {**PLANE, 'use_sim_time': False}, speed=1.0, duration=0.3)
    found = stamps(message for _, message in listener.measured)
    assert before < found[0] and found[-1] < time.time_ns()
    assert np.diff(found).tolist() == [100_000_000] * 3 and not listener.clocks


def test_a_path_begins_at_0(graph):
    parameters = {
        'use_sim_time': True, 'model.name': 'cubic_sensor', 'grid.lower': [-5.0],
        'grid.upper': [5.0], 'grid.shape': [50], 'prior.mean': [0.0],
        'prior.covariance_diagonal': [0.1], 'filter.type': 'dfy', 'kernel.time_step': 0.1}
    listener = graph.add(Listener(graph, measurement=Float64MultiArray))
    path = play(graph, listener, parameters).scenario.measurements['main']
    assert [list(m.data) for _, m in listener.measured] == path.tolist() and path[0] == 0.0


def test_sources_have_topics_of_their_own_or_share_the_messages_of_one(graph):
    several = {
        **PLANE, 'measurements.names': ['east', 'north', 'west'],
        **{f'measurements.{name}.{key}': value for name, point, topic, kind, field in (
            ('east', [5.0, 0.0], 'both', 'geometry_msgs/msg/PointStamped', 'point.x'),
            ('north', [0.0, 5.0], 'both', 'geometry_msgs/msg/PointStamped', 'point.z'),
            ('west', [-5.0, 0.0], 'west', 'sensor_msgs/msg/Range', 'range'))
           for key, value in (('topic', topic), ('type', kind), ('fields', [field]),
                              ('sensor', 'range'), ('params.landmark', point),
                              ('params.sigma', 0.1))}}
    for key in [key for key in several if key.startswith('measurements.main')]:
        del several[key]
    listener = graph.add(Listener(graph, both=PointStamped, west=Range))
    played = play(graph, listener, several).scenario.measurements
    both = [m.point for topic, m in listener.measured if topic == 'both']
    assert [p.x for p in both] == played['east'][:, 0].tolist()
    assert [p.z for p in both] == played['north'][:, 0].tolist() and not any(p.y for p in both)
    ranges = [m.range for topic, m in listener.measured if topic == 'west']
    assert ranges == played['west'][:, 0].astype(np.float32).tolist()


def test_at_speed_0_nothing_is_sent_before_what_came_before_it_is_answered(graph):
    """Oracle: a listener that answers only four measurements has heard five at the time-out."""
    listener = graph.add(Listener(graph, respond=4, fix=JointState))
    player = simulator(graph, speed=0.0, timeout=1.0)
    with pytest.raises(TimeoutError, match='no pose on /filter_node/pose .* at 1.400 s'):
        player.play(spinner(graph))
    assert len(listener.measured) == 5


def test_says_who_is_missing_where_nobody_listens(graph):
    with pytest.raises(TimeoutError, match='nobody at /fix, /clock after 0.2 s'):
        simulator(graph, timeout=0.2).play(spinner(graph))


def test_stops_at_once_when_told_to(graph):
    listener = graph.add(Listener(graph, fix=JointState))
    simulator(graph, duration=50.0, speed=10.0).play(
        spinner(graph), stopped=lambda: len(listener.measured) >= 5)
    assert 5 <= len(listener.measured) <= 7


@pytest.mark.parametrize('parameters, settings, line', [
    ({'use_sim_time': False}, {'speed': 2.0}, 'speed: expected 1 where use_sim_time is false'),
    ({'measurements.main.type': 'std_msgs/msg/Float64MultiArray',
      'measurements.main.fields': ['data']}, {'speed': 0.0}, 'speed: expected one above 0 where'),
    ({'measurements.main.type': 'no_msgs/msg/Fix'}, {}, 'measurements.main.type: expected'),
    ({'measurements.main.fields': ['position', 'velocity']}, {},
     'measurements.main.fields: expected fields that hold 2 numbers'),
    ({'measurements.main.fields': ['position[0]']}, {},
     'measurements.main.fields: expected fields that hold 2 numbers'),
    ({'measurements.main.type': 'std_msgs/msg/UInt8MultiArray',
      'measurements.main.topic': 'whole', 'measurements.main.fields': []}, {'start': [-5.0, 5.0]},
     "measurements.main.fields: expected numbers from 0 to 255 for 'data' (uint8), got -"),
    ({'pose.axes': ['x', 'z']}, {}, 'pose.axes: expected'),
    ({'grid.shap': [20, 20]}, {}, 'grid.shap: expected a known parameter'),
    ({'sed': 3}, {}, 'sed: expected a known parameter'),
    ({'seed': -3}, {}, 'seed: expected a whole number, 0 or more, got -3'),
    ({}, {'start': [1.0]}, 'start: expected 2 values'),
])
def test_what_cannot_be_simulated_is_refused_in_one_line(graph, parameters, settings, line):
    with pytest.raises(ConfigError) as refused:
        simulator(graph, {**PLANE, **parameters}, **settings)
    assert str(refused.value).startswith(line) and '\n' not in str(refused.value)


def test_what_changes_with_time_needs_a_time_of_its_own(graph, monkeypatch):
    def rising() -> System:
        model = StateModel(('x',), lambda x, t: np.full_like(x, t), [[1e-6]], time_dependent=True)
        return System(model, {'position': lambda: Sensor(lambda x, t: x + t, [[1e-12]],
                                                         time_dependent=True)})

    monkeypatch.setitem(SYSTEMS, 'rising', rising)
    line = {'use_sim_time': True, 'model.name': 'rising', 'grid.lower': [-9.0],
            'grid.upper': [9.0], 'grid.shape': [20], 'prior.mean': [0.0],
            'prior.covariance_diagonal': [1.0], 'kernel.time_step': 0.01}
    played = simulator(graph, line, start=[0.0]).scenario
    # from 1 s, where it begins, to 2 s: 1.5, within half a substep; the sensor adds 2
    assert played.truth[-1, 0] == pytest.approx(1.5, abs=0.001)
    assert played.measurements['main'][-1, 0] == pytest.approx(3.5, abs=0.001)
    with pytest.raises(ConfigError, match='^use_sim_time: expected true .* got False$'):
        simulator(graph, {**line, 'use_sim_time': False}, speed=1.0)


def test_a_terminal_sees_how_far_it_is(graph, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    play(graph, graph.add(Listener(graph, fix=JointState)))
    assert '100%' in capsys.readouterr().err


def test_without_tqdm_a_terminal_sees_nothing(graph, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    monkeypatch.setitem(sys.modules, 'tqdm', None)
    listener = graph.add(Listener(graph, fix=JointState))
    play(graph, listener)
    assert capsys.readouterr().err == '' and listener.measured


def test_settings_may_stand_among_the_parameters_and_arguments_count_above_them(graph):
    player = simulator(graph, {**PLANE, 'seed': 7, 'duration': 3, 'rate': 20}, duration=2.0)
    assert (player.settings.seed, player.settings.duration, player.settings.rate) == (7, 2.0, 20.0)
    assert len(player.scenario.truth) == 41


def process(folder: Path, *arguments: str) -> AbstractContextManager[Executable]:
    """Return the executable, with some arguments."""
    return executable(folder, '--', *arguments, module='pif_ros.simulate')


def test_a_named_system_is_played_to_the_end_with_status_0(graph, tmp_path):
    listener = graph.add(Listener(graph, measurement=JointState))
    with process(tmp_path, '--system', 'wiener', '--duration', '1', '--seed', '3', '--speed', '50',
                 '--ros-args', '-p', 'measurements.main.sensor:=position') as running:
        status, *_ = running.end(lambda: graph.executor.spin_once(timeout_sec=0.05))
    assert (status, running.stderr) == (0, '')
    graph.until(lambda: len(listener.measured) == 11)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_status_0_and_not_a_word(tmp_path, number):
    with process(tmp_path, '--system', 'wiener') as running:
        running.until(lambda: 'waiting for the other end' in running.stdout, 'it waits')
        running.signal(number)
        running.signal(number)
        status, *_ = running.end()
    assert (status, running.stderr) == (0, '')


@pytest.mark.parametrize('arguments, line', [
    (['--system', 'lorenz'], '--system: expected one of arctangent_sensor, '),
    (['--sytem', 'wiener'], 'unrecognized arguments: --sytem wiener'),
    (['--syste', 'wiener'], 'unrecognized arguments: --syste wiener'),
    (['--seed', 'x'], "argument --seed: invalid int value: 'x'"),
    (['--seed'], 'argument --seed: expected one argument'),
])
def test_arguments_that_are_none_are_refused_in_one_line(arguments, line):
    with pytest.raises(ValueError) as refused:
        understood(['simulate', *arguments, '--ros-args', '-p', 'frame_id:=hall'])
    assert str(refused.value).startswith(line) and '\n' not in str(refused.value)


def test_a_named_system_is_its_parameter_file_before_all_else_and_settings_are_read():
    arguments, given = understood([
        'simulate', '--system', 'wiener', '--start', '-1.5', '2', '--no-inside', '--seed', '3',
        '--ros-args', '-p', 'frame_id:=hall'])
    before, _, after = ' '.join(arguments).partition(' -- ')
    assert before.startswith('simulate --ros-args --params-file /')
    assert before.endswith('/config/wiener.yaml')
    assert after.endswith('--ros-args -p frame_id:=hall')
    assert given == {'start': [-1.5, 2.0], 'inside': False, 'seed': 3}
    assert understood(['simulate', '--path']) == (['simulate', '--path'], {'path': True})


def process_fails(folder: Path, *arguments: str) -> str:
    """Return the one line with which the executable refuses some arguments."""
    with process(folder, *arguments) as running:
        status, *_ = running.end()
    assert status == 2 and running.stderr.count('\n') == 1
    return running.stderr


def test_what_makes_no_simulation_is_one_line_and_status_2(tmp_path):
    assert process_fails(tmp_path, '--system', 'wiener', '--duration', '-1') == (
        'simulate: duration: expected a positive number, got -1.0\n')
    assert process_fails(tmp_path, '--ros-args', '--params-file', '/absent.yaml') == (
        'simulate: /absent.yaml: expected a readable file, got No such file or directory\n')


def test_parameters_for_another_node_only_are_refused(tmp_path):
    path = write_parameters(tmp_path / 'robot.yaml', {'model.name': 'wiener'}, '/filter_node')
    assert process_fails(tmp_path, '--ros-args', '--params-file', str(path)) == (
        'simulate: --params-file: expected parameters for the node /simulate, got some for '
        '/filter_node only\n')


# What drives a model with inputs

YARD = {
    'use_sim_time': True, 'model.name': 'unicycle_2d', 'filter.type': 'ekf', 'frame_id': 'hall',
    'grid.lower': [-9.0, -9.0, -4.0], 'grid.upper': [9.0, 9.0, 4.0], 'grid.shape': [4, 4, 4],
    'prior.mean': [0.0] * 3, 'prior.covariance_diagonal': [0.1] * 3, 'kernel.time_step': 0.1,
    'control.topic': 'wheels', 'measurements.main.topic': 'fix',
    'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}


def test_what_drives_is_heard_once_at_the_beginning_of_each_interval(graph):
    listener = graph.add(Listener(graph, wheels=TwistStamped, fix=JointState))
    player = simulator(graph, YARD)
    player.play(spinner(graph))
    controls = player.scenario.controls
    graph.until(lambda: len(listener.measured) == 2 * len(controls.values), 'all is heard')
    heard = [message for topic, message in listener.measured if topic == 'wheels']
    assert tuple(stamps(heard)) == controls.stamps_ns
    assert tuple((m.twist.linear.x, m.twist.angular.z) for m in heard) == controls.values


def test_says_that_nobody_hears_what_drives(graph):
    graph.add(Listener(graph, fix=JointState))
    player = simulator(graph, YARD, timeout=0.5)
    with pytest.raises(TimeoutError, match='nobody at /wheels after'):
        player.play(spinner(graph))


@pytest.mark.parametrize(('parameters', 'line'), [
    ({'control.type': 'geometry_msgs/msg/Twist', 'control.fields': ['linear.x', 'angular.z']},
     'speed: expected one above 0 where messages bear no stamp (geometry_msgs/msg/Twist)'),
    ({'control.fields': ['twist.linear.x']}, 'control.fields: expected fields that hold 2 numb'),
    ({'control.type': 'no'}, 'control.type: expected a message type such as')])
def test_refuses_a_control_that_cannot_be_sent(graph, parameters, line):
    with pytest.raises(ConfigError) as refused:
        simulator(graph, {**YARD, **parameters}, speed=0.0)
    assert str(refused.value).startswith(line)
