"""Four states with multiplicative noise: one operator, two sensors  [Sensors, section 5.3]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import multiplicative_4d
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import FilteringCase, Followed
from pif_ros.reproduction.pictures import band_picture
from pif_ros.reproduction.records import Record, recorded
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'Four states with multiplicative noise', 'Sensors, section 5.3'

STEP, LABELS = 0.5, ['x1', 'x2', 'x3', 'x4']
PRINTED, BEST, SIR, OPTIMUM = 'grid, as printed', 'grid, best', 'SIR', 'particles'
NAMES = {'trigonometric': 'sensors-3, sensor of Equation 34',
         'inverse_trigonometric': 'sensors-3, sensor of Equation 35'}


@cache
def cases(quick: bool, scratch: str) -> list[FilteringCase]:
    """Return the cases of the two sensors, whose grids share their operators."""
    rmse = {'trigonometric': (4.65, 0.46), 'inverse_trigonometric': (4.38, 0.56)}
    return [_case(quick, Path(scratch), sensor, *rmse[sensor]) for sensor in NAMES]


def _case(quick: bool, scratch: Path, sensor: str, value: float, spread: float) -> FilteringCase:
    system, steps = multiplicative_4d(), 4 if quick else 40
    sensors = {sensor: system.sensors[sensor]()}
    problem = Problem(system.model, sensors, gaussian(np.zeros(4), 25 * np.eye(4)))
    printed, best = (_cube(20.0, 4), _cube(24.0, 6)) if quick else (
        _cube(20.0, 8), _cube(24.0, 12))

    def record(rng: Generator) -> Record:
        return recorded(system.model, sensors[sensor], sensor, 5 * rng.standard_normal(4),
                        STEP * np.arange(steps + 1), rng, substeps=50)

    return FilteringCase(
        NAMES[sensor], 'four states, a measurement every 0.5 s for 20 s', '"quite good"', record, (
            problem.grid(PRINTED, 'printed', printed, KernelSettings(
                STEP, 0.5, 'exponential', 1, 'sampled'), False, file=scratch / 'printed.kernel'),
            problem.grid(BEST, 'best', best, KernelSettings(STEP / 5),
                         file=scratch / 'best.kernel', significance=1e-4),
            problem.particles(SIR, 'sir', 1000, STEP / 50),
            problem.particles('SIR, one step', '', 5000, STEP),
            problem.extended(STEP / 10), problem.unscented(STEP / 10),
            problem.particles(OPTIMUM, 'optimum', 500 if quick else 10_000, STEP / 25)),
        [Expected(PRINTED, 'rmse', value, spread, "a dense implementation's"),
         Expected(PRINTED, 'coverage_2', 0.865, 0.08, "a dense implementation's")], REMARKS)


REMARKS = [
    'These measurements say next to nothing of the state, whose stationary spread is (3.8, 3.6, '
    '3.6, 6.3): without any measurement the error is 4.4.  What can be shown is the coverage, the '
    'mass and the time.',
    'The printed extent of one cell loses mass that the drift carries further; its bands are as '
    'printed, and too narrow.',
    'An operator is made for the first sensor, kept in a file, and loaded for the second (the '
    'longest time over the seeds in the column made in).',
    'One Euler step of 0.5 s lets particles blow up.',
    'The paper is silent on the prior: N(0, 25 I).']


def _cube(box: float, cells: int) -> Grid:
    return Grid((-box,) * 4, (box,) * 4, (cells,) * 4)


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 13 and 14."""
    pictures = {}
    for sensor, name in NAMES.items():
        tracks = {who: exhibits[name].tracks[who] for who in (PRINTED, BEST, OPTIMUM)}
        pictures[f'estimates_{sensor}.png'] = band_picture(exhibits[name].record, tracks, LABELS)
    return pictures
