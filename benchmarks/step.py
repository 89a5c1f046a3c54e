"""Predict and correct on the paper's two-dimensional example, beside others and the minimum."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from benchmarks.problem import EDGE, grid_filter, prior, Recording, simulate, STEP_NS, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.reference import (CELLS, Cells, mean_size, Means, particle_means, predicted,
                                  Referee, SUBSTEPS)
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.kernels import KernelSettings

Array = NDArray[np.float64]

STEPS = 200
PER_TURN = 10
PASSES = 5
SEEDS = (1, 2, 3)
CHECK_PARTICLES = 1_000_000
L1_STEPS = 50
#: The paper's 2000 steps took 8 minutes, on its computer.
PAPER_S = 8 * 60 / 2000
BARE = 'bare CSR product'
PLAIN = 'DF, plain'
PAPER_KERNEL = KernelSettings(TIME_STEP, extent=2, weights='sampled')


class Player(Protocol):
    """A filter that goes through the measurements of a recording."""

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""

    def step(self, k: int) -> object:
        """Predict, and correct with the k-th measurement."""

    def means(self) -> Means:
        """Return the means of x and |x|."""

    def predicted(self, steps: int) -> Cells | None:
        """Return the density some steps from N(0, I) without a measurement, if it has one."""


class Grid:
    """This package's filter."""

    def __init__(self, filter_: DiracFeynmanFilter) -> None:
        """Take the filter."""
        self.filter, self.prior = filter_, prior(filter_.grid)

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self.belief, self._measurements = self.prior, [tuple(y.tolist()) for y in measurements]

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        to_ns = (k + 1) * STEP_NS
        moved = self.filter.predict(self.belief, to_ns - STEP_NS, to_ns)
        self.belief, _ = self.filter.correct(moved, self._measurements[k], 'squares', to_ns)

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return Means(self.belief.mean(), mean_size(self.belief))

    def predicted(self, steps: int) -> Cells:
        """Return the density some steps from N(0, I) without a measurement."""
        belief = predicted(self.filter, steps)
        return Cells(belief.grid.points, belief.density.ravel(), belief.grid.cell_volume)


class BareProduct:
    """What no filter with this matrix can be faster than: K @ p on the filter's own densities."""

    def __init__(self, filter_: DiracFeynmanFilter) -> None:
        """Take the filter whose matrix and densities these are."""
        self._player, self._K = Grid(filter_), filter_.kernel_at(0)

    def start(self, measurements: Array) -> None:
        """Record the densities that the filter goes through."""
        self._player.start(measurements)
        self._densities = []
        for k in range(len(measurements)):
            self._densities.append(self._player.belief.density.ravel().copy())
            self._player.step(k)

    def step(self, k: int) -> Array:
        """Multiply."""
        return self._K @ self._densities[k]


@dataclass(frozen=True, eq=False)
class Entry:
    """A player with its line in the table; base: the line its time is divided by."""

    name: str
    setting: str
    player: Player | BareProduct
    base: str = BARE

    @property
    def key(self) -> str:
        """Return what tells it from the others."""
        return f'{self.name}, {self.setting}'


