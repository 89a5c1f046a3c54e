"""30 minutes at 100 Hz in, 10 Hz predicted, a density each second: no leak, no gap, no lag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
import signal
import tempfile
import time
from typing import Any

from benchmarks.progress import Progress
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
import numpy as np
from ros import (DEEP, Executable, executable, Graph, nanoseconds, PLANE, stamp_into,
                 write_parameters)
from std_msgs.msg import Float64MultiArray

LASTS, RATE = 1800.0, 100.0
#: The share of the time after which memory counts.
WARM = 0.2
#: Megabytes that it may grow by since then.
GROWTH = 5.0
#: Seconds without a pose that want an explanation, and what this process' own pauses explain.
GAP, PAUSE = 0.5, 0.1
SEED = 23


class Watch:
    """One node's answers: how long each took, and the longest time without any."""

    def __init__(self, peer: Any, topic: str, stalled: Callable[[], bool]) -> None:
        """Hear poses on a topic; stalled: whether this process itself has just paused."""
        self.sent: dict[int, float] = {}
        self.latencies: list[float] = []
        self.gaps: list[float] = []
        self._last: float | None = None
        self._stalled = stalled
        peer.create_subscription(PoseWithCovarianceStamped, topic, self._hear, DEEP)

    def _hear(self, message: PoseWithCovarianceStamped) -> None:
        now = time.monotonic()
        if self._last is not None and now - self._last > GAP and not self._stalled():
            self.gaps.append(now - self._last)
        self._last = now
        began = self.sent.pop(nanoseconds(message.header.stamp), None)
        if began is not None:
            self.latencies.append(now - began)

    def p99_ms(self) -> float:
        """Return the latency that 99 of 100 answers do not exceed."""
        return 1e3 * float(np.percentile(self.latencies, 99))


def run(share: float = 1.0) -> list[str]:
    """Soak a node for that share of the time, beside a node that does nothing but answer."""
    lasts = max(share * LASTS, 5.0)
    parameters = {**PLANE, 'publish.rate': 10.0, 'density.rate': 1.0}
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as other:
        path = write_parameters(Path(folder) / 'node.yaml', parameters)
        graph = Graph(Path(folder))
        try:
            with executable(Path(folder), '--params-file', str(path)) as node, \
                    executable(Path(other), module='proofs.empty_node') as empty:
                return _soaked(graph, node, empty, lasts)
        finally:
            graph.close()


def _soaked(graph: Graph, node: Executable, empty: Executable, lasts: float) -> list[str]:
    """Measure for so many seconds, and return what came of it."""
    peer, progress = graph.peer(), Progress('soak')
    pauses = [0.0]
    densities: list[float] = []
    watches = {name: Watch(peer, f'/{name}/pose', lambda: pauses[0] > PAUSE)
               for name in ('filter_node', 'empty_node')}
    peer.create_subscription(Float64MultiArray, '/filter_node/density',
                             lambda _: densities.append(time.monotonic()), 10)
    sender = peer.create_publisher(PointStamped, 'fix', DEEP)
    graph.until(lambda: sender.get_subscription_count() == 2
                and all(peer.count_publishers(f'/{name}/pose') for name in watches),
                'both nodes hear')
    rng, message = np.random.default_rng(SEED), PointStamped()
    memory: list[float] = []
    sent, began, turn = 0, time.monotonic(), time.monotonic()
    while (now := time.monotonic()) < began + lasts:
        pauses[0], turn = now - turn, now
        if now >= began + sent / RATE:
            stamp_ns = time.time_ns()
            stamp_into(message.header.stamp, stamp_ns)
            message.point.x, message.point.y = (float(v) for v in rng.normal(0.0, 0.3, 2))
            for watch in watches.values():
                watch.sent[stamp_ns] = time.monotonic()
            sender.publish(message)
            sent += 1
        if now >= began + len(memory):
            memory.append(_resident_mb(node))
            progress.show((now - began) / lasts)
        left = began + sent / RATE - time.monotonic()
        graph.executor.spin_once(timeout_sec=max(min(left, 0.01), 0.0))
    progress.show(1.0)
    account = _ended(node)
    empty.signal(signal.SIGTERM)
    empty.end()
    return _judged(watches, memory, densities, sent, account, lasts)


def _judged(watches: dict[str, Watch], memory: list[float], densities: list[float], sent: int,
            account: dict[str, int], lasts: float) -> list[str]:
    """Return lines on a soaked node; AssertionError where it leaks, loses or pauses."""
    mine, empty = watches['filter_node'], watches['empty_node']
    warm = memory[int(WARM * len(memory)):]
    part = max(len(warm) // 10, 1)
    growth = float(np.median(warm[-part:]) - np.median(warm[:part]))
    lines = [
        f'{lasts:.0f} s, {sent} measurements: {account["received"]} received, '
        f'{account["accepted"]} accepted, {account["rejected"]} rejected, '
        f'{account["dropped"]} dropped; {len(densities)} densities',
        f'memory: {warm[0]:.1f} MB when warm, {growth:+.2f} MB since',
        f'latency: p99 {mine.p99_ms():.2f} ms, beside {empty.p99_ms():.2f} ms of a node that does '
        f'nothing; medians {1e3 * float(np.median(mine.latencies)):.2f} and '
        f'{1e3 * float(np.median(empty.latencies)):.2f} ms',
        f'gaps of more than {GAP:g} s without a pose: {len(mine.gaps)}']
    assert growth < GROWTH, lines[1]
    assert not mine.gaps, f'{lines[3]}: {[round(gap, 2) for gap in mine.gaps]}'
    # what was sent before DDS had made the way may be lost, and nothing else
    assert account['accepted'] == account['received'] >= sent - RATE, lines[0]
    assert len(densities) >= 0.8 * lasts - 2, lines[0]
    return lines


def _ended(node: Executable) -> dict[str, int]:
    """End the node, and return what it says became of the measurements."""
    node.signal(signal.SIGTERM)
    status, *_ = node.end()
    last = node.stdout.splitlines()[-1]
    assert (status, node.stderr) == (0, ''), f'status {status}: {node.stderr}'
    return {word: int(re.search(rf'(\d+) {word}', last)[1])  # type: ignore[index]
            for word in ('received', 'accepted', 'rejected', 'dropped')}


def _resident_mb(node: Executable) -> float:
    """Return the memory that a process really has."""
    pages = Path(f'/proc/{node.process.pid}/statm').read_text(encoding='ascii').split()[1]
    return int(pages) * 4096 / 1e6
