"""ROS for tests: nodes that meet in this process, and the node's executable in one of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
import gc
import os
from pathlib import Path
import signal
import subprocess
import sys
import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from pif_ros.filter_node import FilterNode
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
import yaml

ROOT = Path(__file__).resolve().parent.parent
#: Seconds that something may take on a busy machine before it counts as not happening.
PATIENCE = 30.0
SECOND = 1_000_000_000
#: A point in the plane that is seen where it is.
PLANE = {
    'model.name': 'position_2d', 'model.params.diffusion': 0.5,
    'grid.lower': [-3.0, -4.0], 'grid.upper': [3.0, 4.0], 'grid.shape': [20, 24],
    'prior.mean': [0.5, -0.5], 'prior.covariance_diagonal': [1.0, 2.0],
    'kernel.time_step': 0.1, 'publish.rate': 0.0,
    'measurements.main.topic': 'fix', 'measurements.main.type': 'geometry_msgs/msg/PointStamped',
    'measurements.main.fields': ['point.x', 'point.y'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.3}

DEEP = QoSProfile(depth=1000)
_LATCHED = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def nanoseconds(stamp: Any) -> int:
    """Return the time of a message."""
    return stamp.sec * SECOND + stamp.nanosec


def stamp_into(stamp: Any, stamp_ns: int) -> None:
    """Write a time into a message."""
    stamp.sec, stamp.nanosec = divmod(stamp_ns, SECOND)


def write_parameters(path: Path, parameters: Mapping[str, Any], node: str = '/**') -> Path:
    """Write a parameter file as users do, and return its path."""
    tree = {node: {'ros__parameters': dict(parameters)}}
    path.write_text(yaml.dump(tree, Dumper=_Quoting), encoding='utf-8')
    return path


class _Quoting(yaml.SafeDumper):
    """Puts all text into quotes, since ROS takes a plain y for true."""


_Quoting.add_representer(str, lambda dumper, text: dumper.represent_scalar(
    'tag:yaml.org,2002:str', text, style="'"))


class Graph:
    """Nodes of this process, each of whose callbacks runs only while something is waited for."""

    def __init__(self, folder: Path) -> None:
        """Bring ROS up in a context of its own; parameter files go into the folder."""
        self.context = Context()
        rclpy.init(context=self.context, args=[])
        self.executor = SingleThreadedExecutor(context=self.context)
        self._folder = folder
        self._nodes: list[Node] = []
        self._refused = False

    def close(self) -> None:
        """Take it all down."""
        self.executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        if self._refused:
            # a node that was refused is on the graph for as long as it is in the memory, and
            # takes the log of the next of its name with it when it goes
            gc.collect()
        rclpy.try_shutdown(context=self.context)

    def filter_node(self, parameters: Mapping[str, Any], *arguments: str) -> FilterNode:
        """Return a filter node that reads parameters from a file, with further ROS arguments."""
        path = write_parameters(self._folder / 'parameters.yaml', parameters)
        return self.filter_node_of(path, *arguments)

    def filter_node_of(self, path: Path, *arguments: str) -> FilterNode:
        """Return a filter node with a parameter file and further ROS arguments."""
        with self.refusals():
            return self.add(FilterNode(
                context=self.context, use_global_arguments=False,
                cli_args=['--ros-args', '--params-file', str(path), *arguments]))

    @contextmanager
    def refusals(self) -> Iterator[None]:
        """Let a node be made that may refuse to be, which leaves more to take down."""
        try:
            yield
        except Exception:
            self._refused = True
            raise

    def peer(self, name: str = 'peer') -> Node:
        """Return a node that does nothing yet."""
        return self.add(rclpy.create_node(name, context=self.context, use_global_arguments=False))

    def add(self, node: Any) -> Any:
        """Let the callbacks of a node run with the others."""
        self._nodes.append(node)
        self.executor.add_node(node)
        return node

    def until(self, happened: Callable[[], Any], what: str = 'it') -> Any:
        """Run callbacks until something has happened, and return what it returns."""
        deadline = time.monotonic() + PATIENCE
        while not (found := happened()):
            assert time.monotonic() < deadline, f'{what} did not happen within {PATIENCE} s'
            self.executor.spin_once(timeout_sec=0.02)
        return found

    def introduce(self, peer: Node, name: str) -> None:
        """
        Wait until a node of another process knows each subscription that a peer has by now.

        Before that, what it publishes for them is lost.  A process is told of another's readers in
        the order in which they were made: one that answers knows all that are older than the one
        for its answer.
        """
        client, asked = peer.create_client(GetParameters, f'{name}/get_parameters'), []

        def answered() -> bool:
            asked.append(client.call_async(GetParameters.Request()))
            return any(future.done() for future in asked)

        self.until(client.service_is_ready, f'{name} is there')
        self.until(answered, f'an answer of {name}')

    def call(self, client: Client, request: Any) -> Any:
        """Return a service's answer."""
        self.until(client.service_is_ready, f'{client.srv_name} is there')
        future = client.call_async(request)
        self.until(future.done, f'an answer of {client.srv_name}')
        return future.result()


