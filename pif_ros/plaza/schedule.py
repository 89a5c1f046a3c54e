"""What is sent when: a recording as a sequence of steps of its clock."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pif_ros.plaza.recording import Recording


@dataclass(frozen=True)
class Step:
    """
    One reading of the clock, and what has become known since the one before.

    ranges and truths: positions in the recording's arrays, in the order of sending; ranges is
    empty at a step that only lets the clock run on.
    """

    stamp_ns: int
    ranges: range
    truths: range


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


def steps(recording: Recording, span: Span = Span(), quiet: float = 1.0) -> Iterator[Step]:
    """
    Return the steps in order: one per arrival, and one every `quiet` seconds where none arrives.

    Ranges that arrive at one time, as a late block does, are one step.
    """
    first, last = span.limits_ns(recording)
    arrivals, truths = recording.arrivals_ns, recording.truth_stamps_ns
    sent = int(np.searchsorted(truths, first))
    for stamp in _stamps(recording, first, last, round(quiet * 1e9)):
        known = int(np.searchsorted(truths, stamp, side='right'))
        begin, end = np.searchsorted(arrivals, stamp), np.searchsorted(arrivals, stamp, 'right')
        yield Step(stamp, range(int(begin), int(end)), range(sent, known))
        sent = known


def _stamps(recording: Recording, first: int, last: int, quiet_ns: int) -> Iterator[int]:
    """Return the arrivals between first and last, and ticks between those that lie apart."""
    arrivals = np.unique(recording.arrivals_ns)
    inside = arrivals[(arrivals >= first) & (arrivals <= last)].tolist()
    now = first - quiet_ns
    for stamp in [*inside, *([last] if inside[-1] < last else [])]:
        while now + quiet_ns < stamp:
            now += quiet_ns
            yield now
        yield stamp
        now = stamp
