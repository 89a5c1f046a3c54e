"""The node's state across restarts: who was stopped goes on as if it never had been."""

from contextlib import closing
import itertools
import math
import signal

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, TwistStamped
from pif_ros.config import build_tracker, Config, ConfigError
from pif_ros.core.estimates import Measurement
from pif_ros.filter_bank import FilterBank
from pif_ros.keeper import Keeper
import pytest
from rclpy.serialization import serialize_message
from ros import executable, Graph, nanoseconds, PLANE, Rig, SECOND, stamp_into, write_parameters
from std_srvs.srv import Trigger
import yaml

T = 1_000 * SECOND
MS = 1_000_000
SIMULATED = {'use_sim_time': True, 'publish.rate': 10.0, 'time.history': 0.5}
YARD = {
    **PLANE, 'model.name': 'unicycle_2d', 'model.params.sigma_position': 0.2,
    'grid.lower': [-9.0, -9.0, -math.pi], 'grid.upper': [9.0, 9.0, math.pi],
    'grid.shape': [24, 24, 16], 'grid.periodic': [False, False, True],
    'prior.mean': [0.5, -0.5, 3.0], 'prior.covariance_diagonal': [0.3, 0.2, 0.1],
    'control.hold': 0.5}
del YARD['model.params.diffusion']
LIVES = {'df': PLANE, 'active, driven': YARD, 'ekf, driven': {**YARD, 'filter.type': 'ekf'},
         'particle': {**PLANE, 'filter.type': 'particle', 'filter.particles': 500},
         'dfy': {**PLANE, 'filter.type': 'dfy'}, 'ukf': {**PLANE, 'filter.type': 'ukf'},
         'ekf_continuous': {**PLANE, 'filter.type': 'ekf_continuous'}}

#: What happens, in milliseconds: a tick of the clock, a control, or a measurement.
BEFORE = [('tick', 0), ('control', 10, 1.0, 0.3), ('fix', 0, 0.1, -0.2), ('tick', 110),
          ('fix', 100, 0.2, -0.1), ('tick', 250), ('fix', 240, 0.3, 0.0), ('tick', 620),
          ('control', 550, 0.5, -0.4), ('fix', 610, 0.4, 0.2), ('tick', 760)]
#: The first two are late, and what was published last is ahead of both.
AFTER = [('fix', 550, 0.3, 0.1), ('control', 560, 0.7, 0.2), ('fix', 630, 0.5, 0.3),
         ('tick', 900), ('fix', 880, 0.6, 0.3), ('tick', 1030), ('tick', 1500),
         ('fix', 1400, 0.9, 0.5), ('fix', 1200, 0.7, 0.4), ('tick', 1700)]


def fix(stamp_ns, x, y):
    """Return the message of a position."""
    message = PointStamped()
    stamp_into(message.header.stamp, stamp_ns)
    message.point.x, message.point.y = x, y
    return message


def live(rig, events):
    """Let some things happen to a node, each once the one before is done with."""
    driven = bool(rig.node.tracker.filter.model.inputs)
    for kind, ms, *values in events:
        stamp_ns, heard = T + ms * MS, len(rig.poses)
        if kind == 'tick':
            # a forecast is due however long the last one took on a busy machine
            rig.node._rest.end()
            rig.tick(stamp_ns)
            if rig.node.tracker.stamp_ns is not None:
                rig.pose_at(stamp_ns)
        elif kind == 'fix':
            rig.send('fix', fix(stamp_ns, *values))
            rig.graph.until(lambda: len(rig.poses) > heard, 'a pose')
        elif driven:
            message, account = TwistStamped(), rig.node.accounts.control
            before = account.received
            stamp_into(message.header.stamp, stamp_ns)
            message.twist.linear.x, message.twist.angular.z = values
            rig.send('control', message)
            rig.graph.until(lambda: account.received > before
                            and not rig.node.inbox.has_work, 'the control')


def spent(rig):
    """Stop a node as its process does at a signal, and return the poses that came from it."""
    rig.node.finish()
    return [serialize_message(pose) for pose in rig.poses]


@pytest.mark.parametrize('life', LIVES)
def test_who_was_saved_stopped_and_started_again_publishes_bitwise_the_poses_of_a_twin(
        tmp_path, life):
    parameters = {**LIVES[life], **SIMULATED}
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, parameters)
        live(rig, BEFORE)
        before = len(rig.poses)
        live(rig, AFTER)
        twin = spent(rig)
    kept = {**parameters, 'state_file': str(tmp_path / 'state')}
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept)
        live(rig, BEFORE)
        assert spent(rig) == twin[:before]
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept)
        assert rig.node.tracker.stamp_ns is None, 'there is no clock yet'
        live(rig, BEFORE[-1:])
        live(rig, AFTER)
        # it says where it is when it starts; then it goes on
        assert spent(rig) == [twin[before - 1], *twin[before:]]
        assert rig.lines == []


