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
from pif_ros.reproduction.tracks import Estimand, follow, Reading, STATES, Track

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

    draw: returns a record from a generator; estimand: what is scored, after every so many
    measurements; also: what is scored besides, by name; watched: further figures of a belief,
    averaged over time.
    """

    name: str
    title: str
    printed: str
    draw: Callable[[Generator], Record]
    contenders: Sequence[Contender]
    expected: Sequence[Expected] = ()
    remarks: Sequence[str] = ()
    median: bool = False
    covered: str = ''
    estimand: Estimand = STATES
    also: Mapping[str, Estimand] = field(default_factory=dict)
    every: int = 1
    watched: Mapping[str, Reading] = field(default_factory=dict)

    @property
    def entries(self) -> Sequence[Entry]:
        """Return the lines of the table."""
        return [contender.entry for contender in self.contenders]

    def run(self, seed: int, keep: bool) -> Outcome:
        """Return the scores of all contenders on the record of this seed."""
        record = self.draw(np.random.default_rng(seed))
        scores, tracks = {}, {}
        for one in self.contenders:
            begin = perf_counter()
            filter_, prior = one.start(seed)
            made = perf_counter() - begin
            track = follow(filter_, prior, record, self.estimand.moments, {
                **self.watched, **(one.shown if keep else {}),
                **{name: Reading(what.moments) for name, what in self.also.items()}}, self.every)
            tracks[one.entry.name] = track
            scores[one.entry.name] = {**self._scores(track, record.truth), 'start_s': made}
        for role in ('optimum', 'best'):
            for to in [tracks[e.name] for e in self.entries if e.role == role][:1]:
                for name, track in tracks.items():
                    scores[name][f'to_{role}'] = distance(track.means, to.means)
        return Outcome(scores, Followed(record, tracks) if keep else None)

    def _scores(self, track: Track, truth: Array) -> dict[str, float]:
        lost = bool(track.fault)
        scores = error_scores(self.estimand.of(truth)[track.chosen], track.means, track.variances)
        for name, what in self.also.items():
            read = np.full((len(truth), 2, truth.shape[1]), np.nan)
            read[:len(track.read[name])] = track.read[name]
            other = error_scores(what.of(truth), read[:, 0], read[:, 1])
            scores.update({f'{score} {name}': value for score, value in other.items()})
        return {**scores, 'log_evidence': np.nan if lost else track.log_evidence,
                'mass': float(np.mean(track.masses)), 'step_s': float(np.nanmedian(track.seconds)),
                **{name: np.nan if lost else float(np.mean(track.read[name]))
                   for name in self.watched}}


def film(grid: Grid, axis: int, every: int = 1) -> Reading:
    """Return how a marginal is read, on the cells of a grid, after every so many measurements."""
    return Reading(lambda belief: belief.on(grid, [axis]).density.astype(np.float32), every)


def distance(a: Array, b: Array) -> float:
    """Return the root of the mean squared difference over time and components, (K, n) each."""
    return rmse(a - b) / np.sqrt(a.shape[1])


def error_scores(truth: Array, means: Array, variances: Array) -> dict[str, float]:
    """
    Return the scores of means and variances against the truth, (K, n) each; NaN where one is.

    coverage: the share of time and components within 1 and 2 standard deviations of the mean,
    0.683 and 0.954 for a Gaussian.
    """
    errors, spread = np.abs(truth - means), np.sqrt(np.maximum(variances, 0.0))
    lost = not np.all(np.isfinite(errors))
    return {'rmse': distance(truth, means),
            'coverage_1': np.nan if lost else float(np.mean(errors < spread)),
            'coverage_2': np.nan if lost else float(np.mean(errors < 2 * spread))}
