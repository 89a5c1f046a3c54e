"""The cubic sensor: a path that is flat where the state begins  [PMC, section 6.3]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import cubic_sensor
from pif_ros.reproduction.contenders import gaussian, PathProblem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.pictures import band_picture, intensity_picture, path_picture
from pif_ros.reproduction.records import path_recorded, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'The cubic sensor', 'PMC, section 6.3'

#: Points of the path from score to score, and from frame to frame of a film.
STEP, SCORED, FILMED = 0.001, 10, 40
GRID, COARSER = Grid((-15.0,), (15.0,), (3000,)), Grid((-15.0,), (15.0,), (1500,))
PRINTED, BEST, EKF, OPTIMUM = 'DFY post, as printed', 'symmetric', 'EKF', 'particles'
NAME = 'pmc-2'


@cache
def cases(quick: bool, scratch: str) -> list[FilteringCase]:
    """Return the one case."""
    system, steps = cubic_sensor(), 400 if quick else 20_000
    sensors = {'cube': system.sensors['cube']()}
    problem = PathProblem(system.model, sensors, gaussian([0.0], [[0.01]]))

    def record(rng: Generator) -> Record:
        return path_recorded(system.model, sensors['cube'], 'cube', 0.1 * rng.standard_normal(1),
                             STEP * np.arange(steps + 1), rng, substeps=2)

    printed = KernelSettings(STEP, 0.5, 'exponential', weights='sampled')
    return [FilteringCase(
        NAME, 'x from the path of its cube, 20 s', '"excellent"; the EKF "fails completely"',
        record, (
            problem.grid(PRINTED, 'printed', GRID, printed, 'post', False),
            problem.grid(BEST, 'best', COARSER, KernelSettings(STEP), 'symmetric',
                         shown={'film': film(COARSER, 0, FILMED)}),
            problem.particles('SIR', 'sir', 1000, STEP), problem.extended(STEP),
            problem.particles(OPTIMUM, 'optimum', 500 if quick else 10_000, STEP)),
        [Expected(PRINTED, 'rmse', 0.406, 0.091, "a dense implementation's"),
         Expected(PRINTED, 'to_optimum', 0.085, 0.04, "a dense implementation's"),
         Expected(PRINTED, 'coverage_2', 0.860, 0.04, "a dense implementation's"),
         Expected(BEST, 'rmse', 0.378, 0.107, "another implementation's"),
         Expected(EKF, 'rmse', 3.68, 1.5, "another implementation's")], REMARKS, every=SCORED)]


REMARKS = [
    'The EKF starts at 0, where the slope of the sensor is 0: it believes that it learns nothing, '
    'and stays.  That is so in print, and here.',
    'At the edge of the grid the exponent h dy is beyond 6000: everything is in logarithms.',
    'Half as many cells as printed are as good with the symmetric scheme.']


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figure 5, the path, and the density over time."""
    record, tracks = exhibits[NAME].record, exhibits[NAME].tracks
    top = 1.3 * float(np.abs(record.truth).max())
    return {
        'path.png': path_picture(record, ['x'], ['y']),
        'estimates.png': band_picture(
            record, {who: tracks[who] for who in (PRINTED, BEST, EKF)}, ['x']),
        'density.png': intensity_picture(
            record, {BEST: (tracks[BEST].read['film'], COARSER, 0)}, 'x', (-top, top), FILMED)}
