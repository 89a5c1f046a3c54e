"""The rivals on the same data as FilterPy's filters, where it is installed."""

from hypothesis import given, strategies as st
import numpy as np
from oracles import linear_moments
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ExtendedKalmanFilter, UnscentedKalmanFilter
from pif_ros.core.rivals.cloud import systematic
import pytest
from scipy.integrate import solve_ivp

kalman = pytest.importorskip('filterpy.kalman')
resampling = pytest.importorskip('filterpy.monte_carlo.resampling')

SECOND = 1_000_000_000
STEP = 50_000_000
F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
G = E @ Q @ E.T
R = np.array([[0.2, 0.05], [0.05, 0.15]])
MEAN, COVARIANCE = np.array([1.5, -0.6]), np.array([[0.2, 0.1], [0.1, 0.15]])
LINEAR = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)


def drift(x, t=0.0):
    return np.stack([-x[1] + np.cos(x[0]), x[0] + np.sin(x[1])])


def slope(x):
    return np.array([[-np.sin(x[0]), -1.0], [1.0, np.cos(x[1])]])


NONLINEAR = StateModel(('x1', 'x2'), lambda x, t: drift(x), E, Q)


def polar(x, t=0.0):
    """Return distance from and direction to the origin."""
    return np.stack([np.hypot(x[0], x[1]), np.arctan2(-x[1], -x[0])])


def polar_slope(x):
    r = np.hypot(x[0], x[1])
    return np.array([[x[0] / r, x[1] / r], [-x[1] / r**2, x[0] / r**2]])


SENSORS = {'polar': Sensor(polar, R, angular=(False, True))}


def difference(a, b):
    """Return differences of (distance, direction), the direction's the short way round."""
    d = np.subtract(a, b)
    return np.array([d[0], np.angle(np.exp(1j * d[1]))])


def measurements(count):
    """Return what is seen of a point on a circle: the direction passes the cut at pi."""
    rng = np.random.default_rng(7)
    angles = 0.2 * np.arange(count)
    x = np.stack([1.5 * np.cos(angles), 1.5 * np.sin(angles)])
    return (polar(x) + rng.multivariate_normal([0, 0], R, size=count).T).T


def runge_kutta(x, h):
    k1 = drift(x)
    k2 = drift(x + h / 2 * k1)
    k3 = drift(x + h / 2 * k2)
    k4 = drift(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def errors(filter_, other, predict, correct, count=40, gap=3 * STEP):
    """Return the largest difference in mean, covariance and log evidence over a track."""
    belief, worst = filter_.gaussian(MEAN, COVARIANCE), np.zeros(3)
    for k, y in enumerate(measurements(count)):
        belief = filter_.predict(belief, k * gap, (k + 1) * gap)
        predict()
        belief, log_evidence = filter_.correct(belief, y, 'polar', (k + 1) * gap)
        correct(y)
        worst = np.maximum(worst, [np.abs(belief.mean() - other.x).max(),
                                   np.abs(belief.covariance() - other.P).max(),
                                   abs(log_evidence - other.log_likelihood)])
    return worst


def test_the_extended_filter_is_that_of_filterpy_given_the_exact_transition():
    other = kalman.ExtendedKalmanFilter(2, 2)
    other.x, other.P, other.R = MEAN.copy(), COVARIANCE.copy(), R

    def slopes(t, z):
        A, P, J = z[2:6].reshape(2, 2), z[6:].reshape(2, 2), slope(z[:2])
        return np.concatenate([drift(z[:2]), (J @ A).ravel(), (J @ P + P @ J.T + G).ravel()])

    def predict():
        start = np.concatenate([other.x, np.eye(2).ravel(), np.zeros(4)])
        end = solve_ivp(slopes, (0, 0.15), start, rtol=1e-11, atol=1e-13).y[:, -1]
        other.F, other.Q = end[2:6].reshape(2, 2), end[6:].reshape(2, 2)
        other.predict_x = lambda u: setattr(other, 'x', end[:2])
        other.predict()

    def correct(y):
        other.update(y, polar_slope, polar, residual=difference)

    filter_ = ExtendedKalmanFilter(NONLINEAR, SENSORS, 0.0025)
    # steps of fourth order: 0.0025^4 = 4e-11 times derivatives, and central differences in H,
    # 1e-10; the evidence multiplies that by v / S, 20 at most
    assert np.all(errors(filter_, other, predict, correct) < [1e-8, 1e-8, 1e-7])


def test_the_extended_filter_is_that_of_filterpy_when_linear():
    other = kalman.ExtendedKalmanFilter(2, 2)
    other.x, other.P, other.R = MEAN.copy(), COVARIANCE.copy(), R
    other.F, other.Q = linear_moments(F, G, 0.15)
    filter_ = ExtendedKalmanFilter(LINEAR, SENSORS, 0.0025)
    assert np.all(errors(filter_, other, other.predict,
                         lambda y: other.update(y, polar_slope, polar, residual=difference))
                  < [1e-8, 1e-8, 1e-7])


@pytest.mark.parametrize('alpha, beta, kappa', [(1.0, 0.0, 1.0), (0.5, 2.0, 0.0),
                                                (1e-2, 2.0, 1.0)])
def test_the_unscented_filter_is_that_of_filterpy_step_by_step(alpha, beta, kappa):
    h = STEP / SECOND

    def mean_of_angles(points, weights):
        reference = points[0]
        return reference + weights @ np.array([difference(p, reference) for p in points])

    other = kalman.UnscentedKalmanFilter(
        2, 2, h, polar, lambda x, dt: runge_kutta(x, dt),
        kalman.MerweScaledSigmaPoints(2, alpha, beta, kappa),
        z_mean_fn=mean_of_angles, residual_z=difference)
    other.x, other.P, other.R = MEAN.copy(), COVARIANCE.copy(), R
    # the noise goes in in two halves
    other.Q = G * h / 2

    def predict():
        for _ in range(3):
            other.P = other.P + G * h / 2
            other.predict()

    filter_ = UnscentedKalmanFilter(NONLINEAR, SENSORS, h, None, alpha, beta, kappa)
    # the same arithmetic in another order; weights of 1 / alpha^2 cost as many digits
    tolerance = 1e-12 / alpha**2
    assert np.all(errors(filter_, other, predict, other.update) < [
        tolerance, tolerance, 20 * tolerance])


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0, 1, exclude_max=True))
def test_resampling_is_that_of_filterpy(seed, count, u):
    rng = np.random.default_rng(seed)
    weights = rng.exponential(size=count)**rng.integers(1, 6) * (rng.random(count) < 0.7)
    weights[rng.integers(count)] += 0.1
    weights /= weights.sum()
    teeth = (u + np.arange(count)) / count
    # a tooth on the edge of a share goes either way
    if np.abs(teeth[:, None] - np.cumsum(weights)).min() > 1e-12:
        drawn, resampling.random = resampling.random, lambda: u
        try:
            np.testing.assert_array_equal(
                systematic(weights, u), resampling.systematic_resample(weights))
        finally:
            resampling.random = drawn
