"""What a run of the filter was worth: scores beside the extended Kalman filter, and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from pif_ros.plaza.moments import Wanted
from pif_ros.plaza.recorder import Density
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import errors, Scores, Track
from pif_ros.plaza.snapshots import Moment

_SILENCE_NS = 10 * 10**9


@dataclass(frozen=True, eq=False)
class Run:
    """
    What came of playing a recording to a filter.

    sent: how many 'ranges' and, where there are any, 'controls'; accounts: what it says became of
    these; densities: with their stamps.
    """

    recording: Recording
    sent: Mapping[str, int]
    accounts: Mapping[str, Mapping[str, int]]
    poses: Track
    densities: Sequence[tuple[int, Density]]


def corrected(run: Run) -> Track:
    """Return the poses that have seen the range of their stamp."""
    return run.poses.at(np.isin(run.poses.stamps_ns, run.recording.range_stamps_ns))


def forecasts(run: Run) -> Track:
    """Return the poses that were published when nothing had been heard for ten seconds."""
    heard, stamps = np.sort(run.recording.range_stamps_ns), run.poses.stamps_ns
    before = np.maximum(np.searchsorted(heard, stamps, side='right') - 1, 0)
    return run.poses.at(stamps - heard[before] > _SILENCE_NS)


def scores(recording: Recording, tracks: Mapping[str, Track],
           skip: float = 0.1) -> dict[str, Scores]:
    """Return the scores of tracks at the stamps that they have in common."""
    common = reduce(np.intersect1d, [track.stamps_ns for track in tracks.values()])
    result = {}
    for name, track in tracks.items():
        t = track.at(np.isin(track.stamps_ns, common))
        result[name] = errors(t, recording.truth_at(t.stamps_ns), skip)
    return result


def moments(run: Run, wanted: Sequence[Wanted]) -> list[Moment]:
    """Return the wanted moments of which a density was received, each with its pose."""
    found = dict(run.densities)
    position = {int(stamp): i for i, stamp in enumerate(run.poses.stamps_ns)}
    result = []
    for w in wanted:
        stamp = w.choose(list(found))
        if stamp is not None:
            density, i = found[stamp], position[stamp]
            result.append(Moment(
                w.title, stamp, density.values, density.x, density.y,
                run.poses.means[i], run.poses.covariances[i],
                w.heard if stamp == w.last_ns else ()))
    return result
