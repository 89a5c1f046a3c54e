"""More than 20 kinds of hostile requests: the node lives, answers, and believes what it did."""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from benchmarks.progress import Progress
from geometry_msgs.msg import PoseWithCovarianceStamped
from proofs.attacker import Attacker, flag, number, PARAMETERS, START_NS, stranger, text, TOPICS
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (DescribeParameters, GetParameters, GetParameterTypes,
                                ListParameters, SetParameters, SetParametersAtomically)
from rclpy.serialization import serialize_message
from ros import DEEP, SECOND, stamp_into
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from type_description_interfaces.srv import GetTypeDescription

MEGABYTES = 10_000_000
MANY = 20_000
#: Nobody from afar may fill the disk by what is said of him.
LONGEST_LINE = 1000


def run(share: float = 1.0) -> list[str]:
    """Ask each kind so many times as the share says, of five, and check the node after each."""
    slowest = (0.0, '')
    times = max(round(5 * share), 1)
    progress = Progress('hostile')
    with Attacker() as attacker:
        for turn in range(times):
            for k, (kind, ask) in enumerate(KINDS.items()):
                try:
                    ask(attacker)
                    slowest = max(slowest, (attacker.check(), kind))
                except AssertionError as failed:
                    raise AssertionError(f'{kind}: {failed}') from None
                progress.part(turn, times)((k + 1) / len(KINDS))
        log = attacker.process.stdout
    longest = max(map(len, log.splitlines()))
    assert longest <= LONGEST_LINE, f'a line of log with {longest} characters'
    return [f'{len(KINDS)} kinds, {times} times each: {"; ".join(KINDS)}',
            f'after each the node answered, after {slowest[0]:.2f} s at most ({slowest[1]}), and '
            'believed what a tracker of the library does that never knew of it',
            f'it wrote {len(log) / 1e3:.0f} kB of log']


def _types_that_are_none(it: Attacker) -> None:
    bad = Parameter(name='density.rate', value=ParameterValue(type=99))
    # rclpy itself raises, and never answers
    it.client(SetParameters, 'set_parameters').call_async(SetParameters.Request(parameters=[bad]))
    it.client(SetParametersAtomically, 'set_parameters_atomically').call_async(
        SetParametersAtomically.Request(parameters=[bad, bad]))


def _empty_names(it: Attacker) -> None:
    it.set(number('', 1.0), text('', 'a'), text('.', 'a'), text('/', 'a'))
    it.set(number('', 1.0), number('density.rate', PARAMETERS['density.rate']), atomically=True)
    it.call(GetParameters, 'get_parameters', GetParameters.Request(names=['', '.', '\n']))


def _many_parameters(it: Attacker) -> None:
    many = [number(f'grid.lower{k}', 1.0) for k in range(MANY)]
    assert not any(result.successful for result in it.set(*many))
    assert not it.set(*many, atomically=True)[0].successful


def _many_names(it: Attacker) -> None:
    names = ['frame_id'] * MANY
    for kind, name in ((GetParameters, 'get_parameters'),
                       (DescribeParameters, 'describe_parameters'),
                       (GetParameterTypes, 'get_parameter_types')):
        it.call(kind, name, kind.Request(names=names))


def _simulated_time(it: Attacker) -> None:
    for value in (True, False):
        for answer in (*it.set(flag('use_sim_time', value)),
                       *it.set(flag('use_sim_time', value), atomically=True)):
            assert not answer.successful and answer.reason.startswith('use_sim_time: expected')
    assert not it.set(text('use_sim_time', 'yes'))[0].successful


def _conflicting_sets(it: Attacker) -> None:
    for bad in (flag('use_sim_time', True), number('grid.lower', 0.0), text('pose.estimator', 'x'),
                number('density.rate', -1.0)):
        [answer] = it.set(number('density.rate', 7.0), bad, atomically=True)
        assert not answer.successful, f'took {bad}'
    both = number('density.rate', 5.0), number('density.rate', PARAMETERS['density.rate'])
    assert it.set(*both, atomically=True)[0].successful
    rate = it.call(GetParameters, 'get_parameters', GetParameters.Request(names=['density.rate']))
    assert rate.values[0].double_value == PARAMETERS['density.rate'], 'half of a set was taken'


