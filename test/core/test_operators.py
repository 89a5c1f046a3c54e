"""What saves a filter work, and what it costs in accuracy  [Sensors, section 4.3]."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, kernel_of, KernelSettings, OperatorSettings
from pif_ros.core.models import StateModel
from pif_ros.core.scoring import l1_distance
from pif_ros.core.systems import coupled_trigonometric, multiplicative_4d, sine_cubic_drift
import pytest

STEP = 10_000_000
SYSTEM = coupled_trigonometric()
GRID = Grid((-6.0, -6.0), (6.0, 6.0), (62, 62))
PLAIN = DiracFeynmanFilter(SYSTEM.model, GRID, {'main': SYSTEM.sensors['squares']()},
                           KernelSettings(0.01))
PRIOR = PLAIN.gaussian([1.0, -1.0], np.eye(2))


def with_(**how):
    return replace(PLAIN, operator=OperatorSettings(**how))


def tracked(filter_, belief=PRIOR, seed=5, measurements=20):
    """Return the belief and the log evidence after measurements of a still state, 0.05 s apart."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for k in range(measurements):
        belief = filter_.predict(belief, 5 * k * STEP, 5 * (k + 1) * STEP)
        belief, log_evidence = filter_.correct(
            belief, np.array([1.44, 0.64]) + rng.standard_normal(2), 'main', 5 * (k + 1) * STEP)
        total += log_evidence
    return belief, total


# Correction where the prediction is significant

def test_correcting_significant_cells_alone_changes_the_belief_by_what_the_others_held():
    whole, evidence = tracked(PLAIN)
    for share, most in ((1e-9, 1e-6), (1e-6, 1e-3), (1e-3, 0.1)):
        found, found_evidence = tracked(replace(PLAIN, significance=share))
        assert 0 < l1_distance(found, whole) < most
        assert abs(found_evidence - evidence) < 20 * most
        assert abs(found.mass - 1) < 1e-9
    assert np.count_nonzero(found.density) < 0.2 * GRID.size


def test_a_single_correction_by_significance_is_bayes_rule_on_these_cells():
    filter_ = replace(PLAIN, significance=1e-2)
    found, log_evidence = filter_.correct(PRIOR, [1.0, 1.0], 'main', 0)
    p = np.where(PRIOR.density > 1e-2 * PRIOR.density.max(), PRIOR.density, 0.0).ravel()
    x = GRID.points
    joint = p * np.exp(-((1 - x[0]**2)**2 + (1 - x[1]**2)**2) / 2) / (2 * np.pi)
    assert_allclose(found.density.ravel(), joint / joint.sum() / GRID.cell_volume, atol=1e-12)
    assert log_evidence == pytest.approx(np.log(joint.sum() * GRID.cell_volume), abs=1e-12)


def test_an_outlier_among_significant_cells_leaves_a_density():
    filter_ = replace(PLAIN, significance=1e-3)
    found, log_evidence = filter_.correct(PRIOR, [5000.0, -5000.0], 'main', 0)
    assert np.all(np.isfinite(found.density)) and abs(found.mass - 1) < 1e-9
    assert -np.inf < log_evidence < -1e6


def test_narrow_sensors_are_averaged_over_significant_cells_as_over_all():
    system = sine_cubic_drift(sigma_y=0.3)
    coarse = DiracFeynmanFilter(system.model, Grid((-10.0,), (10.0,), (80,)),
                                {'main': system.sensors['square']()}, KernelSettings(0.01))
    prior = coarse.gaussian([3.0], [[1.0]])
    whole, _ = coarse.correct(prior, [9.3], 'main', 0)
    some, _ = replace(coarse, significance=1e-12).correct(prior, [9.3], 'main', 0)
    assert l1_distance(whole, some) < 1e-9
    raw, _ = replace(coarse, average_cells=False).correct(prior, [9.3], 'main', 0)
    assert l1_distance(whole, raw) > 0.05


# Steps composed into one operator

