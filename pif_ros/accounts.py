"""What became of every measurement and every control."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
import time

from pif_ros.traffic import Traffic


#: Reasons that are no sign that something is wrong: the user has it so, or nothing was in sight.
NO_FAULT = ('disabled', 'inactive', 'out of range')


@dataclass
class SourceAccount:
    """
    One topic's messages: received = accepted + rejected (by reason) + dropped + queued.

    outliers: those of the accepted that the belief hardly allowed; lost: what was published, by
    the publisher's count, and never came; traffic: how the last of them came in; off: says in a
    word why it is not listened to now, '' where it is; there: says what is listened to, and who
    publishes there.
    """

    received: int = 0
    accepted: int = 0
    dropped: int = 0
    outliers: int = 0
    lost: int = 0
    rejected: Counter[str] = field(default_factory=Counter)
    traffic: Traffic = field(default_factory=Traffic)
    off: Callable[[], str] = field(default=str, compare=False, repr=False)
    there: Callable[[], str] = field(default=str, compare=False, repr=False)

    def reject(self, reason: str) -> None:
        """Count a message that cannot be used."""
        self.rejected[reason] += 1
        if reason not in NO_FAULT:
            self.traffic.refuse()

    def judge_anew(self, reason: str, refused: bool) -> None:
        """Count one that was accepted as rejected, or one rejected for that as accepted."""
        step = 1 if refused else -1
        self.accepted -= step
        self.rejected[reason] += step
        self.traffic.judge_anew(refused)

    def drop(self) -> None:
        """Count a message that waited too long."""
        self.dropped += 1
        self.traffic.refuse()

    def lose(self, count: int) -> None:
        """Count messages that never came."""
        self.lost += count
        self.traffic.refuse(count)

    def accept(self, stamp_ns: int) -> None:
        """Count a message that was put where it belongs."""
        self.accepted += 1
        self.traffic.accept(stamp_ns)

    def __str__(self) -> str:
        """Return the account in a line."""
        reasons = ', '.join(f'{count} {reason}' for reason, count in (+self.rejected).items())
        return (f'{self.received} received, {self.accepted} accepted'
                f'{f" ({self.outliers} outliers)" if self.outliers else ""}, '
                f'{self.rejected.total()} rejected{f" ({reasons})" if reasons else ""}, '
                f'{self.dropped} dropped'
                f'{f", {self.lost} lost before" if self.lost else ""}')


class Accounts:
    """The accounts of all sources, and that of the control where the model has inputs."""

    def __init__(self, names: Sequence[str], inputs: Sequence[str] = ()) -> None:
        self.sources = {name: SourceAccount() for name in names}
        self.control = SourceAccount() if inputs else None
        self.initial_pose = SourceAccount()

    def __iter__(self) -> Iterator[SourceAccount]:
        """Give the account of each source, and that of the control where there is one."""
        yield from self.sources.values()
        if self.control is not None:
            yield self.control

    def restart(self) -> None:
        """Forget what another clock has told of anyone's messages."""
        for account in (*self, self.initial_pose):
            account.traffic.restart()

    def __str__(self) -> str:
        """Return all accounts in a line."""
        lines = [f'{name}: {account}' for name, account in self.sources.items()]
        if self.control is not None:
            lines.append(f'control: {self.control}')
        if self.initial_pose.received:
            lines.append(f'initialpose: {self.initial_pose}')
        return '; '.join(lines)


#: What a line shows of a text at most: others may have chosen what it tells of.
LONGEST = 500


class Throttle:
    """Which of many like lines are worth saying: the first, then one in so many seconds."""

    def __init__(self, period: float = 5.0) -> None:
        self._period = period
        self._said: dict[str, float] = {}
        self._kept: Counter[str] = Counter()

    def line(self, kind: str, text: str) -> str | None:
        """Return the line to say, with the number of those kept back, or None."""
        now = time.monotonic()
        if now - self._said.get(kind, -self._period) < self._period:
            self._kept[kind] += 1
            return None
        self._said[kind] = now
        text = text if len(text) <= LONGEST else f'{text[:LONGEST]} ...'
        kept = self._kept.pop(kind, 0)
        return f'{text} ({kept} more like it)' if kept else text
