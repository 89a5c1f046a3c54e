"""What the filters that keep a mean and a covariance have in common, and the extended one."""

import warnings

from hypothesis import given, strategies as st
import numpy as np
from oracles import gaussian, kalman
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, GaussianBelief, UnscentedKalmanFilter
from pif_ros.core.systems import (
    bearing_sensor, benes, coupled_trigonometric, position_2d, range_sensor, wiener)
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

SECOND = 1_000_000_000
F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
LINEAR = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
H, R = np.array([[1.0, -0.5], [0.3, 1.0]]), np.array([[0.2, 0.12], [0.12, 0.15]])
SENSORS = {'both': Sensor(lambda x, t: np.tensordot(H, x, 1), R)}
START = GaussianBelief(np.array([0.5, -0.3]), np.array([[0.2, 0.1], [0.1, 0.15]]))
BOTH = pytest.mark.parametrize('kind', [ExtendedKalmanFilter, UnscentedKalmanFilter])
#: Ito's dx = mu x dt + sigma x dv, told in a sense s, where mu is larger by s sigma^2.
MU, SIGMA = -0.4, 0.5


def geometric(s=0.0):
    return StateModel(('x',), lambda x, t: (MU - s * SIGMA**2) * x,
                      lambda x, t: SIGMA * x[None], multiplicative=True, s=s)


def direct(variance=1.0):
    return Sensor(lambda x, t: x, [[variance]])


def errors(kind, time_step):
    """Return the largest errors against the Kalman filter over a track with irregular stamps."""
    rng = np.random.default_rng(6)
    gaps, ys = rng.integers(1, 900_000_000, size=20), rng.normal(size=(20, 2))
    filter_ = kind(LINEAR, SENSORS, time_step)
    exact = kalman(F, E @ Q @ E.T, START.mean(), START.covariance(), [
        (gap / SECOND, y, H, R) for gap, y in zip(gaps, ys)])
    belief, now, worst = START, 0, np.zeros(3)
    for gap, y, m, P, log_exact in zip(gaps.tolist(), ys, *exact):
        belief = filter_.predict(belief, now, now + gap)
        now += gap
        belief, log_evidence = filter_.correct(belief, y, 'both', now)
        worst = np.maximum(worst, [np.abs(belief.mean() - m).max(),
                                   np.abs(belief.covariance() - P).max(),
                                   abs(log_evidence - log_exact)])
    return worst


# Against the Kalman filter and differential equations


@pytest.mark.parametrize('kind, time_step, tolerance', [
    # Runge-Kutta of order 4: (0.02)^5 / 120 per step; the central differences of a linear model
    # are exact but for rounding, 1e-16 / 6e-6
    (ExtendedKalmanFilter, 0.02, 1e-8),
    # the noise in two halves: of order 2, h^2 F^2 g / 12 = 1e-7; the evidence multiplies it by
    # v / S, 20 at most
    (UnscentedKalmanFilter, 0.002, 1e-5),
])
def test_equals_the_kalman_filter_when_linear_and_gaussian(kind, time_step, tolerance):
    assert np.all(errors(kind, time_step) < tolerance)


@pytest.mark.parametrize('kind, order', [
    (ExtendedKalmanFilter, 4), (UnscentedKalmanFilter, 2)])
def test_the_steps_are_of_the_order_stated(kind, order):
    # steps longer than most gaps: the order shows from gap to gap, and is nearly reached
    ratio = errors(kind, 0.4)[:2] / errors(kind, 0.2)[:2]
    assert np.all(ratio > 2**order / 2)


def test_between_measurements_mean_and_covariance_follow_their_differential_equations():
    def moments(t, z):
        slope = 2 * (1 - np.tanh(z[0])**2)
        return [np.tanh(z[0]), slope * z[1] + 1]

    exact = solve_ivp(moments, (0, 1.2345), [0.3, 0.2], rtol=1e-10, atol=1e-12).y[:, -1]
    filter_ = ExtendedKalmanFilter(benes().model, {}, 0.01)
    belief = filter_.predict(GaussianBelief(np.array([0.3]), np.array([[0.2]])), 5,
                             5 + 1_234_500_000)
    assert [belief.mean()[0], belief.covariance()[0, 0]] == pytest.approx(exact, abs=1e-8)


