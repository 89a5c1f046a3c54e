"""Filters to compare with."""

import numpy as np
from oracles import kalman
from pif_ros.core.baselines import ExtendedKalmanFilter, GaussianBelief
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import bearing_sensor, benes, position_2d, range_sensor
import pytest
from scipy.integrate import solve_ivp

SECOND = 1_000_000_000
F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
LINEAR = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
H, R = np.array([[1.0, -0.5], [0.3, 1.0]]), np.array([[0.2, 0.12], [0.12, 0.15]])
SENSORS = {'both': Sensor(lambda x, t: np.tensordot(H, x, 1), R)}
START = GaussianBelief(np.array([0.5, -0.3]), np.array([[0.2, 0.1], [0.1, 0.15]]))


def errors(time_step):
    """Return the largest errors against the Kalman filter over a track with irregular stamps."""
    rng = np.random.default_rng(6)
    gaps, ys = rng.integers(1, 900_000_000, size=20), rng.normal(size=(20, 2))
    filter_ = ExtendedKalmanFilter(LINEAR, SENSORS, time_step)
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


def test_equals_the_kalman_filter_when_linear_and_gaussian():
    # Runge-Kutta of order 4: (0.02)^5 / 120 per step; the central differences of a linear model
    # are exact but for rounding, 1e-16 / 6e-6
    assert np.all(errors(0.02) < 1e-8)


def test_its_steps_are_of_fourth_order():
    # steps longer than every gap but for those of 0.9 s at most: the order shows from gap to gap
    ratio = errors(0.4)[:2] / errors(0.2)[:2]
    assert np.all(ratio > 8)


def test_between_measurements_mean_and_covariance_follow_their_differential_equations():
    def moments(t, z):
        slope = 2 * (1 - np.tanh(z[0])**2)
        return [np.tanh(z[0]), slope * z[1] + 1]

    exact = solve_ivp(moments, (0, 1.2345), [0.3, 0.2], rtol=1e-10, atol=1e-12).y[:, -1]
    filter_ = ExtendedKalmanFilter(benes().model, {}, 0.01)
    belief = filter_.predict(GaussianBelief(np.array([0.3]), np.array([[0.2]])), 5,
                             5 + 1_234_500_000)
    assert [belief.mean()[0], belief.covariance()[0, 0]] == pytest.approx(exact, abs=1e-8)


def test_a_model_that_changes_with_time_is_asked_at_its_time():
    model = StateModel(('x',), lambda x, t: np.full_like(x, np.cos(t)),
                       lambda t: np.array([[np.sqrt(t)]]), time_dependent=True)
    filter_ = ExtendedKalmanFilter(model, {}, 0.01)
    belief = filter_.predict(GaussianBelief(np.zeros(1), np.eye(1)), 2 * SECOND, 3 * SECOND)
    assert belief.mean()[0] == pytest.approx(np.sin(3) - np.sin(2), abs=1e-10)
    assert belief.covariance()[0, 0] == pytest.approx(1 + (9 - 4) / 2, abs=1e-10)


def test_the_covariance_stays_symmetric_and_positive_definite():
    rng = np.random.default_rng(8)
    sensors = {'range': range_sensor([3.0, 1.0], 1e-4)}
    filter_ = ExtendedKalmanFilter(position_2d().model, sensors, 0.1)
    belief = GaussianBelief(np.zeros(2), 1e6 * np.eye(2))
    for k in range(50):
        belief, _ = filter_.correct(belief, [3 + rng.normal()], 'range', 0)
        belief = filter_.predict(belief, 0, 12_345_678)
        P = belief.covariance()
        np.testing.assert_allclose(P, P.T, rtol=1e-6, atol=1e-9 * np.trace(P))
        assert np.linalg.eigvalsh((P + P.T) / 2)[0] > 0


@pytest.mark.parametrize('offset', [0.0, 1e-7, -1e-7, 0.3])
@pytest.mark.parametrize('angle', [np.pi - 0.02, -np.pi + 0.02, 5 * np.pi + 0.01])
def test_bearings_are_compared_on_the_circle_also_where_they_jump(offset, angle):
    # the landmark stands behind, where the bearing jumps from pi to -pi; turned by half a circle
    # the same geometry has no jump
    behind = ExtendedKalmanFilter(
        position_2d().model, {'bearing': bearing_sensor([0.0, 0.0], 0.1)}, 0.1)
    ahead = ExtendedKalmanFilter(
        position_2d().model, {'bearing': bearing_sensor([4.0, 0.0], 0.1)}, 0.1)
    P = np.array([[0.3, 0.1], [0.1, 0.2]])
    one, log_one = behind.correct(
        GaussianBelief(np.array([2.0, offset]), P), [angle], 'bearing', 0)
    other, log_other = ahead.correct(
        GaussianBelief(np.array([2.0, -offset]), P), [angle - np.pi], 'bearing', 0)
    # turned about (2, 0)
    np.testing.assert_allclose(one.mean() - [2, 0], [2, 0] - other.mean(), atol=1e-6)
    np.testing.assert_allclose(one.covariance(), other.covariance(), atol=1e-6)
    assert log_one == pytest.approx(log_other, abs=1e-6)


def test_a_range_far_from_the_origin_of_the_map_has_the_slope_of_one_near_it():
    # metres of a UTM zone; the landmark lies 5 m away in the direction (0.6, 0.8)
    x = np.array([500_000.0, 4_500_000.0])
    sensor = range_sensor(x + [3, 4], 0.1)
    np.testing.assert_allclose(sensor.jacobian(x, 0.0), [[-0.6, -0.8]], atol=1e-4)
