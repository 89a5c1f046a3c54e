"""The split kernel, compiled and with numpy and scipy alone, beside what others take."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
import time

from benchmarks.problem import grid_filter, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import Cells, Means
from benchmarks.report import Goal, Row, Table
from benchmarks.step import accuracy, contestant, Entry
from benchmarks.step import Grid as GridPlayer
from benchmarks.step import PER_TURN, Player, simulated, STEPS
from benchmarks.timing import Contestant, Effort, interleave, ratio, Samples
import numpy as np
from numpy.typing import NDArray
from pif_ros.core import compiler
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, split_kernel, SplitKernel
from pif_ros.core.models import StateModel
from pif_ros.core.systems import lorenz_63
from scipy import ndimage

Array = NDArray[np.float64]

PASSES = 2
RECORDINGS = 2
#: A coupled system in space, with three quarters of a cell of noise in a step.
SPACE = lorenz_63(sigma_x=4.5).model
SPACE_CELLS, SPACE_STEP, SPACE_STEPS = 100, 0.01, 4
QUICK_SPACE, QUICK_CELLS = lorenz_63(sigma_x=9.0).model, 50
SPACE_MEAN, SPACE_VARIANCE = (0.0, 0.0, 25.0), 16.0
SPACE_TURNS, BUILDS = 15, 3
PLAIN = 'DF, plain'
NUMPY, COMPILED = 'split, numpy and scipy', 'split, compiled'
TABULATED = 'tabulated'


class WithoutCompiler:
    """A filter that goes through everything with numpy and scipy alone."""

    def __init__(self, cells: int, settings: KernelSettings) -> None:
        """Make the filter and its kernel."""
        with numpy_alone():
            filter_ = grid_filter(cells, settings)
            filter_.kernel_at(0)
            self._player = GridPlayer(filter_)

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self._player.start(measurements)

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        with numpy_alone():
            self._player.step(k)

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return self._player.means()

    def predicted(self, steps: int) -> Cells:
        """Return the density some steps from N(0, I) without a measurement."""
        with numpy_alone():
            return self._player.predicted(steps)


@contextmanager
def numpy_alone() -> Iterator[None]:
    """Go on as if there were no compiler."""
    there, compiler.is_available = compiler.is_available, lambda: False
    try:
        yield
    finally:
        compiler.is_available = there


def run(effort: Effort) -> Table:
    """Time whole steps in the plane, and one prediction in space."""
    plane, notes, goals = _plane(effort)
    space, more_notes, more_goals = _space(effort)
    return Table('The engine', [*plane, *space], [*notes, *more_notes], [*goals, *more_goals])


def _plane(effort: Effort) -> tuple[list[Row], list[str], list[Goal]]:
    """Predict and correct on the paper's example in the plane."""
    entries = _entries()
    recordings = simulated(effort.scaled(RECORDINGS, 1))
    figures, notes = accuracy(entries, recordings, replace(effort, check=False))
    samples = interleave(
        {entry.key: contestant(entry, recordings[0]) for entry in entries},
        max(round(STEPS // PER_TURN * effort.share), 1), effort.scaled(PASSES, 1),
        Progress('engine: in the plane'))
    keys = {entry.name: entry.key for entry in reversed(entries)}
    rows = [Row.timed(entry.name, entry.setting, samples[entry.key], samples[keys[entry.base]],
                      entry.base, figures[entry.key]) for entry in entries]
    goals = [_times_faster(f'{name}, whole step, against {other}', samples[keys[name]],
                           samples[keys[other]], times)
             for name, other, times in (
                 (COMPILED, PLAIN, 100), (NUMPY, PLAIN, 15),
                 *((COMPILED, entry.name, 300) for entry in entries[5:]))]
    for name in (COMPILED, NUMPY):
        dev = figures[keys[name]]['dev']
        assert dev is not None
        goals.append(Goal(f'{name}, dev', 0.01, dev))
    return rows, [*notes[:4], *_PLANE_NOTES], goals


def _entries() -> list[Entry]:
    from benchmarks.peers import Particles, PointMass
    from benchmarks.stone_soup import StoneSoupParticles
    split = KernelSettings(TIME_STEP, form='split')
    single = replace(split, precision='single')
    sampled = KernelSettings(TIME_STEP, weights='sampled')
    players: list[tuple[str, str, Player, str]] = [
        (PLAIN, '200 x 200, tabulated, sampled', WithoutCompiler(200, sampled), PLAIN),
        (NUMPY, '72 x 72', WithoutCompiler(72, split), PLAIN),
        (COMPILED, '72 x 72', _described(72, split), PLAIN),
        (f'{COMPILED}, single', '72 x 72', _described(72, single), PLAIN),
        (f'{COMPILED}, on as many cells', '200 x 200', _described(200, split), PLAIN),
        ('particles, bootstrap', '100,000 particles', Particles(100_000), COMPILED),
        ('Stone Soup particles', '100,000 particles', StoneSoupParticles(100_000), COMPILED),
        ('Stone Soup point mass', '61 x 61, linearised', PointMass(61), COMPILED)]
    return [Entry(*player) for player in players]


def _described(cells: int, settings: KernelSettings) -> GridPlayer:
    filter_ = grid_filter(cells, settings)
    filter_.describe()
    return GridPlayer(filter_)


def _space(effort: Effort) -> tuple[list[Row], list[str], list[Goal]]:
    """Predict once in space, against a weight per pair of cells and against the memory."""
    model, cells = ((SPACE, SPACE_CELLS) if effort.share == 1 else (QUICK_SPACE, QUICK_CELLS))
    grid, how = _box(cells), KernelSettings(SPACE_STEP)
    before = time.perf_counter()
    T = dirac_feynman(model, grid, how)
    built = {TABULATED: np.array([[time.perf_counter() - before]])}
    single = replace(how, precision='single')
    makers: dict[str, Callable[[], SplitKernel]] = {
        NUMPY: partial(_made_plain, model, grid, how),
        COMPILED: partial(split_kernel, model, grid, how),
        f'{COMPILED}, single': partial(split_kernel, model, grid, single)}
    kernels = {name: make() for name, make in makers.items()}
    built |= interleave({name: Contestant(partial(_call, make)) for name, make in makers.items()},
                        1, effort.scaled(BUILDS, 1))
    # mass everywhere, so that nothing is left out
    p = GridBelief.uniform(grid).density.ravel()
    samples = interleave(
        {TABULATED: Contestant(lambda k: T @ p),
         **{name: Contestant(partial(_apply, K, p)) for name, K in kernels.items()},
         **{f'copy for {name}': _copy(K, grid) for name, K in kernels.items()}},
        effort.scaled(SPACE_TURNS), 1, Progress('engine: in space'))
    nbytes = {TABULATED: T.data.nbytes + T.indices.nbytes + T.indptr.nbytes,
              **{name: K.nbytes for name, K in kernels.items()}}
    exact = _exact(model, grid, how)
    l1 = {name: _l1(K, exact, grid) for name, K in {TABULATED: T, **kernels}.items()}
    setting = f'{cells} x {cells} x {cells}'
    rows = [*_space_rows(setting, samples, nbytes, l1),
            *(Row.timed(f'{name}, built', setting, built[name], built[TABULATED],
                        f'{TABULATED}, built') for name in built)]
    return rows, _space_notes(T.nnz / grid.size, kernels[COMPILED].nnz / grid.size), [
        goal for name, times, smaller in ((NUMPY, 4, 5), (COMPILED, 10, 10))
        for goal in (_times_faster(f'{name}, {setting}, against {TABULATED}', samples[name],
                                   samples[TABULATED], times),
                     Goal(f'{name}, {setting}, memory, against {TABULATED}', 1 / smaller,
                          nbytes[name] / nbytes[TABULATED]),
                     Goal(f'{name}, {setting}, built, against {TABULATED}', 1 / 50,
                          float(np.median(built[name]) / built[TABULATED][0, 0])))] + [
        Goal(f'{COMPILED}, {setting}, against copying as many bytes', 2.5,
             ratio(samples[COMPILED], samples[f'copy for {COMPILED}']))]


def _space_rows(setting: str, samples: Mapping[str, Samples], nbytes: Mapping[str, int],
                l1: Mapping[str, float]) -> Iterator[Row]:
    for name, taken in samples.items():
        if name in l1:
            yield Row.timed(f'{name}, applied', setting, taken, samples[TABULATED],
                            f'{TABULATED}, applied', {'MB': nbytes[name] / 1e6, 'L1': l1[name]})
        else:
            yield Row.timed(name, setting, taken, samples[name.removeprefix('copy for ')],
                            'that itself')


def _call(make: Callable[[], SplitKernel], k: int) -> None:
    make()


def _apply(K: SplitKernel, p: Array, k: int) -> None:
    K @ p


def _made_plain(model: StateModel, grid: Grid, how: KernelSettings) -> SplitKernel:
    with numpy_alone():
        return split_kernel(model, grid, how)


def _copy(K: SplitKernel, grid: Grid) -> Contestant:
    """Return the copying of half of what a step moves: read once and written once."""
    moved = K.nbytes + len(K.factors) * 2 * grid.size * K.factors[0].dtype.itemsize
    source = np.ones(moved // 2, dtype=np.uint8)
    target = np.zeros_like(source)
    return Contestant(lambda k: np.copyto(target, source))


def _box(cells: int) -> Grid:
    return Grid((-30.0, -30.0, -5.0), (30.0, 30.0, 55.0), (cells,) * 3)


def _start(grid: Grid) -> GridBelief:
    return GridBelief.gaussian(grid, SPACE_MEAN, SPACE_VARIANCE * np.eye(3))


def _exact(model: StateModel, grid: Grid, how: KernelSettings) -> Array:
    """Return the density on cells of half the width in quarter steps, at the coarse centres."""
    fine = _box(2 * grid.shape[0])
    K = split_kernel(model, fine, replace(how, time_step=how.time_step / 4))
    p = _start(fine).density.ravel()
    for k in range(4 * SPACE_STEPS):
        p = (K.turned if k % 2 else K) @ p
    at = np.meshgrid(*[2 * np.arange(cells) + 0.5 for cells in grid.shape], indexing='ij')
    return np.asarray(ndimage.map_coordinates(p.reshape(fine.shape), at, order=3)).ravel()


def _l1(K: object, exact: Array, grid: Grid) -> float:
    p = _start(grid).density.ravel()
    for k in range(SPACE_STEPS):
        p = (K.turned if k % 2 and isinstance(K, SplitKernel) else K) @ p  # type: ignore
    return float(np.abs(p - exact).sum() * grid.cell_volume)


def _times_faster(what: str, samples: Samples, base: Samples, times: float) -> Goal:
    return Goal(f'{what}, share of its time', 1 / times, ratio(samples, base))


_PLANE_NOTES = (
    'Whole steps: filter.predict and filter.correct as the tracker calls them. The plain filter '
    'and the one with numpy and scipy alone run as if no compiler were there; ratios hold in '
    'turns, and the larger ones move with what else goes through the memory: the plain kernel of '
    '200 x 200 cells does not fit into a cache, everything of 72 x 72 cells does.',
    'What bounds it now: about half of a compiled step on 72 x 72 cells are loops over cells, '
    "half of these the kernel's weights out of the second-level cache and half the likelihood and "
    'its exponential; the rest are calls and allocations in Python. With numpy and scipy alone it '
    'is the two sparse products and the exponential.',
    "Stone Soup's point mass filter takes 3,721 points and one linear model for all; it is "
    'the quickest of the others and the least accurate.')


def _space_notes(tabulated: float, split: float) -> list[str]:
    return [
        f'In space `lorenz_63` with noise of 4.5, steps of {SPACE_STEP:g} s: {tabulated:.0f} '
        f'weights per cell tabulated, {split:.0f} split. The density that is timed is uniform, so '
        f'that no cell is left out; L1: of {SPACE_STEPS} steps from a Gaussian to the split '
        'kernel on cells of half the width in steps of a quarter.',
        'The tabulated kernel is built once, the others several times. MB: what a kernel holds '
        'when it is made; built: the whole of it from the model, blocks included.',
        'Copying: as many bytes as a step reads and writes, half of them read and half written. '
        'What bounds a compiled step in space is the memory: each weight is read once.']
