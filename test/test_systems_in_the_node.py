"""Every example of config/: simulated, sent over DDS, and believed as the library believes it."""

from pathlib import Path
from typing import Any

from pif_ros import fields
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.core.systems import SYSTEMS
from pif_ros.filter_node import FilterNode
from pif_ros.scenario import BEGIN_NS
from pif_ros.simulation_node import Outlet, Simulator
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from ros import Graph, ROOT, write_parameters
import yaml

FILES = sorted((ROOT / 'config').glob('*.yaml'))
#: Measurements that are sent.
COUNT = 10

#: Fewer cells where the kernel takes a second to make.
COARSE = {'lorenz_63': [16, 16, 16], 'multiplicative_4d': [6, 6, 6, 6], 'position_2d': [40, 40],
          'plaza_range_only': [42, 36]}


def changes(path: Path) -> dict[str, Any]:
    """Return what is told beside a file: time by the simulator, and stamps on all messages."""
    config = Config.from_yaml(path)
    changed: dict[str, Any] = {'use_sim_time': True, 'publish.rate': 0.0}
    for name, source in config.measurements.sources.items():
        if not fields.has_header(fields.message_class(source.type)):
            changed[f'measurements.{name}.type'] = 'sensor_msgs/msg/JointState'
            changed[f'measurements.{name}.fields'] = ['position']
    if path.stem in COARSE:
        changed['grid.shape'] = COARSE[path.stem]
    return changed


def heard(player: Simulator, outlet: Outlet, k: int) -> list[Measurement]:
    """Return what is measured by the k-th message of a topic, once it has been on the wire."""
    message = outlet.type()
    for source, write in outlet.writers.items():
        write(message, player.scenario.measurements[source][k])
    message = deserialize_message(serialize_message(message), outlet.type)
    stamp_ns = BEGIN_NS + int(player.scenario.elapsed_ns[k])
    return [Measurement(stamp_ns, source, fields.field_reader(
        outlet.type, player.config.measurements.sources[source].fields)(message))
        for source in outlet.writers]


def played(graph: Graph, path: Path, *files: str) -> tuple[FilterNode, Simulator]:
    """Return a node and a simulator that has played to it, each told the same."""
    node = graph.filter_node_of(path, *files)
    given = {'speed': 0.0, 'timeout': 20.0}
    player = graph.add(Simulator(
        {**given, 'duration': _seconds(node, path)}, context=graph.context,
        use_global_arguments=False, cli_args=['--ros-args', '--params-file', str(path), *files]))
    player.play(lambda timeout: graph.executor.spin_once(timeout_sec=timeout))
    for name in player.scenario.measurements:
        account = node.accounts.sources[name]
        graph.until(lambda: account.received == COUNT, f'all of {name}')
    return node, player


def _seconds(node: FilterNode, path: Path) -> float:
    """Return how long a file's simulation takes for so many measurements."""
    own = (yaml.safe_load(path.read_text()).get('simulate') or {}).get('ros__parameters', {})
    rate = own.get('rate', 1 / node.config.kernel.time_step)
    return (COUNT - 0.5) / rate


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_the_node_believes_of_a_simulation_what_the_library_does_to_the_last_bit(
        path, graph, tmp_path):
    over = write_parameters(tmp_path / 'over.yaml', changes(path))
    node, player = played(graph, path, '--params-file', str(over))
    tracker, controls = build_tracker(node.config), player.scenario.controls
    for k in range(COUNT):
        if controls.values:
            assert tracker.control(controls.stamps_ns[k], controls.values[k]) is None
        for outlet in player._outlets:
            for measurement in heard(player, outlet, k):
                assert tracker.observe(measurement) is None
        tracker.estimate()
    if controls.values:
        graph.until(lambda: node.accounts.control.accepted == COUNT, 'all controls')
    found, expected = node.tracker.estimate(), tracker.estimate()
    assert found.stamp_ns == expected.stamp_ns == BEGIN_NS + player.scenario.elapsed_ns[-1]
    assert found.total_log_evidence == expected.total_log_evidence
    assert _bits(found.belief) == _bits(expected.belief)
    for name in player.scenario.measurements:
        assert node.accounts.sources[name].accepted == COUNT
    assert node.faults == 0


def _bits(belief: Any) -> tuple[bytes, ...]:
    """Return the moments of a belief and its density, where it has one; of a path's, of now."""
    now = getattr(belief, 'now', belief)
    return (now.mean().tobytes(), now.covariance().tobytes(),
            getattr(now, 'density', now.mean()).tobytes())


@pytest.mark.parametrize('name', SYSTEMS)
def test_every_named_system_has_an_example_that_is_of_it(name):
    [path] = [path for path in FILES if path.stem == name]
    assert Config.from_yaml(path).model.name == name
