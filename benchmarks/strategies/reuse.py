"""A kernel that is kept in a file, against one that is made anew for every sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import tempfile

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.report import Row, Table
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, OperatorSettings
from pif_ros.core.kernels.stored import fingerprint, load_kernel, save_kernel
from pif_ros.core.models import StateModel
from pif_ros.core.systems import multiplicative_4d

BUILDS = 5
STEPS = 10
FOUR = multiplicative_4d()
#: The cells of the paper's third example.
FOUR_GRID = Grid((-20.0,) * 4, (20.0,) * 4, (8,) * 4)
FOUR_SETTINGS = KernelSettings(0.5, extent=1)


@dataclass(frozen=True, eq=False)
class Problem:
    """A kernel that is to be had, and how often it is made."""

    name: str
    model: StateModel
    grid: Grid
    settings: KernelSettings
    builds: int


def run(effort: Effort) -> Table:
    """Make each kernel, write it, and load it, in turns."""
    rows: list[Row] = []
    with tempfile.TemporaryDirectory(prefix='pif_ros_kernels_') as folder:
        for problem in _problems(effort):
            rows.extend(_rows(problem, Path(folder)))
        notes = [
            'load: header, checksum and every index are checked; the matrix is that which was '
            'saved, bit for bit.',
            'fingerprint: what tells whether a file fits: the grid, the settings and the values '
            'of the model on all cells, never the sensor.',
            _second_sensor(Path(folder))]
    return Table('A stored kernel, against making it', rows, notes)


def _problems(effort: Effort) -> Iterator[Problem]:
    for cells in (62, 100):
        yield Problem(f'coupled_trigonometric, {cells} x {cells}', SYSTEM.model, box(cells),
                      KernelSettings(TIME_STEP), effort.scaled(BUILDS))
    # half a minute each
    yield Problem('multiplicative_4d, 8^4, extent 1', FOUR.model, FOUR_GRID, FOUR_SETTINGS, 1)


def _rows(problem: Problem, folder: Path) -> list[Row]:
    model, grid, settings = problem.model, problem.grid, problem.settings
    kernel, mark = dirac_feynman(model, grid, settings), fingerprint(model, grid, settings)
    path = folder / 'kernel'
    samples = interleave(
        {'make': Contestant(lambda k: dirac_feynman(model, grid, settings)),
         'save': Contestant(lambda k: save_kernel(path, kernel, mark)),
         'load': Contestant(lambda k: load_kernel(path, mark, grid.size), 5),
         'fingerprint': Contestant(lambda k: fingerprint(model, grid, settings), 5)},
        1, problem.builds, Progress(f'strategies.reuse: {problem.name}'))
    facts = {'MB on disk': path.stat().st_size / 1e6, 'weights per cell': kernel.nnz / grid.size}
    return [Row.timed(name, problem.name, taken, samples['make'], 'make',
                      facts if name == 'make' else None) for name, taken in samples.items()]


def _second_sensor(folder: Path) -> str:
    """Return how far two filters are apart that have the kernel made, and from a file."""
    made, loaded = (DiracFeynmanFilter(
        FOUR.model, FOUR_GRID, {'y': FOUR.sensors['inverse_trigonometric']()}, FOUR_SETTINGS,
        operator=OperatorSettings(file=str(folder / name))) for name in ('other', 'kernel'))
    difference = 0.0
    beliefs = [filter_.gaussian(np.zeros(4), 25 * np.eye(4)) for filter_ in (made, loaded)]
    for k in range(STEPS):
        for i, filter_ in enumerate((made, loaded)):
            moved = filter_.predict(beliefs[i], k * made.time_step_ns, (k + 1) * made.time_step_ns)
            beliefs[i], _ = filter_.correct(moved, np.zeros(4), 'y', 0)
        difference = max(difference, float(np.abs(
            beliefs[0].density - beliefs[1].density).max()))
    return (f'The file of multiplicative_4d under its other sensor, {STEPS} steps: the largest '
            f'difference of a density to that of a kernel made for it is {difference:g}.')
