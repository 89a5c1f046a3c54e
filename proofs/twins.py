"""A node, and its twin: a tracker of the library that is given only what is right."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
import math
from typing import Any
import warnings

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.verdicts import OFF_THE_GRID
from proofs import events, invariants
from proofs.inputs import BESIDE, Input, INPUTS
from rclpy.clock import ClockType
from rclpy.publisher import Publisher
from rclpy.time import Time
from ros import Graph, nanoseconds, SECOND
from std_srvs.srv import Empty, Trigger

INFO = {'publication_sequence_number': None}
#: Few enough to be full at times.
QUEUE_LENGTH = 12


class Twin:
    """What a tracker believes, and counts, that is given the right messages alone."""

    def __init__(self, parameters: dict[str, Any]) -> None:
        """Build a tracker of the same parameters."""
        config = Config.from_parameters(
            {k: v for k, v in parameters.items() if k != 'use_sim_time'})
        self.tracker = build_tracker(config)
        self.queue: deque[tuple[str, events.Sent]] = deque()
        self.counts: Counter[tuple[str, str]] = Counter()
        self._longest = config.measurements.queue_length

    def put(self, source: str, sent: events.Sent) -> None:
        """Let a right message wait; of a full queue the oldest goes."""
        if len(self.queue) == self._longest:
            oldest, _ = self.queue.popleft()
            self.counts[oldest, 'dropped'] += 1
        self.queue.append((source, sent))

    def take(self, left: int) -> None:
        """Work in what waits, the oldest first, until so many are left."""
        while len(self.queue) > left:
            source, sent = self.queue.popleft()
            if source == 'control':
                rejection = self.tracker.control(sent.stamp_ns, sent.values)
            else:
                rejection = self.tracker.observe(
                    Measurement(sent.stamp_ns, source, sent.values))
            self.counts[source, rejection.value if rejection else 'accepted'] += 1


class Twins:
    """
    A filter node in this process whose callbacks are called, and its twin.

    The node lives in simulated time, so that a seed decides all.  After each event both are held
    against each other, and to the invariants; where the node has more parameters than the twin
    knows of, gates say, to the invariants alone.
    """

    def __init__(self, graph: Graph, kind: Input, **more: Any) -> None:
        """Bring up a node that takes a type of messages, perhaps with more parameters."""
        parameters = {**kind.parameters, **more, 'measurements.queue_length': QUEUE_LENGTH,
                      'use_sim_time': True, 'publish.rate': 20.0, 'density.rate': 5.0}
        self.kind, self.beside = kind, INPUTS[BESIDE] if kind.control else kind
        self.graph, self.node = graph, graph.filter_node(parameters)
        self.twin, self._is_alike = Twin(parameters), not more
        self._fault, self._report = '', self.node.report
        setattr(self.node, 'report', self._hear_report)
        self.poses: list[PoseWithCovarianceStamped] = []
        self.now_ns = 0
        self.events = 0
        self._heard = {s.topic_name: s.callback for s in self.node.subscriptions}
        self._services = {s.srv_name.split('/')[-1]: s.callback for s in self.node.services}
        self._last: tuple[str, str, events.Sent] | None = None
        self._pose_ns = 0
        self._unstamped: Counter[int] = Counter()
        self._may_go_back = False
        self.left_the_grid = 0

    # What happens

    def step(self, chooser: events.Chooser, share_of_starts: int) -> None:
        """Let something happen that a chooser decides; a pose to start from once in so many."""
        if not chooser.rarely(4):
            self._advance(chooser.one_of(events.ADVANCES))
        elif chooser.rarely(200):
            self._advance(700 * SECOND)
        if chooser.rarely(share_of_starts):
            self.start(events.start_of(chooser, self.now_ns, self._newest_ns))
        elif chooser.rarely(20) and self._last is not None:
            self.deliver(*self._last)
        elif chooser.rarely(12):
            self.deliver('main', self.beside.topic,
                         events.good_message(chooser, self.beside, self.now_ns))
        elif chooser.rarely(150):
            self.restart(chooser.one_of(('reset', 'reinitialize_global_localization')))
        else:
            self.deliver('control' if self.kind.control else 'main', self.kind.topic,
                         events.message_of(chooser, self.kind, self.now_ns, self._newest_ns))
        for _ in range(chooser.one_of((0, 0, 1, 2))):
            self.graph.executor.spin_once(timeout_sec=0)
            self._follow()
        self.check()
        if chooser.rarely(8):
            self.settle()

    def deliver(self, source: str, topic: str, sent: events.Sent) -> None:
        """Call the callback of a topic with a message, and let the twin have it if it is right."""
        self._last = source, topic, sent
        account = self._account(source)
        before = Counter(account.rejected)
        self._heard['/' + topic](sent.message, INFO)
        stamped = (self.kind if source == 'control' else self.beside).stamped
        wrong = events.wrong_at(sent, stamped, self.now_ns)
        if wrong:
            found = account.rejected - before
            assert found.total() == 1 and set(found) <= wrong, (
                f'event {self.events + 1}: rejected as {dict(found)}, wrong is {sorted(wrong)}: '
                f'{sent}')
            self.twin.counts[source, next(iter(found))] += 1
        else:
            self.twin.put(source, sent if stamped else replace(
                sent, stamp_ns=self.now_ns + self._before(source)))
        self._follow()

    def _before(self, source: str) -> int:
        """Return how many unstamped controls came now already: each holds after the others."""
        if source != 'control':
            return 0
        self._unstamped[self.now_ns] += 1
        return self._unstamped[self.now_ns] - 1

    def start(self, start: events.Start) -> None:
        """Set the node down somewhere, and the twin where that is right."""
        account = self.node.accounts.initial_pose
        before = account.accepted
        right = start.right and start.stamp_ns >= self._pose_ns - 600 * SECOND
        self._heard['/initialpose'](start.message)
        if right:
            # of the states that a pose says nothing of, what the prior says
            mean = self.twin.tracker.prior.mean()
            covariance = self.twin.tracker.prior.covariance()
            covariance[:2, :], covariance[:, :2] = 0.0, 0.0
            mean[:2], covariance[:2, :2] = start.mean, np.reshape(start.covariance, (2, 2))
            self._forget(self.twin.tracker.filter.gaussian(mean, covariance), start.stamp_ns)
        assert account.accepted - before == right, (
            f'initialpose: {"refused" if right else "accepted"}: {start}')

    def restart(self, service: str) -> None:
        """Call a service that restarts both, after which another time may begin."""
        self._may_go_back = True
        if service == 'reset':
            response = Trigger.Response()
            assert self._services[service](Trigger.Request(), response).success
            self._forget(None, None)
        else:
            self._services[service](Empty.Request(), Empty.Response())
            self._forget(self.twin.tracker.filter.uniform(), None)

    def tick(self) -> None:
        """Let there be a clock, and then some time."""
        self.events += 1
        self._advance(events.MS)

    def begin_anew(self) -> None:
        """Forget all that was believed, ten seconds later, out of reach of all that was sent."""
        self._advance(10 * SECOND)
        self.restart('reset')
        self._last = None
        # what an example found wrong is not to be found by the next
        self.node.faults = 0
        self.poses.clear()
        self.twin.counts = Counter({
            (name, what): n for name, account in self._accounts().items()
            for what, n in _became(account).items()})

    def settle(self) -> None:
        """Let the node work in all that waits."""
        self.graph.until(self._is_idle, 'the work')
        self.check()

    # What must hold

    def check(self) -> None:
        """Check the node against its twin and all invariants; AssertionError names the event."""
        self.events += 1
        try:
            self._check()
        except AssertionError as failed:
            raise AssertionError(f'event {self.events}: {failed}') from None

    def _check(self) -> None:
        node, twin = self.node, self.twin
        assert node.faults == 0, f'{node.faults} faults: {self._fault}'
        queued = Counter(inlet.name for inlet, _ in node.inbox.queue)
        for name, account in self._accounts().items():
            invariants.check_account(name, account, queued[name])
            if not self._is_alike:
                continue
            found = _became(account)
            expected = {what: n for (source, what), n in twin.counts.items() if source == name}
            assert +Counter(found) == +Counter(expected), f'{name}: {found}, twin: {expected}'
        if not node.tracker.backlog:
            mine, theirs = node.tracker.newest, twin.tracker.estimate()
            if self._is_alike:
                invariants.check_same(mine, theirs)
            # a measurement that no state or no gate allows corrects nothing
            invariants.check_belief(
                mine.belief, corrected=self._is_alike and mine.log_evidence > -math.inf)
        for pose in self.poses:
            stamp_ns = nanoseconds(pose.header.stamp)
            assert stamp_ns >= self._pose_ns or self._may_go_back, (
                f'stamps go back: {self._pose_ns}, {stamp_ns}')
            self._pose_ns, self._may_go_back = stamp_ns, False
            invariants.check_pose(pose)
        self.poses.clear()

    @contextmanager
    def overheard(self) -> Iterator[None]:
        """Hear all poses that the node publishes meanwhile, over no wire."""
        publish = Publisher.publish
        topic = f'{self.node.get_fully_qualified_name()}/pose'

        def overhear(publisher: Any, message: Any) -> None:
            publish(publisher, message)
            if publisher.topic_name == topic:
                self.poses.append(message)

        setattr(Publisher, 'publish', overhear)
        try:
            with warnings.catch_warnings():
                # what numpy warns of would be on the stderr of a process
                warnings.simplefilter('error', RuntimeWarning)
                yield
        finally:
            setattr(Publisher, 'publish', publish)

    def _hear_report(self, kind: str, text: str) -> None:
        self._fault = text if kind == 'fault' else self._fault
        self._report(kind, text)

    def _advance(self, by_ns: int) -> None:
        if self.now_ns == 0:
            # for the first few events there is no clock
            by_ns = 1_000 * SECOND if self.events > 5 else 0
        self.now_ns += by_ns
        if self.now_ns:
            self.node.get_clock().set_ros_time_override(
                Time(nanoseconds=self.now_ns, clock_type=ClockType.ROS_TIME))

    def _follow(self) -> None:
        """Let the twin work in as much as the node did."""
        self.twin.take(len(self.node.inbox.queue))
        mine, theirs = self.node.tracker, self.twin.tracker
        if mine.stamp_ns is None and theirs.stamp_ns is not None:
            latest_ns = max(self.now_ns, self._pose_ns, theirs.stamp_ns)
            left = theirs.forecast(latest_ns).belief.mass
            assert left == 0 or not self._is_alike, (
                f'back to the prior with a mass of {left} on the grid')
            theirs.reset(steered_ns=theirs.stamp_ns)
            self.left_the_grid += 1

    def _forget(self, belief: Any, stamp_ns: int | None) -> None:
        self.twin.take(len(self.node.inbox.queue))
        # a robot is driven on from a pose that is set; after a reset nothing is known of it
        self.twin.tracker.reset(belief, stamp_ns, stamp_ns)

    def _is_idle(self) -> bool:
        self._follow()
        return not self.node.inbox.has_work

    @property
    def _newest_ns(self) -> int:
        return self.node.tracker.stamp_ns or self.now_ns

    def _account(self, source: str) -> Any:
        return self._accounts()[source]

    def _accounts(self) -> dict[str, Any]:
        accounts = dict(self.node.accounts.sources)
        if self.node.accounts.control is not None:
            accounts['control'] = self.node.accounts.control
        return accounts


def _became(account: Any) -> dict[str, int]:
    """Return what became of the messages of an account; what a belief cannot use was right."""
    rejected = dict(account.rejected)
    taken = account.accepted + rejected.pop(OFF_THE_GRID, 0)
    return {'accepted': taken, 'dropped': account.dropped, **rejected}
