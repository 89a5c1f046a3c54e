"""A measured path of a linear model, for which the answer is known."""

import numpy as np
from oracles import gaussian, linear_moments
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous import (DiracFeynmanYauFilter, ExtendedKalmanBucyFilter, PathBelief,
                                     SCHEMES)
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
import pytest
from scipy.linalg import solve_continuous_are

SECOND = 1_000_000_000

F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
PLANE = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
H, C = np.array([[1.0, -0.5], [0.3, 1.0]]), np.array([[0.2, 0.12], [0.12, 0.15]])
BOTH = {'both': Sensor(lambda x, t: np.tensordot(H, x, 1), C)}

#: dx = -x dt + dv, dy = x dt + n dw
LINE = StateModel(('x',), lambda x, t: -x, np.eye(1),
                  drift_jacobian=lambda x, t: np.full((1, 1) + x.shape[1:], -1.0))
ONE = np.eye(1)


def direct(variance):
    return {'path': Sensor(lambda x, t: x, [[variance]])}


def joint(F, g, H, seconds):
    """Return transition and covariance of the state and of the integral of H x from 0."""
    n, m = len(F), len(H)
    A = np.block([[F, np.zeros((n, m))], [H, np.zeros((m, m))]])
    return linear_moments(A, np.pad(g, (0, m)), seconds)


def simulated(F, g, H, C, x, gaps, rng):
    """Return the increments of the path over some gaps in seconds, exactly distributed."""
    found = []
    for seconds in gaps:
        transition, noise = joint(F, g, H, seconds)
        mean = transition @ np.append(x, np.zeros(len(H)))
        z = rng.multivariate_normal(mean, noise, method='eigh')
        x = z[:len(F)]
        found.append(z[len(F):] + rng.multivariate_normal(np.zeros(len(H)), C * seconds))
    return np.array(found)


def exact(F, g, H, C, mean, covariance, gaps, increments):
    """Return means, covariances and log evidences given the increments of the path alone."""
    n, m, P, found = len(F), np.array(mean), np.array(covariance), []
    for seconds, dy in zip(gaps, increments):
        transition, noise = joint(F, g, H, seconds)
        z = transition @ np.append(m, np.zeros(len(H)))
        S = transition @ np.pad(P, (0, len(H))) @ transition.T + noise
        v, R = dy - z[n:], S[n:, n:] + C * seconds
        gain = S[:n, n:] @ np.linalg.inv(R)
        m, P = z[:n] + gain @ v, S[:n, :n] - gain @ S[n:, :n]
        found.append((m, P, np.log(gaussian(v, np.zeros(len(v)), R))))
    return [np.array(part) for part in zip(*found)]


def followed(filter_, mean, covariance, gaps_ns, increments):
    """Return means, covariances and log evidences of a filter; its path begins anywhere."""
    [name] = filter_.sensors
    y, now = np.full(len(increments[0]), 7.0), 5 * SECOND
    belief, nothing = filter_.correct(filter_.gaussian(mean, covariance), y, name, now)
    assert nothing == 0
    found = []
    for gap, dy in zip(gaps_ns, increments):
        y = y + dy
        belief = filter_.predict(belief, now, now + gap)
        now += gap
        belief, log_evidence = filter_.correct(belief, y, name, now)
        found.append((belief.mean(), belief.covariance(), log_evidence))
    return [np.array(part) for part in zip(*found)]


def on_a_line(scheme, eps, sensors, steps=1, cells=400):
    settings = KernelSettings(eps / steps, tolerance=1e-9)
    if scheme == 'extended':
        return ExtendedKalmanBucyFilter(LINE, sensors, eps / steps)
    return DiracFeynmanYauFilter(LINE, Grid((-5,), (5,), (cells,)), sensors, settings, scheme)