@pytest.mark.parametrize('s', [0.0, 0.5, 1.0])
def test_of_noise_that_grows_with_the_state_the_extended_filter_takes_what_is_at_the_mean(s):
    # dm/dt = mu m, dP/dt = 2 mu P + sigma^2 m^2; what is missing is sigma^2 P
    t, m, P = 1.5, 2.0, 0.3
    end = m * np.exp(MU * t)
    exact = np.exp(2 * MU * t) * (P + SIGMA**2 * m**2 * t)
    filter_ = ExtendedKalmanFilter(geometric(s), {}, 0.05)
    belief = filter_.predict(GaussianBelief(np.array([m]), np.array([[P]])), 0, int(t * SECOND))
    assert belief.mean()[0] == pytest.approx(end, abs=1e-8)
    assert belief.covariance()[0, 0] == pytest.approx(exact, abs=1e-7)


@BOTH
def test_a_model_that_changes_with_time_is_asked_at_its_time(kind):
    model = StateModel(('x',), lambda x, t: np.full_like(x, np.cos(t)),
                       lambda t: np.array([[np.sqrt(t)]]), time_dependent=True)
    filter_ = kind(model, {}, 0.01)
    belief = filter_.predict(GaussianBelief(np.zeros(1), np.eye(1)), 2 * SECOND, 3 * SECOND)
    assert belief.mean()[0] == pytest.approx(np.sin(3) - np.sin(2), abs=1e-10)
    assert belief.covariance()[0, 0] == pytest.approx(1 + (9 - 4) / 2, abs=1e-10)


# Time


@BOTH
@given(cuts=st.lists(st.integers(0, 12), max_size=4), rest=st.integers(0, 9_999_999),
       start=st.integers(0, 2**62))
def test_whole_steps_in_one_call_or_in_many_give_the_same_bits(kind, cuts, rest, start):
    step = 10_000_000
    filter_ = kind(coupled_trigonometric().model, {}, 0.01,
                   Grid((-0.5, -0.5), (0.5, 0.5), (4, 4), (True, True)))
    belief = filter_.gaussian([0.45, -0.4], [[0.2, 0.1], [0.1, 0.3]])
    whole = filter_.predict(belief, start, start + 12 * step + rest)
    now = start
    for cut in sorted(start + step * cut for cut in cuts):
        belief, now = filter_.predict(belief, now, cut), cut
    belief = filter_.predict(belief, now, start + 12 * step + rest)
    np.testing.assert_array_equal(belief.mean(), whole.mean())
    np.testing.assert_array_equal(belief.covariance(), whole.covariance())


@BOTH
def test_refuses_to_predict_backwards_and_steps_of_no_length(kind):
    with pytest.raises(ValueError, match='to_ns: expected a stamp from 5 on, got 4'):
        kind(LINEAR, {}, 0.1).predict(START, 5, 4)
    for time_step in (0.0, -1.0, float('nan'), float('inf')):
        with pytest.raises(ValueError, match='time_step: expected'):
            kind(LINEAR, {}, time_step)


# Soundness


@BOTH
def test_the_covariance_stays_symmetric_and_positive_definite(kind):
    rng = np.random.default_rng(8)
    sensors = {'range': range_sensor([3.0, 1.0], 1e-4)}
    filter_ = kind(coupled_trigonometric().model, sensors, 0.1)
    belief = GaussianBelief(np.zeros(2), 1e6 * np.eye(2))
    for k in range(50):
        belief, _ = filter_.correct(belief, [3 + rng.normal()], 'range', 0)
        belief = filter_.predict(belief, 0, 12_345_678)
        P = belief.covariance()
        np.testing.assert_array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0


@BOTH
def test_a_measurement_far_more_precise_than_the_belief_leaves_its_own_variance(kind):
    # 1e-10 is nothing beside 1e8, from which it is not to be found by subtraction
    filter_ = kind(position_2d().model, {'s': Sensor(lambda x, t: x[:1], [[1e-10]])}, 0.1)
    belief, _ = filter_.correct(filter_.gaussian([0.0, 0.0], 1e8 * np.eye(2)), [3.0], 's', 0)
    # what the central differences, and the points' own weights, leave: digits
    np.testing.assert_allclose(belief.covariance(), np.diag([1e-10, 1e8]), rtol=1e-3, atol=1e-20)


