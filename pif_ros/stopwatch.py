"""How long the work takes, and how much of the time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
import resource
import statistics
import time
from typing import Any

#: So many of the last of each kind are looked at.
LAST = 200
#: How busy it was is measured over no less than this, in seconds.
SPAN = 0.5


class Stopwatch:
    """The times that pieces of work of some kinds took, in seconds."""

    def __init__(self) -> None:
        self._took: dict[str, deque[float]] = {}
        self._busy = self._share = 0.0
        self._since = time.monotonic()
        self._depth = 0

    @contextmanager
    def timing(self, kind: str) -> Iterator[None]:
        """Time what is done within; what lies within another counts as busy once."""
        began = time.perf_counter()
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1
            took = time.perf_counter() - began
            self._took.setdefault(kind, deque(maxlen=LAST)).append(took)
            if not self._depth:
                self._busy += took

    def summary(self) -> Mapping[str, tuple[float, float]]:
        """Return median and longest by kind."""
        return {kind: (statistics.median(took), max(took)) for kind, took in self._took.items()}

    def busy(self) -> float:
        """Return the share of the time that the work took, since it was last asked for."""
        now = time.monotonic()
        if now - self._since > SPAN:
            self._share = min(self._busy / (now - self._since), 1.0)
            self._busy, self._since = 0.0, now
        return self._share


class TimedFilter:
    """A filter whose two verbs are timed; in all else it is that filter."""

    def __init__(self, inner: Any, watch: Stopwatch) -> None:
        self._inner, self._watch = inner, watch

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def predict(self, *given: Any) -> Any:
        """Return what the filter predicts."""
        with self._watch.timing('predict'):
            return self._inner.predict(*given)

    def correct(self, *given: Any) -> Any:
        """Return what the filter makes of a measurement."""
        with self._watch.timing('correct'):
            return self._inner.correct(*given)


def shortest(work: Callable[[int], Any], times: int = 3) -> float:
    """Return the seconds of the shortest of some pieces of work, each given its number."""
    took = []
    for k in range(times):
        began = time.perf_counter()
        work(k)
        took.append(time.perf_counter() - began)
    return min(took)


def resident_bytes() -> int | None:
    """Return the memory that this process takes now, None where the system does not tell."""
    try:
        return int(Path('/proc/self/statm').read_text().split()[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return None
