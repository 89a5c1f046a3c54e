"""How a source's messages come in: how often, how late, and what they say of the filter."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
import statistics

from pif_ros.core.filters import NANOSECONDS

#: So many of the last messages are looked at.
LAST = 50


def _last() -> deque[float]:
    return deque(maxlen=LAST)


@dataclass
class Traffic:
    """
    What is kept of the last messages of a source, all in seconds but for log evidence.

    skew: clock less stamp at the first message that had a stamp; newest_ns: the newest stamp that
    was accepted; log_evidence: of the corrections by them, as far as there is one.
    """

    skew: float | None = None
    newest_ns: int | None = None
    heard_ns: int | None = None
    log_evidence: deque[float] = field(default_factory=_last)
    _arrivals: deque[float] = field(default_factory=_last)
    _delays: deque[float] = field(default_factory=_last)
    _refused: deque[float] = field(default_factory=_last)

    def arrive(self, now_ns: int, stamp_ns: int | None = None) -> None:
        """Take note of a message, with its stamp where it has one."""
        self.heard_ns = now_ns
        self._arrivals.append(now_ns / NANOSECONDS)
        if stamp_ns is not None:
            delay = (now_ns - stamp_ns) / NANOSECONDS
            self._delays.append(delay)
            self.skew = delay if self.skew is None else self.skew

    def accept(self, stamp_ns: int) -> None:
        """Take note of a message that was taken."""
        self._refused.append(0.0)
        self.newest_ns = max(stamp_ns, self.newest_ns or stamp_ns)

    def refuse(self, count: int = 1) -> None:
        """Take note of messages that were not taken, or never came."""
        self._refused.extend([1.0] * min(count, LAST))

    def judge_anew(self, refused: bool) -> None:
        """Take note that one of them was taken before, and is not now, or the other way round."""
        was, now = (0.0, 1.0) if refused else (1.0, 0.0)
        if was in self._refused:
            # which one does not matter to their share
            self._refused.remove(was)
            self._refused.append(now)

    def restart(self) -> None:
        """Forget all that another clock has told."""
        self.skew = self.newest_ns = self.heard_ns = None
        self._arrivals.clear()
        self._delays.clear()

    @property
    def rate(self) -> float | None:
        """Return how many come in a second, None before there are two."""
        if len(self._arrivals) < 2 or self._arrivals[-1] <= self._arrivals[0]:
            return None
        return (len(self._arrivals) - 1) / (self._arrivals[-1] - self._arrivals[0])

    @property
    def delay(self) -> float | None:
        """Return the median of clock less stamp at arrival, None without stamps."""
        return _median(self._delays)

    @property
    def refused(self) -> float:
        """Return the share of them that were not taken, or never came."""
        return sum(self._refused) / len(self._refused) if self._refused else 0.0

    def age(self, now_ns: int) -> float | None:
        """Return how old the newest stamp that was taken is, None without one."""
        return None if self.newest_ns is None else (now_ns - self.newest_ns) / NANOSECONDS

    def silence(self, now_ns: int, since_ns: int) -> float:
        """Return for how long nothing came, from a moment on where nothing ever did."""
        return (now_ns - (self.heard_ns or since_ns)) / NANOSECONDS


def _median(values: Iterable[float]) -> float | None:
    found = list(values)
    return statistics.median(found) if found else None
