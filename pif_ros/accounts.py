"""What became of every measurement and every control."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
import time


@dataclass
class SourceAccount:
    """
    One topic's messages: received = accepted + rejected (by reason) + dropped + queued.

    outliers: those of the accepted that the belief hardly allowed.
    """

    received: int = 0
    accepted: int = 0
    dropped: int = 0
    outliers: int = 0
    rejected: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        """Return the account in a line."""
        reasons = ', '.join(f'{count} {reason}' for reason, count in self.rejected.items())
        return (f'{self.received} received, {self.accepted} accepted'
                f'{f" ({self.outliers} outliers)" if self.outliers else ""}, '
                f'{self.rejected.total()} rejected{f" ({reasons})" if reasons else ""}, '
                f'{self.dropped} dropped')


class Accounts:
    """The accounts of all sources, and that of the control where the model has inputs."""

    def __init__(self, names: Sequence[str], inputs: Sequence[str] = ()) -> None:
        self.sources = {name: SourceAccount() for name in names}
        self.control = SourceAccount() if inputs else None
        self.initial_pose = SourceAccount()

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