def _unset_parameters(it: Attacker) -> None:
    for name in ('density.rate', 'pose.estimator', 'use_sim_time', 'grid.lower'):
        unset = Parameter(name=name, value=ParameterValue(type=ParameterType.PARAMETER_NOT_SET))
        assert not it.set(unset)[0].successful, f'{name} was unset'
        assert not it.set(unset, atomically=True)[0].successful, f'{name} was unset'


def _fixed_parameters(it: Attacker) -> None:
    fixed = [name for name in PARAMETERS if name not in ('density.rate', 'pose.estimator')]
    answers = it.set(*(number(name, 1.0) for name in fixed))
    assert not any(answer.successful for answer in answers)


def _extreme_values(it: Attacker) -> None:
    for value in (math.nan, math.inf, -math.inf, -1.0):
        assert not it.set(number('density.rate', value))[0].successful
    for value in (5e-324, 1e308, 0.0, -0.0):
        it.set(number('density.rate', value))
        it.senders['drive'].publish(TOPICS['drive']())
    lists = ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY,
                           double_array_value=[1.0] * 100_000)
    assert not it.set(Parameter(name='density.rate', value=lists))[0].successful
    assert it.set(number('density.rate', PARAMETERS['density.rate']))[0].successful


def _deep_lists(it: Attacker) -> None:
    for depth in (0, 1, 2**63, 2**64 - 1):
        it.call(ListParameters, 'list_parameters', ListParameters.Request(depth=depth))
    it.call(ListParameters, 'list_parameters', ListParameters.Request(
        prefixes=['', '.', '..', 'grid.', '\0', 'x' * MEGABYTES], depth=1))


def _long_texts(it: Attacker) -> None:
    it.set(text('x' * MEGABYTES, 'a'), text('frame_id', 'x' * MEGABYTES))
    assert not it.set(text('pose.estimator', 'x' * MEGABYTES))[0].successful
    it.call(GetParameters, 'get_parameters', GetParameters.Request(names=['x' * MEGABYTES]))


def _malformed(topic: str) -> Callable[[Attacker], None]:
    def ask(it: Attacker) -> None:
        message = TOPICS[topic]()
        stamp_into(message.header.stamp, START_NS)
        whole = serialize_message(message)
        for payload in malformed(whole):
            it.senders[topic].publish(payload)
    return ask


def malformed(whole: bytes) -> list[bytes]:
    """Return payloads that are no message, made of one that is."""
    head, body = whole[:4], whole[4:]
    cut = [whole[:n] for n in range(0, len(whole) - 12, 3)]
    heads = [bytes([0xff] * 4) + body, bytes(4) + bytes(2000), b'\x00\x03\x00\x00' + b'\xff' * 64]
    # the length of frame_id, and of all that has a length behind it
    huge = [head + body[:k] + size + body[k + 4:] for k in range(8, len(body) - 4, 4)
            for size in (b'\xff\xff\xff\xff', b'\xff\xff\xff\x7f')]
    return cut + heads + huge


def _long_arrays(it: Attacker) -> None:
    for name in ('position', 'velocity', 'effort'):
        message = JointState(**{name: [0.1] * 1_000_000})
        stamp_into(message.header.stamp, START_NS)
        it.senders['fix'].publish(message)
    it.senders['fix'].publish(JointState(name=['joint'] * 100_000))


def _long_frames(it: Attacker) -> None:
    for topic, kind in TOPICS.items():
        for length in (100_000, MEGABYTES):
            message = kind()
            message.header.frame_id = 'x' * length
            it.senders[topic].publish(message)
    it.spin(0.5)


def _odd_frames(it: Attacker) -> None:
    for frame in ('a\nb', '\x1b[2J', '\u202e', '%s%n', '{0}', '\0', "'; rm", '$(id)'):
        message = PoseWithCovarianceStamped()
        message.header.frame_id = frame
        it.senders['initialpose'].publish(message)


def _many_calls(it: Attacker) -> None:
    client = it.client(GetParameters, 'get_parameters')
    futures = [client.call_async(GetParameters.Request(names=['frame_id'])) for _ in range(2000)]
    it.spin(0.5)
    for future in futures:
        client.remove_pending_request(future)