@pytest.mark.parametrize('steps', [2, 5])
def test_composed_steps_predict_what_single_steps_do(steps):
    composed = with_(steps=steps)
    assert composed.time_step_ns == steps * STEP
    for count in (steps, 2 * steps, 2 * steps + 1):
        # each operator leaves out at most the kernel's own tolerance
        assert l1_distance(composed.predict(PRIOR, 0, count * STEP),
                           PLAIN.predict(PRIOR, 0, count * STEP)) < 1e-5 * (count // steps) + 1e-12
    rest = 2 * steps * STEP + STEP // 3
    assert l1_distance(composed.predict(PRIOR, 0, rest), PLAIN.predict(PRIOR, 0, rest)) < 3e-5


def test_whole_composed_steps_may_be_taken_in_any_number_of_calls():
    composed = with_(steps=4)
    at_once = composed.predict(PRIOR, 0, 12 * STEP)
    belief = PRIOR
    for k in range(3):
        belief = composed.predict(belief, 4 * k * STEP, 4 * (k + 1) * STEP)
    assert belief.density.tobytes() == at_once.density.tobytes()


# A kernel kept in a file

def test_a_kernel_is_made_once_and_serves_another_sensor_and_another_run(tmp_path):
    how = OperatorSettings(file=str(tmp_path / 'kernel'))
    system = multiplicative_4d()
    grid = Grid((-20.0,) * 4, (20.0,) * 4, (5,) * 4)
    first, second = (DiracFeynmanFilter(
        system.model, grid, {'main': system.sensors[name]()}, KernelSettings(0.1), operator=how)
        for name in ('trigonometric', 'inverse_trigonometric'))
    made = first.kernel_at(0)
    stamp = (tmp_path / 'kernel').stat().st_mtime_ns
    loaded = second.kernel_at(0)
    assert loaded.data.tobytes() == made.data.tobytes()
    assert (tmp_path / 'kernel').stat().st_mtime_ns == stamp
    assert np.array_equal(made.data, dirac_feynman(system.model, grid, KernelSettings(0.1)).data)


def test_a_kernel_of_another_model_or_grid_or_step_is_refused_and_left_alone(tmp_path):
    how = OperatorSettings(file=str(tmp_path / 'kernel'))
    settings = KernelSettings(0.01)
    small = Grid((-6.0, -6.0), (6.0, 6.0), (20, 20))
    kernel_of(SYSTEM.model, small, settings, how)
    before = (tmp_path / 'kernel').read_bytes()
    for model, grid, other in (
            (coupled_trigonometric(sigma_x=1.1).model, small, settings),
            (SYSTEM.model, Grid((-6.0, -6.0), (6.0, 6.1), (20, 20)), settings),
            (SYSTEM.model, small, KernelSettings(0.02))):
        with pytest.raises(ValueError, match=str(how.file)):
            kernel_of(model, grid, other, how)
    assert (tmp_path / 'kernel').read_bytes() == before


# A kernel in a wavelet basis

def test_a_filter_in_a_wavelet_basis_tracks_as_in_the_cells():
    whole, evidence = tracked(PLAIN, measurements=6)
    errors = []
    for threshold in (1e-3, 1e-4, 1e-6):
        filter_ = with_(steps=5, wavelet='sym8', threshold=threshold)
        found, found_evidence = tracked(filter_, measurements=6)
        errors.append(l1_distance(found, whole))
        assert abs(found.mass - 1) < 1e-9 and found.density.min() >= 0
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-3 and abs(found_evidence - evidence) < 1e-3
    assert 'of 5 steps' in filter_.describe() and 'in the basis sym8' in filter_.describe()


# What cannot be

@pytest.mark.parametrize(
    'wrong', [{'steps': 0}, {'steps': 1001}, {'level': 0}, {'threshold': 1.0}])
def test_what_makes_no_operator_is_refused_by_name(wrong):
    [name] = wrong
    with pytest.raises(ValueError, match=f'^{name}: expected .*, got {wrong[name]}$'):
        OperatorSettings(**wrong)


def test_strategies_that_need_one_kernel_are_refused_for_a_model_that_changes_with_time():
    model = StateModel(('x',), lambda x, t: -t * x, np.eye(1), time_dependent=True)
    with pytest.raises(ValueError, match='^operator: expected none of steps, file and wavelet'):
        DiracFeynmanFilter(model, Grid((-1.0,), (1.0,), (50,)), {}, KernelSettings(0.01),
                           operator=OperatorSettings(steps=2))


def test_a_share_of_all_or_more_is_no_significance():
    with pytest.raises(ValueError, match='^significance: expected a share, 0 to below 1, got 1$'):
        replace(PLAIN, significance=1)
