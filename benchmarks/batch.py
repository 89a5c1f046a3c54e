"""Many targets on one kernel: predicted together, against one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from unittest import mock

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio
import numpy as np
from pif_ros.core.batch import Batch
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import StateModel
from pif_ros.core.systems import lorenz_63

TARGETS = 16
#: Steps between two frames of a camera.
STEPS = 5
FORMS = {'tabulated': KernelSettings(TIME_STEP, weights='sampled'),
         'split': KernelSettings(TIME_STEP, form='split')}
SEED = 1
TURNS = 4


@dataclass(frozen=True, eq=False)
class Problem:
    """A model on a grid, where targets start (mean and variance), passes of timing, and a goal."""

    name: str
    model: StateModel
    grid: Grid
    mean: tuple[float, ...]
    variance: float
    passes: int
    goal: float

    def filter(self, form: str) -> DiracFeynmanFilter:  # noqa: A003
        """Return a filter that predicts."""
        return DiracFeynmanFilter(self.model, self.grid, {}, FORMS[form])

    @property
    def starts(self) -> list[GridBelief]:
        """Return what is believed of each target before the first step."""
        rng, spread = np.random.default_rng(SEED), np.sqrt(self.variance)
        return [GridBelief.gaussian(self.grid, self.mean + rng.normal(0, spread, self.grid.ndim),
                                    self.variance * np.eye(self.grid.ndim))
                for _ in range(TARGETS)]


def run(effort: Effort) -> Table:
    """Time both ways in turns without a compiler, for each form, and compare what they give."""
    with mock.patch('pif_ros.core.compiler.compiler', return_value=None):
        return _run(effort)


def _run(effort: Effort) -> Table:
    rows, goals, problems = [], [], _problems()
    progress = Progress('batch: timing')
    for number, problem in enumerate(problems):
        for part, form in enumerate(FORMS):
            setting = f'{problem.name}, {form}'
            filter_, starts = problem.filter(form), problem.starts
            batch = Batch(filter_)
            span = (0, STEPS * filter_.time_step_ns)
            spans = [span] * TARGETS
            samples = interleave({
                'one by one': Contestant(partial(_alone, filter_, starts, span)),
                'together': Contestant(lambda k: batch.predict(starts, spans)),
            }, TURNS, effort.scaled(problem.passes, 1))
            alone, together = (samples[name] / (TARGETS * STEPS) for name in samples)
            rows += [Row.timed('one by one', setting, alone, alone, 'itself', {
                         'weights per cell': filter_.kernel_at(0).nnz / problem.grid.size}),
                     Row.timed('together', setting, together, alone, 'one by one', {
                         'difference': _difference(filter_, starts, span)})]
            goals.append(Goal(f'{setting}, together, against one by one', 1 / problem.goal,
                              ratio(together, alone)))
            progress.show((number + (part + 1) / len(FORMS)) / len(problems))
    return Table(f'{TARGETS} targets on one kernel', rows, _notes(), goals)


def _problems() -> list[Problem]:
    space = Grid((-30.0, -30.0, -5.0), (30.0, 30.0, 55.0), (50,) * 3)
    return [*(Problem(f'{cells} x {cells}', SYSTEM.model, box(cells), (0.0, 0.0), 1.0, 25, 1.5)
              for cells in (62, 100)),
            Problem('50 x 50 x 50', lorenz_63(sigma_x=10.0).model, space, (0.0, 0.0, 25.0), 16.0,
                    2, 2.0)]


def _alone(filter_: DiracFeynmanFilter, starts: Sequence[GridBelief], span: tuple[int, int],
           k: int) -> list[GridBelief]:
    return [filter_.predict(start, *span) for start in starts]


def _difference(filter_: DiracFeynmanFilter, starts: Sequence[GridBelief],
                span: tuple[int, int]) -> float:
    """Return the largest difference of a density together from that alone."""
    together = Batch(filter_).predict(starts, [span] * len(starts))
    return max(float(np.abs(found.density - alone.density).max())
               for found, alone in zip(together, _alone(filter_, starts, span, 0)))


def _notes() -> list[str]:
    return [
        f'A step of a target out of {TARGETS}, all predicted by {STEPS} steps of {TIME_STEP:g} s '
        'from different densities at the same stamp, with what it takes to put them side by side '
        'and apart again. In the plane `coupled_trigonometric`, in space `lorenz_63` with noise '
        'of 10. The tabulated kernel is the sampled one; numpy and scipy alone.',
        'difference: the largest of any cell, of the density predicted together and alone.']
