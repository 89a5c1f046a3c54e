"""The executable filter_bank, in processes of its own, over DDS."""

from contextlib import ExitStack
import signal

from geometry_msgs.msg import PoseWithCovarianceStamped
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
import pytest
from ros import DEEP, executable, nanoseconds, SECOND, stamp_into, write_parameters
from sensor_msgs.msg import JointState

SMALL = {
    'model.name': 'position_2d', 'grid.lower': [-3.0, -3.0], 'grid.upper': [3.0, 3.0],
    'grid.shape': [20, 20], 'kernel.time_step': 0.1, 'publish.rate': 0.0,
    'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}
T = 1_000
PROCESSES = {'first': ['alpha', 'bravo'], 'second': ['charlie']}
FILTERS = 'pif_ros.bank'

WRONG = {
    'no targets': (SMALL, [], ['targets: expected names of namespaces', 'got none']),
    'no name': (SMALL, ['-p', 'targets:=[alpha, a/b]'], ['targets: expected', "got 'a/b'"]),
    'one of another size': (
        {'grid.shape': [20, 22]}, ['-p', 'targets:=[alpha, bravo]'],
        ['/bravo/filter_node: grid.shape: expected [62, 62] as /alpha/filter_node has',
         'got [20, 22]']),
}


@pytest.mark.parametrize('kind', WRONG)
def test_a_wrong_start_is_one_line_on_stderr_and_status_2_within_three_seconds(tmp_path, kind):
    told, arguments, words = WRONG[kind]
    path = write_parameters(tmp_path / 'parameters.yaml', told, '/bravo/filter_node')
    with executable(tmp_path, '--params-file', str(path), *arguments, module=FILTERS) as bank:
        status, wall, busy = bank.end()
    assert status == 2
    [line] = bank.stderr.splitlines()
    assert line.startswith('filter_bank: ')
    for word in words:
        assert word in line
    assert 'Traceback' not in bank.stdout
    # from its spawning; where others keep the machine busy, what counts is its own time
    assert min(wall, busy) < 3.0


def test_a_file_for_other_nodes_alone_is_refused(tmp_path):
    path = write_parameters(tmp_path / 'parameters.yaml', {'frequency': 30.0}, 'ekf_filter_node')
    with executable(tmp_path, '--params-file', str(path), '-p', 'targets:=[alpha]',
                    module=FILTERS) as bank:
        status, *_ = bank.end()
    assert (status, bank.stderr) == (2, 'filter_bank: --params-file: expected parameters for the '
                                     'node /filter_bank, got some for ekf_filter_node only\n')


def test_two_processes_share_the_targets_by_their_namespaces_and_end_cleanly(graph, tmp_path):
    path = write_parameters(tmp_path / 'bank.yaml', SMALL)
    peer, poses, senders, trackers = graph.peer(), {}, {}, {}
    for name in sum(PROCESSES.values(), []):
        poses[name] = []
        peer.create_subscription(PoseWithCovarianceStamped, f'/{name}/filter_node/pose',
                                 poses[name].append, DEEP)
        senders[name] = peer.create_publisher(JointState, f'/{name}/measurement', DEEP)
        trackers[name] = build_tracker(Config.from_parameters(SMALL))

    def measure(name, stamp_ns, values):
        message = JointState(position=values)
        stamp_into(message.header.stamp, stamp_ns)
        senders[name].publish(message)

    def latest(name):
        return nanoseconds(poses[name][-1].header.stamp) if poses[name] else None

    with ExitStack() as stack:
        banks = []
        for process, targets in PROCESSES.items():
            (tmp_path / process).mkdir()
            banks.append(stack.enter_context(executable(
                tmp_path / process, '--params-file', str(path), '-p',
                f'targets:=[{", ".join(targets)}]', module=FILTERS)))
        graph.until(lambda: all(s.get_subscription_count() == 1 for s in senders.values()),
                    'the processes meet')
        for name in trackers:
            graph.introduce(peer, f'/{name}/filter_node')
        for step in range(5):
            stamp_ns = T * SECOND + step * SECOND // 8
            for number, (name, tracker) in enumerate(trackers.items()):
                values = (0.1 * step, 0.3 * number)
                measure(name, stamp_ns, values)
                tracker.observe(Measurement(stamp_ns, 'main', values))
            graph.until(lambda: all(latest(name) == stamp_ns for name in poses), 'all poses')
            for name, tracker in trackers.items():
                at, mean = poses[name][-1].pose.pose.position, tracker.estimate().belief.mean()
                # another process, perhaps with other threads in its sums
                assert [at.x, at.y] == pytest.approx(list(mean), abs=1e-12)
        for bank, targets in zip(banks, PROCESSES.values()):
            bank.signal(signal.SIGINT)
            status, *_ = bank.end()
            assert (status, bank.stderr) == (0, '')
            last = bank.stdout.splitlines()[-1]
            assert 'stopped; ' in last and last.count('5 accepted, ') == len(targets)
            for name in targets:
                assert f'{name}: main: ' in last
