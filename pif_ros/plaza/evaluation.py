"""What a run of the filter was worth: scores beside the extended Kalman filter, and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from pif_ros.plaza import pictures
from pif_ros.plaza.moments import Wanted
from pif_ros.plaza.recorder import Density
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import errors, Scores, Track

_SILENCE_NS = 10 * 10**9


@dataclass(frozen=True, eq=False)
class Run:
    """
    What came of playing ranges to a filter.

    sent: how many; accounts: what it says became of them; densities: with their stamps.
    """

    recording: Recording
    sent: int
    accounts: Mapping[str, int]
    poses: Track
    densities: Sequence[tuple[int, Density]]


def corrected(run: Run) -> Track:
    """Return the poses that have seen the range of their stamp."""
    return _chosen(run.poses, np.isin(run.poses.stamps_ns, run.recording.range_stamps_ns))


def forecasts(run: Run) -> Track:
    """Return the poses that were published when nothing had been heard for ten seconds."""
    heard, stamps = np.sort(run.recording.range_stamps_ns), run.poses.stamps_ns
    before = np.maximum(np.searchsorted(heard, stamps, side='right') - 1, 0)
    return _chosen(run.poses, stamps - heard[before] > _SILENCE_NS)


def scores(recording: Recording, tracks: Mapping[str, Track],
           skip: float = 0.1) -> dict[str, Scores]:
    """Return the scores of tracks at the stamps that they have in common."""
    common = reduce(np.intersect1d, [track.stamps_ns for track in tracks.values()])
    result = {}
    for name, track in tracks.items():
        t = _chosen(track, np.isin(track.stamps_ns, common))
        result[name] = errors(
            t.stamps_ns, t.means, t.covariances, recording.truth_at(t.stamps_ns), skip)
    return result


def moments(run: Run, wanted: Sequence[Wanted]) -> list[pictures.Moment]:
    """Return the wanted moments of which a density was received, each with its pose."""
    found = dict(run.densities)
    position = {int(stamp): i for i, stamp in enumerate(run.poses.stamps_ns)}
    result = []
    for w in wanted:
        stamp = w.choose(list(found))
        if stamp is not None:
            density, i = found[stamp], position[stamp]
            result.append(pictures.Moment(
                w.title, stamp, density.values, density.x, density.y,
                run.poses.means[i], run.poses.covariances[i], w.heard))
    return result


def _chosen(track: Track, chosen: np.ndarray) -> Track:
    return Track(track.stamps_ns[chosen], track.means[chosen], track.covariances[chosen])