def kept(folder, **more):
    """Return parameters with a state file."""
    return {**PLANE, 'state_file': str(folder / 'state'), **more}


def follow(rig, *seconds):
    """Measure, and wait for each pose."""
    for second in seconds:
        stamp_ns = T + second * SECOND
        rig.send('fix', fix(stamp_ns, 0.1 * second, 0.2))
        rig.pose_at(stamp_ns)


def density(rig):
    return rig.node.tracker.estimate().belief.density.tobytes()


def newest_in(file, config):
    """Return the newest stamp in a state file, None where there is none yet."""
    keeper = Keeper(config, build_tracker(config), lambda kind, line: None)
    return keeper.load(T + 1000 * SECOND)[0].stamp_ns if file.exists() else None


def ask(rig, service):
    """Return the answer of a service of the node without a request."""
    return rig.graph.call(rig.client(Trigger, f'/filter_node/{service}'), Trigger.Request())


def test_what_was_saved_is_believed_again_when_asked_for(graph, tmp_path):
    rig = Rig(graph, kept(tmp_path))
    follow(rig, 0, 1)
    saved, evidence = density(rig), rig.node.tracker.estimate().total_log_evidence
    answer = ask(rig, 'save_state')
    assert (answer.success, answer.message) == (True, f'saved to {tmp_path / "state"}')
    follow(rig, 2, 3)
    assert density(rig) != saved
    answer = ask(rig, 'load_state')
    assert (answer.success, answer.message) == (True, f'goes on from {tmp_path / "state"}')
    assert density(rig) == saved
    assert rig.node.tracker.estimate().total_log_evidence == evidence
    # what was measured since may be measured again
    follow(rig, 4)
    assert rig.node.accounts.sources['main'].accepted == 5
    assert rig.node.faults == 0 and rig.stamps == sorted(rig.stamps)


def test_without_a_state_file_both_services_say_so(graph):
    rig = Rig(graph, PLANE)
    for service in ('save_state', 'load_state'):
        answer = ask(rig, service)
        assert (answer.success, answer.message) == (
            False, "state_file: expected a file, got '' (none)")


def test_a_damaged_file_is_refused_in_a_line_and_nothing_is_touched(graph, tmp_path):
    rig, file = Rig(graph, kept(tmp_path)), tmp_path / 'state'
    follow(rig, 0, 1)
    assert ask(rig, 'save_state').success
    follow(rig, 2)
    believed, sound = density(rig), file.read_bytes()
    for damaged in (sound[:-1], sound[:30], b'', sound[:-9] + b'x' + sound[-8:], b'\x80\x04.'):
        file.write_bytes(damaged)
        answer = ask(rig, 'load_state')
        assert not answer.success and answer.message.startswith('state_file: ')
        assert len(answer.message.splitlines()) == 1
        assert density(rig) == believed and file.read_bytes() == damaged
    file.write_bytes(sound)
    assert ask(rig, 'load_state').success and rig.node.faults == 0


def test_a_start_from_a_damaged_file_is_one_from_the_prior_and_keeps_the_file(graph, tmp_path):
    file = tmp_path / 'state'
    file.write_bytes(b'precious')
    rig = Rig(graph, kept(tmp_path))
    assert rig.line('state_file: ', 'expected').endswith(': from the prior')
    assert rig.node.tracker.newest.belief is rig.node.tracker.prior
    follow(rig, 0)
    assert file.read_bytes() == b'precious'
    assert ask(rig, 'save_state').success
    assert file.with_name('state.refused').read_bytes() == b'precious'


def test_a_start_with_another_filter_names_what_differs(tmp_path):
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept(tmp_path))
        follow(rig, 0)
        spent(rig)
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept(tmp_path, **{'kernel.time_step': 0.05}))
        rig.line('state_file: kernel.time_step: expected 0.05 as it is now, got a state with 0.1')


def test_what_is_new_is_saved_every_period_and_survives_a_kill(graph, tmp_path):
    rig, file = Rig(graph, kept(tmp_path, checkpoint_period=0.1)), tmp_path / 'state'
    follow(rig, 0, 1)
    follow(rig, 2)

    graph.until(lambda: newest_in(file, rig.node.config) == T + 2 * SECOND, 'a checkpoint of all')


def test_a_state_from_before_the_clock_began_anew_is_refused_at_the_first_clock(tmp_path):
    parameters = kept(tmp_path, **SIMULATED)
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, parameters)
        live(rig, BEFORE[:4])
        spent(rig)
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, parameters)
        answer = ask(rig, 'load_state')
        assert not answer.success and 'expected a /clock before it' in answer.message
        rig.tick(T - 100 * SECOND)
        rig.line('state_file: expected a state from before now, got one from 100.', 'ahead')
        assert rig.node.tracker.stamp_ns is None


