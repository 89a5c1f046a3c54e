"""Which form of a kernel is taken, what is said of it, and the longer steps across gaps."""

from dataclasses import replace

import numpy as np
from oracles import gaussian, linear_moments
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import (chosen_form, KernelSettings, OperatorSettings, split_kernel,
                                  SplitKernel, stored_weights)
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.scoring import l1_distance
from pif_ros.core.smoothing import smooth
from pif_ros.core.systems import (coupled_trigonometric, cubic_bearing, geometric_brownian_motion,
                                  ornstein_uhlenbeck, position_2d)
from pif_ros.core.tracker import Tracker
import pytest

STEP = 10_000_000
SYSTEM = coupled_trigonometric()
GRID = Grid((-6.0, -6.0), (6.0, 6.0), (62, 62))
AUTO = KernelSettings(0.01, form='auto')
SPLIT = KernelSettings(0.01, form='split')
SENSORS = {'main': SYSTEM.sensors['squares']()}


def filter_(settings=SPLIT, model=SYSTEM.model, grid=GRID, **more):
    return DiracFeynmanFilter(model, grid, SENSORS, settings, **more)


def form(settings=AUTO, model=SYSTEM.model, grid=GRID, how=OperatorSettings()):
    return chosen_form(model, grid, settings, how)


def still(e):
    return StateModel(tuple('abc'[:len(e)]), lambda x, t: np.zeros_like(x), np.array(e))


# Which form

def test_a_kernel_is_split_where_its_noise_is_half_a_cell_and_tabulated_otherwise():
    assert form() == 'split'
    assert form(grid=Grid((-6.0,) * 2, (6.0,) * 2, (59, 62))) == 'tabulated'
    assert form(KernelSettings(0.01)) == 'tabulated'
    assert form(SPLIT, grid=Grid((-6.0,) * 2, (6.0,) * 2, (30, 30))) == 'split'
    assert form(model=cubic_bearing().model) == 'tabulated'
    # without drift nothing spreads, however little noise there is
    assert form(model=position_2d(diffusion=0.1).model) == 'split'


TURNING = StateModel(('a', 'b'), lambda x, t: 2 * np.stack([-x[1], x[0]]), np.eye(2))


def errors(model, step, start, exact):
    """Return how far both forms are off after ten steps, in L1."""
    return [np.abs(filter_(KernelSettings(step, form=form), model).predict(
        start, 0, round(10e9 * step)).density.ravel() - exact).sum() * GRID.cell_volume
        for form in ('split', 'tabulated')]


def test_a_kernel_is_split_where_it_is_nearer_and_tabulated_where_the_order_of_axes_matters():
    start = filter_().gaussian([2.0, 0.0], np.eye(2) / 2)
    transition, noise = linear_moments(np.array([[0.0, -2.0], [2.0, 0.0]]), np.eye(2), 1.0)
    exact = gaussian(GRID.points, transition @ [2.0, 0.0],
                     transition @ transition.T / 2 + noise)
    split, tabulated = errors(TURNING, 0.1, start, exact)
    assert split > 2 * tabulated and form(replace(AUTO, time_step=0.1), TURNING) == 'tabulated'
    # every third centre of a finer grid is one of this; steps of a quarter are good to 2e-5
    finer = filter_(replace(SPLIT, time_step=0.005), grid=Grid(GRID.lower, GRID.upper, (186,) * 2))
    exact = finer.predict(finer.gaussian([2.0, 0.0], np.eye(2) / 2), 0, 20 * STEP)
    split, tabulated = errors(SYSTEM.model, 0.02, start, exact.density[1::3, 1::3].ravel())
    assert split < tabulated / 2 and form(replace(AUTO, time_step=0.02)) == 'split'


def test_a_step_in_which_the_order_of_axes_matters_is_warned_of_with_a_remedy_that_holds():
    def remarks(step):
        return [said for said in filter_(KernelSettings(step, form='split'), TURNING).remarks()
                if 'order' in said]

    [remark] = remarks(0.1)
    assert remark.startswith('kernel.time_step: the order of the axes changes the density by 0.')
    assert not remarks(float(remark.split('take steps of ')[1].split(' s')[0]))


def test_a_drift_that_is_not_finite_is_left_to_the_tabulated_kernel_to_refuse():
    assert form(model=StateModel(('a', 'b'), lambda x, t: np.full_like(x, np.nan),
                                 np.eye(2))) == 'tabulated'


@pytest.mark.parametrize('settings', [
    {'r': 0.0}, {'jacobian': 'exponential'}, {'extent': 2}, {'weights': 'sampled'},
    {'noise_inflation': 1.0}])
