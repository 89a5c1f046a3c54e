"""How often something goes out that need not go out every time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
import time
from typing import Any

from pif_ros.core.filters import NANOSECONDS


class Pace:
    """
    So often by the stamps as a live parameter says, and at most for a share of the time.

    live: the values of the parameters that may change; name: that of the rate in Hz, 0 for never;
    share: what making it may take of the time, by the clock on the wall.
    """

    def __init__(self, live: Mapping[str, Any], name: str, share: float = 1.0) -> None:
        self._live, self._name, self._share = live, name, share
        self.restart()

    def restart(self) -> None:
        """Let the next one go out at once."""
        self._newest_ns: int | None = None
        self._next = 0.0

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether what holds at a stamp is to go out."""
        rate = self._live[self._name]
        return bool(rate) and time.monotonic() >= self._next and (
            self._newest_ns is None or stamp_ns >= self._newest_ns + NANOSECONDS / rate)

    @contextmanager
    def making(self, stamp_ns: int) -> Iterator[None]:
        """Take note that what holds at a stamp goes out, and how long that takes."""
        began, self._newest_ns = time.monotonic(), stamp_ns
        yield
        self._next = began + (time.monotonic() - began) / self._share
