"""How often something is done that need not be done every time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import time
from typing import Any

from pif_ros.core.filters import NANOSECONDS


class Rest:
    """
    A rest after each piece of work, so that it has a share of the time at most.

    share: of the time by the clock on the wall; least: seconds within which work may be followed
    by work, as it is where it comes no more often than that.
    """

    def __init__(self, share: float, least: float = 0.0) -> None:
        self._share, self._least = share, least
        self.end()

    def end(self) -> None:
        """Let the next piece of work be done at once."""
        self._until = 0.0

    @property
    def is_over(self) -> bool:
        """Return whether there may be work again."""
        return time.monotonic() >= self._until

    @contextmanager
    def working(self) -> Iterator[None]:
        """Take note of how long the work within takes."""
        began = time.monotonic()
        yield
        span = (time.monotonic() - began) / self._share
        self._until = began + span if span > self._least else 0.0


class Pace:
    """
    So often by the stamps as a live parameter says, and at most for a share of the time.

    live: the values of the parameters that may change; name: that of the rate in Hz, 0 for never;
    share: what making it may take of the time, by the clock on the wall.
    """

    def __init__(self, live: Mapping[str, Any], name: str, share: float = 1.0) -> None:
        self._live, self._name, self._rest = live, name, Rest(share)
        self.restart()

    def restart(self) -> None:
        """Let the next one go out at once."""
        self._newest_ns: int | None = None
        self._rest.end()

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether what holds at a stamp is to go out."""
        rate = self._live[self._name]
        return bool(rate) and self._rest.is_over and (
            self._newest_ns is None or stamp_ns >= self._newest_ns + NANOSECONDS / rate)

    @contextmanager
    def making(self, stamp_ns: int) -> Iterator[None]:
        """Take note that what holds at a stamp goes out, and how long that takes."""
        self._newest_ns = stamp_ns
        with self._rest.working():
            yield
