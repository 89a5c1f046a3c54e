"""What the seeds of a case come to: rows of figures, and whether they are what they should be."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pif_ros.reproduction.study import Case, Outcome

#: How near the best setting is to come to the optimum: in the error, and in either coverage.
ERROR_WITHIN, COVERAGE_WITHIN = 0.05, 0.02


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
    """A figure, and what it was held against: low <= got <= high, None for no bound."""

    what: str
    got: float | None
    low: float | None
    high: float | None

    @property
    def met(self) -> bool:
        """Return whether it is so."""
        return (self.got is not None and (self.low is None or self.low <= self.got)
                and (self.high is None or self.got <= self.high))


def rows(case: Case, seeds: Sequence[int], outcomes: Sequence[Outcome],
         command: str) -> list[Row]:
    """Return a row for each entry of a case, from the outcomes of some seeds."""
    made = []
    for entry in case.entries:
        scores = [outcome.scores[entry.name] for outcome in outcomes]
        figures = {name: Figure.of([score[name] for score in scores]) for name in scores[0]}
        first = next(iter(figures.values()), None)
        lost = [] if first is None else [
            seed for seed, value in zip(seeds, first.values) if value is None]
        made.append(Row(entry.name, entry.role, entry.setting, tuple(seeds), tuple(lost),
                        figures, command))
    return made


def held(case: Case, found: Sequence[Row]) -> list[Held]:
    """Return what the figures of a case were held against."""
    by_name = {row.entry: row for row in found}
    against = []
    for e in case.expected:
        got = digest(by_name[e.entry].figures[e.score], e.median)
        against.append(Held(
            f'{"median of " if e.median else ""}{e.score} of {e.entry}, for {e.source} '
            f'{e.value:g}', got, e.value - e.within, e.value + e.within))
    return against + list(_against_the_optimum(case, found))


def digest(figure: Figure, median: bool) -> float | None:
    """Return the median or the mean of a figure."""
    return figure.median if median else figure.mean


def of_role(found: Sequence[Row], role: str) -> Row | None:
    """Return the first row of a role."""
    return next((row for row in found if row.role == role), None)


def _against_the_optimum(case: Case, found: Sequence[Row]) -> Iterator[Held]:
    best, optimum = of_role(found, 'best'), of_role(found, 'optimum')
    if best is None or optimum is None or 'rmse' not in optimum.figures:
        return
    pair = [digest(row.figures['rmse'], case.median) for row in (best, optimum)]
    yield Held(f'{"median " if case.median else ""}rmse of {best.entry} over the optimum\'s',
               None if None in pair else pair[0] / pair[1],  # type: ignore[operator]
               None, 1 + ERROR_WITHIN)
    for score in ('coverage_1', 'coverage_2'):
        got = [row.figures[score].mean for row in (best, optimum)]
        yield Held(f'{score} of {best.entry} less the optimum\'s',
                   None if None in got else got[0] - got[1],  # type: ignore[operator]
                   -COVERAGE_WITHIN, COVERAGE_WITHIN)


def plain(value: Any) -> Any:
    """Return dataclasses and what they hold as what JSON knows."""
    if hasattr(value, '__dataclass_fields__'):
        made = {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
        return {**made, 'met': value.met} if isinstance(value, Held) else made
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [plain(item) for item in value]
    return value
