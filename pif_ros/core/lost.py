"""
Lost or not: one test on how surprising the measurements are, and one verdict.

Let T_k = P(p(Y) <= p(y_k)), Y drawn from the predictive density p of the kth measurement given all
before it.  For a filter whose belief is right the T_k are independent and uniform on [0, 1],
whatever the model, the shape of the belief and the sensor [Rosenblatt 1952; Dawid 1984], so that
-log T_k is exponential with mean 1: what is known of no false alarms needs no tuning.  For one
that is lost they are small: as alternative -log T_k with a mean 1/a, a < 1.  Page's test
[Page 1954]

    S_k = max(0, S_(k-1) + log a - (1 - a) log T_k),   alarm where S_k >= h

raises a false alarm after exp(h) measurements or more on average [Lorden 1971], a rate of exp(-h),
and detects such a change sooner than any other of that rate [Moustakides 1986].  An increment is
held to a quarter of h, so that no three outliers alone raise it; that makes it only smaller, and
the bound holds as it stands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math

#: The alternative: a lost filter finds log T five times as large as it should be.
SHAPE = 0.2
#: An alarm takes this many measurements at least.
FEWEST = 4
#: A belief that fills more than this share of the grid knows next to nothing.
SPREAD = 0.3
#: One whose heaviest mode has less than this share of the mass does not know where.
AMBIGUOUS = 0.6


@dataclass(frozen=True)
class Watch:
    """
    What is remembered from measurement to measurement, a function of these in their order.

    score: S of the test, up to its threshold; lost: whether an alarm was raised that has not been
    taken back, as it is once the score is 0 again; rejected: in a row, by source, those that have
    any; recoveries: how often the belief was given a share of another one.
    """

    score: float = 0.0
    lost: bool = False
    rejected: tuple[tuple[str, int], ...] = ()
    recoveries: int = 0

    def rejections(self, source: str) -> int:
        """Return how many of a source's measurements were rejected since it had one accepted."""
        return dict(self.rejected).get(source, 0)

    def counted(self, source: str, rejections: int) -> Watch:
        """Return the same with so many of a source's in a row."""
        counts = {**dict(self.rejected), source: rejections}
        return replace(self, rejected=tuple(sorted(
            (name, count) for name, count in counts.items() if count)))

    def recovered(self) -> Watch:
        """Return the same after a recovery: halfway to the next, and lost until it is found."""
        return replace(self, score=self.score / 2, recoveries=self.recoveries + 1)


@dataclass(frozen=True)
class Alarm:
    """The test, with its rate of false alarms per measurement, between 0 and 1."""

    rate: float = 1e-5

    def __post_init__(self) -> None:
        """Refuse what is no rate."""
        if not 0 < self.rate < 1:
            raise ValueError(f'rate: expected a number between 0 and 1, got {self.rate!r}')

    @property
    def threshold(self) -> float:
        """Return h = -log(rate)  [Lorden 1971, theorem 2]."""
        return -math.log(self.rate)

    def after(self, watch: Watch, tail: float) -> Watch:
        """Return what is known after a measurement with tail probability T, NaN for unknown."""
        if math.isnan(tail):
            return watch
        h = self.threshold
        surprise = -math.log(tail) if tail > 0 else math.inf
        step = min(math.log(SHAPE) + (1 - SHAPE) * surprise, h / FEWEST)
        score = min(max(0.0, watch.score + step), h)
        # the sum of quarters may round to just below
        raised = score >= h * (1 - 1e-12)
        return replace(watch, score=score, lost=raised or (watch.lost and score > 0))

    def is_raised(self, watch: Watch) -> bool:
        """Return whether the newest measurement raised it, or raised it again."""
        return watch.score >= self.threshold * (1 - 1e-12)


@dataclass(frozen=True)
class Verdict:
    """
    One word on a filter, a sentence for a person, and the numbers behind it.

    level: 'found', 'unsure' or 'lost'.
    """

    level: str
    sentence: str
    numbers: Mapping[str, float] = field(default_factory=dict)


def verdict(watch: Watch, alarm: Alarm | None, filled: float,
            masses: Sequence[float]) -> Verdict:
    """
    Return whether a filter is lost, by evidence, entropy and modes together.

    filled: the share of the grid that the belief fills, exp(entropy - that of the uniform one);
    masses: those of its modes, heaviest first, none where nobody has looked for them.  Lost is who
    is contradicted by the measurements, and stays so until they fit again; unsure is who is not
    contradicted, but fills much of the grid, or has no mode that holds most of the mass.
    alarm: None where nobody watches whether the measurements fit, which is said then.
    """
    heaviest, scattered = max(masses, default=0.0), len(masses) > 1
    numbers = {'share of the grid filled': filled, 'modes': float(len(masses)),
               'mass of the heaviest mode': heaviest, 'recoveries': float(watch.recoveries)}
    if alarm is not None:
        numbers = {'surprise': watch.score / alarm.threshold, **numbers}
    spread = filled > SPREAD
    torn = scattered and heaviest < AMBIGUOUS
    where = (f'the belief fills {filled:.0%} of the grid' if spread else
             f'{len(masses)} places are possible, the likeliest by {heaviest:.0%}' if torn else
             f'the belief fills {filled:.1%} of the grid' if not masses else
             'the belief is in one place' if not scattered else
             f'{heaviest:.0%} of the belief is in one place')
    if watch.lost:
        return Verdict('lost', f'lost: the measurements contradict what was believed; {where}',
                       numbers)
    if spread or torn:
        return Verdict('unsure', f'unsure: {where}', numbers)
    fit = ', and' if alarm is not None else '; it is not watched whether'
    return Verdict('found', f'found: {where}{fit} the measurements fit', numbers)
