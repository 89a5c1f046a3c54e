"""The unscented Kalman filter."""

import numpy as np
from oracles import gaussian
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import GaussianBelief, UnscentedKalmanFilter
from pif_ros.core.systems import benes
import pytest
from scipy.integrate import solve_ivp

SECOND = 1_000_000_000


def resting(n):
    """Return a model of n states that do not move."""
    return StateModel(tuple(f'x{i}' for i in range(n)), lambda x, t: np.zeros_like(x),
                      1e-9 * np.eye(n))


def correct(n, function, y, mean, covariance, noise, **constants):
    filter_ = UnscentedKalmanFilter(resting(n), {'s': Sensor(function, noise)}, 0.1, **constants)
    return filter_.correct(filter_.gaussian(mean, covariance), y, 's', 0)


@pytest.mark.parametrize('n', [1, 2, 3])
@pytest.mark.parametrize('constants', [{}, {'alpha': 1e-2, 'beta': 2.0, 'kappa': 0.0}])
def test_the_mean_and_the_variance_of_a_state_squared_are_exact_up_to_three_states(n, constants):
    # y = x1^2 + w, x1 ~ N(m, P): E y = m^2 + P, var y = 2 P^2 + 4 m^2 P + R
    m, P, R = 0.7, 0.5, 0.3
    S = 2 * P**2 + 4 * m**2 * P + R
    covariance = P * np.eye(n)
    belief, log_evidence = correct(n, lambda x, t: x[:1]**2, [2.0], [m] * n, covariance, [[R]],
                                   **constants)
    v = 2.0 - m**2 - P
    # alpha 1e-2 leaves alpha^2 (n - 1) P^2 and digits: 1e-16 / alpha^4
    tolerance = 1e-12 if not constants else 1e-4 * n
    assert log_evidence == pytest.approx(
        np.log(gaussian(np.array([v]), np.zeros(1), S)), abs=tolerance)
    # cov(x1, y) = 2 m P
    assert belief.mean()[0] == pytest.approx(m + 2 * m * P / S * v, abs=tolerance)
    assert belief.covariance()[0, 0] == pytest.approx(P - (2 * m * P)**2 / S, abs=tolerance)


@pytest.mark.parametrize('n', [1, 2, 3, 4, 6, 10])
def test_whatever_the_sensor_no_covariance_is_negative(n):
    # one that jumps and saturates, and is a million times as precise as the belief
    def wild(x, t):
        return np.sign(x[:1]) * np.minimum(np.abs(x).sum(axis=0), 2.0)**4

    rng = np.random.default_rng(n)
    for _ in range(20):
        root = rng.normal(size=(n, n))
        belief, log_evidence = correct(n, wild, rng.normal(0, 5, size=1), rng.normal(size=n),
                                       root @ root.T + 1e-3 * np.eye(n), [[1e-6]])
        assert np.isfinite(log_evidence)
        size = np.linalg.eigvalsh(belief.covariance())
        # rounding, 1e-16 of the largest variance
        assert size[0] > -1e-13 * size[-1]


@pytest.mark.parametrize('n', [1, 2, 3, 4, 6, 10])
def test_the_variance_of_a_distance_squared_is_not_negative_in_many_states(n):
    # the points but the first are equally far from the origin
    _, log_evidence = correct(n, lambda x, t: np.square(x).sum(axis=0, keepdims=True), [n + 1.0],
                              np.zeros(n), np.eye(n), [[0.5]])
    # the mean is right, n; with three standard deviations squared at 2 n points of weight 1/6
    # the variance is n (3 - n), and with n of them it is 0
    S = 0.5 + n * max(3 - n, 0)
    assert log_evidence == pytest.approx(np.log(gaussian(np.ones(1), np.zeros(1), S)))


def test_many_states_keep_their_moments_where_nothing_happens():
    rng = np.random.default_rng(5)
    root = rng.normal(size=(10, 10))
    m, P = rng.normal(size=10), root @ root.T
    filter_ = UnscentedKalmanFilter(resting(10), {}, 0.1)
    belief = filter_.predict(filter_.gaussian(m, P), 0, 10 * SECOND)
    np.testing.assert_allclose(belief.mean(), m, atol=1e-12)
    np.testing.assert_allclose(belief.covariance(), P, atol=1e-11)


@pytest.mark.parametrize('s', [0.0, 0.5, 1.0])
def test_of_noise_that_grows_with_the_state_mean_and_variance_are_exact_as_steps_shrink(s):
    # Ito's dx = mu x dt + sigma x dv: m' = mu m, (m^2 + P)' = (2 mu + sigma^2) (m^2 + P)
    mu, sigma, t, m, P = -0.4, 0.5, 1.5, 2.0, 0.3
    model = StateModel(('x',), lambda x, t: (mu - s * sigma**2) * x,
                       lambda x, t: sigma * x[None], multiplicative=True, s=s)
    end = m * np.exp(mu * t)
    exact = (m**2 + P) * np.exp((2 * mu + sigma**2) * t) - end**2
    found = []
    for h in (0.02, 0.01):
        belief = UnscentedKalmanFilter(model, {}, h).predict(
            GaussianBelief(np.array([m]), np.array([[P]])), 0, round(t * SECOND))
        assert belief.mean()[0] == pytest.approx(end, abs=1e-8)
        found.append(belief.covariance()[0, 0] - exact)
    # of first order in the step
    assert abs(found[1]) < 5e-3
    assert found[0] / found[1] == pytest.approx(2, abs=0.1)


def test_a_drift_is_averaged_over_the_belief_as_gauss_and_hermite_do_with_three_nodes():
    # dm/dt = E f, dP/dt = 2 E f (x - m) + g
    nodes, weights = np.polynomial.hermite_e.hermegauss(3)

    def slopes(t, z):
        d = np.sqrt(z[1]) * nodes
        f = np.tanh(z[0] + d)
        return np.array([weights @ f, 2 * (weights @ (f * d)) + weights.sum()]) / weights.sum()

    exact = solve_ivp(slopes, (0, 0.5), [0.6, 0.4], rtol=1e-10, atol=1e-12).y[:, -1]
    found = []
    for h in (0.01, 0.005):
        belief = UnscentedKalmanFilter(benes().model, {}, h).predict(
            GaussianBelief(np.array([0.6]), np.array([[0.4]])), 0, SECOND // 2)
        found.append(np.array([belief.mean()[0], belief.covariance()[0, 0]]) - exact)
    # of first order in the step; f at the mean, as the extended filter has it, leaves 0.09, 0.06
    assert np.all(np.abs(found[1]) < [1e-4, 1e-3])
    np.testing.assert_allclose(found[0] / found[1], 2, atol=0.1)


def test_refuses_constants_that_place_no_points():
    for constants in ({'alpha': 0.0}, {'alpha': float('nan')}, {'kappa': -2.0}):
        with pytest.raises(ValueError, match='alpha, kappa: expected'):
            UnscentedKalmanFilter(resting(2), {}, 0.1, **constants)