def test_a_reset_is_saved_too(tmp_path):
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept(tmp_path))
        follow(rig, 0)
        assert ask(rig, 'save_state').success and ask(rig, 'reset').success
        spent(rig)
    with closing(Graph(tmp_path)) as graph:
        rig = Rig(graph, kept(tmp_path, **{'prior.mean': [1.0, 1.0]}))
        assert rig.node.tracker.newest.belief is rig.node.tracker.prior
        assert rig.lines == []


def test_the_targets_of_a_bank_have_a_file_each(tmp_path):
    def bank(graph, **files):
        own = {f'/{name}/filter_node': {'state_file': str(tmp_path / file)}
               for name, file in files.items()}
        tree = {'/**': PLANE, 'filter_bank': {'targets': list(files)}, **own}
        path = tmp_path / 'bank.yaml'
        path.write_text(yaml.safe_dump({
            node: {'ros__parameters': dict(told)} for node, told in tree.items()}))
        made = FilterBank(context=graph.context, use_global_arguments=False, cli_args=[
            '--ros-args', '--params-file', str(path)])
        for node in made.nodes:
            graph.add(node)
        return made

    def seen(made):
        return {name: target.tracker.estimate().belief.density.tobytes()
                for name, target in made.targets.items()}

    with closing(Graph(tmp_path)) as graph:
        with pytest.raises(ConfigError, match='^/bravo/filter_node: state_file: expected a file '
                                              "for each target, got '.*/same', which is "
                                              "/alpha/filter_node's$"):
            bank(graph, alpha='same', bravo='same')
    with closing(Graph(tmp_path)) as graph:
        made = bank(graph, alpha='a', bravo='b')
        for k, target in enumerate(made.targets.values()):
            for step in range(3):
                target.tracker.observe(Measurement(T + step * SECOND, 'main', (0.1 * k, 0.2)))
        believed = seen(made)
        made.finish()
    with closing(Graph(tmp_path)) as graph:
        made = bank(graph, alpha='a', bravo='b')
        assert all(target.tracker.backlog == 2 for target in made.targets.values())
        graph.until(lambda: not any(target.tracker.backlog for target in made.targets.values()),
                    'the replay, without any message')
        assert seen(made) == believed


def test_a_killed_process_goes_on_from_its_checkpoint_and_saves_at_its_end(
        graph, tmp_path, monkeypatch):
    # over memory that Fast DDS shares with one that is killed, the next may not be heard soon
    monkeypatch.setenv('FASTDDS_BUILTIN_TRANSPORTS', 'UDPv4')
    parameters = kept(tmp_path, checkpoint_period=0.1)
    path = write_parameters(tmp_path / 'node.yaml', parameters)
    config = Config.from_parameters(parameters)
    poses, peer = [], graph.peer()
    sender = peer.create_publisher(PointStamped, 'fix', 100)
    peer.create_subscription(PoseWithCovarianceStamped, '/filter_node/pose', poses.append, 100)
    file, tracker, seconds = tmp_path / 'state', build_tracker(config), itertools.count()

    def measure(second):
        """Measure until there is a pose of it: over and over, since the node may not hear yet."""
        stamp_ns, values = T + second * SECOND, (0.1 * second, 0.2)

        def seen():
            sender.publish(fix(stamp_ns, *values))
            return [pose for pose in poses if nanoseconds(pose.header.stamp) == stamp_ns]

        tracker.observe(Measurement(stamp_ns, 'main', values))
        return graph.until(seen, 'a pose')[-1]

    def follow_with(node):
        graph.introduce(peer, '/filter_node')
        for _ in range(3):
            pose = measure(next(seconds))
        # the other process may have other threads in its sums
        x, y = tracker.estimate().belief.mean()
        assert pose.pose.pose.position.x == pytest.approx(x, abs=1e-12)
        assert pose.pose.pose.position.y == pytest.approx(y, abs=1e-12)

    with executable(tmp_path, '--params-file', str(path)) as node:
        follow_with(node)
        node.until(lambda: newest_in(file, config) == tracker.stamp_ns, 'a checkpoint')
        node.signal(signal.SIGKILL)
        node.end()
    with executable(tmp_path, '--params-file', str(path), '-p', 'checkpoint_period:=0.0') as node:
        node.until(lambda: 'goes on from' in node.stdout, 'it goes on')
        follow_with(node)
        node.signal(signal.SIGINT)
        assert node.end()[0] == 0
    assert newest_in(file, config) == tracker.stamp_ns