@BOTH
@given(h=st.floats(0.01, 50), seed=st.integers(0, 2**32 - 1))
def test_no_step_is_so_long_and_no_sensor_such_that_the_covariance_is_none(kind, h, seed):
    rng = np.random.default_rng(seed)
    A, B, root = rng.normal(size=(3, 3)), rng.normal(size=(2, 3)), rng.normal(size=(3, 3))
    model = StateModel(tuple('abc'), lambda x, t: np.tensordot(A, x, 1), rng.normal(size=(3, 1)))
    sensors = {'s': Sensor(lambda x, t: np.tensordot(B, x, 1)**3, 0.1 * np.eye(2))}
    filter_ = kind(model, sensors, h)
    moved = filter_.predict(GaussianBelief(rng.normal(size=3), root @ root.T), 0,
                            round(h * SECOND))
    for P in (moved.covariance(), filter_.correct(moved, [1.0, -1.0], 's', 0)[0].covariance()):
        np.testing.assert_array_equal(P, P.T)
        # rounding: 1e-16 of the largest eigenvalue there was, in each of some ten products
        assert np.linalg.eigvalsh(P)[0] >= -1e-14 * np.linalg.eigvalsh(moved.covariance())[-1]


@BOTH
@pytest.mark.parametrize('drift', [lambda x, t: x**3, lambda x, t: np.full_like(x, np.nan)])
def test_a_prediction_that_blows_up_has_mass_zero_and_stays_so_without_a_word(kind, drift):
    filter_ = kind(StateModel(('x',), drift, np.eye(1)), {'s': direct()}, 0.5,
                   Grid((-9,), (9,), (8,)))
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        belief = filter_.predict(filter_.gaussian([10.0], [[4.0]]), 0, 100 * SECOND)
        assert belief.mass == 0
        assert filter_.predict(belief, 0, SECOND).mass == 0
        corrected, log_evidence = filter_.correct(belief, [1.0], 's', 0)
        assert corrected.mass == 0 and log_evidence == -np.inf
        assert filter_.uniform().mass == 1
        assert belief.on(filter_.box, [0]).mass == 0


@BOTH
def test_a_belief_wider_than_squares_can_be_told_apart_is_lost_too(kind):
    filter_ = kind(StateModel(('x',), lambda x, t: 150 * x, np.eye(1)), {}, 0.001)
    belief = filter_.predict(filter_.gaussian([0.0], [[1.0]]), 0, SECOND)
    # exp(300), a number still
    assert belief.mass == 0


@BOTH
@pytest.mark.parametrize('function, y', [
    (lambda x, t: x, float('nan')),
    (lambda x, t: x, float('inf')),
    (lambda x, t: np.full_like(x, np.nan), 0.0),
    (lambda x, t: np.where(x > 7, np.inf, x), 0.0),
])
def test_a_measurement_that_cannot_be_weighed_leaves_the_belief_and_has_no_evidence(
        kind, function, y):
    filter_ = kind(wiener().model, {'s': Sensor(function, [[1.0]])}, 0.1)
    before = filter_.gaussian([8.0], [[0.5]])
    after, log_evidence = filter_.correct(before, [y], 's', 0)
    assert after is before and log_evidence == -np.inf


@BOTH
@pytest.mark.parametrize('y', [50.0, -50.0, 1e6])
def test_an_outlier_moves_the_mean_as_bayes_rule_has_it(kind, y):
    filter_ = kind(wiener().model, {'s': direct(0.5)}, 0.1)
    belief, log_evidence = filter_.correct(filter_.gaussian([0.0], [[0.5]]), [y], 's', 0)
    assert belief.mean()[0] == pytest.approx(y / 2)
    assert belief.covariance()[0, 0] == pytest.approx(0.25)
    assert log_evidence == pytest.approx(-y**2 / 2 - np.log(2 * np.pi) / 2)


# Circles


@BOTH
@pytest.mark.parametrize('offset', [0.0, 1e-7, -1e-7, 0.3])
@pytest.mark.parametrize('angle', [np.pi - 0.02, -np.pi + 0.02, 5 * np.pi + 0.01])
def test_bearings_are_compared_on_the_circle_also_where_they_jump(kind, offset, angle):
    # the landmark stands behind, where the bearing jumps from pi to -pi; turned by half a circle
    # the same geometry has no jump
    behind = kind(position_2d().model, {'bearing': bearing_sensor([0.0, 0.0], 0.1)}, 0.1)
    ahead = kind(position_2d().model, {'bearing': bearing_sensor([4.0, 0.0], 0.1)}, 0.1)
    P = np.array([[0.3, 0.1], [0.1, 0.2]])
    one, log_one = behind.correct(
        GaussianBelief(np.array([2.0, offset]), P), [angle], 'bearing', 0)
    other, log_other = ahead.correct(
        GaussianBelief(np.array([2.0, -offset]), P), [angle - np.pi], 'bearing', 0)
    # turned about (2, 0)
    np.testing.assert_allclose(one.mean() - [2, 0], [2, 0] - other.mean(), atol=1e-6)
    np.testing.assert_allclose(one.covariance(), other.covariance(), atol=1e-6)
    assert log_one == pytest.approx(log_other, abs=1e-6)


