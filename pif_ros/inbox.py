"""What waits to be worked in, and what became of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
import math
import time
from typing import Any

from pif_ros.accounts import Accounts, SourceAccount
from pif_ros.config import Config
from pif_ros.core.estimates import (CorrectionFailed, Estimate, Measurement, Memory,
                                    Rejection)
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import Tracker
from pif_ros.sources import Control, Inlet
from pif_ros.verdicts import FAR, surprise, Verdicts

#: Replays that have not come to an end for so long, in seconds, take nothing late any more.
OVERLOAD = 5.0
#: So many corrections of a replay are made before signals, services and messages have their turn.
SLICE = 32
#: Fewer of them where they would take longer than this, in seconds.
TURN = 0.1
#: A replay of more corrections than this waits until a burst of late messages has ended ...
LONG_REPLAY = 4
#: ... but no longer than this, in seconds.
PATIENCE = 0.2


class Inbox:
    """
    A bounded queue of measurements and controls before a tracker; each is accounted for.

    report: called with a kind and a line where something is worth a warning; slice: corrections
    made by one work(); gaps: how often the prior held again after one; last_gap: the line that
    told of the last since a restart, '' without one.
    """

    def __init__(self, tracker: Tracker[Any], accounts: Accounts, config: Config,
                 report: Callable[[str, str], None]) -> None:
        self.queue: deque[tuple[Inlet, Measurement | Control]] = deque()
        self.behind_since: float | None = None
        self.slice = SLICE
        self.gaps, self.last_gap = 0, ''
        self._tracker, self._accounts, self._report = tracker, accounts, report
        self._longest = config.measurements.queue_length
        self._history_ns = round(config.time.history * NANOSECONDS)
        self._unjudged: set[Measurement] = set()
        # what came after a gap, and a line of each; a replay may find others
        self._gaps: dict[Measurement, str] = {}
        self._gaps_told = 0
        # whose gaps another process counted
        self._recalled: frozenset[Measurement] = frozenset()
        self._verdicts = Verdicts(accounts.sources)
        self._burst_since: float | None = None
        self._arrivals = self._arrivals_seen = 0
        # whether a measurement was taken, and whether any was used, since the last news
        self._news = self._made = False
        self._in_turn = 1

    @property
    def has_work(self) -> bool:
        """Return whether something waits, here or in the tracker."""
        return bool(self.queue or self._tracker.backlog)

    @property
    def wants_a_turn(self) -> bool:
        """Return whether there is something to work in, or something to tell."""
        return self.has_work or self._news

    def put(self, inlet: Inlet, item: Measurement | Control) -> None:
        """Let a message wait; the oldest of a full queue is dropped."""
        if len(self.queue) >= self._longest:
            oldest, _ = self.queue.popleft()
            oldest.account.drop()
            self._report('dropped',
                         f'{oldest.name}: dropped the oldest {oldest.what} of a full queue')
        self.queue.append((inlet, item))
        self._arrivals += 1

    def reject(self, inlet: Inlet, reason: str, sentence: str) -> None:
        """Count a message that cannot be used, and tell why."""
        inlet.account.reject(reason)
        self._report(f'{inlet.name}: {reason}', f'{inlet.name}: rejected a {inlet.what}: '
                     f'{sentence}')

    def work(self) -> Estimate[Any] | None:
        """
        Work in what waits, and return what is then believed; None where there is nothing to tell.

        That is so while there is more to do than one slice, and where only controls came: what
        they change is seen in the next forecast.  Raises CorrectionFailed as the tracker does.
        """
        self.drain()
        if self._tracker.backlog > LONG_REPLAY and self._burst_goes_on():
            return None
        self._burst_since = None
        if not self._tracker.backlog:
            self.behind_since = None
            # after one that failed, what the others before it have told
            return self._tracker.newest if self._is_news() else None
        began, left = time.monotonic(), self._tracker.backlog
        try:
            estimate = self._corrected(min(self.slice, self._in_turn))
            # what one took, its prediction included, the next ones will take
            took = (time.monotonic() - began) / (left - self._tracker.backlog)
            self._in_turn = max(1, int(TURN / max(took, 1e-6)))
        finally:
            self.behind_since = (self.behind_since or time.monotonic()) if self.has_work else None
        if self.has_work:
            return None
        return estimate if self._is_news() else None

    def _is_news(self) -> bool:
        """Return whether a measurement was taken, and used, since this was asked last."""
        is_news, self._news, self._made = self._news and self._made, False, False
        return is_news

    def settle(self) -> list[RuntimeError]:
        """Work in all that waits, however long that takes, and return what failed, and why."""
        failed: list[RuntimeError] = []
        while self.has_work:
            self._drain(math.inf)
            try:
                self._corrected(self._tracker.backlog)
            except CorrectionFailed as failure:
                failed.append(failure)
            except Exception as error:  # noqa: B902  the watch: sensors are others' code
                failed.append(RuntimeError(f'no watch over being lost: {error}'))
                failed[-1].__cause__ = error
        self.behind_since = None
        return failed

    def _corrected(self, at_most: int) -> Estimate[Any]:
        """Return what is believed after some corrections, which are accounted for."""
        try:
            return self._tracker.estimate(at_most=at_most, look=False)
        except CorrectionFailed as failed:
            self._verdicts.fail(failed.measurement)
            self._unjudged.discard(failed.measurement)
            self._count_gap(failed.measurement, 0)
            raise
        finally:
            self._made |= bool(self._tracker.corrections)
            self._judge()

    def drain(self) -> None:
        """Put what waits in the queue where it belongs, as far as the work can take it."""
        self._drain(self._longest)

    def _drain(self, most: float) -> None:
        while self.queue and self._tracker.backlog < most:
            inlet, item = self.queue.popleft()
            if self._is_overload(item.stamp_ns):
                self.reject(inlet, 'overload', 'late, and the replays of late ones have not come '
                            f'to an end for {OVERLOAD:g} s')
                continue
            if isinstance(item, Measurement):
                rejection = self._tracker.observe(item)
            else:
                rejection = self._tracker.control(item.stamp_ns, item.values)
            if rejection is not None:
                behind = (self._tracker.stamp_ns or item.stamp_ns) - item.stamp_ns
                more = ', more than time.history' if rejection is Rejection.TOO_LATE else ''
                self.reject(inlet, rejection.value, f'{rejection.value}, '
                            f'{behind / NANOSECONDS:.3f} s behind the newest{more}')
                continue
            inlet.account.accept(item.stamp_ns)
            if isinstance(item, Measurement):
                self._unjudged.add(item)
                self._news = True

    def restart(self, belief: Any, stamp_ns: int | None, steered_ns: int | None = None) -> None:
        """
        Account for what waits, forget it, and start from a belief (None: the prior).

        steered_ns: a stamp at which the robot is still driven as it was, None where it is not;
        where it is, what was measured from the belief's stamp on is worked in anew.
        """
        self.account()
        self._tracker.reset(belief, stamp_ns, steered_ns)
        self._forget(stamp_ns if self._tracker.backlog else None)
        for failed in self.settle():
            self._report('fault', f'{type(failed.__cause__).__name__}: {failed}')
        self._news = self._made = False

    def set_clock(self, by_ns: int, belief: Any) -> None:
        """Go on from the newest belief as it is by a clock that is so much ahead."""
        self._forget()
        self._tracker.set_clock(by_ns, belief)

    def remind(self) -> None:
        """Let the next work() tell what is believed."""
        self._news = self._made = True

    def recall(self, memory: Memory[Any]) -> None:
        """Account for what waits, forget it, and go on from what a tracker remembered."""
        self.restart(None, None)
        self._tracker.recall(memory)
        self._verdicts.disregard(memory.measurements)
        self._recalled = frozenset(memory.measurements)

    def account(self) -> None:
        """Put all that waits in the queue where it belongs."""
        self._drain(math.inf)

    def _forget(self, before_ns: int | None = None) -> None:
        """Let go of what was known of measurements before a stamp, of all where none is given."""
        self._verdicts.forget(before_ns)
        self._unjudged = {m for m in self._unjudged if _is_since(m, before_ns)}
        self._gaps = {m: line for m, line in self._gaps.items() if _is_since(m, before_ns)}
        self.last_gap, self._gaps_told = '', len(self._gaps)
        self.behind_since = None

    def _is_overload(self, stamp_ns: int) -> bool:
        """Return whether what is late would keep replays going that never end."""
        newest_ns, since = self._tracker.stamp_ns, self.behind_since
        return (since is not None and time.monotonic() - since > OVERLOAD
                and newest_ns is not None and stamp_ns < newest_ns)

    def _count_gap(self, after: Measurement, gap_ns: int) -> None:
        """Count a gap before a measurement, or with 0 that there is none any more."""
        known = len(self._gaps)
        if not gap_ns:
            self._gaps.pop(after, None)
        elif after not in self._recalled:
            self._gaps[after] = (f'{after.source}: a gap of {gap_ns / NANOSECONDS:.0f} s, '
                                 'more than time.max_gap: back to the prior')
        self.gaps += len(self._gaps) - known

    def _tell_gaps(self) -> None:
        """Tell of a new gap, once a replay is through: a late measurement may have moved one."""
        if len(self._gaps) == self._gaps_told or self._tracker.backlog:
            return
        is_new = len(self._gaps) > self._gaps_told
        self.last_gap = list(self._gaps.values())[-1] if is_new else ''
        if is_new:
            self._report('gap', self.last_gap)
        oldest_ns = (self._tracker.stamp_ns or 0) - self._history_ns
        self._gaps = {m: line for m, line in self._gaps.items() if m.stamp_ns >= oldest_ns}
        self._gaps_told = len(self._gaps)

    def _judge(self) -> None:
        """
        Count and tell which of the new measurements the belief hardly allows, or not at all.

        What was replayed may have another verdict of the gate than before, and is counted anew.
        """
        for made in self._tracker.corrections:
            measurement = made.measurement
            self._verdicts.take(made)
            if made.gap_ns or self._gaps:
                self._count_gap(measurement, made.gap_ns)
            if measurement not in self._unjudged:
                continue
            self._unjudged.remove(measurement)
            self._account_of(measurement).traffic.log_evidence.append(made.log_evidence)
            if made.recovered:
                self._report('recovery', 'the belief is locked out or lost: a share of '
                             'another one was mixed in')
            if made.gated:
                self._report(f'{measurement.source}: gate', f'{measurement.source}: rejected a '
                             f'measurement of which {made.tail:.2g} are as little expected')
            elif made.log_evidence == -math.inf:
                self._report(f'{measurement.source}: off the grid', f'{measurement.source}: '
                             'rejected a measurement that no state of the belief allows')
            elif surprise(made) > FAR:
                self._report(f'{measurement.source}: outlier', f'{measurement.source}: a '
                             f'measurement about {surprise(made):.0f} standard deviations from '
                             'all that is believed')
        self._tracker.corrections.clear()
        self._tell_gaps()
        made_ns = self._tracker.newest.stamp_ns
        if made_ns is not None:
            self._verdicts.forget(made_ns - self._history_ns)

    def _account_of(self, measurement: Measurement) -> SourceAccount:
        return self._accounts.sources[measurement.source]

    def _burst_goes_on(self) -> bool:
        """Return whether messages still arrive; a replay is best made once, after them."""
        now, since = time.monotonic(), self._burst_since
        self._burst_since = now if since is None else since
        arriving, self._arrivals_seen = self._arrivals != self._arrivals_seen, self._arrivals
        return arriving and now - self._burst_since < PATIENCE


def _is_since(measurement: Measurement, stamp_ns: int | None) -> bool:
    """Return whether a measurement is no older than a stamp; none is where there is no stamp."""
    return stamp_ns is not None and measurement.stamp_ns >= stamp_ns
