"""The telling moments of a run: when the belief changes its shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.schedule import Span

_SILENCE = 30.0
#: What is worth seeing after so many metres.
_DRIVEN = {1.0: 'Driving off: which way?', 10.0: 'Heading found'}


@dataclass(frozen=True)
class Wanted:
    """
    A moment that is worth a picture.

    first_ns, last_ns: the stamps between which it may be taken; newest: whether the last one
    published in between is the best, else the first; heard: the beacons of the latest ranges, at
    last_ns.
    """

    title: str
    first_ns: int
    last_ns: int
    heard: tuple[int, ...] = ()
    newest: bool = False

    def choose(self, stamps_ns: Sequence[int]) -> int | None:
        """Return the best of increasing stamps, None where none will do."""
        within = [s for s in stamps_ns if self.first_ns <= s <= self.last_ns]
        return within[-1 if self.newest else 0] if within else None


def telling_moments(recording: Recording, span: Span = Span(),
                    odometry: bool = False) -> list[Wanted]:
    """
    Return up to six: the first three beacons, the way, the longest silence if it is long.

    With odometry the way is where it begins to drive, and where the heading has become known.
    """
    first, last = span.limits_ns(recording)
    arrivals = recording.arrivals_ns
    on_time = np.flatnonzero(
        (recording.range_stamps_ns == arrivals) & (arrivals >= first) & (arrivals <= last))
    stamps, ids = recording.range_stamps_ns[on_time], recording.beacon_ids[on_time]
    beginning = _beginning(stamps.tolist(), ids.tolist())
    if odometry:
        driven = [w for metres, title in _DRIVEN.items()
                  for w in _after(recording, stamps, ids, metres, title)]
        return [*beginning, *driven, *_silence(stamps, ids)[:1]]
    return [*beginning, *_way(stamps, ids), *_silence(stamps, ids)]


def _beginning(stamps: list[int], ids: list[int]) -> list[Wanted]:
    """Return when the first, the second and the third beacon were heard for the first time."""
    titles = ['One range: a ring', 'Second radio: robot or ghost?', 'Third radio: the ghost dies']
    wanted, heard = [], []
    for stamp, beacon in zip(stamps, ids):
        if beacon not in heard and titles:
            heard.append(beacon)
            wanted.append(Wanted(titles.pop(0), stamp, stamp, tuple(heard)))
    return wanted


def _after(recording: Recording, stamps: np.ndarray, ids: np.ndarray, metres: float,
           title: str) -> list[Wanted]:
    """Return when the odometry has counted so many metres since the first range."""
    starts, ends = recording.odometry_stamps_ns, recording.odometry_ends_ns
    driven = np.cumsum((starts >= stamps[0]) * recording.odometry[:, 0] * (ends - starts) * 1e-9)
    begin = ends[np.searchsorted(driven, metres):][:1]
    if not len(begin) or begin[0] > stamps[-1]:
        return []
    i = int(np.searchsorted(stamps, begin[0]))
    return [Wanted(title, int(begin[0]), int(stamps[i]), (int(ids[i]),))]


def _way(stamps: np.ndarray, ids: np.ndarray) -> list[Wanted]:
    """Return the range after a quarter of the ranges."""
    i = len(stamps) // 4
    return [Wanted('On its way', int(stamps[i]), int(stamps[i]), (int(ids[i]),))]


def _silence(stamps: np.ndarray, ids: np.ndarray) -> list[Wanted]:
    """Return the end of the longest silence, and the first range after it."""
    if len(stamps) < 2 or np.diff(stamps).max() < _SILENCE * 1e9:
        return []
    i = int(np.argmax(np.diff(stamps))) + 1
    begin, end = int(stamps[i - 1]), int(stamps[i])
    title = f'In a silence of {(end - begin) * 1e-9:.0f} s'
    return [
        Wanted(title, begin + 10**9, end - 1, newest=True),
        Wanted('Heard again', end, end, (int(ids[i]),))]
