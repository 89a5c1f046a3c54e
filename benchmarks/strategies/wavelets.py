"""The operator in a wavelet basis, against its weights from cell to cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import time

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import (
    carried, Density, l1, products, start, to_exact)
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


@dataclass(frozen=True)
class Measured:
    """What the verdict is made of."""

    name: str
    in_basis: bool
    elements: int
    median_s: float
    distance: float


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
        found, measured = _rows(cells, steps, bases, density, effort)
        rows.extend(found)
        notes.append(f'{found[0].setting}: {_verdict(measured)}')
    return Table('The operator in a wavelet basis, `coupled_trigonometric`', rows, notes)


def _rows(cells: int, steps: int, bases: Sequence[tuple[str, int]], density: Density,
          effort: Effort) -> tuple[list[Row], list[Measured]]:
    grid, setting = box(cells), f'{cells} x {cells}, {steps} steps'
    progress = Progress(f'strategies.wavelets: {setting}')
    entries = []
    for entry in _entries(cells, steps, bases):
        entries.append(entry)
        progress.show(len(entries) / (3 + 4 * len(bases)))
    p = start(grid)
    samples = interleave(
        {entry.name: Contestant(products(entry.operator, p), PER_TURN) for entry in entries},
        effort.scaled(TURNS), 1)
    inside = interleave(
        {entry.name: Contestant(products(
            entry.operator.coefficients, entry.operator.analyse(p)), PER_TURN)
         for entry in entries if isinstance(entry.operator, WaveletKernel)},
        effort.scaled(TURNS), 1)
    whole, rows, measured = carried(entries[0].operator, p, STEPS // steps), [], []
    for entry in entries:
        q = carried(entry.operator, p, STEPS // steps)
        within = inside.get(entry.name)
        rows.append(Row.timed(
            entry.name, setting, samples[entry.name], samples[WHOLE], WHOLE,
            {'within the basis, us': None if within is None else 1e6 * float(np.median(within)),
             'elements per cell': entry.operator.nnz / grid.size, 'made in s': entry.made_s,
             'L1 to exact': to_exact(q, density, grid),
             '1000 L1 to whole': 1000 * l1(q, whole, grid)}))
        measured.append(Measured(entry.name, within is not None, entry.operator.nnz,
                                 float(np.median(samples[entry.name])), l1(q, whole, grid)))
    progress.show(1.0)
    return rows, measured


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


def _verdict(measured: Sequence[Measured]) -> str:
    """Return which operators of either kind are the smallest, among those that are good enough."""
    alike = [found for found in measured if found.distance <= ALIKE]
    basis = [found for found in alike if found.in_basis]
    cells = min((found for found in alike if not found.in_basis), key=lambda found: found.elements)
    if not basis:
        return f'no basis comes as near as an L1 of {ALIKE:g} to the unpruned operator.'
    least = min(basis, key=lambda found: found.elements)
    return (f'at an L1 of at most {ALIKE:g} to the unpruned operator, {least.name} holds '
            f'{least.elements / cells.elements:.3g} times the elements of {cells.name}, and takes '
            f'{least.median_s / cells.median_s:.3g} times as long.')
