"""Smoothing: what is believed of a moment given all measurements of a window, later ones too."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.kernels import Operator
from pif_ros.core.models import Sensor

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """
    The beliefs of a window given all of its measurements.

    stamps_ns: from the prior's on, in order and each once; beliefs: one for each; log_evidence:
    log p(all measurements), without those that no state allows.
    """

    stamps_ns: tuple[int, ...]
    beliefs: tuple[GridBelief, ...]
    log_evidence: float

    def at(self, stamp_ns: int) -> GridBelief:
        """Return the belief at one of the stamps; ValueError for another one."""
        if stamp_ns not in self.stamps_ns:
            raise ValueError(f'stamp_ns: expected one of the {len(self.stamps_ns)} smoothed '
                             f'stamps, got {stamp_ns}')
        return self.beliefs[self.stamps_ns.index(stamp_ns)]

    def means(self) -> Array:
        """Return the means, shape (stamps, n)."""
        return np.stack([belief.mean() for belief in self.beliefs])


@dataclass(frozen=True, eq=False)
class _Gap:
    """The belief at a stamp, what was predicted of the next, and what was believed there then."""

    start_ns: int
    end_ns: int
    before: GridBelief
    predicted: GridBelief
    after: GridBelief


def smooth(filter_: DiracFeynmanFilter, prior: GridBelief,
           measurements: Sequence[Measurement | tuple[int, str, ArrayLike]],
           start_ns: int | None = None, every_step: bool = False) -> Smoothed:
    """
    Return the beliefs at the prior's stamp and at each measurement's, given all measurements.

    The filter runs forward, then its own operators, transposed, run backward: exact for the
    filter's discretisation.  What leaves the grid on its way is no path at all; where all of it
    has, the belief of mass 0 tells nothing of what was before.  measurements: as such or
    (stamp_ns, source, values); start_ns: the prior's stamp, the first measurement's
    where none is given; every_step: also at the ends of the filter's steps in between.  Raises
    ValueError where there is no measurement, one lies before the prior or is none of its sensor's,
    or the filter's operator is in a wavelet basis, which cuts what is negative and so has no
    transpose.
    """
    if filter_.operator.wavelet:
        raise ValueError('filter_: expected an operator on the cells, got one in the wavelet '
                         f'basis {filter_.operator.wavelet}')
    ordered = in_order(measurements, start_ns)
    for m in ordered:
        _check(m, filter_.sensors)
    start = ordered[0].stamp_ns if start_ns is None else start_ns
    gaps, log_evidence = _forward(filter_, prior, ordered, start)
    steps = list(_backward(filter_, gaps, every_step))[::-1]
    return Smoothed(tuple(stamp for stamp, _ in steps), tuple(belief for _, belief in steps),
                    log_evidence)


def in_order(measurements: Sequence[Measurement | tuple[int, str, ArrayLike]],
             start_ns: int | None) -> list[Measurement]:
    """Return measurements by stamp, source and values, as the tracker takes them."""
    ordered = sorted(m if isinstance(m, Measurement) else Measurement(
        _whole(m[0]), m[1], tuple(map(float, np.atleast_1d(m[2])))) for m in measurements)
    if not ordered:
        raise ValueError('measurements: expected at least one, got none')
    if start_ns is not None and ordered[0].stamp_ns < start_ns:
        raise ValueError(f'measurements: expected stamps from {start_ns} on, that of the prior, '
                         f'got {ordered[0].stamp_ns}')
    return ordered


def _whole(stamp_ns: object) -> int:
    """Return a stamp, which seconds are none of, not even whole ones."""
    if not isinstance(stamp_ns, (int, np.integer)):
        raise ValueError('measurements: expected stamps in whole nanoseconds, an int each, '
                         f'got {stamp_ns!r}')
    return int(stamp_ns)


def _check(m: Measurement, sensors: Mapping[str, Sensor]) -> None:
    """Refuse a measurement that is none of a sensor's."""
    if m.source not in sensors:
        raise ValueError(f'measurements: expected sources {", ".join(sensors)}, got {m.source}')
    size = sensors[m.source].size
    if len(m.values) != size or not np.all(np.isfinite(m.values)):
        raise ValueError(f'measurements: expected {size} finite values of {m.source}, '
                         f'got {list(m.values)}')


def _forward(filter_: DiracFeynmanFilter, prior: GridBelief, measurements: list[Measurement],
             start_ns: int) -> tuple[list[_Gap], float]:
    """Return what the filter believed, gap by gap, and the log evidence in total."""
    gaps, now, belief, total = [], start_ns, prior, 0.0
    for stamp, together in groupby(measurements, lambda m: m.stamp_ns):
        before, predicted = belief, filter_.predict(belief, now, stamp)
        belief = predicted
        for m in together:
            belief, log_evidence = filter_.correct(belief, m.values, m.source, stamp)
            # what no state allows is not believed, and says nothing of what is
            total += log_evidence if log_evidence > -math.inf else 0.0
        gaps.append(_Gap(now, stamp, before, predicted, belief))
        now = stamp
    return gaps, total


def _backward(filter_: DiracFeynmanFilter, gaps: list[_Gap],
              every_step: bool) -> Iterator[tuple[int, GridBelief]]:
    """Yield stamps and smoothed beliefs, the last first."""
    belief = gaps[-1].after
    yield gaps[-1].end_ns, belief
    for gap in reversed(gaps):
        # p(x' | Y) = p(x' | Y') sum_x'' K(x'', x') p(x'' | Y) / p(x'' | Y')
        told = belief.mass > 0
        message = (_ratio(belief.density.ravel(), gap.predicted.density.ravel()) if told
                   else np.ones(filter_.grid.size))
        steps = [_Step(*step) for step in filter_.steps(gap.start_ns, gap.end_ns)]
        forward = _carried(filter_, gap, steps) if every_step else {}
        for step in reversed(steps):
            if told:
                moved = step.operator_at(step.start_ns).T @ message  # type: ignore[attr-defined]
                message = moved if step.share == 1 else (
                    step.share * moved + (1 - step.share) * message)
            if step.start_ns in forward:
                yield step.start_ns, _product(forward[step.start_ns], message)
        belief = _product(gap.before, message)
        if gap.start_ns < gap.end_ns:
            yield gap.start_ns, belief


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of the filter: what gives its operator, and what share of that."""

    start_ns: int
    operator_at: Callable[[int], Operator]
    share: float


def _carried(filter_: DiracFeynmanFilter, gap: _Gap,
             steps: list[_Step]) -> dict[int, GridBelief]:
    """Return what was predicted at the beginning of each step of a gap but the first."""
    found, belief = {}, gap.before
    for step, following in zip(steps, steps[1:]):
        belief = filter_.predict(belief, step.start_ns, following.start_ns)
        found[following.start_ns] = belief
    return found


def _ratio(smoothed: Array, predicted: Array) -> Array:
    """Return smoothed / predicted up to a factor, 0 where nothing was predicted."""
    with np.errstate(divide='ignore', invalid='ignore'):
        # in logs: after an outlier the ratio may be beyond the largest number
        log_ratio = np.log(smoothed) - np.log(predicted)
    log_ratio[~(predicted > 0)] = -np.inf
    return np.exp(log_ratio - log_ratio.max())


def _product(belief: GridBelief, message: Array) -> GridBelief:
    """Return the belief times a message, of mass 1; one of mass 0 as it is."""
    if not belief.mass > 0:
        return belief
    density = belief.density.ravel() * message
    return GridBelief(belief.grid, density.reshape(belief.grid.shape)).normalised()