def test_what_only_a_tabulated_kernel_has_makes_it_tabulated_and_refuses_a_split_one(settings):
    assert form(replace(AUTO, **settings)) == 'tabulated'
    [(name, value)] = settings.items()
    with pytest.raises(ValueError, match=f"^form: expected 'auto' or 'tabulated' with {name} = "
                                         f"{value!r}, got 'split'$"):
        form(replace(SPLIT, **settings))


@pytest.mark.parametrize('how', [{'steps': 2}, {'file': 'kernel'}, {'wavelet': 'sym8'}])
def test_so_does_an_operator_that_is_made_of_a_tabulated_kernel(how):
    assert form(how=OperatorSettings(**how)) == 'tabulated'
    with pytest.raises(ValueError, match=f'^form: .* with {next(iter(how))} = '):
        form(SPLIT, how=OperatorSettings(**how))


def test_multiplicative_noise_is_tabulated():
    model, grid = geometric_brownian_motion().model, Grid((0.1,), (5.0,), (100,))
    assert form(model=model, grid=grid) == 'tabulated'
    with pytest.raises(ValueError, match='^form: .* where the noise is multiplicative, got'):
        form(SPLIT, model, grid)


def test_correlated_noise_is_split_as_far_as_each_axis_has_noise_of_its_own():
    weak, strong = still([[1.0, 0.0], [0.3, 0.9]]), still([[1.0, 0.0], [0.97, 0.2]])
    grid = Grid((-5.0,) * 2, (5.0,) * 2, (70, 70))
    assert form(model=weak, grid=grid) == 'split'
    assert len(filter_(AUTO, weak, grid).kernel_at(0).factors) == 3
    assert form(model=strong, grid=grid) == 'tabulated'
    with pytest.raises(ValueError, match="^form: .* where the correlation leaves axis '[ab]' "
                                         r'noise of 0\S* cells per step of its own \(0.5 want'):
        form(SPLIT, strong, grid)
    changing = replace(weak, vielbein=lambda t: np.array([[1.0, 0.0], [0.3, 0.9]]))
    assert form(model=changing, grid=grid) == 'tabulated'


@pytest.mark.parametrize('asked', [AUTO, SPLIT])
def test_where_noise_comes_to_be_correlated_a_split_kernel_gives_way_to_a_tabulated_one(asked):
    def noise(t):
        share = 0.0 if t < 1 else 0.4
        return 2.5 * (share + (1 - share) * np.eye(4))

    model = StateModel(tuple('abcd'), lambda x, t: 0 * x, np.eye(4), noise)
    grid = Grid((-3.5,) * 4, (3.5,) * 4, (7,) * 4)
    made = filter_(replace(asked, time_step=0.2), model, grid)
    assert made.form == 'split'
    p = np.zeros(grid.shape)
    p[3, 3, 3, 3] = 1.0
    for t in (0, 2):
        belief = made.predict(GridBelief(grid, p), int(t * 1e9), int((t + 0.2) * 1e9))
        assert isinstance(made.kernel_at(int(t * 1e9)), SplitKernel) == (t == 0)
        # cut at five standard deviations
        np.testing.assert_allclose(belief.covariance(), 0.2 * noise(t), atol=2e-3)


def test_the_number_of_weights_is_known_beforehand():
    for model, grid, settings in (
            (SYSTEM.model, GRID, AUTO), (SYSTEM.model, GRID, replace(AUTO, time_step=0.05)),
            (still([[1.0, 0.0], [0.3, 0.9]]), GRID, replace(AUTO, time_step=0.05))):
        made = filter_(settings, model, grid).kernel_at(0)
        assert isinstance(made, SplitKernel)
        # less what leaves the grid; a chunk with the widest noise may take a node more
        assert made.nnz == pytest.approx(stored_weights(model, grid, settings, 'split'), rel=0.15)


# What is said of a step

def test_too_little_noise_for_the_cells_is_named_with_a_remedy_that_holds():
    coarse = Grid((-6.0,) * 2, (6.0,) * 2, (62, 25))
    [remark] = filter_(grid=coarse, average_cells=False).remarks()[:1]
    assert remark == (
        "kernel.time_step: the noise moves 0.21 cells per step on axis 'x2' (0.5 wanted), so that "
        'drift between two cells spreads by itself; take steps of 0.058 s or more, or cells of '
        '0.2 or less')
    for better in (filter_(replace(SPLIT, time_step=0.058), grid=coarse),
                   filter_(grid=Grid((-6.0,) * 2, (6.0,) * 2, (62, 60)))):
        assert not [said for said in better.remarks() if said.startswith('kernel')]


