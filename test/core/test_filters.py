"""Predict and correct."""

from dataclasses import replace
import itertools

from hypothesis import given, strategies as st
import numpy as np
from oracles import gaussian, kalman
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import (
    coupled_trigonometric, ornstein_uhlenbeck, position_2d, sine_cubic_drift, wiener)
import pytest
from scipy import stats

SECOND = 1_000_000_000
SEEDS = st.integers(0, 2**32 - 1)

F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
LINEAR = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
H_BOTH, R_BOTH = np.array([[1.0, -0.5], [0.3, 1.0]]), np.array([[0.2, 0.12], [0.12, 0.15]])
H_SUM, R_SUM = np.array([[0.7, 0.7]]), np.array([[0.1]])
LINEAR_SENSORS = {'both': Sensor(lambda x, t: np.tensordot(H_BOTH, x, 1), R_BOTH),
                  'sum': Sensor(lambda x, t: np.tensordot(H_SUM, x, 1), R_SUM)}


def direct(variance=1.0):
    return Sensor(lambda x, t: x, [[variance]])


def track(filter_, belief, measurements):
    """Yield belief and log evidence after each of (nanoseconds since the last, y, sensor)."""
    now = 0
    for gap, y, sensor in measurements:
        belief = filter_.predict(belief, now, now + gap)
        now += gap
        belief, log_evidence = filter_.correct(belief, y, sensor, now)
        yield belief, log_evidence


# Against the Kalman filter


def test_equals_the_kalman_filter_at_irregular_stamps_when_linear_and_gaussian():
    rng = np.random.default_rng(1)
    gaps, ys = rng.integers(3_000_001, 250_000_000, size=40), rng.normal(0, 0.9, size=(40, 1))
    filter_ = DiracFeynmanFilter(ornstein_uhlenbeck().model, Grid((-5,), (5,), (500,)),
                                 {'position': direct(0.25)}, KernelSettings(0.002, tolerance=1e-8))
    exact = kalman(-np.eye(1), np.eye(1), [0.5], [[0.3]], [
        (gap / SECOND, y, np.eye(1), np.eye(1) / 4) for gap, y in zip(gaps, ys)])
    start = GridBelief.gaussian(filter_.grid, [0.5], [[0.3]])
    steps = track(filter_, start, [(int(gap), y, 'position') for gap, y in zip(gaps, ys)])
    for (belief, log_evidence), m, P, log_exact in zip(steps, *exact):
        # the rest of a step adds (eps f)^2 / 4 <= 6e-6 to a variance of 0.2 and so 3e-5 of an
        # innovation below 3 to the mean, of which a few are remembered
        assert belief.mean() == pytest.approx(m, abs=3e-4)
        assert belief.covariance() == pytest.approx(P, abs=1e-4)
        assert log_evidence == pytest.approx(log_exact, abs=1e-3)