def _descriptions(it: Attacker) -> None:
    for name, digest in (('', ''), ('std_msgs/msg/String', 'RIHS01_0'), ('x' * 100_000, '\0')):
        it.call(GetTypeDescription, 'get_type_description', GetTypeDescription.Request(
            type_name=name, type_hash=digest, include_type_sources=True))


def _other_types(it: Attacker) -> None:
    # a participant of its own, since one has one type for a topic
    with stranger() as graph:
        peer = graph.peer('of_other_types')
        for topic in TOPICS:
            sender = peer.create_publisher(String, topic, DEEP)
            for _ in range(100):
                sender.publish(String(data='x' * 1000))
        it.spin(0.3)


def _namesake(it: Attacker) -> None:
    with stranger() as graph:
        graph.peer('filter_node')
        it.spin(0.3)
    it.spin(0.3)


def _coming_and_going(it: Attacker) -> None:
    for k in range(50):
        sender = it.peer.create_publisher(JointState, 'fix', DEEP)
        sender.publish(JointState())
        heard = it.peer.create_subscription(String, f'/filter_node/none_{k}', print, 1)
        it.peer.destroy_subscription(heard)
        it.peer.destroy_publisher(sender)


def _clocks(it: Attacker) -> None:
    sender = it.peer.create_publisher(Clock, '/clock', DEEP)
    for seconds in (0, 1, -5, 2**31 - 1, 7):
        message = Clock()
        message.clock.sec = seconds
        sender.publish(message)
    it.spin(0.1)
    it.peer.destroy_publisher(sender)


def _flood(it: Attacker) -> None:
    message = JointState(position=[math.nan, 0.0])
    stamp_into(message.header.stamp, it.stamp_ns)
    payload = serialize_message(message)
    for k in range(MANY):
        it.senders['fix'].publish(payload)
        if k % 100 == 0:
            it.spin(0.002)


def _odd_times(it: Attacker) -> None:
    for topic, kind in TOPICS.items():
        for sec, nanosec in ((0, 0), (-1, 0), (-2**31, 2**32 - 1), (2**31 - 1, 2**32 - 1)):
            message = kind()
            message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
            # a pose at any time would be one to start from
            message.header.frame_id = 'elsewhere'
            it.senders[topic].publish(message)


def _absurd_controls(it: Attacker) -> None:
    for speed in (1e6, 1e160, 1e308, math.inf, math.nan, -1e308):
        message: Any = TOPICS['drive']()
        stamp_into(message.header.stamp, it.stamp_ns + SECOND // 20)
        message.twist.linear.x = message.twist.angular.z = speed
        it.senders['drive'].publish(message)


def _no_beliefs(it: Attacker) -> None:
    for k, value in enumerate((math.nan, math.inf, 1e308, -1.0, 0.0)):
        message = PoseWithCovarianceStamped()
        message.header.frame_id = 'map'
        stamp_into(message.header.stamp, it.stamp_ns)
        message.pose.covariance[7 * (k % 2)] = value
        message.pose.pose.position.x = value
        it.senders['initialpose'].publish(message)


KINDS: dict[str, Callable[[Attacker], None]] = {
    'parameters of type 99': _types_that_are_none,
    'parameters without a name': _empty_names,
    '20,000 parameters in one call': _many_parameters,
    '20,000 names in one call': _many_names,
    'use_sim_time from afar': _simulated_time,
    'sets that conflict, atomically': _conflicting_sets,
    'parameters unset': _unset_parameters,
    'fixed parameters set': _fixed_parameters,
    'live parameters with extreme values': _extreme_values,
    'parameters listed to any depth': _deep_lists,
    'texts of 10 MB': _long_texts,
    **{f'malformed CDR on {topic}': _malformed(topic) for topic in TOPICS},
    'arrays of a million numbers': _long_arrays,
    'frames of 10 MB': _long_frames,
    'frames that are no names': _odd_frames,
    '2,000 calls at once': _many_calls,
    'descriptions of types that are none': _descriptions,
    'other types on its topics': _other_types,
    'a second node of its name': _namesake,
    'publishers that come and go': _coming_and_going,
    'a clock that it does not live by': _clocks,
    '20,000 bad measurements at once': _flood,
    'stamps of no time': _odd_times,
    'controls of no speed': _absurd_controls,
    'poses to start from that are none': _no_beliefs,
}
