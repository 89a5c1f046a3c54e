"""Two coupled states, seen by their squares, often and seldom  [Sensors, section 5.2]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.simulation import simulate_inside
from pif_ros.core.systems import coupled_trigonometric
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import Contender, film, FilteringCase, Followed
from pif_ros.reproduction.pictures import band_picture, intensity_picture
from pif_ros.reproduction.records import observed, Record
from pif_ros.reproduction.study import Expected
from pif_ros.reproduction.tracks import Reading, sizes

TITLE, SOURCE = 'Two coupled states, seen by their squares', 'Sensors, section 5.2'

STEP, BOX, SELDOM = 0.01, 6.0, 20
PRINTED, BEST, SIR, OPTIMUM = 'grid, as printed', 'grid, best', 'SIR', 'particles'
FINE = Grid((-8.0, -8.0), (8.0, 8.0), (120, 120))
#: Cells on which sizes are read off any belief.
READ = Grid((-8.0, -8.0), (8.0, 8.0), (800, 800))
SIZES: dict[str, Any] = {'covered': ' of |x|', 'also': {'of |x|': sizes(READ)}}
LABELS = ['x1', 'x2']
OFTEN, RARE = 'sensors-2, dt = 0.01', 'sensors-2, dt = 0.2'


@cache
def cases(quick: bool, scratch: str) -> list[FilteringCase]:
    """Return the cases of a measurement every 0.01 s and every 0.2 s."""
    steps = 100 if quick else 2000
    return [
        FilteringCase(
            OFTEN, 'x1 and x2, a measurement every 0.01 s for 20 s',
            'DF 0.54 (8 min), SIR 1.48 (10 min)',
            lambda rng: _record(rng, 1, steps), _often(quick),
            [Expected(PRINTED, 'rmse', 0.560, 0.266, "a dense implementation's"),
             Expected(PRINTED, 'rmse', 0.46, 0.15, "a dense implementation's", median=True)],
            [*SHARED_REMARKS, SETTLED, NOISY], median=True, **SIZES),
        FilteringCase(
            RARE, 'x1 and x2, a measurement every 0.2 s for 20 s',
            'DF 0.69 (14 s), 0.31 without the first few; SIR 3.68 (37 s), 3.34 with 50,000 '
            'particles (14 min)',
            lambda rng: _record(rng, SELDOM, steps), _seldom(quick),
            [Expected(PRINTED, 'rmse', 1.52, 0.89, "a dense implementation's"),
             Expected(WIDE, 'rmse', 0.80, 0.39, "a dense implementation's")],
            [*SHARED_REMARKS, FAILURES, NOISY, EXTENT], median=True, **SIZES)]


def _often(quick: bool) -> list[Contender]:
    problem, printed = _problem(), _square(BOX, 62)
    return [
        problem.grid(PRINTED, 'printed', printed,
                     KernelSettings(STEP, 0.5, 'exponential', 2, 'sampled'), False),
        problem.grid('grid, in between', '', _square(7.0, 84), KernelSettings(STEP)),
        problem.grid(BEST, 'best', FINE, KernelSettings(STEP), shown=_films()),
        problem.particles(SIR, 'sir', 5000, STEP),
        problem.extended(STEP), problem.unscented(STEP),
        problem.particles(OPTIMUM, 'optimum', 2000 if quick else 100_000, STEP)]


def _seldom(quick: bool) -> list[Contender]:
    problem, printed, dt = _problem(), _square(BOX, 31), SELDOM * STEP
    return [
        problem.grid(PRINTED, 'printed', printed,
                     KernelSettings(dt, 0.5, 'exponential', 2, 'sampled'), False),
        problem.grid(WIDE, '', printed,
                     KernelSettings(dt, 0.5, 'exponential', 0, 'sampled'), False),
        problem.grid(BEST, 'best', FINE, KernelSettings(dt / 10), shown=_films()),
        problem.particles(SIR, 'sir', 2000, dt),
        problem.particles('SIR, more', '', 50_000, dt),
        problem.extended(dt / 4), problem.unscented(dt / 4),
        problem.particles(OPTIMUM, 'optimum', 2000 if quick else 200_000, dt / 10)]


WIDE = 'grid, as printed but the extent'
SHARED_REMARKS = [
    'Neither sign is seen, and the drift tells them apart but slowly: that makes the error, and '
    'its spread from seed to seed.',
    'Paths are those, of a start drawn from N(0, I), that stay inside the printed box; without '
    'that no grid of this size holds them.']
SETTLED = (
    'A particle filter of 5000 settles on the wrong signs in some of the runs, and the printed '
    'failure may be one of these; in most it is as good as the grid, as its median shows.')
FAILURES = (
    'The printed failures of the particle filter are not reproduced: with systematic resampling '
    'and weights kept as logarithms it does about as well as the grid.')
NOISY = (
    'Even this many particles have not converged: each choice of signs has its own share of them, '
    'whose evidence wanders over the corrections, and in the end they trust one choice too much.  '
    'Two grids of different cells agree far better (the column to our best), and of |x|, which '
    'hangs little on the signs, the particle filter tells what the grid does: it is for |x| that '
    'the coverage is held against that of the optimum.')
EXTENT = ('An extent of 2 cells cuts off what the drift carries further in 0.2 s, a quarter of '
          'the mass at each step: a window as wide as the kernel, on the same grid, mends it.')


def _problem() -> Problem:
    system = coupled_trigonometric()
    return Problem(system.model, {'squares': system.sensors['squares']()},
                   gaussian([0.0, 0.0], 10 * np.eye(2)))


def _square(box: float, cells: int) -> Grid:
    return Grid((-box, -box), (box, box), (cells, cells))


def _films() -> dict[str, Reading]:
    return {f'film {axis}': film(FINE, axis) for axis in (0, 1)}


def _record(rng: Generator, every: int, steps: int) -> Record:
    """Return a path that stays in the printed box, measured after every so many steps."""
    problem, times = _problem(), STEP * np.arange(steps + 1)
    path = simulate_inside(problem.model, lambda rng: rng.standard_normal(2), times, rng,
                           [-BOX] * 2, [BOX] * 2, substeps=5)
    return observed(problem.sensors['squares'], 'squares', path[::every], times[::every], rng)


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 7 to 12, and the densities over time."""
    pictures = {}
    for file, name in (('often', OFTEN), ('seldom', RARE)):
        record, tracks = exhibits[name].record, exhibits[name].tracks
        pictures[f'estimates_{file}.png'] = band_picture(
            record, {name: tracks[name] for name in (PRINTED, BEST, SIR)}, LABELS)
        pictures[f'density_{file}.png'] = intensity_picture(
            record, {f'{LABELS[axis]}, {BEST}': (tracks[BEST].read[f'film {axis}'], FINE, axis)
                     for axis in (0, 1)}, 'state', (-BOX, BOX))
    return pictures
