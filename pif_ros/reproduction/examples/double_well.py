"""A polynomial drift: transition densities of the double well  [TM, Example 2, Fig. 1]."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from matplotlib.figure import Figure
from pif_ros.core.grid import Grid
from pif_ros.core.systems import double_well
from pif_ros.reproduction.pictures import transition_picture
from pif_ros.reproduction.study import Expected
from pif_ros.reproduction.transitions import Densities, l1_from, Setting, TransitionCase

TITLE, SOURCE = 'Transition densities of the double well', 'TM, Example 2'

STARTS = (-0.75, -0.35, -0.05, 0.30, 0.70)
EULER = Setting('', 0.0, 'exponential', 1)
PRINTED = Setting('printed', 0.5, 'exponential', 1)
BEST = Setting('best', 0.5, 'determinant', 32, filtered=True)
SETTINGS = (
    PRINTED, EULER, Setting('', 0.5, 'determinant', 1), Setting('', 0.5, 'exponential', 2),
    Setting('', 0.5, 'determinant', 2), Setting('', 0.5, 'exponential', 4),
    Setting('', 0.5, 'determinant', 4), BEST)

#: L1 distances to the truth that a dense implementation of the formulas gave.
REFERENCE = {
    EULER: (.579, .341, .221, .375, .488), PRINTED: (.067, .033, .023, .031, .062),
    SETTINGS[2]: (.067, .034, .012, .033, .062), SETTINGS[3]: (.018, .009, .010, .008, .017),
    SETTINGS[5]: (.006, .002, .005, .002, .005)}


@cache
def cases(quick: bool, scratch: str) -> list[TransitionCase]:
    """Return the one case."""
    return [TransitionCase(
        'tm-2', 'where a state is 0.1 s after it was at each of five points',
        'densities on top of 100,000 simulations (Figure 1), no number', double_well().model,
        STARTS, 0.1, Grid((-1.2,), (1.2,), (1200,)), 240, 2_000 if quick else 100_000, SETTINGS,
        expected=expected(REFERENCE, STARTS), remarks=REMARKS)]


def expected(reference: Mapping[Setting, tuple[float, ...]],
             starts: tuple[float, ...]) -> list[Expected]:
    """Return what the distances are to be, to the digits that are known."""
    return [Expected(setting.name, l1_from(x), value, 0.002, "a dense implementation's")
            for setting, values in reference.items() for x, value in zip(starts, values)]


REMARKS = [
    'The printed form with r = 1/2 has the factor exp(-eps div f / 2), the expansion of the '
    "step's Jacobian det(1 - eps df/dx / 2); with the determinant the mass is 1.",
    'L1 is the integral of the absolute difference to the Fokker-Planck solution; that to the '
    'simulation has the noise of its histogram in it, which is what the Fokker-Planck solution '
    'has of it.']


def draw(exhibits: Mapping[str, Densities]) -> dict[str, Figure]:
    """Return the densities at the printed setting, at r = 0, and at the best."""
    return {'transition_densities.png': transition_picture(exhibits['tm-2'], {
        'r = 1/2, one step of 0.1 s, as printed': PRINTED.name,
        'r = 0, one step (Euler)': EULER.name,
        'r = 1/2 with the determinant, 32 steps, by the filter': BEST.name})}
