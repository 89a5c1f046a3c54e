"""From a measurement to its pose through the node, beside a node that only echoes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from typing import TYPE_CHECKING

from benchmarks.progress import Progress
from benchmarks.report import Row, Table
from benchmarks.timing import Contestant, Effort, interleave, Samples
import numpy as np
from pif_ros import share

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.node import Node

CONFIG = 'config/coupled_trigonometric.yaml'
#: No pose but the answers: the timer's would be taken for them.
QUIET = ('-p', 'publish.rate:=0.0')
PER_TURN, TURNS, PASSES = 25, 10, 5
RATE = 100.0
STEADY, BURSTS = '100 per second to each', f'{PER_TURN} at 100 per second, then rest'
STATE = np.array([2.0, -1.5])
LIMIT_S = 30.0
ECHO = 'echo'


def run(effort: Effort) -> Table:
    """Start the nodes, each a process in a namespace of its own, and question them in turns."""
    with ExitStack() as stack:
        _keep_ros_to_itself(stack.enter_context(tempfile.TemporaryDirectory()))
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        client, executor = rclpy.create_node('client'), SingleThreadedExecutor()
        executor.add_node(client)
        peers = {name: stack.enter_context(Peer(f'/peer_{i}', command, client, executor))
                 for i, (name, command) in enumerate(_commands().items())}
        for peer in peers.values():
            peer.wait_until_connected()
        rows = []
        for setting, (per_turn, turns, pause_s) in _paces(len(peers)).items():
            samples = interleave(
                {name: Contestant(peer.ask, per_turn, pause_s=pause_s)
                 for name, peer in peers.items()},
                turns, effort.scaled(PASSES, 1), Progress(f'node: {setting}'))
            rows += [_row(name, setting, taken.reshape(-1, PER_TURN),
                          samples[ECHO].reshape(-1, PER_TURN))
                     for name, taken in samples.items()]
    return Table('The node over DDS, a measurement out and its pose back', rows, [
        'Each node is a process of its own, and this one is the client; times are round trips, '
        "the client's own work and both ways over DDS included, so that beyond the echo, the "
        "difference of the medians, is what the filter adds between a measurement's arrival "
        'and its pose leaving.',
        f'{CONFIG}, with publish.rate 0: between measurements the node rests. The echo has the '
        'same types, quality of service and executor.',
        f'{rows[0].accuracy["samples"]:.0f} round trips or more each.  {STEADY}: in turn, so that '
        f'none ever rests; {BURSTS}: the others have their {PER_TURN} before, during which the '
        'filter is forgotten by the processor and has as long to predict.'])


class Peer:
    """A process whose node answers measurements, and the client's connection to it."""

    def __init__(self, space: str, command: Sequence[str], client: Node,
                 executor: Executor) -> None:
        """Start it in a namespace."""
        from geometry_msgs.msg import PoseWithCovarianceStamped
        from pif_ros import interface
        from std_msgs.msg import Float64MultiArray
        self._space = space
        self._client, self._executor, self._answers = client, executor, 0
        self._publisher = client.create_publisher(
            Float64MultiArray, f'{self._space}/measurement', 10)
        client.create_subscription(
            PoseWithCovarianceStamped, self._topic, self._on_pose, interface.POSE.qos)
        rng = np.random.default_rng(3)
        self._measurements = [Float64MultiArray(data=(STATE**2 + w).tolist())
                              for w in rng.standard_normal((1000, 2))]
        self._process = subprocess.Popen(
            [sys.executable, '-m', *command, '-r', f'__ns:={self._space}'],
            stdout=subprocess.DEVNULL)

    def __enter__(self) -> Peer:
        return self

    def __exit__(self, *_: object) -> None:
        """End the process as a user would."""
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(LIMIT_S)
        finally:
            self._process.kill()

    @property
    def _topic(self) -> str:
        return f'{self._space}/filter_node/pose'

    def wait_until_connected(self) -> None:
        """Return when both topics are matched; raises RuntimeError where they are not in time."""
        self._spin_until(lambda: self._publisher.get_subscription_count() > 0
                         and self._client.count_publishers(self._topic) > 0)
        # a reader that is counted may still be unmatched on the other side: ask until answered
        deadline = time.monotonic() + LIMIT_S
        while not self._answers and time.monotonic() < deadline:
            self._publisher.publish(self._measurements[0])
            self._executor.spin_once(timeout_sec=0.2)
        while time.monotonic() < deadline:
            before = self._answers
            self._executor.spin_once(timeout_sec=0.5)
            if self._answers == before:
                return

    def ask(self, k: int) -> None:
        """Send the k-th measurement and wait for its pose."""
        wanted = self._answers + 1
        self._publisher.publish(self._measurements[k % len(self._measurements)])
        self._spin_until(lambda: self._answers >= wanted)

    def _on_pose(self, _: object) -> None:
        self._answers += 1

    def _spin_until(self, done: Callable[[], bool]) -> None:
        deadline = time.monotonic() + LIMIT_S
        while not done():
            self._executor.spin_once(timeout_sec=0.1)
            if self._process.poll() is not None:
                raise RuntimeError(f'{self._space}: ended with {self._process.returncode}')
            if time.monotonic() > deadline:
                raise RuntimeError(f'{self._space}: no answer in {LIMIT_S:g} s')


def _commands() -> dict[str, list[str]]:
    node = ['pif_ros.node', '--ros-args', '--params-file', str(share.find(CONFIG)), *QUIET]
    return {ECHO: ['benchmarks.echo', '--ros-args'],
            'filter_node': node,
            'filter_node, not watched': [*node, '-p', 'lost.false_alarm_rate:=0.0']}


def _paces(peers: int) -> dict[str, tuple[int, int, float]]:
    """Return measurements in a turn, turns, and the rest before each, in seconds."""
    return {'one after the other': (PER_TURN, TURNS, 0.0),
            STEADY: (1, PER_TURN * TURNS, 1 / (RATE * peers)),
            BURSTS: (PER_TURN, TURNS, 1 / RATE)}


def _row(name: str, setting: str, samples: Samples, echo: Samples) -> Row:
    beyond = 1e6 * float(np.median(samples) - np.median(echo))
    tails = np.percentile(samples, 99) / np.percentile(echo, 99)
    return Row.timed(name, setting, samples, echo, ECHO,
                     {'ratio of p99': float(tails),
                      'us beyond the echo': None if name == ECHO else beyond,
                      'samples': float(samples.size)})


def _keep_ros_to_itself(log_folder: str) -> None:
    """Keep the traffic on this machine and in a domain of its own, and the logs out of the way."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(random.randint(1, 101)))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['ROS_LOG_DIR'] = log_folder
