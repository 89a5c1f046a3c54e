"""A path that is measured through an arctangent, with little noise and less  [PMC, section 6.2]."""

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
from pif_ros.reproduction.records import path_recorded, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'A path measured through an arctangent', 'PMC, section 6.2'
STEP = 0.01
GRID = Grid((-1.5,), (1.5,), (300,))


@cache
def cases(quick: bool) -> list[FilteringCase]:
    """Return the cases of sigma_y = 0.05 and sigma_y = 0.0125."""
    return [_case(quick, 0.05), _case(quick, 0.0125)]


def _case(quick: bool, sigma_y: float) -> FilteringCase:
    system, steps = arctangent_sensor(sigma_y=sigma_y), 50 if quick else 200
    sensors = {'arctangent': system.sensors['arctangent']()}
    problem = PathProblem(system.model, sensors, gaussian([0.0], [[0.01]]))

    def draw(rng: Generator) -> Record:
        return path_recorded(system.model, sensors['arctangent'], 'arctangent',
                             0.1 * rng.standard_normal(1), STEP * np.arange(steps + 1), rng, 10)

    kernel = KernelSettings(STEP, 0.5, 'exponential', weights='sampled')
    return FilteringCase(
        f'pmc-1 {sigma_y}','','',draw,(
            problem.grid('DFY pre, as printed','printed',GRID,kernel,'pre_printed',False),
            problem.grid('DFY pre','',GRID,kernel,'pre',False),
            problem.grid('DFY post','',GRID,kernel,'post',False),
            problem.grid('splitting','',GRID,KernelSettings(STEP),'splitting'),
            problem.grid('symmetric','',GRID,KernelSettings(STEP),'symmetric'),
            problem.grid('symmetric sub','best',GRID,KernelSettings(STEP/2),'symmetric'),
            problem.grid('symmetric wide','',Grid((-2.5,),(2.5,),(500,)),KernelSettings(STEP),'symmetric'),
            problem.particles('SIR 1000','sir',1000,STEP),
            problem.extended(STEP),
            problem.particles('optimum','optimum',20000,STEP/5)))

def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    return {}
