"""Brownian motion, for which one step of any length is exact  [TM, Example 1]."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from pif_ros.core.systems import wiener
from pif_ros.reproduction.pictures import transition_picture
from pif_ros.reproduction.study import Expected
from pif_ros.reproduction.transitions import Densities, L1, MASS, Setting, TransitionCase

TITLE, SOURCE = 'Transition densities of Brownian motion', 'TM, Example 1'

STARTS = (-4.0, 0.0, 3.0)
PRINTED = Setting('printed', 0.5, 'exponential', 1)
BEST = Setting('best', 0.5, 'determinant', 100, filtered=True)
SETTINGS = (PRINTED, Setting('', 0.5, 'exponential', 10), Setting('', 0.5, 'exponential', 100),
            Setting('', 0.5, 'determinant', 1, filtered=True), BEST)


@cache
def cases(quick: bool, scratch: str) -> list[TransitionCase]:
    """Return the one case."""
    # what is lost is the Gaussian beyond six of its deviations, and the filter's tolerance
    expected = [Expected(setting.name, score, value, 1e-8, 'an exact')
                for setting in SETTINGS[:3] for score, value in ((L1, 0.0), (MASS, 1.0))]
    expected.append(Expected(BEST.name, L1, 0.0, 1e-3, 'an exact'))
    return [TransitionCase(
        'tm-1', 'where a state is 1 s after it was at each of three points',
        'the formula (Equation 123) is exact for a step of any length', wiener().model, STARTS,
        1.0, Grid((-10.0,), (10.0,), (1000,)), 100, 2_000 if quick else 100_000, SETTINGS,
        ('exact density', exact), expected, REMARKS)]


REMARKS = ["The filter's densities differ by the tails that its kernel leaves out, 1e-5 of each "
           "step's mass."]


def exact(model: StateModel, grid: Grid, starts: Sequence[float],
          seconds: float) -> NDArray[np.float64]:
    """Return the Gaussians  [TM, Eq. 123]."""
    variance = seconds * float(model.diffusion(0.0)[0, 0])
    d = grid.points - np.array([starts]).T
    return np.asarray(np.exp(-0.5 * d * d / variance) / np.sqrt(2 * np.pi * variance))


def draw(exhibits: Mapping[str, Densities]) -> dict[str, Figure]:
    """Return the densities after one step, and after a hundred."""
    return {'transition_densities.png': transition_picture(exhibits['tm-1'], {
        'one step of 1 s': PRINTED.name, '100 steps of 0.01 s, by the filter': BEST.name})}