@pytest.mark.parametrize('unit, half, cells, step, tolerance', [
    # at whole steps what is left is the second order of the step: (0.025)^2 / 12 and less
    (100_000_000, 4, 128, 0.025, 5e-5),
    # between them the rest of a step adds (eps f)^2 / 4 = 1e-4 to a variance of 0.1, so 1e-3 of
    # an innovation of 2
    (1, 3, 80, 0.02, 3e-3),
])
def test_equals_the_kalman_filter_in_the_plane_with_correlated_noises(
        unit, half, cells, step, tolerance):
    rng = np.random.default_rng(2)
    gaps = rng.integers(10_000_001, 400_000_000, size=12)
    gaps = np.maximum(gaps // unit, 1) * unit
    ys = rng.normal(0, 0.5, size=(12, 2))
    filter_ = DiracFeynmanFilter(LINEAR, Grid((-half,) * 2, (half,) * 2, (cells,) * 2),
                                 LINEAR_SENSORS, KernelSettings(step, tolerance=1e-8))
    P0 = [[0.2, 0.1], [0.1, 0.15]]
    seen = [(int(gap), y, 'both') if k % 2 else (int(gap), y[:1], 'sum')
            for k, (gap, y) in enumerate(zip(gaps, ys))]
    exact = kalman(F, E @ Q @ E.T, [0.5, -0.3], P0, [
        (gap / SECOND, y, *((H_BOTH, R_BOTH) if name == 'both' else (H_SUM, R_SUM)))
        for gap, y, name in seen])
    start = GridBelief.gaussian(filter_.grid, [0.5, -0.3], P0)
    for (belief, log_evidence), m, P, log_exact in zip(track(filter_, start, seen), *exact):
        np.testing.assert_allclose(belief.mean(), m, atol=tolerance)
        np.testing.assert_allclose(belief.covariance(), P, atol=tolerance)
        assert log_evidence == pytest.approx(log_exact, abs=4 * tolerance)


def test_equals_the_exact_filter_where_the_belief_is_two_humps():
    # f = tanh x, y = x + w: the posterior is cosh(x) N(m, P) over its integral, with m and P of
    # the Kalman filter of Brownian motion
    model = StateModel(('x',), lambda x, t: np.tanh(x), np.eye(1))
    filter_ = DiracFeynmanFilter(model, Grid((-15,), (15,), (1500,)), {'far': direct(25.0)},
                                 KernelSettings(0.01, tolerance=1e-8))
    x = filter_.grid.points
    start = np.cosh(x[0]) * gaussian(x, [0.1], [[0.2]])
    belief = GridBelief(filter_.grid, start).normalised()
    ys = [0.5, -1.0, 0.8, 0.2]
    exact = kalman(np.zeros((1, 1)), np.eye(1), [0.1], [[0.2]], [
        (1.0, np.array([y]), np.eye(1), np.array([[25.0]])) for y in ys])
    for (belief, _), m, P, _ in zip(track(filter_, belief, [(SECOND, [y], 'far') for y in ys]),
                                    *exact):
        p = np.cosh(x[0]) * gaussian(x, m, P)
        p /= p.sum() * filter_.grid.cell_volume
        # r = 1/2 leaves 0.0019 in L1 at steps of 1/32, at first order
        assert np.abs(p - belief.density).sum() * filter_.grid.cell_volume < 1e-3
        assert belief.mean()[0] == pytest.approx((m + P @ np.tanh(m))[0], abs=1e-3)
    assert len(belief.modes(0.5)) == 2


# Against brute force


def test_equals_the_sum_over_all_paths_on_five_cells():
    # stamps: 2 steps, then 1.4, then another sensor at the same stamp, then 1
    grid, step = Grid((-2.5,), (2.5,), (5,)), 100_000_000
    model = StateModel(('x',), lambda x, t: -np.sin(x), np.eye(1) * 3)
    filter_ = DiracFeynmanFilter(model, grid, {'square': Sensor(lambda x, t: x**2, [[0.5]]),
                                               'place': direct(0.7)},
                                 KernelSettings(0.1), average_cells=False)
    K = filter_.kernel_at(0).toarray()
    x, prior = grid.axes[0], [0.3, 0.1, 0.2, 0.25, 0.15]
    rest = 0.6 * np.eye(5) + 0.4 * K
    moves = [K, K, K, rest, K]

    def likelihood(y, h, variance):
        return np.exp(-(y - h)**2 / 2 / variance) / np.sqrt(2 * np.pi * variance)

    # after how many moves which measurement is made
    seen = {2: lambda x: likelihood(1.3, x**2, 0.5),
            4: lambda x: likelihood(2.0, x**2, 0.5) * likelihood(-1.1, x, 0.7),
            5: lambda x: likelihood(0.2, x, 0.7)}
    total = np.zeros(5)
    for path in itertools.product(range(5), repeat=6):
        probability = prior[path[0]]
        for k, move in enumerate(moves):
            probability *= move[path[k + 1], path[k]]
            if k + 1 in seen:
                probability *= seen[k + 1](x[path[k + 1]])
        total[path[-1]] += probability
    found = list(track(filter_, GridBelief(grid, np.array(prior)), [
        (2 * step, [1.3], 'square'), (int(1.4 * step), [2.0], 'square'), (0, [-1.1], 'place'),
        (step, [0.2], 'place')]))
    np.testing.assert_allclose(found[-1][0].density, total / total.sum(), rtol=1e-12)
    assert sum(e for _, e in found) == pytest.approx(np.log(total.sum()), rel=1e-12)


def changing(t):
    return np.array([[0.5 + 0.3 * np.sin(t)]])


def test_a_model_and_a_sensor_that_change_with_time_are_asked_at_their_stamps():
    grid = Grid((-4,), (4,), (40,))
    model = StateModel(('x',), lambda x, t: np.cos(t) - x, changing, time_dependent=True)
    sensor = Sensor(lambda x, t: x * t, lambda t: np.array([[1 + t]]), time_dependent=True)
    filter_ = DiracFeynmanFilter(model, grid, {'s': sensor}, KernelSettings(0.25))
    start = GridBelief.gaussian(grid, [0.3], [[0.5]])
    p = start.density
    for t in (7.0, 7.25, 7.5):
        p = dirac_feynman(model, grid, KernelSettings(0.25), t) @ p
    K = dirac_feynman(model, grid, KernelSettings(0.25), 7.75)
    p = 0.6 * p + 0.4 * (K @ p)
    predicted = filter_.predict(start, 7 * SECOND, 7 * SECOND + 850_000_000)
    np.testing.assert_allclose(predicted.density, p, rtol=1e-12)
    likelihood = stats.norm(2.0 * grid.axes[0], np.sqrt(3.0)).pdf(1.5)
    corrected, log_evidence = filter_.correct(start, [1.5], 's', 2 * SECOND)
    weight = start.density * likelihood
    np.testing.assert_allclose(corrected.density, weight / weight.sum() / 0.2, rtol=1e-10)
    assert log_evidence == pytest.approx(np.log(weight.sum() * 0.2), rel=1e-12)


def test_the_kernels_of_a_period_are_made_once():
    asked = []

    def drift(x, t):
        asked.append(t)
        return np.cos(2 * np.pi * t) - x

    model = StateModel(('x',), drift, np.eye(1), time_dependent=True, period=1.0)
    filter_ = DiracFeynmanFilter(model, Grid((-4,), (4,), (40,)), {}, KernelSettings(0.125))
    start = GridBelief.gaussian(filter_.grid, [0.3], [[0.5]])
    first = filter_.predict(start, 7 * SECOND, 8 * SECOND)
    count = len(asked)
    again = filter_.predict(start, 1009 * SECOND, 1010 * SECOND)
    assert again.density.tobytes() == first.density.tobytes()
    assert len(asked) == count > 0
    # without a period it would be made anew, and be the same but for the rounding of t
    never = DiracFeynmanFilter(replace(model, period=0.0), filter_.grid, {}, filter_.kernel)
    np.testing.assert_allclose(never.predict(start, 7 * SECOND, 8 * SECOND).density,
                               first.density, atol=1e-12)
    with pytest.raises(ValueError, match='^period: expected seconds, 0 or more, got -1$'):
        replace(model, period=-1)


def test_a_period_that_is_no_whole_number_of_nanoseconds_does_not_drift_away():
    model = StateModel(('x',), lambda x, t: np.cos(t) - x, np.eye(1), time_dependent=True)
    grid, now = Grid((-4,), (4,), (80,)), 1_700_000_000 * SECOND
    start = GridBelief.gaussian(grid, [0.3], [[0.5]])
    means = [DiracFeynmanFilter(replace(model, period=period), grid, {}, KernelSettings(0.05))
             .predict(start, now, now + SECOND).mean()[0] for period in (0.0, 2 * np.pi)]
    # a double holds 2 pi to 4e-16, which is 1e-7 s after all these periods
    assert means[1] == pytest.approx(means[0], abs=1e-6)


# Predict


OU = DiracFeynmanFilter(ornstein_uhlenbeck().model, Grid((-3,), (3,), (30,)),
                        {'position': direct()}, KernelSettings(0.1))


@given(st.integers(0, 10**9), st.integers(-2**62, 2**62))
def test_whole_steps_are_powers_and_a_rest_is_a_mixture_of_staying_and_a_step(gap, start):
    K = OU.kernel_at(0).toarray()
    p = GridBelief.gaussian(OU.grid, [0.5], [[0.2]])
    steps, a = gap // 10**8, gap % 10**8 / 10**8
    exact = np.linalg.matrix_power(K, steps) @ p.density
    exact = (1 - a) * exact + a * (K @ exact)
    found = OU.predict(p, start, start + gap).density
    np.testing.assert_allclose(found, exact, rtol=1e-12, atol=1e-300)
    assert np.all(found >= 0)


@pytest.mark.parametrize('form', ['tabulated', 'split'])
@pytest.mark.parametrize('step_ns', [1.5, 2.4, 7.7])
def test_a_step_that_is_no_whole_number_of_nanoseconds_goes_as_far_as_its_time(form, step_ns):
    # 1 m/ns, and noise of a cell or so
    model = StateModel(('x',), lambda x, t: 0 * x + 1e9, [[3e4]])
    filter_ = DiracFeynmanFilter(model, Grid((0,), (100,), (200,)), {},
                                 KernelSettings(step_ns * 1e-9, form=form))
    start = filter_.gaussian([20.0], [[4.0]])
    moved = filter_.predict(start, 0, 48)
    # whole steps of 2 and 8 ns; what leaves the grid is less than 1e-6
    assert moved.mean()[0] - start.mean()[0] == pytest.approx(48, abs=1e-3)
    assert (moved.covariance() - start.covariance())[0, 0] == pytest.approx(
        9e8 * 48e-9, rel=0.01)


def test_no_time_changes_nothing_and_time_does_not_run_backwards():
    p = GridBelief.uniform(OU.grid)
    np.testing.assert_array_equal(OU.predict(p, 5, 5).density, p.density)
    with pytest.raises(ValueError, match='^to_ns: expected a stamp from 5 on, got 4$'):
        OU.predict(p, 5, 4)


@given(st.floats(0, 1))
def test_the_rest_of_a_step_keeps_the_mean_and_the_variance_of_a_random_walk(a):
    grid = Grid((-20,), (20,), (400,))
    filter_ = DiracFeynmanFilter(wiener().model, grid, {}, KernelSettings(1.0, tolerance=1e-12))
    p = filter_.predict(GridBelief.gaussian(grid, [0.0], [[0.5]]), 0, round(a * SECOND))
    # the edges are 16 deviations away, and a deviation is 10 cells: only the tails of 1e-12 count
    assert p.mean()[0] == pytest.approx(0, abs=1e-9)
    assert p.covariance()[0, 0] == pytest.approx(0.5 + a, abs=1e-8)


@given(SEEDS)
def test_mass_never_grows_and_density_is_never_negative(seed):
    rng = np.random.default_rng(seed)
    filter_ = DiracFeynmanFilter(
        coupled_trigonometric().model, Grid((-2, -3), (2, 3), (9, 11), (False, bool(seed % 2))),
        {'squares': Sensor(lambda x, t: x**2, np.eye(2))}, KernelSettings(0.05))
    belief = GridBelief.uniform(filter_.grid)
    for _ in range(6):
        before, gap = belief.mass, int(rng.integers(0, SECOND))
        belief = filter_.predict(belief, 0, gap)
        assert 0 < belief.mass <= before * (1 + 1e-12)
        assert np.all(belief.density >= 0)
        belief, _ = filter_.correct(belief, rng.normal(0, 10**rng.uniform(0, 2), size=2),
                                    'squares', 0)
        assert belief.mass == pytest.approx(1, abs=1e-12)
        assert np.all(belief.density >= 0)


def test_on_periodic_axes_mass_is_kept_for_ever():
    model = StateModel(('theta',), lambda x, t: np.full_like(x, 3.0), np.eye(1) * 0.2)
    filter_ = DiracFeynmanFilter(model, Grid((0,), (2 * np.pi,), (36,), (True,)), {},
                                 KernelSettings(0.01))
    belief = filter_.predict(GridBelief.gaussian(filter_.grid, [1.0], [[0.01]]), 0, 10 * SECOND)
    assert belief.mass == pytest.approx(1, abs=1e-10)


@pytest.mark.parametrize('time_step', [1e-4, 1e3])
def test_a_tiny_or_a_huge_time_step_spoils_neither_mass_nor_sign(time_step):
    model = StateModel(('theta',), lambda x, t: np.sin(x), np.eye(1))
    filter_ = DiracFeynmanFilter(model, Grid((0,), (2 * np.pi,), (16,), (True,)), {},
                                 KernelSettings(time_step))
    belief = filter_.predict(GridBelief.gaussian(filter_.grid, [1.0], [[0.3]]), 0, SECOND // 10)
    assert belief.mass == pytest.approx(1, abs=1e-10)
    assert np.all(belief.density >= 0)


# Correct


@given(st.floats(-3, 3))
def test_the_evidence_integrated_over_all_measurements_is_the_mass_before(mean):
    filter_ = DiracFeynmanFilter(wiener().model, Grid((-4,), (4,), (40,)), {'s': direct(0.25)},
                                 KernelSettings(0.5))
    belief = filter_.predict(GridBelief.gaussian(filter_.grid, [mean], [[0.3]]), 0, SECOND)
    y = np.linspace(-9, 9, 361)
    evidence = [np.exp(filter_.correct(belief, [v], 's', 0)[1]) for v in y]
    # a smooth integrand on a lattice of a tenth of its width: no error worth the name
    assert np.sum(evidence) * 0.05 == pytest.approx(belief.mass, rel=1e-9)


@pytest.mark.parametrize('average_cells', [False, True])
@pytest.mark.parametrize('y', [5.0, 20.0, 50.0, -50.0, 500.0])
def test_after_an_outlier_the_belief_is_finite_with_mass_one(y, average_cells):
    filter_ = DiracFeynmanFilter(wiener().model, Grid((-10,), (10,), (100,)), {'s': direct()},
                                 KernelSettings(0.1), average_cells)
    belief = GridBelief.gaussian(filter_.grid, [0.0], [[0.01]])
    for k in range(3):
        belief, log_evidence = filter_.correct(belief, [y], 's', 0)
        assert np.all(np.isfinite(belief.density)) and np.isfinite(log_evidence)
        assert belief.mass == pytest.approx(1, abs=1e-12)
        # at the edge of the grid, where it may be pinned, some of it leaves
        belief = filter_.predict(belief, 0, SECOND)
        assert 0.1 < belief.mass <= 1 + 1e-12
    recovered = belief
    for k in range(50):
        recovered = filter_.predict(filter_.correct(recovered, [0.0], 's', 0)[0], 0, SECOND)
    assert abs(recovered.mean()[0]) < 1


@pytest.mark.parametrize('sigmas', [3, 12, 30, 50])
def test_an_outlier_is_weighed_by_bayes_rule_as_far_as_the_belief_reaches(sigmas):
    # N(0, 1/2) after the first measurement, and y = sigmas of the second: no step between them,
    # so the product of two Gaussians is exact on the grid; down to 1e-250 the belief holds it
    filter_ = DiracFeynmanFilter(wiener().model, Grid((-60,), (60,), (1200,)), {'s': direct()},
                                 KernelSettings(0.1))
    belief, _ = filter_.correct(GridBelief.gaussian(filter_.grid, [0.0], [[1.0]]), [0.0], 's', 0)
    belief, log_evidence = filter_.correct(belief, [float(sigmas)], 's', 0)
    assert log_evidence == pytest.approx(stats.norm(0, np.sqrt(1.5)).logpdf(sigmas), rel=1e-6)
    assert belief.mean()[0] == pytest.approx(sigmas / 3, abs=1e-6)
    assert belief.covariance()[0, 0] == pytest.approx(1 / 3, abs=1e-6)


def test_cells_where_the_sensor_is_undefined_are_excluded_and_the_rest_follows_bayes_rule():
    def root(x, t):
        with np.errstate(invalid='ignore'):
            return np.sqrt(x)

    grid = Grid((-4,), (4,), (80,))
    filter_ = DiracFeynmanFilter(wiener().model, grid, {'root': Sensor(root, [[1.0]])},
                                 KernelSettings(0.1))
    belief, log_evidence = filter_.correct(GridBelief.uniform(grid), [1.2], 'root', 0)
    x = grid.axes[0]
    likelihood = np.where(x > 0, stats.norm(np.sqrt(np.abs(x)), 1).pdf(1.2), 0)
    np.testing.assert_allclose(belief.density, likelihood / likelihood.sum() / 0.1, atol=1e-12)
    assert log_evidence == pytest.approx(np.log(likelihood.sum() / 80), rel=1e-10)


@pytest.mark.parametrize('function, y', [
    (lambda x, t: x, float('nan')),
    (lambda x, t: x, float('inf')),
    (lambda x, t: np.full_like(x, np.nan), 0.0),
])
def test_a_measurement_that_no_cell_allows_leaves_the_belief_and_has_no_evidence(function, y):
    filter_ = DiracFeynmanFilter(wiener().model, Grid((-4,), (4,), (80,)),
                                 {'s': Sensor(function, [[1.0]])}, KernelSettings(0.1))
    before = GridBelief.gaussian(filter_.grid, [0.5], [[1.0]])
    after, log_evidence = filter_.correct(before, [y], 's', 0)
    np.testing.assert_array_equal(after.density, before.density)
    assert log_evidence == -np.inf


def test_verbs_leave_the_belief_they_are_given_alone():
    belief = GridBelief.gaussian(OU.grid, [0.5], [[0.2]])
    before = belief.density.copy()
    OU.predict(belief, 0, 123_456_789)
    OU.correct(belief, [0.3], 'position', 0)
    np.testing.assert_array_equal(belief.density, before)


def test_bearings_on_either_side_of_the_cut_are_close_to_each_other():
    # the landmark stands behind: its bearing is pi for the one and -pi for the other
    sensor = position_2d().sensors['bearing'](landmark=[0.0, 0.0], sigma=0.2)
    filter_ = DiracFeynmanFilter(position_2d().model, Grid((1, -3), (5, 3), (20, 30)),
                                 {'bearing': sensor}, KernelSettings(0.1))
    start = GridBelief.uniform(filter_.grid)
    high, low = (filter_.correct(start, [angle], 'bearing', 0)[0]
                 for angle in (np.pi - 0.01, -np.pi - 0.01))
    np.testing.assert_allclose(high.density, low.density, rtol=1e-9, atol=1e-12)
    mirrored = filter_.correct(start, [-np.pi + 0.01], 'bearing', 0)[0].density[:, ::-1]
    np.testing.assert_allclose(high.density, mirrored, rtol=1e-9, atol=1e-12)
    assert abs(high.mean()[1]) < 0.2


def test_remarks_name_the_sensor_that_the_grid_does_not_resolve():
    sensors = {'coarse': direct(100.0), 'fine': direct(1e-4)}
    filter_ = DiracFeynmanFilter(wiener().model, Grid((-4,), (4,), (80,)), sensors,
                                 KernelSettings(0.1))
    [remark] = filter_.remarks()
    assert "'fine'" in remark and '10.0' in remark and '100%' in remark


# [TM, Example 4]


def test_averaging_over_cells_makes_a_coarse_grid_as_honest_as_a_fine_one():
    # the papers' cell of 0.25 is many times the width of y = x^2 + w where |x| is large
    system = sine_cubic_drift()
    sensors = {'square': system.sensors['square']()}
    box = ((-20,), (20,))
    grids = {'centres': (Grid(*box, (160,)), KernelSettings(0.01), False),
             'averages': (Grid(*box, (160,)), KernelSettings(0.01), True),
             'reference': (Grid(*box, (1600,)), KernelSettings(0.0025, r=0), False)}
    filters = {name: DiracFeynmanFilter(system.model, grid, sensors, kernel, average)
               for name, (grid, kernel, average) in grids.items()}
    inside = {name: [] for name in filters}
    for seed in range(6):
        rng = np.random.default_rng(seed)
        x, truth, ys = rng.normal(), [], []
        for _ in range(400):
            for noise in rng.normal(size=20) * 3 * np.sqrt(0.0005):
                x += -np.sin(x * (x**2 - 1)) * 0.0005 + noise
            truth.append(abs(x))
            ys.append((10_000_000, [x**2 + rng.normal()], 'square'))
        for name, filter_ in filters.items():
            distance = np.abs(filter_.grid.axes[0])
            start = GridBelief.gaussian(filter_.grid, [0.0], [[1.0]])
            for actual, (belief, _) in zip(truth, track(filter_, start, ys)):
                weight = belief.density * filter_.grid.cell_volume
                mean = weight @ distance
                spread = np.sqrt(weight @ (distance - mean)**2)
                inside[name].append(abs(actual - mean) <= 2 * spread)
    share = {name: np.mean(values) for name, values in inside.items()}
    assert abs(share['averages'] - share['reference']) < 0.02
    assert share['reference'] - share['centres'] > 0.05


# Refusals


@pytest.mark.parametrize('model, axes', [(wiener().model, 2), (position_2d().model, 1),
                                         (position_2d().model, 3)])
def test_refuses_a_grid_that_has_not_one_axis_for_each_state(model, axes):
    grid = Grid((0,) * axes, (4,) * axes, (4,) * axes)
    with pytest.raises(ValueError, match='expected .* got'):
        DiracFeynmanFilter(model, grid, {}, KernelSettings(1.0)).predict(
            GridBelief.uniform(grid), 0, SECOND)
