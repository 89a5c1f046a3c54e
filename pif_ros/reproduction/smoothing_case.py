"""Smoothing: whole paths by Monte Carlo, against the grid filter's forward and backward run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.path_monte_carlo import PathPosterior, PathSample, sample, SamplerSettings
from pif_ros.core.smoothing import smooth, Smoothed
from pif_ros.reproduction.filtering import error_scores
from pif_ros.reproduction.records import Record
from pif_ros.reproduction.study import Entry, Expected, Outcome
from pif_ros.reproduction.tracks import follow, sizes

Array = NDArray[np.float64]

FILTER = Entry('filter', '', 'the grid, no later measurements')
SMOOTHER = Entry('smoother', 'best', 'the grid, forward and backward')
PATHS = Entry('path Monte Carlo', 'optimum', 'whole paths from exp(-action)')
#: The rms over time of what path Monte Carlo and grid differ by, in standard errors.
APART, R_HAT, SIZE = 'apart, in standard errors', 'largest R-hat', 'least effective size'


@dataclass(frozen=True, eq=False)
class SmoothedRecord:
    """What the pictures of a smoothing case are drawn from."""

    record: Record
    smoothed: Smoothed
    sample: PathSample


@dataclass(frozen=True, eq=False)
class SmoothingCase:
    """
    The states of a window given all measurements in it, their signs left out.

    mean, covariance: of the Gaussian prior; kernel: of grid and paths alike, so that both have
    the same density.
    """

    name: str
    title: str
    printed: str
    model: StateModel
    sensors: Mapping[str, Sensor]
    mean: ArrayLike
    covariance: ArrayLike
    grid: Grid
    kernel: KernelSettings
    sampler: SamplerSettings
    draw: Callable[[Generator], Record]
    remarks: Sequence[str] = ()
    median: bool = False
    covered: str = ''

    @property
    def entries(self) -> Sequence[Entry]:
        """Return the lines of the table."""
        return FILTER, SMOOTHER, PATHS

    @property
    def expected(self) -> Sequence[Expected]:
        """Return that both agree within the Monte Carlo error."""
        return [Expected(PATHS.name, APART, 1.0, 0.3, 'Monte Carlo error alone'),
                Expected(PATHS.name, R_HAT, 1.0, 0.05, 'chains that agree')]

    def run(self, seed: int, keep: bool) -> Outcome:
        """Return the scores of all three on the record of this seed."""
        record = self.draw(np.random.default_rng(seed))
        filter_ = DiracFeynmanFilter(self.model, self.grid, self.sensors, self.kernel)
        prior, absolute = filter_.gaussian(self.mean, self.covariance), sizes(self.grid)
        measured = [Measurement(stamp, record.sensor, tuple(y.tolist()))
                    for stamp, y in zip(record.stamps_ns.tolist(), record.measured)]
        track = follow(filter_, prior, record, absolute.moments, {})
        times = [perf_counter()]
        smoothed = smooth(filter_, prior, measured, 0)
        times.append(perf_counter())
        drawn = sample(PathPosterior(self.model, self.sensors, self.kernel, self.mean,
                                     self.covariance, measured, 0), self.sampler, seed)
        times.append(perf_counter())
        moments = np.array([absolute.moments(belief) for belief in smoothed.beliefs[1:]])
        average, square = drawn.average(np.abs), drawn.average(np.square)
        means = average.mean[1:]
        apart = (means - moments[:, 0]) / average.standard_error[1:]
        truth, (fast, slow) = np.abs(record.truth), np.diff(times)
        scores = {
            FILTER.name: {**error_scores(truth, track.means, track.variances),
                          'start_s': float(track.seconds.sum())},
            SMOOTHER.name: {**error_scores(truth, moments[:, 0], moments[:, 1]), 'start_s': fast},
            PATHS.name: {**error_scores(truth, means, square.mean[1:] - means**2), 'start_s': slow,
                         APART: float(np.sqrt(np.mean(apart**2))),
                         R_HAT: float(drawn.r_hat.max()),
                         SIZE: float(drawn.effective_sample_size.min())}}
        return Outcome(scores, SmoothedRecord(record, smoothed, drawn) if keep else None)