class Rig:
    """
    A filter node, and a peer that measures and hears what the node publishes and says.

    poses: all that came on ~/pose; lines: all warnings.
    """

    def __init__(self, graph: Graph, parameters: Mapping[str, Any], *arguments: str,
                 name: str = '/filter_node') -> None:
        """Bring both up and let them find each other."""
        self.graph = graph
        self.node = graph.filter_node(parameters, *arguments)
        self.peer = graph.peer()
        self.name = name
        self.poses: list[PoseWithCovarianceStamped] = []
        self.lines: list[str] = []
        self._senders: dict[str, Any] = {}
        self.peer.create_subscription(Log, '/rosout', self._on_log, _LATCHED)
        self.hear(PoseWithCovarianceStamped, f'{name}/pose', self.poses)

    def hear(self, kind: type, topic: str, into: list[Any], qos: QoSProfile = DEEP) -> None:
        """Put all that comes on a topic into a list from now on."""
        subscription = self.peer.create_subscription(kind, topic, into.append, qos)
        self.graph.until(lambda: self.peer.count_publishers(subscription.topic_name)
                         and any(p.get_subscription_count() for p in self.node.publishers
                                 if p.topic_name == subscription.topic_name),
                         f'a publisher of {topic}')

    def send(self, topic: str, message: Any, qos: QoSProfile = DEEP) -> None:
        """Publish on a topic that the node hears."""
        if topic not in self._senders:
            sender = self._senders[topic] = self.peer.create_publisher(type(message), topic, qos)
            self.graph.until(sender.get_subscription_count, f'a subscription to {topic}')
        self._senders[topic].publish(message)

    def tick(self, now_ns: int) -> None:
        """Set the time of /clock, and wait until the node has it."""
        message = Clock()
        stamp_into(message.clock, now_ns)
        self.send('/clock', message)
        self.graph.until(lambda: self.node.get_clock().now().nanoseconds == now_ns,
                         'the node hears the clock')

    def client(self, kind: type, name: str) -> Client:
        """Return a client of a service."""
        return self.peer.create_client(kind, name)

    def handled(self, count: int, source: str = 'main') -> None:
        """Wait until so many measurements of a source are accounted for."""
        account = self.node.accounts.sources[source]
        self.graph.until(lambda: account.accepted + account.rejected.total() + account.dropped
                         >= count, f'measurement {count} of {source}')

    def pose_at(self, stamp_ns: int) -> PoseWithCovarianceStamped:
        """Wait for a pose with a stamp or a later one, and return the last that came."""
        self.graph.until(lambda: self.poses and nanoseconds(self.poses[-1].header.stamp)
                         >= stamp_ns, f'a pose at {stamp_ns}')
        return self.poses[-1]

    def line(self, *words: str) -> str:
        """Wait for a warning that has all of these words, and return it."""
        return self.graph.until(
            lambda: next((line for line in self.lines if all(w in line for w in words)), None),
            f'a warning with {words}')

    @property
    def stamps(self) -> list[int]:
        """Return the stamps of the poses that came."""
        return [nanoseconds(pose.header.stamp) for pose in self.poses]

    def _on_log(self, log: Log) -> None:
        if log.name == self.name.strip('/').replace('/', '.') and log.level >= 30:
            self.lines.append(log.msg)


class Executable:
    """
    The executable filter_node, or another module, in a process of its own.

    Its output is in files.
    """

    def __init__(self, folder: Path, *arguments: str, module: str = 'pif_ros.node') -> None:
        """Start it with some ROS arguments."""
        self.began = time.monotonic()
        self._out, self._err = folder / 'stdout', folder / 'stderr'
        with self._out.open('wb') as out, self._err.open('wb') as err:
            self.process = subprocess.Popen(
                [sys.executable, '-X', 'faulthandler', '-m', module, '--ros-args', *arguments],
                cwd=ROOT, stdout=out, stderr=err)

    @property
    def stdout(self) -> str:
        """Return what it has written so far."""
        return self._out.read_text(encoding='utf-8', errors='replace')

    @property
    def stderr(self) -> str:
        """Return what it has complained of so far."""
        return self._err.read_text(encoding='utf-8', errors='replace')

    def until(self, happened: Callable[[], Any], what: str) -> None:
        """Wait for something that the process does."""
        deadline = time.monotonic() + PATIENCE
        while not happened():
            assert self.process.poll() is None, f'it ended before {what}: {self.stderr}'
            assert time.monotonic() < deadline, f'{what} did not happen: {self._stuck()}'
            time.sleep(0.005)

    def handles_signals(self) -> bool:
        """Return whether it has a handler of its own for SIGTERM."""
        status = Path(f'/proc/{self.process.pid}/status').read_text(encoding='ascii')
        caught = int(next(line.split()[1] for line in status.splitlines()
                          if line.startswith('SigCgt')), 16)
        return bool(caught >> (signal.SIGTERM - 1) & 1)

    def runs(self) -> bool:
        """Return whether the node has said that it is made."""
        return 'made in' in self.stdout

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal; where it has ended by itself, end() still tells how."""
        os.kill(self.process.pid, number)

    def end(self, meanwhile: Callable[[], Any] = lambda: time.sleep(0.005),
            ) -> tuple[int, float, float]:
        """
        Wait for the end: status, seconds of wall time and of processor time since the start.

        Meanwhile, something is done over and over.
        """
        deadline = time.monotonic() + PATIENCE
        while True:
            pid, status, usage = os.wait4(self.process.pid, os.WNOHANG)
            if pid:
                break
            assert time.monotonic() < deadline, f'it does not end: {self.stdout}{self._stuck()}'
            meanwhile()
        self.process.returncode = os.waitstatus_to_exitcode(status)
        return (self.process.returncode, time.monotonic() - self.began,
                usage.ru_utime + usage.ru_stime)

    def _stuck(self) -> str:
        """End it for good, and return what it complained of and where each of its threads was."""
        self.signal(signal.SIGABRT)
        self.process.wait()
        return self.stderr


@contextmanager
def executable(folder: Path, *arguments: str,
               module: str = 'pif_ros.node') -> Iterator[Executable]:
    """
    Run the executable for as long as it is needed, and never longer.

    It is told to end: over memory that Fast DDS shares with one that is killed, the next may not
    be heard soon.
    """
    running = Executable(folder, *arguments, module=module)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.signal(signal.SIGTERM)
            running.end()