def errors_on_a_line(scheme, count, variance, seeds=4, steps=1):
    """Return mean errors of mean and variance, and of the total log evidence, over a second."""
    found = []
    for seed in range(seeds):
        fine = simulated(-ONE, ONE, ONE, ONE * variance, [0.5], [1 / 64] * 64,
                         np.random.default_rng(seed))
        increments = fine.reshape(count, -1, 1).sum(axis=1)
        m, P, log_exact = exact(-ONE, ONE, ONE, ONE * variance, [0.3], ONE / 4,
                                [1 / count] * count, increments)
        filter_ = on_a_line(scheme, 1 / count, direct(variance), steps)
        means, covariances, log_evidences = followed(
            filter_, [0.3], ONE / 4, [SECOND // count] * count, increments)
        found.append([np.abs(means - m).mean(), np.abs(covariances - P).mean(),
                      abs(np.sum(log_evidences - log_exact))])
    return np.mean(found, axis=0)


@pytest.mark.parametrize('scheme, orders, largest', [
    # errors at 1/8 s, sigma_y = 1, as measured, with some room
    ('symmetric', (2, 2, 1), (5e-4, 6e-4, 5e-3)),
    ('splitting', (1, 1, 1), (3e-2, 1e-2, 3e-2)),
    ('post', (1, 2, 1), (3e-2, 1e-4, 4e-2)),
    ('pre', (1, 2, 1), (3e-2, 1e-4, 3e-2)),
    # it lacks an increment, whose noise is of the order eps^(1/2)
    ('pre_printed', (0.5, 2, 1), (0.2, 1e-4, 3e-2)),
])
def test_each_scheme_tends_to_the_kalman_filter_of_the_path_at_its_order(scheme, orders, largest):
    coarse, fine = (errors_on_a_line(scheme, count, 1.0) for count in (8, 32))
    assert np.all(coarse < largest)
    found = np.log(coarse / fine) / np.log(4)
    assert found[:2] == pytest.approx(orders[:2], abs=0.3)
    # a sum of signed errors of a few seeds shows its order less clearly
    assert found[2] > orders[2] - 0.5


def test_where_the_noise_is_small_the_symmetric_scheme_is_far_the_best():
    found = {scheme: errors_on_a_line(scheme, 32, 0.02) for scheme in SCHEMES}
    for scheme in ('splitting', 'post', 'pre', 'pre_printed'):
        # of the mean: 8, 49, 49 and 188 times as measured
        assert found[scheme][0] > 5 * found['symmetric'][0]
    # a hundredth of the standard deviation
    assert found['symmetric'][0] < 1e-3


def test_the_symmetric_schemes_evidence_counts_what_two_halves_lack():
    # g eps / (8 C) per second without it: 0.31 here
    assert errors_on_a_line('symmetric', 8, 0.05)[2] < 0.06


@pytest.mark.parametrize('scheme', SCHEMES)
def test_more_kernel_steps_than_stamps_do_no_harm(scheme):
    one, four = (errors_on_a_line(scheme, 16, 0.2, steps=steps) for steps in (1, 4))
    assert np.all(four < 1.3 * one + 1e-4)


def gaps_and_increments(F, g, H, C, x, count, rng):
    gaps = rng.integers(5_000_001, 60_000_000, size=count)
    return gaps, simulated(F, g, H, C, x, gaps / SECOND, rng)


@pytest.mark.parametrize('scheme, tolerance', [
    # eps^2 and eps at 0.06 s, times what h and C make of it; measured 3e-4 and 8e-3
    ('symmetric', 1e-3), ('splitting', 2e-2), ('post', 2e-2), ('pre', 2e-2)])
def test_equals_the_kalman_filter_of_the_path_in_the_plane_at_irregular_stamps(scheme, tolerance):
    rng = np.random.default_rng(4)
    g = E @ Q @ E.T
    gaps, increments = gaps_and_increments(F, g, H, C, [0.6, -0.2], 12, rng)
    P0 = np.array([[0.2, 0.1], [0.1, 0.15]])
    filter_ = DiracFeynmanYauFilter(PLANE, Grid((-2.5,) * 2, (2.5,) * 2, (70, 70)), BOTH,
                                    KernelSettings(0.02, tolerance=1e-8), scheme)
    m, P, log_exact = exact(F, g, H, C, [0.5, -0.3], P0, gaps / SECOND, increments)
    means, covariances, log_evidences = followed(filter_, [0.5, -0.3], P0, gaps.tolist(),
                                                 increments)
    np.testing.assert_allclose(means, m, atol=tolerance)
    np.testing.assert_allclose(covariances, P, atol=tolerance)
    np.testing.assert_allclose(log_evidences, log_exact, atol=4 * tolerance)


def test_multiplicative_noise_is_the_kalman_filter_of_the_logarithm():
    # dx = x dv / 2, dy = log(x) dt + n dw: the logarithm falls by 1/8 a second, dv / 2
    model = StateModel(('x',), lambda x, t: 0 * x, lambda x, t: x[None] / 2, multiplicative=True)
    sensors = {'logarithm': Sensor(lambda x, t: np.log(x), [[0.05]])}
    seconds, rng = np.full(10, 0.025), np.random.default_rng(8)
    level = simulated(0 * ONE, ONE / 4, ONE, ONE / 20, [0.1], seconds, rng)
    ends = np.cumsum(seconds)
    fallen = np.diff(ends**2, prepend=0) / 16
    m, P, log_exact = exact(0 * ONE, ONE / 4, ONE, ONE / 20, [0.0], ONE / 25, seconds, level)
    filter_ = DiracFeynmanYauFilter(model, Grid((0.2,), (4,), (760,)), sensors,
                                    KernelSettings(0.005, tolerance=1e-9))
    x = filter_.grid.axes[0]
    prior = GridBelief(filter_.grid, np.exp(-12.5 * np.log(x)**2) / x).normalised()
    belief, _ = filter_.correct(PathBelief.before_the_path(prior), [0.0], 'logarithm', 0)
    y = np.cumsum(level[:, 0] - fallen)
    for k in range(10):
        at_ns = round(SECOND * ends[k])
        belief, log_evidence = filter_.correct(belief, y[k:k + 1], 'logarithm', at_ns)
        w = belief.density / belief.density.sum()
        mean = w @ np.log(x)
        # of first order in the 0.005 s of the kernel, and second in the 0.025 s of the path
        assert mean == pytest.approx(m[k, 0] - ends[k] / 8, abs=5e-4)
        assert w @ (np.log(x) - mean)**2 == pytest.approx(P[k, 0, 0], abs=5e-4)
        assert log_evidence == pytest.approx(log_exact[k], abs=1e-3)


def test_extended_kalman_bucy_is_the_kalman_filter_of_the_path_at_any_stamps():
    rng = np.random.default_rng(5)
    g = E @ Q @ E.T
    gaps = rng.integers(1, 900_000_000, size=20)
    increments = simulated(F, g, H, C, [0.6, -0.2], gaps / SECOND, rng)
    P0 = np.array([[0.2, 0.1], [0.1, 0.15]])
    expected = exact(F, g, H, C, [0.5, -0.3], P0, gaps / SECOND, increments)
    found = followed(ExtendedKalmanBucyFilter(PLANE, BOTH, 0.01), [0.5, -0.3], P0, gaps.tolist(),
                     increments)
    for part, wanted in zip(found, expected):
        # Runge-Kutta of fourth order, 0.01^4 times what a second collects
        np.testing.assert_allclose(part, wanted, atol=1e-7)


def test_extended_kalman_bucys_steps_are_of_fourth_order():
    coarse, fine = (errors_on_a_line('extended', 8, 0.1, steps=steps) for steps in (1, 2))
    assert np.all(coarse[:2] / fine[:2] > 12)


def test_the_covariance_settles_where_riccatis_equation_has_it():
    settled = solve_continuous_are(F.T, H.T, E @ Q @ E.T, C)
    filter_ = ExtendedKalmanBucyFilter(PLANE, BOTH, 0.02)
    _, covariances, _ = followed(filter_, [0.0, 0.0], np.eye(2), [SECOND // 50] * 200,
                                 np.zeros((200, 2)))
    # of second order in the 0.02 s between what is known of the path
    np.testing.assert_allclose(covariances[-1], settled, atol=2e-5)
