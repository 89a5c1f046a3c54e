"""What is studied: a case of an example, its contenders, and what they are held against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

#: What a contender can be; a summary of a case takes the first of each.
ROLES = ('printed', 'best', 'sir', 'ekf', 'ukf', 'optimum', '')

#: The columns of the tables: what is measured for each seed, with how it is called there.
COLUMNS = {
    'rmse': 'rmse', 'to_optimum': 'to the optimum', 'to_best': 'to our best',
    'coverage_1': 'in 1 sigma', 'coverage_2': 'in 2 sigma', 'log_evidence': 'log evidence',
    'mass': 'mass', 'step_s': 'time per step', 'start_s': 'made in'}

Scores = Mapping[str, float]


@dataclass(frozen=True)
class Entry:
    """A line of a case's table: who, as what (one of ROLES), at which settings."""

    name: str
    role: str
    setting: str


@dataclass(frozen=True)
class Expected:
    """
    What a figure of an entry is to be near to, and how near.

    value, within: for the mean over the seeds, or the median where so asked; source: whose value
    it is, for the reader.
    """

    entry: str
    score: str
    value: float
    within: float
    source: str
    median: bool = False


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one seed gave: scores by entry, and what its pictures are drawn from, if asked for."""

    scores: Mapping[str, Scores]
    exhibit: Any = None


class Case(Protocol):
    """One setting of an example, that can be run for any seed."""

    @property
    def name(self) -> str:
        """Return the name, unique among all cases."""

    @property
    def title(self) -> str:
        """Return what is estimated, in words."""

    @property
    def printed(self) -> str:
        """Return what the paper prints."""

    @property
    def entries(self) -> Sequence[Entry]:
        """Return the lines of the table, in order."""

    @property
    def expected(self) -> Sequence[Expected]:
        """Return what figures are held against."""

    @property
    def remarks(self) -> Sequence[str]:
        """Return what a reader of the table must know, a sentence or two each."""

    @property
    def median(self) -> bool:
        """Return whether medians over the seeds are the fairer figure."""

    @property
    def covered(self) -> str:
        """Return the suffix of the coverages that are held against the optimum's."""

    def run(self, seed: int, keep: bool) -> Outcome:
        """Return the scores of a seed, and an exhibit where it is to be kept."""


class Example(Protocol):
    """A module of pif_ros.reproduction.examples."""

    TITLE: str
    SOURCE: str

    @staticmethod
    def cases(quick: bool, scratch: str) -> Sequence[Case]:
        """
        Return the cases; small ones, that show only that everything runs, if quick.

        scratch: a folder for what is made once and used again.
        """

    @staticmethod
    def draw(exhibits: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the pictures, figures of matplotlib by file name, from exhibits by case."""
