"""
What stands between a measurement and a belief: gate, outliers, recovery, and the watch over all.

All of it is a function of the belief before the measurement, the measurement and the watch so far,
and so of the ordered measurements alone: who replays them comes to the same verdicts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import math
from typing import Any, cast, Generic

import numpy as np
from pif_ros.core.clutter import Clutter, MovingClutter
from pif_ros.core.filters import Belief, Expecting, Filter, NANOSECONDS
from pif_ros.core.lost import Alarm, Watch
from pif_ros.core.predictive import Predictive

#: A share of a belief that is not worth having.
NEGLIGIBLE = 1e-12


@dataclass(frozen=True)
class Gate:
    """
    What is done about a source's outliers.

    tail_probability: a measurement y is rejected where P(p(Y) <= p(y)) is below it, p being the
    density of what is expected, whatever its shape; 0 for never; max_consecutive_rejections: with
    the last of so many in a row comes a recovery; outlier_probability: o, where a measurement is
    clutter as often as that, and clutter its density.
    """

    tail_probability: float = 0.0
    max_consecutive_rejections: int = 5
    outlier_probability: float = 0.0
    clutter: Clutter | MovingClutter | None = None

    def __post_init__(self) -> None:
        """Refuse what makes no gate."""
        o, alpha = self.outlier_probability, self.tail_probability
        if not 0 <= o < 1:
            raise ValueError(f'outlier_probability: expected a number from 0 to below 1, got {o}')
        if o and self.clutter is None:
            raise ValueError('clutter: expected the density of clutter where there is some')
        if not 0 <= alpha < 1:
            raise ValueError(f'tail_probability: expected a number from 0 to below 1, got {alpha}')
        if 0 < alpha <= o:
            raise ValueError('tail_probability: expected more than outlier_probability, or nothing'
                             f' is ever rejected: {o}, got {alpha}')
        if self.max_consecutive_rejections < 1:
            raise ValueError('max_consecutive_rejections: expected at least 1, '
                             f'got {self.max_consecutive_rejections}')

    def log_clutter(self, y: tuple[float, ...], at_ns: int) -> float:
        """Return the log density of clutter at a measurement."""
        assert self.clutter is not None
        return self.clutter.at(at_ns / NANOSECONDS).log_density(y)

    def tail(self, expected: Predictive, y: tuple[float, ...]) -> float:
        """
        Return how often the source surprises like that.

        Clutter is all but flat, so that the order is that of p alone, and all of the clutter is
        taken to be as rare as y: o + (1 - o) P(p(Y) <= p(y)), hardly too large.
        """
        o = self.outlier_probability
        return o + (1 - o) * expected.tail(y)


@dataclass(frozen=True, eq=False)
class Recovery:
    """What is mixed into the belief of a filter that is locked out: a share of another belief."""

    belief: Any
    share: float = 0.1
    when_lost: bool = False

    def __post_init__(self) -> None:
        """Refuse a share that is none."""
        if not 0 < self.share < 1:
            raise ValueError(f'share: expected a number between 0 and 1, got {self.share!r}')


@dataclass(frozen=True, eq=False)
class Outcome(Generic[Belief]):
    """
    What became of a belief at a measurement.

    log_evidence: log p(y | all before), clutter included; tail: how often a measurement surprises
    like that, NaN where nobody asked; gated: whether it was rejected, and the belief does not know
    of it; recovered: whether a share of another belief was mixed in before.
    """

    belief: Belief
    log_evidence: float
    watch: Watch = Watch()
    tail: float = math.nan
    gated: bool = False
    recovered: bool = False


@dataclass(frozen=True, eq=False)
class Guard:
    """
    What corrects beliefs, and does not trust every measurement.

    gates: by source, none for a source without; recovery: what is mixed in after too many
    rejections in a row, or, if it is to be, at an alarm; alarm: the test on whether the filter is
    lost, None for none.  Without any of these it is the filter's own correct.
    """

    gates: Mapping[str, Gate] = field(default_factory=dict)
    recovery: Recovery | None = None
    alarm: Alarm | None = None

    def __post_init__(self) -> None:
        """Refuse a gate that nothing opens again."""
        if self.recovery is None and any(g.tail_probability for g in self.gates.values()):
            raise ValueError('recovery: expected one where there is a gate, which locks the '
                             'filter out otherwise')

    def only_watches(self, source: str) -> bool:
        """Return whether a source's measurements are watched, but the watch moves no belief."""
        return (self.alarm is not None and not self.gates.get(source, OPEN).tail_probability
                and not (self.recovery is not None and self.recovery.when_lost))

    def watched(self, filter_: Filter[Belief], predicted: Belief, y: tuple[float, ...],
                source: str, at_ns: int, watch: Watch) -> Watch:
        """Return the watch after a measurement of a source that is only watched."""
        assert self.alarm is not None
        expected = cast(Expecting[Belief], filter_).predictive(predicted, source, at_ns)
        tail = self.gates.get(source, OPEN).tail(expected, y)
        return self.alarm.after(watch, tail).counted(source, 0)

    def correct(self, filter_: Filter[Belief], predicted: Belief, y: tuple[float, ...],
                source: str, at_ns: int, watch: Watch | None) -> Outcome[Belief]:
        """
        Return what becomes of a predicted belief at a measurement.

        watch: None for a source that is only watched, to look later.
        """
        gate = self.gates.get(source, OPEN)
        if watch is None or self.alarm is None and not gate.tail_probability:
            return Outcome(*_robust(filter_, predicted, y, source, at_ns, gate), watch or Watch())
        asked = cast(Expecting[Belief], filter_)
        expected = asked.predictive(predicted, source, at_ns)
        tail = gate.tail(expected, y)
        watch = watch if self.alarm is None else self.alarm.after(watch, tail)
        gated = tail < gate.tail_probability
        rejections = watch.rejections(source) + 1 if gated else 0
        belief, recovered = predicted, False
        if self.recovery is not None and self._is_due(watch, rejections, gate):
            belief = asked.mixed(predicted, self.recovery.belief, self.recovery.share, at_ns)
            expected = asked.predictive(belief, source, at_ns)
            watch, recovered, rejections = watch.recovered(), True, 0
            gated = gate.tail(expected, y) < gate.tail_probability
        watch = watch.counted(source, rejections)
        if gated:
            log_p = _log_evidence(expected, y, at_ns, gate, belief.mass)
            return Outcome(belief, log_p, watch, tail, True, recovered)
        return Outcome(*_robust(filter_, belief, y, source, at_ns, gate), watch, tail, False,
                       recovered)

    def _is_due(self, watch: Watch, rejections: int, gate: Gate) -> bool:
        """Return whether a recovery is due at a measurement."""
        assert self.recovery is not None
        if rejections >= gate.max_consecutive_rejections:
            return True
        return self.recovery.when_lost and self.alarm is not None and self.alarm.is_raised(watch)


