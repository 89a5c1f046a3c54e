"""The operator in a wavelet basis, against its weights from cell to cell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
import time

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import carried, Density, l1, products, start, to_exact
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, Operator
from pif_ros.core.kernels.composed import composed
from pif_ros.core.kernels.wavelets import WaveletKernel
from scipy import sparse

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
#: The operators that have no more than this L1 to the exact composition are compared at the end.
ALIKE = 3e-3
TURNS = 10
PER_TURN = 4
PLAIN = 'cells, step by step'


@dataclass(frozen=True, eq=False)
class Entry:
    """
    An operator with its line in the table.

    times: products that it takes; made_s: seconds that it took to make.
    """

    name: str
    grid: Grid
    operator: Operator
    times: int
    made_s: float


@dataclass(frozen=True, eq=False)
class Result:
    """A row, and what the verdict on it is made of."""

    row: Row
    in_basis: bool
    elements: int
    distance: float


def run(effort: Effort) -> Table:
    """Apply every operator to the same density, in turns."""
    density, _ = Referee().predicted(STEPS)
    rows: list[Row] = []
    notes = [
        f'From N(0, 1) to {STEPS} steps of {TIME_STEP:g} s. The time is that of the steps in the '
        'setting: so many products step by step, else one; for a basis with the way there and '
        'back, or, within the basis, without.',
        'tolerance: of the composition; threshold: elements of W K W^T below it are dropped; '
        'made: of wavelets without the composition that they are made from.',
        'L1 to exact: to fine cells, sub-steps, extrapolated; 1000 L1 to plain: a thousand times '
        'the L1 to the density that the steps one by one give.']
    for cells, steps, bases in PROBLEMS[:effort.scaled(len(PROBLEMS))]:
        results = _results(cells, steps, bases, density, effort)
        rows.extend(result.row for result in results)
        notes.append(f'{results[0].row.setting}: {_verdict(results)}')
    return Table('The operator in a wavelet basis, `coupled_trigonometric`', rows, notes)


def _results(cells: int, steps: int, bases: Sequence[tuple[str, int]], density: Density,
             effort: Effort) -> list[Result]:
    setting = f'{cells} x {cells}, {steps} step{"s" * (steps > 1)}'
    progress, entries = Progress(f'strategies.wavelets: {setting}'), []
    for entry in _entries(box(cells), steps, bases):
        entries.append(entry)
        progress.show(len(entries) / (5 + len(THRESHOLDS) * len(bases)))
    samples = interleave(
        {entry.name: Contestant(products(entry.operator, start(entry.grid), entry.times), PER_TURN)
         for entry in entries}, effort.scaled(TURNS), 1)
    within = interleave(
        {entry.name: Contestant(products(entry.operator.coefficients,
                                         entry.operator.analyse(start(entry.grid))), PER_TURN)
         for entry in entries if isinstance(entry.operator, WaveletKernel)},
        effort.scaled(TURNS), 1)
    plain, results = carried(entries[0].operator, start(box(cells)), STEPS), []
    for entry in entries:
        p = carried(entry.operator, start(entry.grid), entry.times * STEPS // steps)
        same, inside = entry.grid.shape == (cells, cells), within.get(entry.name)
        distance = l1(p, plain, entry.grid) if same else np.inf
        row = Row.timed(
            entry.name, setting, samples[entry.name], samples[PLAIN], PLAIN,
            {'within the basis, us': None if inside is None else 1e6 * float(np.median(inside)),
             'elements per cell': entry.operator.nnz / cells**2, 'made in s': entry.made_s,
             'L1 to exact': to_exact(p, density, entry.grid),
             '1000 L1 to plain': 1000 * distance if same else None})
        results.append(Result(row, inside is not None, entry.operator.nnz, distance))
    progress.show(1.0)
    return results


def _entries(grid: Grid, steps: int, bases: Sequence[tuple[str, int]]) -> Iterator[Entry]:
    before = time.perf_counter()
    kernel = dirac_feynman(SYSTEM.model, grid, KernelSettings(TIME_STEP))
    yield Entry(PLAIN, grid, kernel, steps, time.perf_counter() - before)
    before = time.perf_counter()
    whole = composed(kernel, steps, 1e-5)
    if steps > 1:
        yield Entry('cells, tolerance 1e-05', grid, whole, 1, time.perf_counter() - before)
        for tolerance in TOLERANCES:
            yield _pruned('cells', grid, kernel, steps, tolerance)
        half = box(grid.shape[0] // 2)
        yield _pruned('half as many on an axis', half, dirac_feynman(
            SYSTEM.model, half, KernelSettings(TIME_STEP)), steps, TOLERANCES[0])
    for wavelet, level in bases:
        for threshold in THRESHOLDS:
            before = time.perf_counter()
            found = WaveletKernel.make(whole, grid, wavelet, level, threshold)
            yield Entry(f'{wavelet}, level {level}, threshold {threshold:g}', grid, found, 1,
                        time.perf_counter() - before)


def _pruned(name: str, grid: Grid, kernel: sparse.csr_array, steps: int,
            tolerance: float) -> Entry:
    before = time.perf_counter()
    found = composed(kernel, steps, tolerance)
    return Entry(f'{name}, tolerance {tolerance:g}', grid, found, 1, time.perf_counter() - before)


def _verdict(results: Sequence[Result]) -> str:
    """Return how the smallest operators of either kind compare, of those that are good enough."""
    alike = [result for result in results if result.distance <= ALIKE]
    basis = [result for result in alike if result.in_basis]
    # step by step is the first, and a kind of its own where there is another
    cells = [result for result in alike if not result.in_basis]
    if not basis:
        return f'no basis comes as near as an L1 of {ALIKE:g} to plain.'
    least, other = (min(kind, key=lambda result: result.elements)
                    for kind in (basis, cells[1:] or cells))
    return (f'of what has an L1 of at most {ALIKE:g} to plain, {least.row.name} holds '
            f'{least.elements / other.elements:.2g} times the elements of {other.row.name}; '
            f'they take {least.row.ratio or 0:.2g} and {other.row.ratio or 0:.2g} times as long '
            'as step by step.')
