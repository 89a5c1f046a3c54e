"""What is sent when: a recording as a sequence of steps of its clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pif_ros.plaza.recording import Recording


@dataclass(frozen=True)
class Step:
    """
    One reading of the clock, and what has become known since the one before.

    ranges, truths and odometry: positions in the recording's arrays, in the order of sending;
    quiet: whether no range has arrived for so long that the clock runs on by itself.
    """

    stamp_ns: int
    ranges: range
    truths: range
    odometry: range = range(0)
    quiet: bool = False


@dataclass(frozen=True)
class Span:
    """The part of a recording from `start` on for `duration` seconds; 0 means to its end."""

    start: float = 0.0
    duration: float = 0.0

    def limits_ns(self, recording: Recording) -> tuple[int, int]:
        """Return the first and the last stamp; ValueError where no range arrives between."""
        first = recording.start_ns + round(self.start * 1e9)
        last = max(int(recording.truth_stamps_ns[-1]), int(recording.arrivals_ns[-1]))
        if self.duration > 0.0:
            last = min(last, first + round(self.duration * 1e9))
        arrivals = recording.arrivals_ns
        if not np.any((arrivals >= first) & (arrivals <= last)):
            end = f'{self.start + self.duration:g} s' if self.duration > 0.0 else 'the end'
            raise ValueError(
                f'no range of {recording.name} arrives between {self.start:g} s and {end}')
        return first, last

    def seconds(self, recording: Recording) -> float:
        """Return how much of a recording this is."""
        first, last = self.limits_ns(recording)
        return (last - first) * 1e-9


def steps(recording: Recording, span: Span = Span(), quiet: float = 1.0,
          odometry: bool = False) -> Iterator[Step]:
    """
    Return the steps in order: one per arrival, and one every `quiet` seconds where no range comes.

    What arrives at one time, as a late block of ranges does, is one step.  What odometry, where it
    is wanted, says of an interval arrives at its end.
    """
    first, last = span.limits_ns(recording)
    arrivals, truths = recording.arrivals_ns, recording.truth_stamps_ns
    ends = recording.odometry_ends_ns[:None if odometry else 0]
    sent = int(np.searchsorted(truths, first))
    for stamp, ticks in _stamps(arrivals, ends, first, last, round(quiet * 1e9)):
        known = int(np.searchsorted(truths, stamp, side='right'))
        yield Step(stamp, _at(arrivals, stamp), range(sent, known), _at(ends, stamp), ticks)
        sent = known


def _at(stamps: NDArray[np.int64], stamp: int) -> range:
    """Return the positions of a stamp in ordered ones."""
    return range(int(np.searchsorted(stamps, stamp)), int(np.searchsorted(stamps, stamp, 'right')))


def _stamps(arrivals: NDArray[np.int64], ends: NDArray[np.int64], first: int, last: int,
            quiet_ns: int) -> Iterator[tuple[int, bool]]:
    """Return in order what comes between first and last, and whether it is a tick in silence."""
    ticks = set(_ticks(np.unique(arrivals), first, last, quiet_ns))
    inside = [s for stamps in (arrivals, ends) for s in stamps[
        (stamps >= first) & (stamps <= last)].tolist()]
    for stamp in sorted({*inside, *ticks, last}):
        yield stamp, stamp in ticks


def _ticks(arrivals: NDArray[np.int64], first: int, last: int, quiet_ns: int) -> Iterator[int]:
    """Return when the clock runs on by itself between arrivals that lie apart, or to the end."""
    inside = arrivals[(arrivals >= first) & (arrivals <= last)].tolist()
    now = first - quiet_ns
    for stamp in [*inside, *([last] if inside[-1] < last else [])]:
        while now + quiet_ns < stamp:
            now += quiet_ns
            yield now
        now = stamp
