"""A window of so many cells, against one as wide as the kernel needs."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Row, Table
from benchmarks.strategies.measures import (carried, Density, exact_on_line, line, LINE_CELLS,
                                            products, start, to_exact)
from benchmarks.timing import Contestant, Effort, interleave
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.models import StateModel
from pif_ros.core.systems import sine_cubic_drift

EXTENTS = (0, 1, 2, 3)
STEPS = 50
#: The paper's longer step, on its grid, and as many of them.
LONG, LONG_CELLS, LONG_STEPS = 0.2, 40, 3
TURNS = 40
PER_TURN = 20


@dataclass(frozen=True, eq=False)
class Problem:
    """What is predicted, for how many steps, and the exact density then."""

    name: str
    model: StateModel
    grid: Grid
    time_step: float
    steps: int
    density: Density


def run(effort: Effort) -> Table:
    """Predict with every extent, in turns."""
    progress, problems, rows = Progress('strategies.extent'), _problems(), []
    for number, problem in enumerate(problems):
        rows.extend(_rows(problem, effort))
        progress.show((number + 1) / len(problems))
    return Table('The extent of the kernel', rows, [
        f'From N(0, 1) to {STEPS} steps of {TIME_STEP:g} s, or {LONG_STEPS} of {LONG:g} s; time '
        'is that of a step.',
        'mass kept: what is left of 1 then; weights outside the extent are dropped, and their '
        'mass with them, as it is printed.',
        'L1: to the exact density: fine cells, sub-steps, extrapolated; scaled: of the density '
        'scaled to mass 1, as a correction would.',
        'Extent 0 takes the weights by default: moments where the noise is thinner than a cell, '
        'which the step of 0.01 s is on 62 x 62. With an extent the density is sampled, as the '
        'paper does, whose variance is wrong there.'])


def _problems() -> list[Problem]:
    referee = Referee()
    plane, _ = referee.predicted(STEPS)
    longer, _ = referee.predicted(round(LONG_STEPS * LONG / TIME_STEP))
    found = [Problem(f'coupled_trigonometric, {cells} x {cells}, dt {TIME_STEP:g}', SYSTEM.model,
                     box(cells), TIME_STEP, STEPS, plane) for cells in (62, 100)]
    found.append(Problem(
        f'coupled_trigonometric, {LONG_CELLS} x {LONG_CELLS}, dt {LONG:g}', SYSTEM.model,
        box(LONG_CELLS), LONG, LONG_STEPS, longer))
    found.append(Problem(
        f'sine_cubic_drift, {LINE_CELLS}, dt {TIME_STEP:g}', sine_cubic_drift().model,
        line(LINE_CELLS), TIME_STEP, STEPS, exact_on_line(TIME_STEP, STEPS)))
    return found


def _rows(problem: Problem, effort: Effort) -> list[Row]:
    grid, p = problem.grid, start(problem.grid)
    kernels = {extent: dirac_feynman(problem.model, grid, KernelSettings(
        problem.time_step, extent=extent)) for extent in EXTENTS}
    samples = interleave({str(extent): Contestant(products(K, p), PER_TURN)
                          for extent, K in kernels.items()}, effort.scaled(TURNS), 1)
    rows = []
    for extent, K in kernels.items():
        q = carried(K, p, problem.steps)
        mass = float(q.sum()) * grid.cell_volume
        rows.append(Row.timed(
            f'extent {extent}', problem.name, samples[str(extent)], samples['0'], 'extent 0',
            {'weights per cell': K.nnz / grid.size, 'mass kept': mass,
             'L1': to_exact(q, problem.density, grid),
             'L1, scaled': to_exact(q / mass, problem.density, grid)}))
    return rows
