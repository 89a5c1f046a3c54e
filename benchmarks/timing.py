"""Contestants timed in turns, so that whatever else the machine does hits all of them alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import gc
import time

from benchmarks.progress import Progress
import numpy as np
from numpy.typing import NDArray

#: Seconds per run, one row per turn.
Samples = NDArray[np.float64]


@dataclass(frozen=True)
class Effort:
    """How much is measured: a share of the usual samples; whether the reference is checked."""

    share: float = 1.0
    check: bool = False

    def scaled(self, count: int, least: int = 2) -> int:
        """Return the share of a count."""
        return max(round(count * self.share), least)


@dataclass(frozen=True)
class Contestant:
    """
    A piece of work that is timed: run(k) does its k-th part.

    per_turn: how many parts make a turn; reset: what goes before part 0 and is not timed;
    pause_s: how long to rest before each part.
    """

    run: Callable[[int], object]
    per_turn: int = 1
    reset: Callable[[], object] = lambda: None
    pause_s: float = 0.0


def interleave(contestants: Mapping[str, Contestant], turns: int, passes: int,
               progress: Progress | None = None) -> dict[str, Samples]:
    """
    Return the seconds of each run, shape (passes * turns, per_turn), by contestant.

    A pass starts everyone anew and gives each its turns, A B C, B C A, and so on, so that none
    always follows the same one.  One pass more, the first, warms up and is not kept.
    """
    names = list(contestants)
    kept: dict[str, list[list[float]]] = {name: [] for name in names}
    for number in range(passes + 1):
        for contestant in contestants.values():
            contestant.reset()
        for turn in range(turns):
            for name in _rotated(names, turn):
                samples = _timed(contestants[name], turn)
                if number:
                    kept[name].append(samples)
            if progress is not None:
                progress.show((number * turns + turn + 1) / ((passes + 1) * turns))
    return {name: np.array(samples) for name, samples in kept.items()}


def ratio(samples: Samples, base: Samples) -> float:
    """Return how many times as long as the base, the median over turns side by side."""
    return float(np.median(np.median(samples, axis=1) / np.median(base, axis=1)))


def _timed(contestant: Contestant, turn: int) -> list[float]:
    run, clock, samples = contestant.run, time.perf_counter, []
    first = turn * contestant.per_turn
    collecting = gc.isenabled()
    gc.disable()
    try:
        for k in range(first, first + contestant.per_turn):
            if contestant.pause_s:
                time.sleep(contestant.pause_s)
            before = clock()
            run(k)
            samples.append(clock() - before)
    finally:
        if collecting:
            gc.enable()
    return samples


def _rotated(names: Sequence[str], turn: int) -> list[str]:
    start = turn % len(names)
    return [*names[start:], *names[:start]]
