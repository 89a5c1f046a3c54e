"""10,000 messages through DDS, 4,000 of them corrupted: the node lives, and believes its twin."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
import tempfile
import time
from typing import Any

from benchmarks.progress import Progress
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from proofs import invariants
from proofs.attacker import PARAMETERS, TOPICS
from proofs.inputs import INPUTS
from rclpy.serialization import serialize_message
from ros import Graph, nanoseconds, Rig, SECOND, stamp_into

MESSAGES, CORRUPTED, BATCH = 10_000, 0.4, 25
SEED = 11
WRITERS = {'fix': INPUTS['JointState'].write, 'drive': INPUTS['TwistStamped'].write,
           'initialpose': INPUTS['PoseWithCovarianceStamped'].write}


class Mirror:
    """Gives a twin what a tracker takes, as it takes it, and remembers what it was asked."""

    def __init__(self, tracker: Any, twin: Any) -> None:
        """Listen at a tracker."""
        self.tracker, self.twin = tracker, twin
        self.asked: set[Measurement] = set()
        self._own = {name: getattr(tracker, name) for name in ('observe', 'control', 'reset')}
        for name in self._own:
            setattr(tracker, name, getattr(self, f'_{name}'))

    def _observe(self, measurement: Measurement) -> Any:
        self.asked.add(measurement)
        rejection = self._own['observe'](measurement)
        if rejection is None:
            assert self.twin.observe(measurement) is None
        return rejection

    def _control(self, stamp_ns: int, values: Any) -> Any:
        rejection = self._own['control'](stamp_ns, values)
        if rejection is None:
            assert self.twin.control(stamp_ns, values) is None
        return rejection

    def _reset(self, belief: Any = None, stamp_ns: int | None = None,
               steered_ns: int | None = None) -> None:
        self._own['reset'](belief, stamp_ns, steered_ns)
        self.twin.reset(belief, stamp_ns, steered_ns)


def run(share: float = 1.0) -> list[str]:
    """Send so many, in batches, and look at the node after each."""
    batches = max(round(share * MESSAGES / BATCH), 2)
    rng, progress = np.random.default_rng(SEED), Progress('wire')
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder))
        try:
            rig = Rig(graph, {**PARAMETERS, 'publish.rate': 20.0})
            mirror = Mirror(rig.node.tracker,
                            build_tracker(Config.from_parameters(PARAMETERS)))
            corrupted = sum(_batch(rig, mirror, rng, progress.part(k, batches))
                            for k in range(batches))
            told = str(rig.node.accounts)
        finally:
            graph.close()
    return [f'{batches * BATCH} messages on {", ".join(TOPICS)}, {corrupted} of them corrupted: '
            f'no fault, and the belief of the twin after each {BATCH}; {told}']


def _batch(rig: Rig, mirror: Mirror, rng: np.random.Generator, show: Any) -> int:
    """Send a batch and a measurement after it, and check the node once it has that."""
    corrupted = 0
    for _ in range(BATCH):
        topic = list(TOPICS)[rng.choice(3, p=[0.5, 0.4, 0.1])]
        message = _message(topic, rng)
        payload = serialize_message(message)
        if rng.random() < CORRUPTED:
            corrupted += 1
            payload = _corrupted(payload, rng)
        _send(rig, topic, message, payload)
    last = _message('fix', rng)
    stamp_into(last.header.stamp, time.time_ns())
    wanted = Measurement(nanoseconds(last.header.stamp), 'main', tuple(last.position))
    rig.send('fix', last)
    rig.graph.until(lambda: wanted in mirror.asked and not rig.node.inbox.has_work,
                    'the last of a batch')
    mirror.asked.clear()
    _check(rig, mirror)
    show(1.0)
    return corrupted


def _message(topic: str, rng: np.random.Generator) -> Any:
    """Return a message that is right, of a moment ago."""
    message = TOPICS[topic]()
    stamp_into(message.header.stamp, time.time_ns() - int(rng.integers(SECOND // 2)))
    message.header.frame_id = 'map'
    WRITERS[topic](message, [float(v) for v in rng.normal(0.0, 0.5, 2)])
    if isinstance(message, PoseWithCovarianceStamped):
        message.pose.covariance[0] = message.pose.covariance[7] = 0.5
    return message


def _corrupted(payload: bytes, rng: np.random.Generator) -> bytes:
    """Return a payload with some bytes changed, cut off, or put in."""
    found = bytearray(payload)
    kind = rng.integers(5)
    if kind == 0:
        del found[int(rng.integers(len(found))):]
    elif kind == 1:
        at = int(rng.integers(len(found)))
        found[at:at] = rng.bytes(int(rng.integers(1, 16)))
    elif kind == 2:
        at = 4 * int(rng.integers(1, len(found) // 4))
        found[at:at + 4] = rng.choice([b'\xff' * 4, bytes(4), b'\0\0\xf0\x7f', b'\0\0\0\x80'])
    else:
        for at in rng.integers(len(found), size=int(rng.integers(1, 6))):
            found[at] = int(rng.integers(256))
    return bytes(found)


def _send(rig: Rig, topic: str, message: Any, payload: bytes) -> None:
    """Publish bytes on a topic that the node hears as messages like one."""
    if topic not in rig._senders:
        rig.send(topic, message)
    rig._senders[topic].publish(payload)


def _check(rig: Rig, mirror: Mirror) -> None:
    node = rig.node
    assert node.faults == 0, f'{node.faults} faults: {rig.lines}'
    found = node.tracker.estimate()
    invariants.check_same(found, mirror.twin.estimate())
    invariants.check_belief(found.belief, corrected=found.log_evidence > -np.inf)
    queued = Counter(inlet.name for inlet, _ in node.inbox.queue)
    for name, account in {**node.accounts.sources, 'control': node.accounts.control}.items():
        invariants.check_account(name, account, queued[name])
    stamps = rig.stamps
    assert stamps == sorted(stamps), 'stamps go back'
    for pose in rig.poses:
        invariants.check_pose(pose)
    del rig.poses[:-1]