#: Where nothing is said of a source: all that it says is taken.
OPEN = Gate()


def _robust(filter_: Filter[Belief], belief: Belief, y: tuple[float, ...], source: str,
            at_ns: int, gate: Gate) -> tuple[Belief, float]:
    """
    Return the belief given a measurement that may be clutter, and its log evidence.

    With the likelihood (1 - o) N(y; h(x), R) + o u(y), of which clutter's density u does not
    depend on the state, the posterior is the mixture of that without clutter and the belief as it
    was, by what each says of y: (1 - o) p(y) and o u(y).
    """
    corrected, log_p = filter_.correct(belief, y, source, at_ns)
    o = gate.outlier_probability
    if not (o and belief.mass > 0):
        return corrected, log_p
    # what has left the grid says nothing, neither of y nor of clutter
    log_u = gate.log_clutter(y, at_ns) + math.log(o * belief.mass)
    log_evidence = float(np.logaddexp(math.log1p(-o) + log_p, log_u))
    share = math.exp(log_u - log_evidence) if log_evidence > -math.inf else 0.0
    if share < NEGLIGIBLE:
        return corrected, log_evidence
    mixed = cast(Expecting[Belief], filter_).mixed(corrected, belief, share, at_ns)
    return mixed, log_evidence


def _log_evidence(expected: Predictive, y: tuple[float, ...], at_ns: int, gate: Gate,
                  mass: float) -> float:
    """Return log p(y), clutter included, of what was not used; what has left says nothing."""
    if not mass > 0:
        return -math.inf
    log_p, o = expected.log_density(y), gate.outlier_probability
    if o:
        log_p = float(np.logaddexp(math.log1p(-o) + log_p,
                                   math.log(o) + gate.log_clutter(y, at_ns)))
    return log_p + math.log(mass)
