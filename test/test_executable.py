"""The executable filter_node, in a process of its own, over DDS."""

import os
import signal
import threading
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from ros import DEEP, executable, nanoseconds, write_parameters
from sensor_msgs.msg import JointState

SECOND = 1_000_000_000
SMALL = {
    'model.name': 'position_2d', 'grid.lower': [-3.0, -3.0], 'grid.upper': [3.0, 3.0],
    'grid.shape': [20, 20], 'kernel.time_step': 0.1, 'publish.rate': 0.0,
    'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}

STRANGER = 'ekf_filter_node:\n  ros__parameters: {frequency: 30.0}\n'
NODE = 'filter_node:\n  ros__parameters:\n'
WRONG = {
    'unknown parameter': (NODE + '    grid: {lowr: [-6.0, -6.0]}\n',
                          ['grid.lowr: expected', "'grid.lower'?", 'got [-6.0, -6.0]']),
    'not a number': (NODE + '    prior: {mean: [.nan, 0.0]}\n',
                     ['prior.mean: expected', 'finite', 'got [nan, 0.0]']),
    'too large': (NODE + '    grid: {shape: [60000, 60000]}\n',
                  ['grid.shape: expected', 'memory', 'got [60000, 60000]']),
    'empty list': (NODE + '    grid: {shape: []}\n', ['grid.shape: expected 2 values', 'got []']),
    'bad topic': (NODE + "    measurements: {main: {topic: 'no topic'}}\n",
                  ['measurements.main.topic: expected', "got 'no topic'"]),
    'mixed list': (NODE + '    grid: {lower: [-6, -6.5]}\n',
                   ['grid.lower: expected', 'one type', 'got [-6, -6.5]']),
    'plain y': (NODE + '    pose: {axes: [x, y]}\n', ["'y'", 'quotes']),
    'broken file': (NODE + '    grid: [\n', ['expected YAML']),
    'missing file': (None, ['expected a readable file', 'No such file']),
    "another node's file": (STRANGER, ['/filter_node', 'ekf_filter_node']),
}


@pytest.mark.parametrize('kind', WRONG)
def test_a_wrong_start_is_one_line_on_stderr_and_status_2_within_three_seconds(tmp_path, kind):
    text, words = WRONG[kind]
    path = tmp_path / 'parameters.yaml'
    if text is not None:
        path.write_text(text)
    with executable(tmp_path, '--params-file', str(path)) as node:
        status, wall, busy = node.end()
    assert status == 2
    [line] = node.stderr.splitlines()
    assert line.startswith('filter_node: ')
    for word in words:
        assert word in line
    assert 'Traceback' not in node.stdout
    # from its spawning; where others keep the machine busy, what counts is its own time
    assert min(wall, busy) < 3.0


def check_a_clean_end(node, since, limit):
    """Check that a process ends with status 0 and nothing on stderr, soon after a moment."""
    status, *_ = node.end()
    took = time.monotonic() - since
    assert (status, node.stderr) == (0, '')
    assert 'stopped; main: ' in node.stdout.splitlines()[-1]
    assert took < limit


@pytest.mark.parametrize('signals', [
    (signal.SIGINT,), (signal.SIGTERM,), (signal.SIGINT, signal.SIGINT),
    (signal.SIGINT, signal.SIGTERM)], ids=lambda all_: '+'.join(one.name for one in all_))
def test_a_running_node_ends_cleanly_within_two_seconds_of_a_signal(tmp_path, signals):
    path = write_parameters(tmp_path / 'parameters.yaml', {**SMALL, 'publish.rate': 20.0})
    with executable(tmp_path, '--params-file', str(path)) as node:
        node.until(node.runs, 'it runs')
        since = time.monotonic()
        for number in signals:
            node.signal(number)
            # as far apart as a launch and its terminal send theirs
            time.sleep(0.005)
        check_a_clean_end(node, since, 2.0)


# Parts of a start: as soon as it can hear a signal, while it imports, while it makes the node.
@pytest.mark.parametrize(('part', 'signals'), [
    (0.0, [signal.SIGINT]), (0.2, [signal.SIGTERM]), (0.5, [signal.SIGINT, signal.SIGINT]),
    (0.8, [signal.SIGTERM]), (0.95, [signal.SIGINT])])
def test_a_node_that_is_told_to_end_while_it_starts_ends_cleanly(
        tmp_path, start_time, part, signals):
    path = write_parameters(tmp_path / 'parameters.yaml', SMALL)
    with executable(tmp_path, '--params-file', str(path)) as node:
        node.until(node.handles_signals, 'it handles signals')
        threading.Event().wait(part * start_time)
        since = time.monotonic()
        for number in signals:
            node.signal(number)
        # it may finish what it began, and no more
        check_a_clean_end(node, since, 2.0 + 4 * start_time)


@pytest.fixture(scope='module')
def start_time(tmp_path_factory):
    """Return how long a start takes here and now, from when the node handles signals."""
    folder = tmp_path_factory.mktemp('start')
    path = write_parameters(folder / 'parameters.yaml', SMALL)
    with executable(folder, '--params-file', str(path)) as node:
        node.until(node.handles_signals, 'it handles signals')
        began = time.monotonic()
        node.until(node.runs, 'it runs')
        took = time.monotonic() - began
        node.signal(signal.SIGINT)
        assert node.end()[0] == 0
    return took


class Other:
    """A process beside the node's: it measures, and hears poses."""

    def __init__(self, graph):
        """Meet the node, whichever of both comes later."""
        self.graph, self.poses, self.sent = graph, [], 0
        self.peer = graph.peer()
        self.sender = self.peer.create_publisher(JointState, 'measurement', DEEP)
        self.peer.create_subscription(
            PoseWithCovarianceStamped, '/filter_node/pose', self.poses.append, DEEP)

    def meet(self):
        """Wait until both ends know of each other, and nothing is lost that either sends."""
        self.graph.until(lambda: self.sender.get_subscription_count() == 1
                         and self.peer.count_publishers('/filter_node/pose') == 1,
                         'the processes meet')
        self.graph.introduce(self.peer, '/filter_node')

    def measure(self, stamp_ns, *values):
        """Measure, until a pose with that stamp has come, and return it."""
        message = JointState(position=values)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, SECOND)
        self.sender.publish(message)
        self.sent += 1
        return self.graph.until(lambda: next(
            (p for p in self.poses if nanoseconds(p.header.stamp) == stamp_ns), None), 'a pose')


