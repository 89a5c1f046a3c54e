"""Predictions that take longer than their period: measurements are fused or counted."""

from __future__ import annotations

from collections.abc import Mapping
import os
from pathlib import Path
import re
import signal
import tempfile
import time
from typing import Any

from benchmarks.progress import Progress
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from proofs.slow_node import SECONDS
from rcl_interfaces.srv import GetParameters
from ros import DEEP, executable, Graph, PLANE, stamp_into, write_parameters

#: Measurements per second, and for how many seconds.
RATE, LASTS = 50.0, 30.0
#: Poses predicted per second, and how much longer than that period each prediction takes.
FORECASTS, FACTORS = 10.0, (1.5, 5.0)
#: Measurements that wait at most, in the node and in DDS.
QUEUE = 6
#: The share of what was sent that must be fused or counted.
ACCOUNTED = 0.95
#: Seconds within which a service must answer.
ANSWER = 5.0


def run(share: float = 1.0) -> list[str]:
    """Overload a node in both ways, for so long, at each factor."""
    lasts, lines = max(share * LASTS, 2.0), []
    progress = Progress('overload')
    for k, factor in enumerate(FACTORS):
        lines.append(_overloaded(factor, lasts))
        progress.show((k + 1) / len(FACTORS))
    return lines


def _overloaded(factor: float, lasts: float) -> str:
    """Return a line on a node whose predictions take so many times their period."""
    seconds = factor / FORECASTS
    parameters: Mapping[str, Any] = {**PLANE, 'publish.rate': FORECASTS,
                                     'measurements.queue_length': QUEUE}
    os.environ[SECONDS] = str(seconds)
    with tempfile.TemporaryDirectory() as folder:
        path = write_parameters(Path(folder) / 'node.yaml', parameters)
        graph = Graph(Path(folder))
        try:
            peer = graph.peer()
            sender = peer.create_publisher(PointStamped, 'fix', DEEP)
            client = peer.create_client(GetParameters, '/filter_node/get_parameters')
            with executable(Path(folder), '--params-file', str(path),
                            module='proofs.slow_node') as node:
                graph.until(lambda: sender.get_subscription_count()
                            and client.service_is_ready(), 'the node hears')
                first = _meet(graph, peer, sender)
                sent, answers = _feed(graph, sender, client, lasts)
                # of what still waits in DDS a node takes one message a turn
                time.sleep(1.0 + 2 * QUEUE * seconds)
                node.signal(signal.SIGTERM)
                status, *_ = node.end()
                last = node.stdout.splitlines()[-1]
        finally:
            graph.close()
    assert status == 0, f'status {status}'
    count = {word: int(number) for number, word in re.findall(
        r'(\d+) (received|accepted|rejected|dropped|lost)', last)}
    # those of the first meeting are not of the load
    accepted = count['accepted'] - first
    counted = count['dropped'] + count.get('lost', 0)
    assert count['received'] == count['accepted'] + count['rejected'] + count['dropped'], last
    assert count['rejected'] == 0, last
    told = (f'predictions of {seconds:g} s at {FORECASTS:g} Hz, {factor:g} times their period: of '
            f'{sent} measurements {accepted} fused, {counted} counted as dropped, here or in DDS; '
            f'services answered after {max(answers):.2f} s at most')
    assert accepted + counted >= ACCOUNTED * sent, told
    assert accepted > 0 and max(answers) < ANSWER, told
    return told


def _meet(graph: Graph, peer: Any, sender: Any) -> int:
    """Measure until a pose comes back, and return how often: DDS may still make the way."""
    poses: list[Any] = []
    peer.create_subscription(PoseWithCovarianceStamped, '/filter_node/pose', poses.append, DEEP)
    for sent in range(1, 100):
        sender.publish(_measurement())
        graph.executor.spin_once(timeout_sec=2.0)
        if poses:
            return sent
    raise AssertionError('no pose comes back')


def _measurement() -> PointStamped:
    message = PointStamped()
    stamp_into(message.header.stamp, time.time_ns())
    message.point.x, message.point.y = 0.1, 0.2
    return message


def _feed(graph: Graph, sender: Any, client: Any, lasts: float) -> tuple[int, list[float]]:
    """Measure for some seconds, asking all the while; return how often, and how long it took."""
    sent, answers = 0, []
    began = time.monotonic()
    asked, future = began, client.call_async(GetParameters.Request(names=['frame_id']))
    while (now := time.monotonic()) < began + lasts or not future.done():
        assert now < began + lasts + 10 * ANSWER, 'a service does not answer'
        if sent < (now - began) * RATE and now < began + lasts:
            sender.publish(_measurement())
            sent += 1
        graph.executor.spin_once(timeout_sec=0.005)
        if future.done() and now < began + lasts:
            answers.append(now - asked)
            asked, future = now, client.call_async(GetParameters.Request(names=['frame_id']))
    return sent, [*answers, time.monotonic() - asked]
