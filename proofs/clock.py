"""The system's clock is set under a running node: the belief goes on, at the new time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
import os
from pathlib import Path
import signal
import tempfile
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
import libfaketime
import numpy as np
from ros import DEEP, Executable, executable, Graph, nanoseconds, PLANE, SECOND, write_parameters
from std_msgs.msg import Float64MultiArray

#: By how many seconds the clock is set, one after the other.
STEPS = (-5.0, 65.0, -3600.0, 86400.0)
SPACING, RATE = 0.02, 20.0
#: A pose must come within a period, and what two processes take besides; more where these were
#: as late before.
WITHIN = 1 / RATE + 0.25
#: Deviation of a measurement, and of a belief that knows many: it did not begin anew.
SIGMA, SURE = 0.05, 0.045
#: A point that hardly moves, seen without a stamp.
STILL = {**PLANE, 'measurements.main.type': 'std_msgs/msg/Float64MultiArray',
         'measurements.main.fields': ['data'], 'measurements.main.params.sigma': SIGMA,
         'grid.lower': [0.5, 0.0], 'grid.upper': [1.5, 1.0], 'grid.shape': [60, 60],
         'prior.mean': [1.0, 0.5], 'prior.covariance_diagonal': [0.1, 0.1],
         'model.params.diffusion': 0.05, 'publish.rate': RATE}


def run(share: float = 1.0) -> list[str]:
    """Set the clock of a node that is measured 50 times a second; it must not miss a beat."""
    steps = STEPS[:max(round(share * len(STEPS)), 2)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = write_parameters(folder / 'node.yaml', STILL)
        with (_faked(folder), closing(Graph(folder)) as graph,
              executable(folder, '--params-file', str(path)) as node):
            node.until(node.runs, 'it runs')
            lines = list(_steps(graph, node, folder, steps))
            node.signal(signal.SIGTERM)
            status, *_ = node.end()
            assert (status, node.stderr) == (0, ''), node.stderr
            told = [line for line in node.stdout.splitlines() if 'was set by' in line]
            assert len(told) == len(steps), f'{len(steps)} steps, and in the log {told}'
            assert 'back to the prior' not in node.stdout, node.stdout
    return [*lines, 'one line of the log for each, and no other']


def _steps(graph: Graph, node: Executable, folder: Path,
           steps: tuple[float, ...]) -> Iterator[str]:
    peer, poses = graph.peer(), []
    peer.create_subscription(
        PoseWithCovarianceStamped, '/filter_node/pose',
        lambda pose, info: poses.append((info['source_timestamp'] / SECOND, pose)), DEEP)
    sender = peer.create_publisher(Float64MultiArray, 'fix', DEEP)
    graph.until(lambda: sender.get_subscription_count() and peer.count_publishers(
        '/filter_node/pose'), 'the node is there')
    rng, ahead = np.random.default_rng(4), 0.0
    _measure(graph, sender, rng, 2.0)
    for by in steps:
        ahead += by
        usual = _gap(np.array([sent for sent, _ in poses]))
        poses.clear()
        _set(folder, ahead)
        # to write the file may take a while
        began = time.time()
        _measure(graph, sender, rng, 3.0)
        stamps = np.array([nanoseconds(pose.header.stamp) / SECOND for _, pose in poses])
        # by whichever of its clocks it was sent, that is by this process' own
        sent = np.array([sent for sent, _ in poses]) - ahead
        middle = began + 1.5
        sent += np.where(np.abs(sent - middle) < np.abs(sent + by - middle), 0.0, by)
        lag = stamps - sent
        new = np.abs(lag - ahead) < np.abs(lag - ahead + by)
        assert new.any(), f'{by:+g} s: no pose by the new clock: they lie {lag} s off'
        first = int(np.argmax(new))
        assert new[first:].all(), f'{by:+g} s: a pose by the old clock after one by the new'
        assert np.all(np.diff(stamps[first:]) >= 0), f'{by:+g} s: stamps go back'
        gap = _gap(np.array([began, *sent]))
        assert gap < WITHIN + 2 * usual, (f'{by:+g} s: no pose for {gap:.2f} s, before for '
                                          f'{usual:.2f} s at most')
        wide = float(np.sqrt(max(pose.pose.covariance[0] for _, pose in poses)))
        assert wide < SURE, f'{by:+g} s: the belief did not go on: a deviation of {wide:.3f}'
        yield (f'clock set by {by:+g} s: {len(poses)} poses in 3 s, none later than {gap:.2f} s '
               f'after the last, deviations up to {wide:.3f} (one measurement: {SIGMA})')


def _gap(sent: np.ndarray) -> float:
    """
    Return the longest time between two poses, as the node sent them.

    How soon DDS delivers them is another matter, of which libfaketime makes a second at times.
    """
    return float(np.diff(sent).max())


def _measure(graph: Graph, sender: object, rng: np.random.Generator, seconds: float) -> None:
    end = time.monotonic() + seconds
    while (now := time.monotonic()) < end:
        data = (np.array([1.0, 0.5]) + SIGMA * rng.standard_normal(2)).tolist()
        sender.publish(Float64MultiArray(data=data))  # type: ignore[attr-defined]
        while time.monotonic() < now + SPACING:
            graph.executor.spin_once(timeout_sec=0.005)


def _set(folder: Path, ahead: float) -> None:
    """Set the clock, at once: a file that is empty for a moment is a clock that is right."""
    (folder / 'new').write_text(f'{ahead:+.1f}')
    (folder / 'new').replace(folder / 'ahead')


@contextmanager
def _faked(folder: Path) -> Iterator[None]:
    """Let processes that are started within have a clock that a file sets."""
    _set(folder, 0.0)
    library = next(Path(libfaketime.__file__).parent.rglob('libfaketime.so.1'))
    given = {'LD_PRELOAD': str(library), 'FAKETIME_TIMESTAMP_FILE': str(folder / 'ahead'),
             'FAKETIME_CACHE_DURATION': '1', 'FAKETIME_DONT_FAKE_MONOTONIC': '1'}
    before = {name: os.environ.get(name) for name in given}
    os.environ.update(given)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
