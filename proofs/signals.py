"""200 signals at random phase: the node ends with status 0, an empty stderr, and soon."""

from __future__ import annotations

import os
from pathlib import Path
import signal
import tempfile
import time

from benchmarks.progress import Progress
from geometry_msgs.msg import PointStamped
import numpy as np
from ros import DEEP, Executable, executable, Graph, PLANE, stamp_into, write_parameters

SIGNALS = 200
SEED = 17
#: Of those that run, this share must end within so many seconds.
MOST, LIMIT = 0.99, 1.0
#: What a node that rests waits for at most before it sees that it was told to end.
WAIT = 0.1
#: The first part of a second after its start in which a running node is told to end.
WHILE_RUNNING = 1.0
KINDS = {'SIGINT': (signal.SIGINT,), 'SIGTERM': (signal.SIGTERM,),
         'SIGINT twice': (signal.SIGINT, signal.SIGINT),
         'SIGINT, SIGTERM': (signal.SIGINT, signal.SIGTERM)}


def run(share: float = 1.0) -> list[str]:
    """End so many nodes: three of four while they run, the others while they start."""
    count = max(round(share * SIGNALS), 4)
    rng, progress = np.random.default_rng(SEED), Progress('signals')
    running: list[tuple[float, float]] = []
    starting: list[tuple[float, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = write_parameters(Path(folder) / 'node.yaml', {**PLANE, 'publish.rate': 20.0})
        graph = Graph(Path(folder))
        try:
            sender = graph.peer().create_publisher(PointStamped, 'fix', DEEP)
            for k in range(count):
                kind = list(KINDS)[k % len(KINDS)]
                # of four turns of the kinds, one is for the start
                early = (k // len(KINDS)) % 4 == 3
                with executable(Path(folder), '--params-file', str(path)) as node:
                    took = _ended(node, kind, early, rng, sender)
                (starting if early else running).append(took)
                progress.show((k + 1) / count)
        finally:
            graph.close()
    # where others keep the machine busy, what counts is its own time
    soon = float(np.mean(np.min(running, axis=1) < LIMIT))
    lines = [_told('while it runs, at 20 Hz and measured at 100 Hz', running)]
    if starting:
        lines.append(_told('while it starts, which it finishes first', starting))
    assert soon >= MOST, f'{soon:.1%} within {LIMIT:g} s: {lines[0]}'
    return [f'{count} signals ({"; ".join(KINDS)}): status 0 and an empty stderr each time',
            *lines]


def _ended(node: Executable, kind: str, early: bool, rng: np.random.Generator,
           sender: object) -> tuple[float, float]:
    """Return how many seconds after a signal a node has ended, and how many of them it worked."""
    node.until(node.handles_signals, 'it handles signals')
    if early:
        time.sleep(float(rng.uniform(0.0, 0.5)))
    else:
        node.until(node.runs, 'it runs')
        _measure(sender, float(rng.uniform(0.0, WHILE_RUNNING)))
    began, busy = time.monotonic(), _processor_time(node)
    for number in KINDS[kind]:
        node.signal(number)
        time.sleep(float(rng.uniform(0.0, 0.01)))
    status, _, busy_at_end = node.end()
    took = time.monotonic() - began, busy_at_end - busy + WAIT
    assert status == 0, f'{kind}: status {status}: {node.stderr}'
    assert node.stderr == '', f'{kind}: on stderr: {node.stderr}'
    last = node.stdout.splitlines()[-1]
    assert 'stopped; main: ' in last, f'{kind}: the last line is {last!r}'
    return took


def _measure(sender: object, seconds: float) -> None:
    """Measure a hundred times a second for some time."""
    message = PointStamped()
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        stamp_into(message.header.stamp, time.time_ns())
        message.point.x = message.point.y = 0.1
        sender.publish(message)  # type: ignore[attr-defined]
        time.sleep(0.01)


def _processor_time(node: Executable) -> float:
    """Return the processor time that a process has taken so far, in seconds."""
    words = Path(f'/proc/{node.process.pid}/stat').read_text(encoding='ascii').split(') ')[1]
    user, system = words.split()[11:13]
    return (int(user) + int(system)) / os.sysconf('SC_CLK_TCK')


def _told(when: str, took: list[tuple[float, float]]) -> str:
    wall, own = np.array(took).T
    median, most = np.percentile(wall, [50, 99])
    return (f'{len(took)} {when}: ended after {median:.2f} s (median), {most:.2f} s (99 %), '
            f'{wall.max():.2f} s (most), of which its own time was {own.max():.2f} s at most')
