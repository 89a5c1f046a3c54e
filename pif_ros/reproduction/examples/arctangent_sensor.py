"""A path measured through an arctangent, with little noise and less  [PMC, section 6.2]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import arctangent_sensor
from pif_ros.reproduction.contenders import gaussian, PathProblem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.pictures import band_picture, intensity_picture, path_picture
from pif_ros.reproduction.records import path_recorded, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'A path measured through an arctangent', 'PMC, section 6.2'

STEP, GRID = 0.01, Grid((-1.5,), (1.5,), (300,))
PRINTED, POST, SPLITTING = 'DFY pre, as printed', 'DFY post', 'splitting'
BEST, EKF, OPTIMUM = 'symmetric', 'EKF', 'particles'
NAMES = {0.05: 'pmc-1, sigma_y = 0.05', 0.0125: 'pmc-1, sigma_y = 0.0125'}
#: By sigma_y, what an implementation of its own gave: rmse, distance to the reference's mean.
REFERENCE = {
    0.05: {PRINTED: (0.1042, 0.0195), POST: (0.1027, 0.0066), BEST: (0.1031, 0.0010)},
    0.0125: {PRINTED: (0.0793, 0.0515), POST: (0.0744, 0.0430), BEST: (0.0638, 0.0007)}}


@cache
def cases(quick: bool, scratch: str) -> list[FilteringCase]:
    """Return the cases of sigma_y = 0.05 and sigma_y = 0.0125."""
    return [_case(quick, sigma_y) for sigma_y in NAMES]


def _case(quick: bool, sigma_y: float) -> FilteringCase:
    system, steps = arctangent_sensor(sigma_y=sigma_y), 50 if quick else 200
    sensors = {'arctangent': system.sensors['arctangent']()}
    problem = PathProblem(system.model, sensors, gaussian([0.0], [[0.01]]))
    printed = KernelSettings(STEP, 0.5, 'exponential', weights='sampled')
    filmed = {'film': film(GRID, 0)}

    def record(rng: Generator) -> Record:
        return path_recorded(system.model, sensors['arctangent'], 'arctangent',
                             0.1 * rng.standard_normal(1), STEP * np.arange(steps + 1), rng,
                             substeps=10)

    return FilteringCase(
        NAMES[sigma_y], 'x from the path of its arctangent, 2 s', '"mostly within 2 sigma"',
        record, (
            problem.grid(PRINTED, 'printed', GRID, printed, 'pre_printed', False, filmed),
            problem.grid('DFY pre', '', GRID, printed, 'pre', False),
            problem.grid(POST, '', GRID, printed, 'post', False),
            problem.grid(SPLITTING, '', GRID, KernelSettings(STEP), 'splitting'),
            problem.grid(BEST, 'best', GRID, KernelSettings(STEP), 'symmetric', shown=filmed),
            problem.particles('SIR', 'sir', 1000, STEP), problem.extended(STEP),
            problem.particles(OPTIMUM, 'optimum', 1000 if quick else 20_000, STEP / 2)),
        [Expected(entry, score, value, 0.015 if score == 'rmse' else 0.5 * value + 0.001,
                  "a dense implementation's")
         for entry, values in REFERENCE[sigma_y].items()
         for score, value in zip(('rmse', 'to_optimum'), values)], REMARKS)


REMARKS = [
    'The pre-measurement form as printed is read before the last increment is used; DFY pre is '
    'the same, read after it.',
    'The symmetric scheme takes half of the likelihood of an increment before the step and half '
    'after it.  The printed forms take h dy at one end of the step and h^2 in its middle, which '
    'shows where the noise is small.',
    'The paper is silent on the start: x(0) is drawn from N(0, 0.01).']


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 1 to 4, and the densities over time."""
    pictures = {}
    for file, name in zip(('', '_small_noise'), NAMES.values()):
        record, tracks = exhibits[name].record, exhibits[name].tracks
        pictures[f'path{file}.png'] = path_picture(record, ['x'], ['y'])
        pictures[f'estimates{file}.png'] = band_picture(
            record, {who: tracks[who] for who in (PRINTED, BEST, EKF)}, ['x'])
        pictures[f'density{file}.png'] = intensity_picture(record, {
            who: (tracks[who].read['film'], GRID, 0) for who in (PRINTED, BEST)}, 'x',
            (-1.0, 1.5))
    return pictures
