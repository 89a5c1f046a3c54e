"""Path integral Monte Carlo: whole paths given all measurements  [TM, section 9.2, Eq. 130]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.random import Generator
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.path_monte_carlo import SamplerSettings
from pif_ros.core.systems import coupled_trigonometric, sine_cubic_drift, System
from pif_ros.reproduction.pictures import paths_picture
from pif_ros.reproduction.records import Record, recorded
from pif_ros.reproduction.smoothing_case import SmoothedRecord, SmoothingCase

TITLE, SOURCE = 'Whole paths, by Monte Carlo', 'TM, section 9.2'

NAMES = {'square': 'tm-9, sine_cubic_drift', 'squares': 'tm-9, coupled_trigonometric'}
GRIDS = {'square': Grid((-10.0,), (10.0,), (400,)),
         'squares': Grid((-6.0, -6.0), (6.0, 6.0), (80, 80))}


@cache
def cases(quick: bool, scratch: str) -> list[SmoothingCase]:
    """Return the cases of one state and of two, windows of fifty measurements."""
    return [_case(quick, sine_cubic_drift(), 'square', 0.01),
            _case(quick, coupled_trigonometric(), 'squares', 0.02)]


def _case(quick: bool, system: System, sensor: str, step: float) -> SmoothingCase:
    sensors, n = {sensor: system.sensors[sensor]()}, system.model.ndim

    def record(rng: Generator) -> Record:
        return recorded(system.model, sensors[sensor], sensor, rng.standard_normal(n),
                        step * np.arange(11 if quick else 51), rng, substeps=10)

    return SmoothingCase(
        NAMES[sensor], 'sizes of the states, given all of 50 measurements',
        'proposed, not shown', system.model, sensors, np.zeros(n), np.eye(n), GRIDS[sensor],
        KernelSettings(step), SamplerSettings(draws=20 if quick else 150,
                                              warm_up=10 if quick else 50, particles=128),
        record, REMARKS)


REMARKS = [
    'Grid and paths have the same one-step density, so that all they may differ by is the Monte '
    'Carlo error: 1 in units of the standard error, root mean square over the window.',
    'The column made in has the longest time for the whole window.']


def draw(exhibits: Mapping[str, SmoothedRecord]) -> dict[str, Figure]:
    """Return paths drawn, with the grid's bands, and the marginals in the middle."""
    return {f'paths_{sensor}.png': paths_picture(exhibits[name].record, exhibits[name].smoothed,
                                                 exhibits[name].sample, GRIDS[sensor])
            for sensor, name in NAMES.items()}
