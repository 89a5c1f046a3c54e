"""Transition densities are scored as they should be."""

from pif_ros.core.grid import Grid
from pif_ros.core.systems import double_well
from pif_ros.reproduction.examples import cosine_drift, wiener
from pif_ros.reproduction.examples.double_well import BEST, EULER, PRINTED, SETTINGS, STARTS
from pif_ros.reproduction.transitions import L1, l1_from, MASS, Setting, SIMULATION, TransitionCase
import pytest

FILTERED_EULER = Setting('', 0.0, 'exponential', 1, filtered=True)
CASE = TransitionCase('small', '', '', double_well().model, STARTS, 0.1,
                      Grid((-1.2,), (1.2,), (600,)), 120, 5_000, (*SETTINGS, FILTERED_EULER))


@pytest.fixture(scope='module')
def scores():
    return CASE.run(0, False).scores


def test_a_second_order_formula_is_far_better_than_eulers(scores):
    for x in STARTS:
        assert scores[PRINTED.name][l1_from(x)] < 0.2 * scores[EULER.name][l1_from(x)]
    # distances that a dense implementation of the formulas gave, to their digits
    assert [scores[EULER.name][l1_from(x)] for x in STARTS] == pytest.approx(
        [.579, .341, .221, .375, .488], abs=2e-3)
    assert [scores[PRINTED.name][l1_from(x)] for x in STARTS] == pytest.approx(
        [.067, .033, .023, .031, .062], abs=2e-3)


def test_only_the_printed_form_makes_mass(scores):
    exponential, determinant = SETTINGS[0], SETTINGS[2]
    assert scores[exponential.name][MASS] == pytest.approx(1.023, abs=2e-3)
    assert scores[determinant.name][MASS] == pytest.approx(1.0, abs=1e-3)


def test_more_steps_are_better_and_the_filter_is_the_formula(scores):
    errors = [scores[name][L1] for name in (SETTINGS[2].name, SETTINGS[4].name, SETTINGS[6].name,
                                            BEST.name)]
    assert errors == sorted(errors, reverse=True)
    # for r = 0 both are the same Gaussian, but for the filter's start, shared by two cells
    assert scores[FILTERED_EULER.name][L1] == pytest.approx(scores[EULER.name][L1], abs=5e-3)


def test_simulation_differs_from_the_truth_by_its_noise_alone(scores):
    # 5000 paths in about 12 cells of their own: 0.8 sqrt(12 / 5000) is 0.04
    assert 0.02 < scores['Fokker-Planck equation'][SIMULATION] < 0.06
    assert scores['Fokker-Planck equation'][L1] == 0.0


def test_one_step_of_brownian_motion_is_exact():
    [case] = wiener.cases(True, '')
    scores = case.run(0, False).scores
    for setting in wiener.SETTINGS[:3]:
        assert scores[setting.name][L1] < 1e-8
    assert scores[wiener.BEST.name][L1] < 1e-3


def test_every_picture_of_densities_can_be_drawn(tmp_path):
    exhibits = {'tm-3': cosine_drift.cases(True, '')[0].run(0, True).exhibit}
    for name, figure in cosine_drift.draw(exhibits).items():
        figure.savefig(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 10_000
