"""The kernel split by axis beside the tabulated one: applied, built, for many, across a gap."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from benchmarks.problem import box, STEP_NS, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Referee
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio, Samples
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import StateModel
from pif_ros.core.systems import lorenz_63
from scipy import ndimage

Array = NDArray[np.float64]

L1_STEPS = 50
SPACE_STEPS = 8
PER_TURN = 10
TURNS = 10
BUILDS = 5
TARGETS = 16
MACRO_ERROR = 2e-3
GAP_STEPS = 64
LORENZ = lorenz_63(sigma_x=10.0).model
SPACE_STEP = 0.01
SPACE_MEAN, SPACE_VARIANCE = (0.0, 0.0, 25.0), 16.0


@dataclass(frozen=True, eq=False)
class Problem:
    """A model on a grid, the tabulated kernel to compare with, and where it starts."""

    name: str
    model: StateModel
    grid: Grid
    tabulated: KernelSettings
    mean: tuple[float, ...]
    variance: float
    steps: int

    def filter(self, form: str, macro_error: float = 0.0) -> DiracFeynmanFilter:  # noqa: A003
        """Return a filter that predicts."""
        settings = self.tabulated if form == 'tabulated' else KernelSettings(
            self.tabulated.time_step, form='split', macro_error=macro_error)
        return DiracFeynmanFilter(self.model, self.grid, {}, settings)

    @property
    def start(self) -> GridBelief:
        """Return what is believed before the first step."""
        return GridBelief.gaussian(self.grid, self.mean,
                                   self.variance * np.eye(self.grid.ndim))

    def predicted(self, filter_: DiracFeynmanFilter, substeps: int = 1) -> GridBelief:
        """Return the density after all steps."""
        step_ns = round(self.tabulated.time_step * 1e9) * substeps
        return filter_.predict(self.start, 0, self.steps * step_ns)


def run(effort: Effort) -> Table:
    """Time both forms in turns, and hold what they predict against a finer computation."""
    rows, goals = [], []
    progress, problems = Progress('split: timing'), _problems()
    density, change = Referee().predicted(L1_STEPS)
    for number, problem in enumerate(problems):
        plane = problem.grid.ndim == 2
        exact = density(problem.grid.points) if plane else _in_space(problem)
        tabulated, split = problem.filter('tabulated'), problem.filter('split')
        contestants = _contestants(problem, tabulated, split)
        samples = interleave(contestants, TURNS, effort.scaled(3, 1))
        built = interleave(
            {form: contestants[form] for form in ('tabulated', 'split')}
            | {f'{form}, built': Contestant(partial(_build, problem, form))
               for form in ('tabulated', 'split')}, 1, effort.scaled(BUILDS, 1))
        rows += _rows(problem, tabulated, split, samples, built,
                      lambda filter_: _l1(problem.predicted(filter_), exact))
        goals.append(Goal(f'{problem.name}, split, applied, against tabulated', 1.0,
                          ratio(samples['split'], samples['tabulated'])))
        if plane and problem.grid.shape[0] in (62, 100):
            goals.append(Goal(f'{problem.name}, split, L1',
                              0.003 if problem.grid.shape[0] == 62 else 0.0002,
                              _l1(problem.predicted(split), exact)))
        progress.show((number + 1) / len(problems))
    return Table('The kernel split by axis', rows, _notes(change), goals)


def _problems() -> list[Problem]:
    sampled = KernelSettings(TIME_STEP, weights='sampled')
    plane = [Problem(f'{cells} x {cells}', SYSTEM.model, box(cells), sampled, (0.0, 0.0), 1.0,
                     L1_STEPS) for cells in (62, 100, 200)]
    return [*plane, Problem('50 x 50 x 50', LORENZ, _space(50), KernelSettings(SPACE_STEP),
                            SPACE_MEAN, SPACE_VARIANCE, SPACE_STEPS)]


def _space(cells: int) -> Grid:
    return Grid((-30.0, -30.0, -5.0), (30.0, 30.0, 55.0), (cells,) * 3)


def _build(problem: Problem, form: str, k: int) -> None:
    problem.filter(form).kernel_at(0)


def _contestants(problem: Problem, tabulated: DiracFeynmanFilter,
                 split: DiracFeynmanFilter) -> dict[str, Contestant]:
    p = problem.start.density.ravel()
    many = np.repeat(p[:, None], TARGETS, axis=1)
    T, K = tabulated.kernel_at(0), split.kernel_at(0)
    longer = problem.filter('split', MACRO_ERROR)
    gap_ns = GAP_STEPS * split.time_step_ns
    found = {'tabulated': Contestant(lambda k: T @ p, PER_TURN),
             'split': Contestant(lambda k: K @ p, PER_TURN),
             'split, many': Contestant(lambda k: K @ many)}
    if problem.grid.ndim == 2:
        found['gap'] = Contestant(lambda k: split.predict(problem.start, 0, gap_ns))
        found['gap, longer'] = Contestant(lambda k: longer.predict(problem.start, 0, gap_ns))
    return found


def _rows(problem: Problem, tabulated: DiracFeynmanFilter, split: DiracFeynmanFilter,
          samples: dict[str, Samples], built: dict[str, Samples],
          l1: Callable[[DiracFeynmanFilter], float]) -> list[Row]:
    setting, size = problem.name, problem.grid.size

    def weights(filter_: DiracFeynmanFilter) -> dict[str, float | None]:
        return {'weights per cell': filter_.kernel_at(0).nnz / size}

    base = samples['tabulated']
    rows = [Row.timed('tabulated, applied', setting, base, base, 'itself',
                      {**weights(tabulated), 'L1': l1(tabulated)}),
            Row.timed('split, applied', setting, samples['split'], base, 'tabulated, applied',
                      {**weights(split), 'L1': l1(split)}),
            Row.timed(f'split, applied to {TARGETS}, each', setting,
                      samples['split, many'] / TARGETS, samples['split'], 'split, applied'),
            *(Row.timed(f'{form}, built', setting, built[f'{form}, built'], built[form],
                        f'{form}, applied') for form in ('tabulated', 'split'))]
    if 'gap' in samples:
        longer = problem.filter('split', MACRO_ERROR)
        count = longer.time_step_ns // STEP_NS
        difference = _l1(longer.predict(problem.start, 0, GAP_STEPS * STEP_NS), split.predict(
            problem.start, 0, GAP_STEPS * STEP_NS).density.ravel())
        rows += [Row.timed(f'split, {GAP_STEPS} steps', setting, samples['gap'], samples['gap'],
                           'itself'),
                 Row.timed(f'the same, up to {count} steps at once', setting,
                           samples['gap, longer'], samples['gap'], f'split, {GAP_STEPS} steps',
                           {'L1 to single steps': difference})]
    return rows


def _l1(belief: GridBelief, exact: Array) -> float:
    return float(np.abs(belief.density.ravel() - exact).sum() * belief.grid.cell_volume)


def _in_space(problem: Problem) -> Array:
    """Return the density on a grid of half the spacing in quarter steps, at the coarse centres."""
    fine = replace(problem, grid=_space(2 * problem.grid.shape[0]), steps=4 * problem.steps,
                   tabulated=KernelSettings(SPACE_STEP / 4))
    density = fine.predicted(fine.filter('split')).density
    at = np.meshgrid(*[2 * np.arange(cells) + 0.5 for cells in problem.grid.shape], indexing='ij')
    return np.asarray(ndimage.map_coordinates(density, at, order=3), dtype=float).ravel()


def _notes(change: float) -> list[str]:
    return [
        f'In the plane `coupled_trigonometric`, steps of {TIME_STEP:g} s, the tabulated kernel '
        f'sampled; L1: of {L1_STEPS} steps from N(0, I) to the exact density, of which two '
        f'computations differ by {change:.5f}.',
        f'In space `lorenz_63` with noise of 10, steps of {SPACE_STEP:g} s, the tabulated kernel '
        f'as by default; L1: of {SPACE_STEPS} steps to the split kernel on cells of half the '
        'width in steps of a quarter.',
        f'Longer steps are taken where they differ by less than {MACRO_ERROR:g} in L1 from two '
        'of half their length, on all densities that are tried.']
