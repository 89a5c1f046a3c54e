"""Several kernel steps in one operator, against one after another."""

from __future__ import annotations

from dataclasses import dataclass
import time

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import (carried, Density, exact_on_line, l1, line, LINE_CELLS,
                                            products, start, to_exact)
from benchmarks.timing import Contestant, Effort, interleave
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.kernels.composed import composed
from pif_ros.core.models import StateModel
from pif_ros.core.systems import sine_cubic_drift

COUNTS = (1, 2, 5, 10, 20)
TOLERANCES = (1e-5, 1e-3)
#: All counts divide it.
STEPS = 100
TURNS = 5
PLAIN = '1 step'


@dataclass(frozen=True, eq=False)
class Problem:
    """What is predicted, and the exact density after STEPS."""

    name: str
    model: StateModel
    grid: Grid
    density: Density


def run(effort: Effort) -> Table:
    """Predict STEPS with every operator, in turns."""
    rows: list[Row] = []
    for problem in _problems():
        rows.extend(_rows(problem, effort))
    return Table('Kernel steps composed into one operator', rows, [
        f'From N(0, 1) to {STEPS} steps of {TIME_STEP:g} s; time is that of all of them, so that '
        'the ratio is that of the time for a second of prediction.',
        'tolerance: how far a column may be from that of the whole power, in L1.',
        'L1 to exact: to fine cells, sub-steps, extrapolated; 1000 L1 to plain: a thousand times '
        'the L1 to the density that the steps one by one give.',
        'In n dimensions s steps reach about s^(n/2) times as many cells as one, and save s - 1 '
        'products: on a line that pays; on a plane hardly, and only with the wider tolerance.'])


def _problems() -> list[Problem]:
    plane, _ = Referee().predicted(STEPS)
    return [*(Problem(f'coupled_trigonometric, {cells} x {cells}', SYSTEM.model, box(cells),
                      plane) for cells in (62, 100)),
            Problem(f'sine_cubic_drift, {LINE_CELLS}', sine_cubic_drift().model,
                    line(LINE_CELLS), exact_on_line(TIME_STEP, STEPS))]


def _rows(problem: Problem, effort: Effort) -> list[Row]:
    grid, p = problem.grid, start(problem.grid)
    progress = Progress(f'strategies.composition: {problem.name}')
    K = dirac_feynman(problem.model, grid, KernelSettings(TIME_STEP))
    cases = [(count, tolerance) for count in COUNTS for tolerance in TOLERANCES
             if count > 1 or tolerance == TOLERANCES[0]]
    names = {case: PLAIN if case[0] == 1 else f'{case[0]} steps, tolerance {case[1]:g}'
             for case in cases}
    operators, made = {}, {}
    for number, case in enumerate(cases):
        before = time.perf_counter()
        operators[case] = composed(K, *case)
        made[case] = time.perf_counter() - before
        progress.show((number + 1) / len(cases))
    samples = interleave(
        {names[case]: Contestant(products(operators[case], p, STEPS // case[0]))
         for case in cases}, effort.scaled(TURNS), 1)
    plain = carried(K, p, STEPS)
    rows = []
    for case, operator in operators.items():
        q = carried(operator, p, STEPS // case[0])
        rows.append(Row.timed(
            names[case], problem.name, samples[names[case]], samples[PLAIN], PLAIN,
            {'weights per cell': operator.nnz / grid.size, 'MB': 12e-6 * operator.nnz,
             'made in s': made[case], 'L1 to exact': to_exact(q, problem.density, grid),
             '1000 L1 to plain': 1000 * l1(q, plain, grid)}))
    return rows
