"""Anybody on the network, beside a node in a process of its own, and what that node believes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack
import math
from pathlib import Path
import tempfile
import time
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from proofs.inputs import YARD
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters, SetParametersAtomically
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros import DEEP, executable, Graph, SECOND, stamp_into, write_parameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

PARAMETERS = {
    **YARD, 'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'control.topic': 'drive', 'time.history': 2.0,
    'density.rate': 1000.0}
#: What the node hears, and of what type.
TOPICS = {'fix': JointState, 'drive': TwistStamped, 'initialpose': PoseWithCovarianceStamped}
#: A time long ago, so that no stamp near it is ahead of the clock.
START_NS = 1_000 * SECOND
#: Seconds within which the node must answer after whatever was done to it.
ANSWER = 5.0
#: What sums in another process, with other threads perhaps, may differ by, as a share.
ROUNDING = 1e-9
#: Words of what Python would complain of.
OURS = {'Traceback', 'RuntimeWarning:', 'Exception'}
_RELIABLE = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


class Attacker:
    """Starts a node, makes itself known to it, and may then ask of it what it likes."""

    def __enter__(self) -> Attacker:
        """Start the node, and wait until it answers a measurement."""
        self._stack = ExitStack()
        try:
            self._start(Path(self._stack.enter_context(tempfile.TemporaryDirectory())))
        except BaseException:
            self._stack.close()
            raise
        return self

    def _start(self, folder: Path) -> None:
        path = write_parameters(folder / 'node.yaml', PARAMETERS)
        self.graph = Graph(folder)
        self._stack.callback(self.graph.close)
        self.peer = self.graph.peer('stranger')
        self.process = self._stack.enter_context(
            executable(folder, '--params-file', str(path)))
        self.twin = build_tracker(Config.from_parameters(PARAMETERS))
        self.stamp_ns, self._count = START_NS, 0
        self.densities: list[Float64MultiArray] = []
        self.peer.create_subscription(Float64MultiArray, '/filter_node/density',
                                      self.densities.append, _RELIABLE)
        self.senders = {topic: self.peer.create_publisher(kind, topic, DEEP)
                        for topic, kind in TOPICS.items()}
        self.graph.until(lambda: all(s.get_subscription_count() for s in self.senders.values()),
                         'the node hears')
        self._clients: dict[str, Any] = {}
        self.call(GetParameters, 'get_parameters', GetParameters.Request(names=['frame_id']))
        self._measure_until_heard()

    def __exit__(self, *_: object) -> None:
        """End all of it."""
        self._stack.close()

    def _measure_until_heard(self) -> None:
        """Send the same measurement until its density comes: DDS may still make the way back."""
        message = self._fix()
        self.graph.until(lambda: self.densities or self.senders['fix'].publish(message),
                         'the first density')
        self.twin.observe(Measurement(self.stamp_ns, 'main', tuple(message.position)))
        self.check_belief()

    def _fix(self) -> JointState:
        message = JointState(position=[0.3 * math.sin(self._count), 0.2 * math.cos(self._count)])
        stamp_into(message.header.stamp, self.stamp_ns)
        return message

    def spin(self, seconds: float) -> None:
        """Let callbacks run for some time."""
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self.graph.executor.spin_once(timeout_sec=left)

    def client(self, kind: Any, name: str) -> Any:
        """Return a client of one of the node's services, once that is there."""
        if name not in self._clients:
            whole = name if name.startswith('/') else f'/filter_node/{name}'
            self._clients[name] = self.peer.create_client(kind, whole)
            self.graph.until(self._clients[name].service_is_ready, f'the service {name}')
        return self._clients[name]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Return a service's answer; AssertionError where none comes in time."""
        future = self.client(kind, name).call_async(request)
        self.wait(future.done, ANSWER, f'an answer of {name}')
        return future.result()

    def wait(self, happened: Callable[[], Any], seconds: float, what: str) -> None:
        """Wait for something that must happen in time."""
        until = time.monotonic() + seconds
        while not happened():
            assert time.monotonic() < until, f'{what}: none in {seconds:g} s'
            assert self.process.process.poll() is None, f'the node ended: {self.process.stderr}'
            self.graph.executor.spin_once(timeout_sec=0.02)

    def set(self, *parameters: Parameter, atomically: bool = False) -> list[Any]:  # noqa: A003
        """Return what the node says to parameters that are set."""
        if atomically:
            return [self.call(SetParametersAtomically, 'set_parameters_atomically',
                              SetParametersAtomically.Request(parameters=parameters)).result]
        return self.call(SetParameters, 'set_parameters',
                         SetParameters.Request(parameters=parameters)).results

    def check(self) -> float:
        """Check that the node lives, answers and believes what its twin does; return seconds."""
        began = time.monotonic()
        answer = self.call(GetParameters, 'get_parameters',
                           GetParameters.Request(names=['frame_id', 'use_sim_time']))
        assert answer.values[0].string_value == 'map', f'another frame_id: {answer.values[0]}'
        assert not answer.values[1].bool_value, 'another use_sim_time'
        answered = time.monotonic() - began
        self._count += 1
        self.stamp_ns += SECOND // 10
        self.densities.clear()
        message = self._fix()
        self.senders['fix'].publish(message)
        self.wait(lambda: self.densities, ANSWER, 'a density')
        assert self.twin.observe(
            Measurement(self.stamp_ns, 'main', tuple(message.position))) is None
        self.check_belief()
        # the middleware tells there, in C, of messages that are none
        assert not OURS.intersection(self.process.stderr.split()), (
            f'on stderr: {self.process.stderr}')
        return answered

    def check_belief(self) -> None:
        """Check that the newest density is the twin's, normalised, on the grid."""
        belief = self.twin.estimate().belief
        grid = belief.base if hasattr(belief, 'base') else belief.grid
        expected = belief.on(grid, range(grid.ndim)).normalised().density
        found = np.frombuffer(self.densities[-1].data).reshape(expected.shape)
        error = np.abs(found - expected).max() / expected.max()
        assert error <= ROUNDING, f'another belief than the twin, by {error:g} of its peak'


@contextmanager
def stranger() -> Iterator[Graph]:
    """Return a participant of its own."""
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder))
        try:
            yield graph
        finally:
            graph.close()


def number(name: str, value: float) -> Parameter:
    """Return a parameter that is a real number."""
    return Parameter(name=name, value=ParameterValue(
        type=ParameterType.PARAMETER_DOUBLE, double_value=value))


def text(name: str, value: str) -> Parameter:
    """Return a parameter that is a text."""
    return Parameter(name=name, value=ParameterValue(
        type=ParameterType.PARAMETER_STRING, string_value=value))


def flag(name: str, value: bool) -> Parameter:
    """Return a parameter that is true or false."""
    return Parameter(name=name, value=ParameterValue(
        type=ParameterType.PARAMETER_BOOL, bool_value=value))
