"""How the cost of a prediction grows: with the cells of a grid, and with those that are active."""

from __future__ import annotations

from pathlib import Path
import time

from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Effort
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active import ActiveBelief, ActiveGridFilter, Patch, RegionSettings, Window
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, split_kernel
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]

SECOND = 1_000_000_000
STEP, CELLS = 0.01, 0.7
#: Cells in all, by the number of axes: what makes no more than some gigabytes of weights.
SIZES = {1: (3, 7), 2: (3, 7), 3: (3, 6.5), 4: (3, 6)}
#: Above how many cells the cost is to be a straight line, and how far its slope may be from 1:
#: where the caches end, between 1e5 and 1e6 cells, each costs up to twice as much.
LINEAR_FROM, SLOPE = 3e4, 0.3
PICTURE = Path('build/benchmarks/cost.png')


def run(effort: Effort) -> Table:
    """Return times per prediction, and draw them."""
    progress, lines = Progress('cost'), {}
    for n in SIZES:
        lines[f'{n}-D, all cells'] = [all_cells(n, cells, effort) for cells in sizes(n)]
        progress.show(n / 8)
    for n in SIZES:
        lines[f'{n}-D, active cells'] = [active_cells(n, cells, effort) for cells in sizes(n)
                                         if cells**n < 2e6]
        progress.show((4 + n) / 8)
    draw(lines, PICTURE)
    slopes = {name: slope(points) for name, points in lines.items()}
    rows = [Row(name, f'{points[-1][0]:,.0f} cells', points[-1][1], None, None, '',
                {'slope': slopes[name],
                 'ns per cell': 1e9 * points[-1][1] / points[-1][0]})
            for name, points in lines.items()]
    return Table('Cost of a prediction against cells', rows, (
        f'Drifts that couple neighbours, noise of {CELLS:g} cells in a step; the best of some '
        f'runs.  slope: of log time over log cells, above {LINEAR_FROM:,.0f} cells.  Drawn in '
        f'{PICTURE}.',), tuple(
        Goal(f'{name}: slope from 1', SLOPE, abs(value - 1)) for name, value in slopes.items()
        if np.isfinite(value)))


def sizes(n: int) -> list[int]:
    """Return numbers of cells on an axis, for half decades of cells in all."""
    low, high = SIZES[n]
    return [round(10**(e / n)) for e in np.arange(low, high + 0.01, 0.5)]


def all_cells(n: int, cells: int, effort: Effort) -> tuple[float, float]:
    """Return the cells of a grid, and the seconds of a step on all of them."""
    grid = Grid((-1.0,) * n, (1.0,) * n, (cells,) * n)
    kernel = split_kernel(model(n, grid), grid, KernelSettings(STEP, form='split'))
    p = np.full(grid.size, 1.0)
    return grid.size, best(lambda: kernel @ p, effort)


def active_cells(n: int, cells: int, effort: Effort) -> tuple[float, float]:
    """Return how many cells are active in a world of a million a side, and a step's seconds."""
    world = Grid((-1e6 / cells,) * n, (1e6 / cells,) * n, (10**6,) * n)
    filter_ = ActiveGridFilter(model(n, Grid((-1.0,) * n, (1.0,) * n, (cells,) * n)), world, {},
                               STEP, region=RegionSettings(finest=0))
    filter_.describe()
    window = Window(world, (0,) * n, (500_000 - cells // 2,) * n, (cells,) * n)
    belief = ActiveBelief(world, (Patch(window, np.ones(window.shape)),)).normalised()
    return window.size, best(lambda: filter_.predict(belief, 0, round(STEP * SECOND)), effort)


def model(n: int, grid: Grid) -> StateModel:
    """Return states each of which is driven by the next, with noise that suits the cells."""
    sigma = CELLS * grid.spacing[0] / np.sqrt(STEP)
    return StateModel(tuple(f'x{i + 1}' for i in range(n)),
                      lambda x, t: np.sin(np.roll(x, 1, axis=0)) - x, sigma * np.eye(n))


def best(work, effort: Effort) -> float:  # type: ignore[no-untyped-def]
    """Return the seconds of the fastest of some runs, after one that does not count."""
    work()
    taken = []
    for _ in range(effort.scaled(10, 2)):
        began = time.perf_counter()
        work()
        taken.append(time.perf_counter() - began)
        if sum(taken) > 2.0:
            break
    return min(taken)


def slope(points: list[tuple[float, float]]) -> float:
    """Return the slope of log time over log cells where it is to be a straight line."""
    cells, seconds = np.array([point for point in points if point[0] >= LINEAR_FROM]).T
    return float(np.polyfit(np.log(cells), np.log(seconds), 1)[0])


def draw(lines: dict[str, list[tuple[float, float]]], path: Path) -> None:
    """Draw seconds over cells, both in decades."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(7, 4.5), layout='constrained')
    axes = figure.add_subplot()
    for k, (name, points) in enumerate(lines.items()):
        axes.loglog(*np.array(points).T, 'o-' if 'all' in name else 's--', ms=4,
                    color=f'C{k % len(SIZES)}', label=name)
    axes.set(xlabel='cells', ylabel='seconds per prediction', title='Cost is linear in cells')
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=120)
