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
from pif_ros.reproduction.records import path_recorded, Record
from pif_ros.reproduction.study import Expected

TITLE, SOURCE = 'The cubic sensor', 'PMC, section 6.3'
STEP = 0.001
GRID = Grid((-15.,), (15.,), (3000,))


@cache
def cases(quick: bool) -> list[FilteringCase]:
    system, steps = cubic_sensor(), 500 if quick else 20000
    sensors = {'cube': system.sensors['cube']()}
    problem = PathProblem(system.model, sensors, gaussian([0.0], [[0.01]]))

    def draw(rng: Generator) -> Record:
        return path_recorded(system.model, sensors['cube'], 'cube',
                             0.1 * rng.standard_normal(1), STEP * np.arange(steps + 1), rng, 5)

    kernel = KernelSettings(STEP, 0.5, 'exponential', weights='sampled')
    return [FilteringCase(
        f'pmc-2','','',draw,(
            problem.grid('DFY pre, as printed','printed',GRID,kernel,'pre_printed',False),
            problem.grid('DFY post','',GRID,kernel,'post',False),
            problem.grid('splitting','',GRID,KernelSettings(STEP),'splitting'),
            problem.grid('symmetric','',GRID,KernelSettings(STEP),'symmetric'),
            problem.grid('symmetric coarse','best',Grid((-15.,), (15.,), (1500,)),KernelSettings(STEP),'symmetric'),
            problem.particles('SIR 1000','sir',1000,STEP),
            problem.extended(STEP),
            problem.particles('optimum','optimum',10000,STEP)))]

def draw(exhibits: Mapping[str, Followed]) -> dict[str, Figure]:
    return {}