def run(effort: Effort) -> Table:
    """Time all players on one recording, and hold their means against the exact filter's."""
    entries = _entries()
    recordings = simulated(effort.scaled(len(SEEDS), 1))
    figures, notes = accuracy(entries, recordings, effort)
    samples = interleave(
        {entry.key: contestant(entry, recordings[0]) for entry in entries},
        STEPS // PER_TURN, effort.scaled(PASSES, 1), Progress('step: timing'))
    keys = {entry.name: entry.key for entry in reversed(entries)}
    rows = [Row.timed(entry.name, entry.setting, samples[entry.key], samples[keys[entry.base]],
                      entry.base, figures.get(entry.key)) for entry in entries]
    plain = samples[keys[PLAIN]]
    rows.append(Row('the paper', '62 x 62, extent 2, its computer', PAPER_S,
                    ratio=PAPER_S / float(np.median(plain)), base=PLAIN))
    goal = Goal(f'{PLAIN}, paper setting, against the {BARE}', 2.5,
                ratio(plain, samples[keys[BARE]]))
    return Table('Predict and correct, `coupled_trigonometric`', rows, notes, [goal])


def _entries() -> list[Entry]:
    from benchmarks.peers import Particles, PointMass
    plain = grid_filter(62, PAPER_KERNEL)
    wide = KernelSettings(TIME_STEP, weights='sampled')
    default = KernelSettings(TIME_STEP)
    large = grid_filter(200, wide)
    return [
        Entry(BARE, '62 x 62, matrix of the next line', BareProduct(plain)),
        Entry(PLAIN, '62 x 62, extent 2, sampled', Grid(plain)),
        Entry(PLAIN, '62 x 62, no extent, sampled', Grid(grid_filter(62, wide))),
        Entry('DF, default kernel', '62 x 62, moments', Grid(grid_filter(62, default))),
        Entry('DF, all defaults', '62 x 62, moments, cells averaged',
              Grid(grid_filter(62, default, average_cells=True))),
        Entry('bare CSR product, large', '200 x 200, matrix of the next line',
              BareProduct(large)),
        Entry('DF, plain, large', '200 x 200, sampled', Grid(large), 'bare CSR product, large'),
        Entry('Stone Soup point mass', '61 x 61, linearised', PointMass(61), PLAIN),
        Entry('particles, bootstrap', '10,000 particles', Particles(10_000), PLAIN)]


def simulated(count: int) -> list[Recording]:
    """Return so many recordings."""
    return [simulate(seed, STEPS) for seed in SEEDS[:count]]


def contestant(entry: Entry, recording: Recording) -> Contestant:
    """Return a player on a recording, in turns of PER_TURN steps."""
    return Contestant(entry.player.step, PER_TURN,
                      lambda: entry.player.start(recording.measurements))


def accuracy(entries: Sequence[Entry], recordings: Sequence[Recording],
             effort: Effort) -> tuple[Mapping[str, Mapping[str, float | None]], list[str]]:
    """Return the figures of each player, and what is to be said about them."""
    referee, progress = Referee(), Progress('step: reference')
    references = [referee.means(recording, progress.part(i, len(recordings)))
                  for i, recording in enumerate(recordings)]
    density, change = referee.predicted(L1_STEPS)
    figures: dict[str, Mapping[str, float | None]] = {}
    for entry in entries:
        if isinstance(entry.player, BareProduct):
            continue
        distances = [_means(entry.player, recording).distance(reference.means)
                     for recording, reference in zip(recordings, references)]
        dev, dev_size = np.sqrt(np.mean(np.square(distances), axis=0))
        figures[entry.key] = {'dev': float(dev), 'dev of abs x': float(dev_size),
                              'L1': _l1(entry.player.predicted(L1_STEPS), density)}
    error = max(reference.error for reference in references)
    notes = [
        f'Prior N(0, 10 I) cut at the box [{-EDGE:g}, {EDGE:g}]^2, one measurement each '
        f'{TIME_STEP:g} s, {STEPS} of them; {len(recordings)} simulated paths that stay a unit '
        'away from the edge (others are drawn again); times are those of the first.',
        "dev: RMS distance of the posterior mean from the exact filter's. The sensor sees no "
        'sign and the belief has up to four humps, so this is mostly their weights; dev of abs x '
        'is the same of the mean of |x|, which is not. The error against the truth would not '
        'tell the filters apart.',
        f'L1: distance of the density predicted {L1_STEPS} steps from N(0, I) to the exact one.',
        f'The exact filter: {CELLS} x {CELLS} cells, sampled, tolerance 1e-7, '
        f'{SUBSTEPS[0]} and {SUBSTEPS[1]} sub-steps, extrapolated; these two differ by a dev of '
        f'{error:.5f} and an L1 of {change:.5f} at most.',
        "Stone Soup's point mass filter is for linear models: the drift is linearised about the "
        'mean at every step, and its grid moves and turns with the belief.',
        'At this step the kernel needs no more than two cells on each side: extent 2 changes '
        'nothing, and the two plain lines are one filter measured twice.']
    if effort.check:
        dev, dev_size = particle_means(recordings[0], CHECK_PARTICLES).distance(
            references[0].means)
        notes.append(f'Check of the reference, first path: {CHECK_PARTICLES:,} particles with '
                     f'4 Euler sub-steps, an independent program, lie at a dev of {dev:.3f} and '
                     f'a dev of abs x of {dev_size:.4f}.')
    return figures, notes


def _means(player: Player, recording: Recording) -> Means:
    player.start(recording.measurements)
    x, size = [], []
    for k in range(len(recording.measurements)):
        player.step(k)
        means = player.means()
        x.append(means.x)
        size.append(means.size)
    return Means(np.array(x), np.array(size))


def _l1(cells: Cells | None, density: Callable[[Array], Array]) -> float | None:
    """Return the integral of |p - q|; what of q lies off the cells of p counts too."""
    if cells is None:
        return None
    q = np.where(np.all(np.abs(cells.x) < EDGE, axis=0), density(cells.x), 0.0)
    return float(np.abs(cells.density - q).sum() * cells.volume
                 + max(1 - q.sum() * cells.volume, 0.0))
