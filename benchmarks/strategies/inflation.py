"""Thin noise inflated to the cells, against weights that keep it thin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from benchmarks.progress import Progress
from benchmarks.report import Row, Table
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.systems import cubic_bearing

Array = NDArray[np.float64]

SYSTEM = cubic_bearing()
SENSOR = SYSTEM.sensors['arcsine']()
#: The paper's first example.
START, EDGE, TIME_STEP, STEPS = (0.37, 0.31), 0.8, 0.01, 200
STEP_NS = 10_000_000
PATHS = 40
SUBSTEPS = 10
#: Cells on an axis, and alpha.
CASES = ((42, 0.0), (42, 0.5), (42, 1.0), (84, 0.0), (84, 1.0), (168, 0.0))
BASE = (42, 0.0)


@dataclass(frozen=True, eq=False)
class Track:
    """A simulated path (steps, 2) and what was measured along it (steps, 1)."""

    truth: Array
    measurements: Array


def run(effort: Effort) -> Table:
    """Filter the same paths with every noise."""
    paths = [_track(seed) for seed in range(effort.scaled(PATHS))]
    progress, filters = Progress('strategies.inflation'), {case: _filter(*case) for case in CASES}
    figures: dict[tuple[int, float], list[Array]] = {case: [] for case in CASES}
    for number, track in enumerate(paths):
        for case, filter_ in filters.items():
            figures[case].append(_followed(filter_, track))
        progress.show((number + 1) / len(paths))
    samples = interleave({str(case): Contestant(_steps(filter_, paths[0]), 10)
                          for case, filter_ in filters.items()}, STEPS // 10, 1)
    rows = []
    for case in CASES:
        rmse, one, two = np.array(figures[case]).T
        rows.append(Row.timed(
            f'alpha {case[1]:g}' if case[1] else 'true noise', f'{case[0]} x {case[0]}',
            samples[str(case)], samples[str(BASE)], f'true noise, {BASE[0]} x {BASE[0]}',
            {'rmse': float(rmse.mean()), 'its error': float(rmse.std(ddof=1) / len(rmse)**0.5),
             'median': float(np.median(rmse)), 'cov1': float(one.mean()),
             'cov2': float(two.mean())}))
    return Table('Noise inflation, `cubic_bearing`', rows, [
        f'{len(paths)} paths from {START}, sigma_y = 0.2, {STEPS} steps of {TIME_STEP:g} s, a '
        'measurement after each, uniform prior; those that leave the box are counted too.',
        'rmse: root of the mean square over both states and time, its mean over the paths, the '
        'standard error of that, and its median.',
        'cov1, cov2: share of time in which the truth lies within 1 and 2 standard deviations of '
        'the mean, both states.'])


def _track(seed: int) -> Track:
    rng = np.random.default_rng(seed)
    truth = simulate(SYSTEM.model, START, TIME_STEP * np.arange(STEPS + 1), rng, SUBSTEPS)[1:]
    return Track(truth, np.array([measure(SENSOR, x, 0.0, rng) for x in truth]))


def _filter(cells: int, alpha: float) -> DiracFeynmanFilter:
    grid = Grid((-EDGE, -EDGE), (EDGE, EDGE), (cells, cells))
    return DiracFeynmanFilter(SYSTEM.model, grid, {'arcsine': SENSOR},
                              KernelSettings(TIME_STEP, noise_inflation=alpha))


def _steps(filter_: DiracFeynmanFilter, track: Track) -> Callable[[int], object]:
    """Return what predicts a uniform belief, and corrects it with the k-th measurement."""
    belief = filter_.uniform()
    return lambda k: _step(filter_, belief, track.measurements[k], k)


def _step(filter_: DiracFeynmanFilter, belief: GridBelief, y: Array, k: int) -> GridBelief:
    moved = filter_.predict(belief, k * STEP_NS, (k + 1) * STEP_NS)
    return filter_.correct(moved, y, 'arcsine', (k + 1) * STEP_NS)[0]


def _followed(filter_: DiracFeynmanFilter, track: Track) -> Array:
    """Return RMSE, and the shares of time within 1 and 2 standard deviations."""
    belief, error, deviation = filter_.uniform(), [], []
    for k, (x, y) in enumerate(zip(track.truth, track.measurements)):
        belief = _step(filter_, belief, y, k)
        error.append(belief.mean() - x)
        deviation.append(np.sqrt(np.diag(belief.covariance())))
    e, s = np.array(error), np.array(deviation)
    return np.array([np.sqrt(np.mean(e**2)), np.mean(np.abs(e) <= s), np.mean(np.abs(e) <= 2 * s)])
