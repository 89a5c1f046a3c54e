"""A filtering example whose sensor does not see the sign  [TM, Example 4, Figs. 3 to 7]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import sine_cubic_drift
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import film, FilteringCase, Followed
from pif_ros.reproduction.pictures import (band_picture, cloud_picture, intensity_picture,
                                           path_picture)
from pif_ros.reproduction.records import recorded, Record
from pif_ros.reproduction.study import Expected
from pif_ros.reproduction.tracks import Reading

TITLE, SOURCE = 'A state whose sign no sensor sees', 'TM, Example 4'

Array = NDArray[np.float64]

STEP, BOX = 0.01, 20.0
PRINTED, BEST = 'grid, as printed', 'grid, best'
#: Cells on which |x| is read off any belief.
READ = Grid((-BOX,), (BOX,), (4000,))
EVERY = 10


@cache
def cases(quick: bool) -> list[FilteringCase]:
    """Return the one case."""
    system, steps = sine_cubic_drift(), 100 if quick else 1000
    sensors = {'square': system.sensors['square']()}
    problem = Problem(system.model, sensors, gaussian([0.0], [[1.0]]))
    coarse, fine = (Grid((-BOX,), (BOX,), (cells,)) for cells in (160, 800))
    cloud = {'cloud': Reading(lambda belief: belief.points.astype(np.float32), 5)}

    def draw(rng: Generator) -> Record:
        return recorded(system.model, sensors['square'], 'square', rng.standard_normal(1),
                        STEP * np.arange(steps + 1), rng, substeps=10)

    return [FilteringCase(
        'tm-4', '|x| from its square, 10 s', 'densities and clouds (Figures 5 to 7), no number',
        draw, (
            problem.grid(PRINTED, 'printed', coarse,
                         KernelSettings(STEP, 0.5, 'exponential', weights='sampled'), False,
                         {'film': film(coarse, 0)}),
            problem.grid(BEST, 'best', fine, KernelSettings(STEP / 4, 0.0),
                         shown={'film': film(fine, 0)}),
            problem.particles('SIR 200', 'sir', 200, STEP, shown=cloud),
            problem.particles('SIR 200, other seed', '', 200, STEP, shown=cloud, salt=1),
            problem.particles('SIR 1000', '', 1000, STEP),
            problem.extended(STEP), problem.unscented(STEP),
            problem.particles('particles', 'optimum', 2_000 if quick else 100_000, STEP / 4)),
        EXPECTED, REMARKS, moments=absolute_moments, transform=np.abs,
        watched={'both signs alive': Reading(both_signs)})]


def absolute_moments(belief: Any) -> tuple[Array, Array]:
    """Return mean and variance of |x|, which the sensor sees, shape (1,) each."""
    density = belief.on(READ, [0])
    x, p = np.abs(density.grid.axes[0]), density.density / density.density.sum()
    mean = x @ p
    return np.array([mean]), np.array([(x - mean)**2 @ p])


def both_signs(belief: Any) -> float:
    """Return 1 where either sign has 1 % of the mass or more, else 0."""
    density = belief.on(READ, [0])
    left = density.density[density.grid.axes[0] < 0].sum() / density.density.sum()
    return float(0.01 <= left <= 0.99)


EXPECTED = [Expected(PRINTED, 'rmse', 0.158, 0.043, "a dense implementation's"),
            Expected(PRINTED, 'to_optimum', 0.036, 0.01, "a dense implementation's"),
            Expected('SIR 200', 'rmse', 0.153, 0.043, "another implementation's")]
REMARKS = [
    'Errors are those of E|x|, since the sensor does not see the sign.',
    'The paper is silent on the start and the box: x(0) is drawn from N(0, 1), and the box reaches '
    'from -20 to 20.']


def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    """Return Figures 3 to 7, and the estimates of |x|."""
    return {}
