"""Correction only where the prediction is significant, against correction everywhere."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.problem import box, prior, Recording, SENSOR, simulate, STEP_NS, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import l1
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.kernels import KernelSettings

SHARES = (0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2)
CELLS = (62, 100, 200)
STEPS = 200
PER_TURN = 10
PASSES = 3
SEEDS = (1, 2, 3)


def run(effort: Effort) -> Table:
    """Correct the same predicted densities with every share, in turns."""
    recordings = [simulate(seed, STEPS) for seed in SEEDS[:effort.scaled(len(SEEDS), 1)]]
    rows: list[Row] = []
    for cells in CELLS:
        rows.extend(_rows(cells, recordings, effort))
    return Table('Correction where the prediction is significant, `coupled_trigonometric`', rows, [
        f'From N(0, 10 I), one measurement each {TIME_STEP:g} s, {STEPS} of them on '
        f'{len(recordings)} paths; time is that of a correction, on the first.',
        'share: cells with no more than this of the densest one are emptied, not corrected.',
        'cells: the part of them that is corrected, on the average. A hump that is emptied never '
        'comes back, however much measurements favour it later.',
        '1000 dev, 1000 L1: a thousand times the RMS distance of the mean, and the mean L1 of the '
        'density, to the filter that corrects everywhere, each having gone its own way.'])


def _filter(cells: int, share: float) -> DiracFeynmanFilter:
    return DiracFeynmanFilter(SYSTEM.model, box(cells), {'squares': SENSOR},
                              KernelSettings(TIME_STEP), significance=share)


def _rows(cells: int, recordings: list[Recording], effort: Effort) -> list[Row]:
    setting = f'{cells} x {cells}'
    progress = Progress(f'strategies.significance: {setting}')
    filters = {share: _filter(cells, share) for share in SHARES}
    figures = [_compared(filters, recording) for recording in recordings]
    progress.show(0.5)
    predicted = _predicted(filters[0.0], recordings[0])
    samples = interleave(
        {f'{share:g}': Contestant(_corrections(filter_, predicted, recordings[0]), PER_TURN)
         for share, filter_ in filters.items()}, STEPS // PER_TURN, effort.scaled(PASSES, 1))
    progress.show(1.0)
    rows = []
    for share in SHARES:
        part, dev, distance = np.mean([found[share] for found in figures], axis=0)
        rows.append(Row.timed(
            f'share {share:g}' if share else 'everywhere', setting, samples[f'{share:g}'],
            samples['0'], 'everywhere',
            {'cells': part, '1000 dev': 1000 * float(np.sqrt(dev)), '1000 L1': 1000 * distance}))
    return rows


def _corrections(filter_: DiracFeynmanFilter, predicted: list[GridBelief],
                 recording: Recording) -> Callable[[int], object]:
    """Return what corrects the k-th predicted belief."""
    measured = [tuple(y) for y in recording.measurements.tolist()]
    return lambda k: filter_.correct(predicted[k], measured[k], 'squares', (k + 1) * STEP_NS)


def _predicted(filter_: DiracFeynmanFilter, recording: Recording) -> list[GridBelief]:
    """Return the beliefs before each correction."""
    belief, found = prior(filter_.grid), []
    for k, y in enumerate(recording.measurements):
        found.append(filter_.predict(belief, k * STEP_NS, (k + 1) * STEP_NS))
        belief, _ = filter_.correct(found[-1], y, 'squares', (k + 1) * STEP_NS)
    return found


def _compared(filters: dict[float, DiracFeynmanFilter],
              recording: Recording) -> dict[float, list[float]]:
    """Return part of the cells, squared distance of the mean, and L1, by share."""
    beliefs = {share: prior(filter_.grid) for share, filter_ in filters.items()}
    found = {share: np.zeros(3) for share in filters}
    for k, y in enumerate(recording.measurements):
        for share, filter_ in filters.items():
            moved = filter_.predict(beliefs[share], k * STEP_NS, (k + 1) * STEP_NS)
            beliefs[share], _ = filter_.correct(moved, y, 'squares', (k + 1) * STEP_NS)
            p, q = beliefs[share], beliefs[0.0]
            found[share] += np.array([
                np.mean(moved.density > share * moved.density.max()),
                np.mean((p.mean() - q.mean())**2), l1(p.density, q.density, p.grid)])
    return {share: list(sums / len(recording.measurements)) for share, sums in found.items()}