@BOTH
def test_the_mean_of_a_state_that_goes_round_stays_in_the_box(kind):
    model = StateModel(('theta',), lambda x, t: np.full_like(x, 3.0), 0.1 * np.eye(1))
    sensors = {'compass': Sensor(lambda x, t: x, [[0.01]], angular=(True,))}
    filter_ = kind(model, sensors, 0.1, Grid((-np.pi,), (np.pi,), (36,), (True,)))
    belief = filter_.predict(filter_.gaussian([3.0], [[0.01]]), 0, SECOND)
    assert belief.mean()[0] == pytest.approx(6.0 - 2 * np.pi)
    # the variances are equal, 0.01 + 0.01 and 0.02, but for its share: 2/3 of the way
    belief, _ = filter_.correct(filter_.gaussian([3.1], [[0.02]]), [-3.1], 'compass', 0)
    assert belief.mean()[0] == pytest.approx(3.1 + (2 * np.pi - 6.2) * 2 / 3 - 2 * np.pi)
    # as seen from across the cut
    assert filter_.gaussian([3.1], [[0.02]]).covariance(about=[-3.1])[0, 0] == pytest.approx(
        0.02 + (2 * np.pi - 6.2)**2)


@pytest.mark.parametrize('variance', [0.02, 1.0, 9.0, 100.0])
def test_on_a_periodic_axis_the_density_is_the_wrapped_one(variance):
    grid = Grid((0, -20), (2 * np.pi, 20), (90, 40), (True, False))
    P = np.array([[variance, 0.3], [0.3, 4.0]])
    density = GaussianBelief(np.array([5.5, 1.0]), P, grid).on(grid, [0])
    # its Fourier series
    k = np.arange(1, 200)[:, None]
    terms = np.exp(-k**2 * variance / 2) * np.cos(k * (grid.axes[0] - 5.5))
    exact = (1 + 2 * terms.sum(axis=0)) / (2 * np.pi)
    # 6 turns to either side leave out what is 3.9 standard deviations away at most
    np.testing.assert_allclose(density.density, exact, atol=2e-4 * exact.max())


# What can be read off


def test_on_the_cells_of_a_grid_it_is_the_density_of_the_axes_asked_for():
    grid = Grid((-4, -6, -8), (4, 6, 8), (40, 50, 60))
    root = np.array([[0.5, 0, 0], [0.3, 0.6, 0], [-0.2, 0.4, 0.7]])
    m, P = np.array([0.4, -0.5, 0.3]), root @ root.T
    belief = GaussianBelief(m, P)
    found = belief.on(grid, [2, 0])
    assert found.grid == grid.select([2, 0]) and found.mass == pytest.approx(1)
    exact = gaussian(found.grid.points, m[[2, 0]], P[np.ix_([2, 0], [2, 0])])
    np.testing.assert_allclose(found.density.ravel(), exact, atol=1e-6)


@pytest.mark.parametrize('m, variance', [
    (0.3, 1e-12), (3.5, 1.0), (50.0, 0.1), (-1e9, 1.0), (0.0, 1e12)])
def test_on_a_grid_the_mass_of_a_belief_is_what_lies_there(m, variance):
    grid = Grid((-4,), (4,), (40,))
    found = GaussianBelief(np.array([m]), np.array([[variance]])).on(grid, [0])
    due = np.diff(stats.norm(m, np.sqrt(variance)).cdf([-4, 4]))[0]
    # half a cell is the least width: sampled there, it comes to 1 but for 2 exp(-pi^2 / 2)
    assert found.mass == pytest.approx(due, rel=1e-3, abs=1e-9 if variance > 0.01 else 0.015)
    assert np.all(found.density >= 0)


@pytest.mark.parametrize('P', [[[1.0, 1.0], [1.0, 1.0]], [[4.0, 2.0], [2.0, 1.0]]])
def test_on_a_grid_a_singular_belief_has_a_density_too(P):
    grid = Grid((-9, -9), (9, 9), (90, 90))
    found = GaussianBelief(np.zeros(2), np.array(P)).on(grid, [0, 1])
    assert found.mass == pytest.approx(1.0, abs=0.02) and np.all(np.isfinite(found.density))


