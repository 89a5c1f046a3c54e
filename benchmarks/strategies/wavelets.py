"""The operator in a wavelet basis, against its weights from cell to cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import time

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import carried, Density, l1, start, to_exact
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.kernels import dirac_feynman, KernelSettings, Operator
from pif_ros.core.kernels.composed import composed
from pif_ros.core.kernels.wavelets import WaveletKernel

Array = NDArray[np.float64]

#: All numbers of kernel steps divide it.
STEPS = 50
#: Cells on an axis, kernel steps in an operator, and the bases that are tried: wavelet, level.
PROBLEMS = (
    (62, 1, (('haar', 1), ('db2', 2), ('db4', 2), ('sym8', 2))),
    (62, 10, (('haar', 1), ('db2', 2), ('db4', 2), ('sym8', 2))),
    (62, 50, (('haar', 2), ('db2', 2), ('db4', 1), ('db4', 2), ('db4', 3), ('sym8', 2))),
    (100, 50, (('db4', 2), ('sym8', 2), ('sym8', 3))),
)
TOLERANCES = (1e-2, 1e-3)
THRESHOLDS = (1e-2, 1e-3, 1e-4)
#: The operators that have no more than this L1 to the unpruned one are compared at the end.
ALIKE = 3e-3
TURNS = 10
PER_TURN = 4
WHOLE = 'cells, whole'


@dataclass(frozen=True, eq=False)
class Entry:
    """An operator with its line in the table, and the seconds that it took to make."""

    name: str
    operator: Operator
    made_s: float


def run(effort: Effort) -> Table:
    """Apply every operator to the same density, in turns."""
    density, _ = Referee().predicted(STEPS)
    rows, notes = [], [
        f'From N(0, 1) to {STEPS} steps of {TIME_STEP:g} s, so many of them in an operator; time '
        'is that of one product, for wavelets with the way into the basis and back, or without.',
        'tolerance: of the composition; threshold: elements of W K W^T below it are dropped.',
        'L1 to exact: to fine cells, sub-steps, extrapolated; 1000 L1 to whole: a thousand times '
        'the L1 to the density that the unpruned operator gives.']
    for cells, steps, bases in PROBLEMS[:effort.scaled(len(PROBLEMS))]:
        found = _rows(cells, steps, bases, density, effort)
        rows.extend(found)
        notes.append(_verdict(found))
    return Table('The operator in a wavelet basis, `coupled_trigonometric`', rows, notes)


def _rows(cells: int, steps: int, bases: Sequence[tuple[str, int]], density: Density,
          effort: Effort) -> list[Row]:
    grid, setting = box(cells), f'{cells} x {cells}, {steps} steps'
    progress = Progress(f'strategies.wavelets: {setting}')
    entries = []
    for entry in _entries(cells, steps, bases):
        entries.append(entry)
        progress.show(len(entries) / (3 + 4 * len(bases)))
    p = start(grid)
    samples = interleave(
        {entry.name: Contestant(lambda k, entry=entry: entry.operator @ p, PER_TURN)
         for entry in entries}, effort.scaled(TURNS), 1)
    inside = interleave(
        {entry.name: Contestant(lambda k, K=entry.operator, c=entry.operator.analyse(p):
                                K.coefficients @ c, PER_TURN)
         for entry in entries if isinstance(entry.operator, WaveletKernel)},
        effort.scaled(TURNS), 1)
    whole, rows = carried(entries[0].operator, p, STEPS // steps), []
    for entry in entries:
        q = carried(entry.operator, p, STEPS // steps)
        within = inside.get(entry.name)
        rows.append(Row.timed(
            entry.name, setting, samples[entry.name], samples[WHOLE], WHOLE,
            {'within the basis, us': None if within is None else 1e6 * float(np.median(within)),
             'elements per cell': entry.operator.nnz / grid.size, 'made in s': entry.made_s,
             'L1 to exact': to_exact(q, density, grid),
             '1000 L1 to whole': 1000 * l1(q, whole, grid)}))
    progress.show(1.0)
    return rows


def _entries(cells: int, steps: int, bases: Sequence[tuple[str, int]]) -> Iterator[Entry]:
    grid, before = box(cells), time.perf_counter()
    kernel = dirac_feynman(SYSTEM.model, grid, KernelSettings(TIME_STEP))
    whole = composed(kernel, steps, 1e-6)
    yield Entry(WHOLE, whole, time.perf_counter() - before)
    if steps > 1:
        for tolerance in TOLERANCES:
            before = time.perf_counter()
            pruned = composed(kernel, steps, tolerance)
            yield Entry(f'cells, tolerance {tolerance:g}', pruned, time.perf_counter() - before)
    for wavelet, level in bases:
        for threshold in THRESHOLDS:
            before = time.perf_counter()
            found = WaveletKernel.make(whole, grid, wavelet, level, threshold)
            yield Entry(f'{wavelet}, level {level}, threshold {threshold:g}', found,
                        time.perf_counter() - before)


def _verdict(rows: Sequence[Row]) -> str:
    """Return which operators of either kind are the smallest, among those that are good enough."""
    alike = [row for row in rows if row.accuracy['1000 L1 to whole'] <= 1000 * ALIKE]
    kinds = {kind: [row for row in alike if row.name.startswith('cells') == (kind == 'cells')]
             for kind in ('cells', 'wavelets')}
    text = f'{rows[0].setting}, at an L1 of at most {ALIKE:g} to the unpruned operator: '
    if not kinds['wavelets']:
        return text + 'no basis here reaches it.'
    cells, basis = (min(found, key=lambda row: row.accuracy['elements per cell'])
                    for found in kinds.values())
    return (f'{text}{basis.name} holds '
            f'{basis.accuracy["elements per cell"] / cells.accuracy["elements per cell"]:.3g} '
            f'times the elements of {cells.name}, and takes '
            f'{basis.median_s / cells.median_s:.3g} times as long.')
