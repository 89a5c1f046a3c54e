"""Two coupled states, seen by their squares, often and seldom  [Sensors, section 5.2]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.simulation import simulate_inside
from pif_ros.core.systems import coupled_trigonometric
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.records import observed, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'Two coupled states, seen by their squares', 'Sensors, section 5.2'

STEP, BOX, SELDOM = 0.01, 6.0, 20
PRINTED, WIDE, BEST = 'grid, as printed', 'grid, window as wide as the kernel', 'grid, best'
OFTEN_NAME, SELDOM_NAME = 'sensors-2 often', 'sensors-2 seldom'


@cache
def cases(quick: bool) -> list[FilteringCase]:
    """Return the cases of a measurement every 0.01 s and every 0.2 s."""
    return [_often(quick), _seldom(quick)]


def _often(quick: bool) -> FilteringCase:
    problem, printed = _problem(), _square(BOX, 62)
    fine = _square(8.0, 120)
    return FilteringCase(
        OFTEN_NAME, 'x1 and x2, a measurement every 0.01 s, 20 s', 'DF 0.54, SIR 1.48',
        lambda rng: _record(rng, 1, 100 if quick else 2000), (
            problem.grid(PRINTED, 'printed', printed,
                         KernelSettings(STEP, 0.5, 'exponential', 2, 'sampled'), False),
            problem.grid(BEST, 'best', fine, KernelSettings(STEP, 0.5),
                         shown={'film 0': film(fine, 0), 'film 1': film(fine, 1)}),
            problem.particles('SIR 5000', 'sir', 5000, STEP),
            problem.extended(STEP), problem.unscented(STEP),
            problem.particles('particles', 'optimum', 2000 if quick else 50_000, STEP)),
        median=True)


def _seldom(quick: bool) -> FilteringCase:
    problem, dt = _problem(), SELDOM * STEP
    printed, fine = _square(BOX, 31), _square(8.0, 120)
    return FilteringCase(
        SELDOM_NAME, 'x1 and x2, a measurement every 0.2 s, 20 s',
        'DF 0.69 (0.31 without the first few), SIR 3.68 (2000 particles), 3.34 (50,000)',
        lambda rng: _record(rng, SELDOM, 100 if quick else 2000), (
            problem.grid(PRINTED, 'printed', printed,
                         KernelSettings(dt, 0.5, 'exponential', 2, 'sampled'), False),
            problem.grid(WIDE, '', printed,
                         KernelSettings(dt, 0.5, 'exponential', 0, 'sampled'), False),
            problem.grid(BEST, 'best', fine, KernelSettings(dt / 10, 0.5),
                         shown={'film 0': film(fine, 0), 'film 1': film(fine, 1)}),
            problem.particles('SIR 2000, one step', 'sir', 2000, dt),
            problem.particles('SIR 50000, one step', '', 50_000, dt),
            problem.extended(dt / 4), problem.unscented(dt / 4),
            problem.particles('particles', 'optimum', 2000 if quick else 50_000, dt / 10)),
        median=True)


def _problem() -> Problem:
    system = coupled_trigonometric()
    return Problem(system.model, {'squares': system.sensors['squares']()},
                   gaussian([0.0, 0.0], 10 * np.eye(2)))


def _square(box: float, cells: int) -> Grid:
    return Grid((-box, -box), (box, box), (cells, cells))


def _record(rng: Generator, every: int, steps: int) -> Record:
    """Return a path that stays in the printed box, measured at every so many steps."""
    problem, times = _problem(), STEP * np.arange(steps + 1)
    path = simulate_inside(problem.model, lambda rng: rng.standard_normal(2), times, rng,
                           [-BOX] * 2, [BOX] * 2, substeps=5)
    return observed(problem.sensors['squares'], 'squares', path[::every], times[::every], rng)


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 7 to 12, and the densities over time."""
    return {}