def test_no_noise_at_all_is_named_and_a_state_that_does_not_drift_needs_none():
    model = StateModel(('x', 'v'), lambda x, t: np.stack([x[1], 0 * x[1]]), np.diag([0.0, 0.1]))
    remarks = filter_(model=model).remarks()
    assert [said[:59] for said in remarks if said.startswith('kernel')] == [
        "kernel.time_step: there is no noise on axis 'x' (0.5 cells "]
    still_ = DiracFeynmanFilter(position_2d(diffusion=0.1).model, GRID, {}, SPLIT)
    assert still_.remarks() == []


def test_the_description_says_how_the_kernel_is_stored():
    said = filter_().describe()
    assert said.startswith('Dirac-Feynman filter on 62 x 62 cells, a kernel split by axis, of ')
    assert 'split' not in filter_(KernelSettings(0.01)).describe()


# The filter

def test_the_filter_turns_the_order_by_the_stamp_alone():
    K, belief = split_kernel(SYSTEM.model, GRID, SPLIT), filter_().gaussian([1, 0], np.eye(2))
    for start in (0, 3 * STEP, 5 * STEP // 2):
        p = belief.density.ravel()
        for k in range(5):
            p = (K.turned if (start // STEP + k) % 2 else K) @ p
        found = filter_().predict(belief, start, start + 5 * STEP)
        assert found.density.tobytes() == p.tobytes()


def test_a_kernel_that_changes_with_time_is_taken_in_the_middle_of_its_step_and_turned():
    model = StateModel(('a', 'b'), lambda x, t: np.stack([np.sin(9 * t) - x[1], x[0]]),
                       np.eye(2), time_dependent=True)
    moving = filter_(model=model)
    belief = moving.gaussian([0.5, 0.0], np.eye(2) / 2)
    p = belief.density.ravel()
    for k in range(3):
        K = split_kernel(model, GRID, SPLIT, k * 0.01)
        p = (K.turned if k % 2 else K) @ p
    assert moving.predict(belief, 0, 3 * STEP).density.tobytes() == p.tobytes()
    # dm/dt = F m + (sin 9 t, 0), by small steps
    mean, steps = np.array([0.5, 0.0]), 3000
    for k in range(steps):
        t = (k + 0.5) * 0.3 / steps
        mean = mean + 0.3 / steps * np.array([np.sin(9 * t) - mean[1], mean[0]])
    # of second order: 30 steps of (9 * .01)^2 / 24 * .01 and of the order of the factors
    found = moving.predict(belief, 0, 30 * STEP).mean()
    np.testing.assert_allclose(found, mean, atol=3e-4)


def test_mass_is_kept_and_a_density_stays_positive_in_part_of_a_step_too():
    belief = filter_().gaussian([0, 0], np.eye(2) / 4)
    for nanoseconds in (STEP // 3, 5 * STEP // 2, 40 * STEP + 1):
        moved = filter_().predict(belief, 0, nanoseconds)
        assert moved.density.min() >= 0 and moved.mass == pytest.approx(1, abs=1e-9)


# Longer steps across gaps

MACRO = replace(SPLIT, macro_error=2e-3)


def test_a_longer_step_is_taken_for_two_as_long_as_it_differs_by_no_more_than_the_error():
    fine = Grid((-6.0,) * 2, (6.0,) * 2, (100, 100))
    start = filter_(grid=fine).gaussian([1.0, -1.0], np.eye(2))
    lengths = []
    for error in (1e-9, 1e-3, 2e-3, 5e-3):
        macro = filter_(replace(SPLIT, macro_error=error), grid=fine)
        lengths.append(macro.time_step_ns // STEP)
        # one rung's error, and those of the rungs below, each time a quarter and less
        assert l1_distance(macro.predict(start, 0, macro.time_step_ns), filter_(
            grid=fine).predict(start, 0, macro.time_step_ns)) <= 2 * error
    assert lengths == sorted(set(lengths)) and lengths[0] == 1 and lengths[-1] >= 8
    assert filter_().time_step_ns == STEP


def test_a_gap_is_crossed_with_the_longest_steps_first_and_nearly_the_same_result():
    plain, macro = filter_(), filter_(MACRO)
    count = macro.time_step_ns // STEP
    gap = (3 * count + count // 2 + 1) * STEP + STEP // 4
    steps = list(macro.steps(STEP, STEP + gap))
    assert [share for *_, share in steps] == [1, 1, 1, 1, 1, 0.25]
    assert [(stamp - STEP) // STEP for stamp, *_ in steps] == [
        k * count for k in range(4)] + [3 * count + count // 2, 3 * count + count // 2 + 1]
    belief = plain.gaussian([1.0, -1.0], np.eye(2))
    # an error each for four long steps, and as much again for those below them
    assert 0 < l1_distance(macro.predict(belief, STEP, STEP + gap),
                           plain.predict(belief, STEP, STEP + gap)) < 8 * MACRO.macro_error


def test_whole_longest_steps_may_be_taken_in_any_number_of_calls():
    macro = filter_(MACRO)
    belief, step = macro.gaussian([1.0, -1.0], np.eye(2)), macro.time_step_ns
    for start in (0, 7 * STEP, STEP // 3):
        at_once, piecemeal = macro.predict(belief, start, start + 5 * step), belief
        for k in range(5):
            piecemeal = macro.predict(piecemeal, start + k * step, start + (k + 1) * step)
        assert at_once.density.tobytes() == piecemeal.density.tobytes()


def test_forecasts_leave_no_trace_in_what_the_tracker_believes():
    def believed(forecasts):
        tracker = Tracker(filter_(MACRO), filter_().gaussian([1.0, -1.0], np.eye(2)))
        for k, y in enumerate(([1.0, 1.2], [0.8, 1.1], [1.3, 0.9])):
            tracker.observe(Measurement(k * 33 * STEP // 2, 'main', tuple(y)))
            tracker.estimate()
            for later in forecasts:
                tracker.forecast(k * 33 * STEP // 2 + later * STEP)
        return tracker.estimate().belief.density.tobytes()

    assert believed([]) == believed([1, 7, 8, 12, 16])


@pytest.mark.parametrize('macro_error, longest', [(0.0, 2), (0.05, 32)])
def test_smoothing_is_bayes_rule_over_the_steps_that_prediction_takes(macro_error, longest):
    grid = Grid((-4.0,) * 2, (4.0,) * 2, (20, 20))
    smoothed_by = filter_(KernelSettings(0.02, form='split', macro_error=macro_error), grid=grid,
                          average_cells=False)
    assert smoothed_by.time_step_ns == longest * STEP
    prior, end, y = smoothed_by.gaussian([1.0, 0.0], np.eye(2) / 2), 47 * STEP, (1.2, 0.9)
    found = smooth(smoothed_by, prior, [(end, 'main', y)], start_ns=0)
    whole = np.stack([smoothed_by.predict(GridBelief(grid, one.reshape(grid.shape)), 0,
                                          end).density.ravel() for one in np.eye(grid.size)])
    likelihood = gaussian(grid.points**2, y, np.eye(2))
    exact = prior.density.ravel() * (whole @ likelihood)
    np.testing.assert_allclose(found.beliefs[0].density.ravel(),
                               exact / exact.sum() / grid.cell_volume, rtol=1e-9)


@pytest.mark.parametrize('wrong', [
    {'model': replace(SYSTEM.model, time_dependent=True)},
    {'operator': OperatorSettings(steps=2)}])
def test_longer_steps_are_refused_where_they_cannot_be(wrong):
    with pytest.raises(ValueError, match='^macro_error: expected 0 where .*, got 0.002$'):
        filter_(replace(MACRO, form='auto'), **wrong)


@pytest.mark.parametrize('wrong', [{'form': 'spilt'}, {'macro_error': 1.0}, {'macro_error': -1}])
def test_settings_that_make_no_kernel_are_refused_by_name(wrong):
    [name] = wrong
    with pytest.raises(ValueError, match=f'^{name}: expected .*, got {wrong[name]!r}$'):
        replace(SPLIT, **wrong)


def test_a_tabulated_kernel_takes_longer_steps_too():
    plain = filter_(KernelSettings(0.01), ornstein_uhlenbeck().model, Grid((-5.0,), (5.0,), (90,)))
    table = replace(plain, kernel=KernelSettings(0.01, macro_error=2e-3))
    assert table.form == 'tabulated' and table.time_step_ns > STEP
    belief = table.gaussian([1.0], [[0.5]])
    assert 0 < l1_distance(table.predict(belief, 0, table.time_step_ns),
                           plain.predict(belief, 0, table.time_step_ns)) < 4e-3


def test_a_sensor_of_the_model_is_all_that_the_filter_needs_besides():
    # predict and correct together, against Bayes' rule on the cells
    one = DiracFeynmanFilter(SYSTEM.model, GRID, {'main': Sensor(lambda x, t: x[:1], [[0.5]])},
                             SPLIT)
    belief = one.gaussian([1.0, -1.0], np.eye(2))
    moved = one.predict(belief, 0, 4 * STEP)
    found, log_evidence = one.correct(moved, [0.4], 'main', 4 * STEP)
    joint = moved.density.ravel() * gaussian(GRID.points[:1], [0.4], [[0.5]])
    np.testing.assert_allclose(found.density.ravel(), joint / joint.sum() / GRID.cell_volume,
                               atol=1e-12)
    assert log_evidence == pytest.approx(np.log(joint.sum() * GRID.cell_volume), abs=1e-9)