def test_on_a_grid_a_belief_narrower_than_a_cell_keeps_its_mean():
    grid = Grid((-4,), (4,), (40,))
    for m in (0.3, 0.33, 0.36, 0.4):
        found = GaussianBelief(np.array([m]), np.array([[1e-9]])).on(grid, [0])
        # sampled at q = 1/2 of a cell, 4 pi q^2 exp(-2 pi^2 q^2) = 0.0226 of a cell is left
        assert found.mean()[0] == pytest.approx(m, abs=0.023 * 0.2)


def test_moments_about_a_point_are_those_about_the_mean_and_the_distance_squared():
    about = np.array([1.0, -2.0])
    d = START.mean() - about
    np.testing.assert_allclose(START.covariance(about), START.covariance() + np.outer(d, d))
    np.testing.assert_array_equal(START.mode(), START.mean())


@BOTH
def test_the_uniform_belief_has_the_moments_of_the_box(kind):
    filter_ = kind(LINEAR, {}, 0.1, Grid((-1, 2), (3, 8), (5, 5)))
    belief = filter_.uniform()
    u = np.random.default_rng(4).uniform([-1, 2], [3, 8], size=(200_000, 2))
    # five standard errors of the sample: 1.7 / sqrt(200,000) and 3 / sqrt(200,000)
    np.testing.assert_allclose(belief.mean(), u.mean(axis=0), atol=0.02)
    np.testing.assert_allclose(belief.covariance(), np.cov(u.T), atol=0.034)
    with pytest.raises(ValueError, match='box: expected'):
        kind(LINEAR, {}, 0.1).uniform()


@BOTH
def test_refuses_a_start_that_is_no_gaussian_and_a_box_of_other_states(kind):
    filter_ = kind(LINEAR, {}, 0.1)
    for mean, covariance, name in [([1.0], np.eye(2), 'mean'),
                                   ([1.0, np.nan], np.eye(2), 'mean'),
                                   ([1.0, 2.0], -np.eye(2), 'covariance'),
                                   ([1.0, 2.0], np.eye(3), 'covariance')]:
        with pytest.raises(ValueError, match=f'{name}: expected .* got'):
            filter_.gaussian(mean, covariance)
    with pytest.raises(ValueError, match='box: expected 2 axes, one for each state, got 1'):
        kind(LINEAR, {}, 0.1, Grid((0,), (1,), (4,)))


def test_a_range_far_from_the_origin_of_the_map_has_the_slope_of_one_near_it():
    # metres of a UTM zone; the landmark lies 5 m away in the direction (0.6, 0.8)
    x = np.array([500_000.0, 4_500_000.0])
    sensor = range_sensor(x + [3, 4], 0.1)
    np.testing.assert_allclose(sensor.jacobian(x, 0.0), [[-0.6, -0.8]], atol=1e-4)


@BOTH
@pytest.mark.parametrize('unit', [1e-3, 1e-6])
@pytest.mark.parametrize('start', [0.05, 1e-6])
def test_a_belief_does_not_know_the_units_of_its_states(kind, unit, start):
    def moments(unit):
        well = StateModel(('x',), lambda x, t: x - x**3 / unit**2, [[0.2 * unit]])
        square = Sensor(lambda x, t: x**2 / unit, [[(0.1 * unit)**2]])
        filter_ = kind(well, {'square': square}, 0.01)
        belief = filter_.gaussian([0.9 * unit], [[(start * unit)**2]])
        belief = filter_.predict(belief, 0, SECOND)
        belief, log_evidence = filter_.correct(belief, [0.8 * unit], 'square', SECOND)
        return (belief.mean()[0] / unit, belief.covariance()[0, 0] / unit**2,
                log_evidence + np.log(unit))

    np.testing.assert_allclose(moments(unit), moments(1.0), rtol=1e-6)


def test_a_derivative_is_one_where_nothing_is_uncertain_yet():
    # the place has no noise but the speed's, and was known exactly
    model = StateModel(('x', 'v'), lambda x, t: np.stack([x[1], 1 - np.sin(x[0])]),
                       [[0.0], [0.3]])
    filter_ = ExtendedKalmanFilter(model, {}, 0.1)
    belief = GaussianBelief(np.array([0.0, 0.5]), np.zeros((2, 2)))
    given = ExtendedKalmanFilter(StateModel(
        model.names, model.drift, model.vielbein, drift_jacobian=lambda x, t: np.array(
            [[0, 1], [-np.cos(x[0]), 0]])), {}, 0.1)
    np.testing.assert_allclose(filter_.predict(belief, 0, SECOND).covariance(),
                               given.predict(belief, 0, SECOND).covariance(), rtol=1e-7)
