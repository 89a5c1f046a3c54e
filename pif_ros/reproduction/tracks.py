"""A filter follows a record, through the tracker; what it believed on its way."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import CorrectionFailed, Measurement
from pif_ros.core.filters import Filter
from pif_ros.core.grid import Grid
from pif_ros.core.tracker import Tracker
from pif_ros.reproduction.records import Record

Array = NDArray[np.float64]

#: What a filter may raise for its numbers; anything else is a mistake, and ends the run.
NUMERICAL = (ArithmeticError, np.linalg.LinAlgError)
#: Returns means and variances (n,) of a belief.
Moments = Callable[[Any], tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Reading:
    """What is read off a belief, a number or an array, after every so many measurements."""

    read: Callable[[Any], Any]
    every: int = 1


@dataclass(frozen=True, eq=False)
class Track:
    """
    What a filter believed after some of K measurements.

    chosen (k,): which; means, variances: (k, n); masses (K,): what each prediction kept on the
    grid; seconds (K,): time per measurement; log_evidence: its total; read: further readings by
    name, stacked; fault: why it ended before its time, '' where it did not.
    """

    chosen: NDArray[np.intp]
    means: Array
    variances: Array
    masses: Array
    seconds: Array
    log_evidence: float
    read: Mapping[str, Array]
    fault: str = ''


def follow(filter_: Filter[Any], prior: Any, record: Record, moments: Moments,
           readings: Mapping[str, Reading], every: int = 1) -> Track:
    """
    Return the track of a filter from a prior that holds at stamp 0.

    every: of so many measurements the moments are read after the last.  Where the filter raises,
    or believes what is not finite, the track ends with NaN and its fault says why.
    """
    K, n = record.truth.shape
    means, variances = np.full((K, n), np.nan), np.full((K, n), np.nan)
    masses, seconds = np.full(K, np.nan), np.full(K, np.nan)
    read: dict[str, list[Any]] = {name: [] for name in readings}
    tracker, fault, total = Tracker(filter_, prior, history=0.0, memory=0), '', 0.0
    tracker.reset(prior, 0)
    if record.origin is not None:
        tracker.observe(Measurement(0, record.sensor, tuple(record.origin.tolist())))
        tracker.estimate()
    chosen = np.arange(every - 1, K, every)
    for k, (stamp, y) in enumerate(zip(record.stamps_ns.tolist(), record.measured)):
        begin = perf_counter()
        try:
            masses[k] = tracker.forecast(stamp).belief.mass
            tracker.observe(Measurement(stamp, record.sensor, tuple(y.tolist())))
            estimate = tracker.estimate()
        except (CorrectionFailed, *NUMERICAL) as error:
            if not isinstance(error.__cause__ or error, NUMERICAL):
                raise
            fault = str(error.__cause__ or error)
            break
        seconds[k] = perf_counter() - begin
        if k % every == every - 1:
            means[k], variances[k] = moments(estimate.belief)
            if not np.all(np.isfinite(means[k])):
                fault = 'its mean is not finite'
                break
        total = estimate.total_log_evidence
        for name, reading in readings.items():
            if k % reading.every == 0:
                read[name].append(reading.read(estimate.belief))
    return Track(chosen, means[chosen], variances[chosen], masses, seconds, total,
                 {name: np.array(values) for name, values in read.items()}, fault)


@dataclass(frozen=True, eq=False)
class Estimand:
    """
    What is estimated of a state.

    moments: returns means and variances (n,) of it from a belief; of: returns it from states
    (K, n), of the same shape.
    """

    moments: Moments
    of: Callable[[Array], Array]


def moments(belief: Any) -> tuple[Array, Array]:
    """Return the mean of each state and its variance, (n,) each."""
    mean = belief.mean()
    return mean, np.diag(belief.covariance(mean))


def sizes(cells: Grid) -> Estimand:
    """Return the sizes |x_i| as what is estimated, read on the cells of a grid."""
    def read(belief: Any) -> tuple[Array, Array]:
        found = [_absolute(belief.on(cells, [axis])) for axis in range(cells.ndim)]
        return np.array([mean for mean, _ in found]), np.array([variance for _, variance in found])
    return Estimand(read, np.abs)


def _absolute(density: GridBelief) -> tuple[float, float]:
    x, p = np.abs(density.grid.axes[0]), density.density / density.density.sum()
    mean = float(x @ p)
    return mean, float((x - mean)**2 @ p)


#: The states themselves.
STATES = Estimand(moments, np.asarray)
