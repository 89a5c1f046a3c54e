"""Filtering: contenders follow the same record, and are scored against the truth and the best."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.filters import Filter
from pif_ros.core.grid import Grid
from pif_ros.core.scoring import rmse
from pif_ros.reproduction.records import Record
from pif_ros.reproduction.study import Entry, Expected, Outcome
from pif_ros.reproduction.tracks import follow, Moments, moments, Reading, Track

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Contender:
    """
    A filter in a case.

    start: returns the filter and its prior for a seed; shown: what the pictures need of its
    beliefs, beside means and variances.
    """

    entry: Entry
    start: Callable[[int], tuple[Filter[Any], Any]]
    shown: Mapping[str, Reading] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Followed:
    """What the pictures of a filtering case are drawn from: a record, and tracks by entry."""

    record: Record
    tracks: Mapping[str, Track]


@dataclass(frozen=True, eq=False)
class FilteringCase:
    """
    Contenders on the same record.

    draw: returns a record from a generator; moments: what is estimated, means and variances (n,)
    of a belief, and of the truth, transform: states (K, n) to the same (K, n), after every so many
    measurements; watched: further figures of a belief, averaged over time.
    """

    name: str
    title: str
    printed: str
    draw: Callable[[Generator], Record]
    contenders: Sequence[Contender]
    expected: Sequence[Expected] = ()
    remarks: Sequence[str] = ()
    median: bool = False
    moments: Moments = moments
    transform: Callable[[Array], Array] = np.asarray
    every: int = 1
    watched: Mapping[str, Reading] = field(default_factory=dict)

    @property
    def entries(self) -> Sequence[Entry]:
        """Return the lines of the table."""
        return [contender.entry for contender in self.contenders]

    def run(self, seed: int, keep: bool) -> Outcome:
        """Return the scores of all contenders on the record of this seed."""
        record = self.draw(np.random.default_rng(seed))
        scores, tracks, truth = {}, {}, self.transform(record.truth)
        for one in self.contenders:
            begin = perf_counter()
            filter_, prior = one.start(seed)
            made = perf_counter() - begin
            track = follow(filter_, prior, record, self.moments,
                           {**self.watched, **(one.shown if keep else {})}, self.every)
            tracks[one.entry.name] = track
            scores[one.entry.name] = {
                **scored(track, truth[track.chosen], self.watched), 'start_s': made}
        for role in ('optimum', 'best'):
            for to in [tracks[e.name] for e in self.entries if e.role == role][:1]:
                for name, track in tracks.items():
                    scores[name][f'to_{role}'] = distance(track.means, to.means)
        return Outcome(scores, Followed(record, tracks) if keep else None)


def film(grid: Grid, axis: int, every: int = 1) -> Reading:
    """Return how a marginal is read, on the cells of a grid, after every so many measurements."""
    cells = grid.select([axis])
    return Reading(lambda belief: belief.on(cells, [axis]).density.astype(np.float32), every)


def distance(a: Array, b: Array) -> float:
    """Return the root of the mean squared difference over time and components, (K, n) each."""
    return rmse(a - b) / np.sqrt(a.shape[1])


def scored(track: Track, truth: Array, watched: Mapping[str, Reading]) -> dict[str, float]:
    """
    Return the scores of a track against the truth (K, n).

    coverage: the share of time and components within 1 and 2 standard deviations of the mean,
    0.683 and 0.954 for a Gaussian.  A track that ended early has no errors.
    """
    errors, spread = truth - track.means, np.sqrt(np.maximum(track.variances, 0.0))
    lost = bool(track.fault)
    return {
        'rmse': distance(truth, track.means),
        'coverage_1': np.nan if lost else float(np.mean(np.abs(errors) < spread)),
        'coverage_2': np.nan if lost else float(np.mean(np.abs(errors) < 2 * spread)),
        'log_evidence': np.nan if lost else track.log_evidence,
        'mass': float(np.mean(track.masses)),
        'step_s': float(np.nanmedian(track.seconds)),
        **{name: float(np.mean(track.read[name])) for name in watched}}
