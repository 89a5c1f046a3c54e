"""A filtering example whose sensor does not see the sign  [TM, Example 4, Figs. 3 to 7]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import sine_cubic_drift
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.pictures import (cloud_picture, error_picture, intensity_picture,
                                           path_picture)
from pif_ros.reproduction.records import Record, recorded
from pif_ros.reproduction.study import Expected
from pif_ros.reproduction.tracks import Reading, sizes

TITLE, SOURCE = 'A state whose sign no sensor sees', 'TM, Example 4'

STEP, BOX = 0.01, 20.0
COARSE, FINE = (Grid((-BOX,), (BOX,), (cells,)) for cells in (160, 800))
#: Cells on which |x| is read off any belief.
READ = Grid((-BOX,), (BOX,), (4000,))
#: Measurements from picture to picture of a cloud.
EVERY = 2
PRINTED, BEST, OPTIMUM = 'grid, as printed', 'grid, best', 'particles'
SIR, OTHER = 'SIR', 'SIR, another seed'


@cache
def cases(quick: bool, scratch: str) -> list[FilteringCase]:
    """Return the one case."""
    system, steps = sine_cubic_drift(), 100 if quick else 1000
    sensors = {'square': system.sensors['square']()}
    problem = Problem(system.model, sensors, gaussian([0.0], [[1.0]]))
    cloud = {'cloud': Reading(lambda belief: belief.points.astype(np.float32), EVERY)}

    def record(rng: Generator) -> Record:
        return recorded(system.model, sensors['square'], 'square', rng.standard_normal(1),
                        STEP * np.arange(steps + 1), rng, substeps=10)

    printed = KernelSettings(STEP, 0.5, 'exponential', weights='sampled')
    return [FilteringCase(
        'tm-4', '|x| from its square, every 0.01 s for 10 s',
        'densities and particle clouds (Figures 5 to 7), no error; 0.5 ms a step', record, (
            problem.grid(PRINTED, 'printed', COARSE, printed, False, {'film': film(COARSE, 0)}),
            problem.grid(BEST, 'best', FINE, KernelSettings(STEP / 4, 0.0),
                         shown={'film': film(FINE, 0)}),
            problem.particles(SIR, 'sir', 200, STEP, shown=cloud),
            problem.particles(OTHER, '', 200, STEP, shown=cloud, salt=1),
            problem.particles('SIR, more', '', 1000, STEP),
            problem.extended(STEP), problem.unscented(STEP),
            problem.particles(OPTIMUM, 'optimum', 2_000 if quick else 100_000, STEP / 2)),
        EXPECTED, REMARKS, estimand=sizes(READ),
        watched={'both signs alive': Reading(both_signs)})]


def both_signs(belief: Any) -> float:
    """Return 1 where either sign has 1 % of the mass or more, else 0."""
    density = belief.on(READ, [0])
    left = density.density[density.grid.axes[0] < 0].sum() / density.density.sum()
    return float(0.01 <= left <= 0.99)


EXPECTED = [
    Expected(PRINTED, 'rmse', 0.158, 0.043, "a dense implementation's"),
    Expected(PRINTED, 'to_best', 0.036, 0.010, "a dense implementation's"),
    Expected(PRINTED, 'coverage_2', 0.71, 0.15, "a dense implementation's"),
    Expected(SIR, 'rmse', 0.153, 0.048, "another implementation's"),
    Expected('SIR, more', 'rmse', 0.152, 0.048, "another implementation's")]
REMARKS = [
    'What is estimated is |x|, since the sensor does not see the sign: the mean of x itself says '
    'nothing, and is best for a filter that lost one of the two humps by luck.',
    'The paper is silent on the start and the box: x(0) is drawn from N(0, 1), and the box is '
    '[-20, 20].',
    "The printed cell of 0.25 is wider than the likelihood at |x| > 2, where sigma_y / |h'| < "
    '0.25: the mean suffers little, but the bands come out too narrow.',
    'That the particle filter loses one of the humps (Figures 6 and 7) is so, and no accident: '
    'resampling lets one of two equal humps die out, with 1000 particles too.']


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 3 to 7, and the errors of |x|."""
    record, tracks = exhibits['tm-4'].record, exhibits['tm-4'].tracks
    top = 1.1 * float(np.abs(record.truth).max())
    return {
        'path.png': path_picture(record, ['x'], ['y']),
        'density.png': intensity_picture(record, {
            'as printed, cells of 0.25': (tracks[PRINTED].read['film'], COARSE, 0),
            'best, cells of 0.05': (tracks[BEST].read['film'], FINE, 0)}, 'x', (-top, top)),
        'clouds.png': cloud_picture(record, {
            f'{name}, 200 particles': tracks[name].read['cloud'] for name in (SIR, OTHER)},
            {BEST: (tracks[BEST].read['film'], FINE)}, 0, 'x', EVERY),
        'errors.png': error_picture(record, np.abs(record.truth), {
            name: tracks[name] for name in (PRINTED, BEST, SIR)}, 'error of |x|')}
