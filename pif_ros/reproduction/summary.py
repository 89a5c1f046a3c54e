"""What the seeds of a case come to: rows of figures, and whether they are what they should be."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.reproduction.study import Case, Outcome

Array = NDArray[np.float64]

#: How near the best setting is to come to the optimum: in the error, and in either coverage.
ERROR_WITHIN, COVERAGE_WITHIN = 0.05, 0.02
#: How often seeds are drawn anew to see how far a figure hangs on them.
RESAMPLES = 400


@dataclass(frozen=True)
class Figure:
    """
    A score over the seeds: values (one a seed, None where a contender was lost) and their digest.

    standard_error: of the mean, None for fewer than two values.
    """

    values: tuple[float | None, ...]
    mean: float | None
    standard_error: float | None
    median: float | None

    @classmethod
    def of(cls, scores: Sequence[float]) -> Figure:
        """Return the figure of the scores of all seeds, NaN for a lost one."""
        found = [float(v) for v in scores if np.isfinite(v)]
        return cls(tuple(float(v) if np.isfinite(v) else None for v in scores),
                   float(np.mean(found)) if found else None,
                   float(np.std(found, ddof=1) / len(found)**0.5) if len(found) > 1 else None,
                   float(np.median(found)) if found else None)

    @property
    def scores(self) -> Array:
        """Return the values as an array, NaN for a lost one."""
        return np.array([np.nan if v is None else v for v in self.values])


@dataclass(frozen=True)
class Row:
    """An entry of a case and its figures by score; lost: the seeds in which it ended early."""

    entry: str
    role: str
    setting: str
    seeds: tuple[int, ...]
    lost: tuple[int, ...]
    figures: Mapping[str, Figure]
    command: str


@dataclass(frozen=True)
class Held:
    """
    A figure, and what it was held against: low <= got <= high, None for no bound.

    error: how far the figure hangs on the seeds that were drawn, a standard deviation; verdict:
    'held', 'open' where it misses by less than twice that, or 'missed'.
    """

    what: str
    got: float
    error: float
    low: float | None
    high: float | None
    verdict: str

    @classmethod
    def to(cls, what: str, statistic: Callable[[Array], float], scores: Array,
           low: float | None, high: float | None) -> Held:
        """Return what a statistic of scores (seeds, ...) comes to, held against its bounds."""
        got, rng = statistic(scores), np.random.default_rng(0)
        again = [statistic(scores[rng.integers(len(scores), size=len(scores))])
                 for _ in range(RESAMPLES)]
        error = float(np.std(again))
        by = max(low - got if low is not None else 0.0, got - high if high is not None else 0.0)
        verdict = 'held' if by <= 0 else 'open' if by < 2 * error else 'missed'
        return cls(what, float(got), error, low, high, verdict)


def rows(case: Case, seeds: Sequence[int], outcomes: Sequence[Outcome],
         command: str) -> list[Row]:
    """Return a row for each entry of a case, from the outcomes of some seeds."""
    made = []
    for entry in case.entries:
        scores = [outcome.scores[entry.name] for outcome in outcomes]
        figures = {name: Figure.of([score[name] for score in scores]) for name in scores[0]}
        first = next(iter(figures.values()))
        lost = tuple(seed for seed, value in zip(seeds, first.values) if value is None)
        made.append(Row(entry.name, entry.role, entry.setting, tuple(seeds), lost, figures,
                        command))
    return made


def held(case: Case, found: Sequence[Row]) -> list[Held]:
    """Return what the figures of a case were held against."""
    by_name = {row.entry: row for row in found}
    against = [Held.to(
        f'{"median of " if e.median else ""}{e.score} of {e.entry}, for {e.source} {e.value:g}',
        np.nanmedian if e.median else np.nanmean, by_name[e.entry].figures[e.score].scores,
        e.value - e.within, e.value + e.within) for e in case.expected]
    return against + list(_against_the_optimum(case, found))


def of_role(found: Sequence[Row], role: str) -> Row | None:
    """Return the first row of a role."""
    return next((row for row in found if row.role == role), None)


def _against_the_optimum(case: Case, found: Sequence[Row]) -> Iterator[Held]:
    best, optimum = of_role(found, 'best'), of_role(found, 'optimum')
    if best is None or optimum is None:
        return
    digest, word = (np.nanmedian, 'median ') if case.median else (np.nanmean, '')
    for score in [name for name in optimum.figures if name in best.figures]:
        both = np.stack([row.figures[score].scores for row in (best, optimum)], axis=1)
        if score.startswith('rmse'):
            yield Held.to(f"{word}{score} of {best.entry} over the optimum's",
                          lambda both: float(digest(both[:, 0]) / digest(both[:, 1])), both,
                          None, 1 + ERROR_WITHIN)
        elif score in (f'coverage_1{case.covered}', f'coverage_2{case.covered}'):
            yield Held.to(f"{score} of {best.entry} less the optimum's",
                          lambda both: float(np.nanmean(both[:, 0] - both[:, 1])), both,
                          -COVERAGE_WITHIN, COVERAGE_WITHIN)


def plain(value: Any) -> Any:
    """Return dataclasses and what they hold as what JSON knows."""
    if hasattr(value, '__dataclass_fields__'):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    return value