def test_measurements_of_another_process_become_poses_whatever_that_process_asks(graph, tmp_path):
    path = write_parameters(tmp_path / 'node.yaml', SMALL)
    tracker = build_tracker(Config.from_parameters(SMALL))
    other = Other(graph)
    with executable(tmp_path, '--params-file', str(path)) as node:
        other.meet()
        first = 1_000 * SECOND
        for step in range(10):
            stamp_ns, values = first + step * SECOND // 8, (0.1 * step, 0.2 - 0.05 * step)
            pose = other.measure(stamp_ns, *values)
            tracker.observe(Measurement(stamp_ns, 'main', values))
            x, y = tracker.estimate().belief.mean()
            # another process, perhaps with other threads in its sums
            assert pose.pose.pose.position.x == pytest.approx(x, abs=1e-12)
            assert pose.pose.pose.position.y == pytest.approx(y, abs=1e-12)

        # what ends rclpy.spin(): a type that no parameter has
        ask = other.peer.create_client(SetParameters, '/filter_node/set_parameters')
        graph.until(ask.service_is_ready, 'the service')
        ask.call_async(SetParameters.Request(parameters=[
            Parameter(name='density.rate', value=ParameterValue(type=99))]))
        node.until(lambda: graph.executor.spin_once(timeout_sec=0.02) or 'rclpy: ' in node.stdout,
                   'it tells of the request')
        client = other.peer.create_client(GetParameters, '/filter_node/get_parameters')
        answer = graph.call(client, GetParameters.Request(names=['density.rate']))
        assert answer.values[0].double_value == 1.0
        assert other.measure(first + 3 * SECOND, 0.5, -0.5)

        since = time.monotonic()
        node.signal(signal.SIGINT)
        check_a_clean_end(node, since, 2.0)
    words = node.stdout.splitlines()[-1]
    assert ' 11 accepted, ' in words and ' 0 dropped' in words


def test_all_of_this_stays_on_this_machine_in_a_domain_below_the_ephemeral_ports():
    assert os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert 1 <= int(os.environ['ROS_DOMAIN_ID']) <= 101
