"""The stamps of the poses that go out: none is older than the last, until another time begins."""

from __future__ import annotations

from pif_ros.config import Config
from pif_ros.core.filters import NANOSECONDS


class Epoch:
    """
    A time in which stamps go on, and the newest one that went out in it, -1 before there is one.

    A belief that is further behind than any forecast reaches is of another time.
    """

    def __init__(self, config: Config) -> None:
        time, self._rate = config.time, config.publish.rate
        self._max_ahead_ns = round(time.max_ahead * NANOSECONDS)
        self._furthest_ns = round(max(time.max_gap, time.max_forecast) * NANOSECONDS)
        self.restart()
        self._ahead_ns = self._furthest_ns

    def restart(self) -> None:
        """Let the next stamp be any."""
        self.newest_ns = -1

    def expect_another(self) -> None:
        """Take the next stamp for another time's as early as where a clock jumps back."""
        self._ahead_ns = self._max_ahead_ns

    def advance(self, stamp_ns: int) -> None:
        """Take note of a stamp that goes out."""
        self.newest_ns, self._ahead_ns = stamp_ns, self._furthest_ns

    def is_over(self, stamp_ns: int) -> bool:
        """Return whether the newest stamp is so far ahead of one that this is another time's."""
        return self.newest_ns - stamp_ns > self._ahead_ns

    def stamp_for(self, stamp_ns: int, now_ns: int | None) -> int | None:
        """
        Return the stamp to which what holds at another one is predicted before it goes out.

        None: it lies so far back that to predict each to now would take long, and what goes out
        by itself tells it soon.
        """
        behind_ns = self.newest_ns - stamp_ns
        if (self._rate and now_ns is not None and now_ns > self.newest_ns
                and behind_ns > NANOSECONDS / self._rate):
            return None
        return max(stamp_ns, self.newest_ns)
