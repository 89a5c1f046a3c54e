"""A transcendental drift: its transition densities  [TM, Example 3, Fig. 2]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
from pif_ros.core.grid import Grid
from pif_ros.core.systems import cosine_drift
from pif_ros.reproduction.examples.double_well import BEST, EULER, expected, PRINTED
from pif_ros.reproduction.examples.double_well import REMARKS as SHARED_REMARKS
from pif_ros.reproduction.examples.double_well import SETTINGS
from pif_ros.reproduction.pictures import transition_picture
from pif_ros.reproduction.transitions import Densities, TransitionCase

TITLE, SOURCE = 'Transition densities of a periodic drift', 'TM, Example 3'

STARTS = (-0.5, -0.05, 0.05, 0.5)
#: L1 distances to the truth that a dense implementation of the formulas gave.
REFERENCE = {
    EULER: (.372, .111, .247, .300), PRINTED: (.080, .061, .058, .053),
    SETTINGS[2]: (.051, .059, .057, .007), SETTINGS[3]: (.033, .022, .021, .028),
    SETTINGS[5]: (.015, .009, .009, .015)}


@cache
def cases(quick: bool, scratch: str) -> list[TransitionCase]:
    """Return the one case."""
    return [TransitionCase(
        'tm-3', 'where a state is 0.2 s after it was at each of four points',
        'densities (Figure 2), no number', cosine_drift().model, STARTS, 0.2,
        Grid((-1.5,), (1.5,), (600,)), 100, 2_000 if quick else 100_000, SETTINGS,
        expected=expected(REFERENCE, STARTS), remarks=[*SHARED_REMARKS, REMARK])]


REMARK = ("The paper's list of starting points has -0.05 twice; +0.05 is taken for one of them.")


def draw(exhibits: Mapping[str, Densities]) -> dict[str, Figure]:
    """Return the densities at the printed setting, at r = 0, and at the best."""
    return {'transition_densities.png': transition_picture(exhibits['tm-3'], {
        'r = 1/2, one step of 0.2 s, as printed': PRINTED.name,
        'r = 0, one step (Euler)': EULER.name,
        'r = 1/2 with the determinant, 32 steps, by the filter': BEST.name})}
