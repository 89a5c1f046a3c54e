"""The exact answer, as nearly as it can be had, to hold the contestants against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.problem import (
    euler, grid_filter, prior, PRIOR_COVARIANCE, PRIOR_MEAN, Recording, STEP_NS, TIME_STEP)
from benchmarks.progress import Progress
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.kernels import KernelSettings
from scipy.interpolate import RectBivariateSpline

Array = NDArray[np.float64]

#: Cells per axis; a sub-step of a quarter of the time step is still a cell wide.
CELLS = 200
SUBSTEPS = (2, 4)


@dataclass(frozen=True, eq=False)
class Means:
    """The posterior means of x and of |x| after each correction, (steps, 2) each."""

    x: Array
    size: Array

    def __add__(self, other: Means) -> Means:
        return Means(self.x + other.x, self.size + other.size)

    def __rmul__(self, factor: float) -> Means:
        return Means(factor * self.x, factor * self.size)

    def distance(self, other: Means) -> tuple[float, float]:
        """Return the RMS distance of the means of x, and of those of |x|."""
        return _rms(self.x - other.x), _rms(self.size - other.size)


@dataclass(frozen=True, eq=False)
class Cells:
    """A density (N,) at the centres (2, N) of cells of one volume, wherever they lie."""

    x: Array
    density: Array
    volume: float


@dataclass(frozen=True, eq=False)
class Reference:
    """
    The means of the exact filter, and how far they can be trusted.

    error: RMS distance of the means of x between the two finest computations, of which the
    reference is the extrapolation to sub-steps of no length.
    """

    means: Means
    error: float


class Referee:
    """Grid filters with sub-steps, extrapolated: the kernel's error is first order in the step."""

    def __init__(self) -> None:
        """Build the two kernels."""
        self._filters = [grid_filter(CELLS, KernelSettings(
            TIME_STEP / n, weights='sampled', tolerance=1e-7)) for n in SUBSTEPS]

    def means(self, recording: Recording, progress: Callable[[float], None]) -> Reference:
        """Return the reference for a recording."""
        slow, fast = SUBSTEPS[1] / sum(SUBSTEPS), SUBSTEPS[0] / sum(SUBSTEPS)
        coarse = grid_means(self._filters[0], recording, lambda share: progress(fast * share))
        fine = grid_means(self._filters[1], recording,
                          lambda share: progress(fast + slow * share))
        return Reference(2.0 * fine + -1.0 * coarse, fine.distance(coarse)[0])

    def predicted(self, steps: int) -> tuple[Callable[[Array], Array], float]:
        """
        Return the density after some steps from N(0, I) without a measurement.

        As a function of states (2, N), and the L1 distance between the two finest computations.
        """
        coarse, fine = (predicted(filter_, steps) for filter_ in self._filters)
        change = np.abs(fine.density - coarse.density).sum() * fine.grid.cell_volume
        spline = RectBivariateSpline(*fine.grid.axes, 2 * fine.density - coarse.density)
        return lambda x: spline.ev(x[0], x[1]), float(change)


def grid_means(filter_: DiracFeynmanFilter, recording: Recording,
               progress: Callable[[float], None] = lambda share: None) -> Means:
    """Return the means that a grid filter gives for a recording."""
    belief, x, size = prior(filter_.grid), [], []
    for k, y in enumerate(recording.measurements):
        belief = filter_.predict(belief, k * STEP_NS, (k + 1) * STEP_NS)
        belief, _ = filter_.correct(belief, y, 'squares', (k + 1) * STEP_NS)
        x.append(belief.mean())
        size.append(mean_size(belief))
        progress((k + 1) / len(recording.measurements))
    return Means(np.array(x), np.array(size))


def mean_size(belief: GridBelief) -> Array:
    """Return the mean of |x|, which does not hang on the weights of mirrored humps."""
    return np.abs(belief.grid.points) @ belief.density.ravel() / belief.density.sum()


def predicted(filter_: DiracFeynmanFilter, steps: int) -> GridBelief:
    """Return the density after some steps from N(0, I)."""
    start = GridBelief.gaussian(filter_.grid, np.zeros(2), np.eye(2))
    return filter_.predict(start, 0, steps * STEP_NS)


def particle_means(recording: Recording, count: int, substeps: int = 4, seed: int = 7) -> Means:
    """Return the means of a plain bootstrap filter of many particles, resampled at each step."""
    rng, progress = np.random.default_rng(seed), Progress(f'{count} particles')
    cloud = rng.multivariate_normal(PRIOR_MEAN, PRIOR_COVARIANCE, count).T
    x, size = [], []
    for k, y in enumerate(recording.measurements):
        cloud = euler(cloud, TIME_STEP, substeps, rng)
        log_w = -0.5 * np.sum((y[:, None] - cloud**2)**2, axis=0)
        w = np.exp(log_w - log_w.max())
        w /= w.sum()
        x.append(cloud @ w)
        size.append(np.abs(cloud) @ w)
        edges = np.cumsum(w)
        picks = np.searchsorted(edges / edges[-1], (np.arange(count) + rng.random()) / count)
        cloud = cloud[:, picks]
        progress.show((k + 1) / len(recording.measurements))
    return Means(np.array(x), np.array(size))


def _rms(difference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
