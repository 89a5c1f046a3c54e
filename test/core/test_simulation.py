"""Sample paths and measurements from a seeded generator."""

from dataclasses import replace

import numpy as np
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.simulation import measure, measure_path, refined, simulate, simulate_inside
from pif_ros.core.systems import SYSTEMS
import pytest
from scipy.integrate import solve_ivp

Q = np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.4], [0.0, -0.4, 0.5]])
E = np.array([[1.0, 0.5, 0.0], [-0.3, 0.2, 0.8]])


def rng(seed=1):
    return np.random.default_rng(seed)


def start(*values, count):
    """Return the same state (n, count) many times."""
    return np.tile(np.array(values, dtype=float)[:, None], (1, count))


def last(model, x0, seconds, steps, seed=1):
    """Return the states at the end of so many steps."""
    return simulate(model, x0, [0.0, seconds], rng(seed), steps)[-1]


def check_moments(x, mean, covariance, extra=0.0):
    """
    Check the sample moments of states (n, count) against exact ones.

    A mean has the standard error sqrt(P / count), a covariance sqrt((P_ii P_jj + P_ij^2) / count);
    five of them are rarer than one draw in a million.  extra: allowed beside, the scheme's own.
    """
    P, count = np.atleast_2d(covariance), x.shape[1]
    diagonal = np.diag(P)
    assert np.all(np.abs(x.mean(axis=1) - mean) <= 5 * np.sqrt(diagonal / count) + extra)
    spread = np.sqrt((np.outer(diagonal, diagonal) + P**2) / count)
    assert np.all(np.abs(np.cov(x).reshape(P.shape) - P) <= 5 * spread + extra)


def test_paths_have_a_state_at_every_time_and_begin_where_they_are_told_to():
    model = SYSTEMS['coupled_trigonometric']().model
    times = [0.0, 0.1, 0.3, 0.35]
    one = simulate(model, [1.0, 2.0], times, rng())
    many = simulate(model, np.ones((2, 3, 5)), times, rng(), substeps=2)
    assert one.shape == (4, 2) and one[0].tolist() == [1.0, 2.0]
    assert many.shape == (4, 2, 3, 5) and np.all(many[0] == 1.0)
    assert len(np.unique(many[1])) == 30


@pytest.mark.parametrize('name', SYSTEMS)
def test_the_same_seed_gives_the_same_bits_and_another_does_not(name):
    model = SYSTEMS[name]().model
    x0, times = np.full(model.ndim, 0.5), np.arange(5) * 0.01
    first, again, other = (simulate(model, x0, times, rng(seed), 2) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes() and np.all(first[1:] != other[1:])


def test_nothing_given_is_changed():
    x0 = np.zeros((1, 4))
    simulate(SYSTEMS['wiener']().model, x0, [0.0, 1.0], rng())
    assert not x0.any()


@pytest.mark.parametrize('multiplicative', [False, True])
def test_noise_of_a_rectangular_vielbein_has_the_covariance_e_q_e(multiplicative):
    def everywhere(x, t):
        return np.broadcast_to(E[:, :, None], (2, 3, x.shape[1]))

    model = StateModel(('a', 'b'), lambda x, t: np.zeros_like(x),
                       everywhere if multiplicative else E, Q, multiplicative=multiplicative)
    x = last(model, start(1.0, -2.0, count=40_000), 0.7, 2)
    check_moments(x, [1.0, -2.0], 0.7 * E @ Q @ E.T)


@pytest.mark.parametrize('multiplicative', [False, True])
def test_noise_that_is_silent_at_times_is_none_then(multiplicative):
    # one of two noises from 1 s on, both of them from 2 s on
    def noise(t):
        return np.diag([2.0 if t >= 1 else 0.0, 0.5 if t >= 2 else 0.0])

    e = np.array([[1.0, 0.0], [0.5, 1.0]])
    model = StateModel(('a', 'b'), lambda x, t: 0 * x, (
        lambda x, t: e[..., None] + 0 * x) if multiplicative else e, noise,
        multiplicative=multiplicative, time_dependent=multiplicative)
    silent, one, both = np.diff(simulate(model, np.zeros((2, 20_000)), np.arange(4.0), rng()),
                                axis=0)
    assert not silent.any()
    np.testing.assert_allclose(one[1], 0.5 * one[0], atol=1e-12)
    check_moments(one[:1], [0], [[2.0]])
    check_moments(both, [0, 0], e @ noise(2) @ e.T)


def test_an_ornstein_uhlenbeck_process_has_its_exact_moments():
    model = SYSTEMS['ornstein_uhlenbeck'](a=1.5, sigma=0.8).model
    x = last(model, start(2.0, count=20_000), 1.0, 200)
    # at first order the mean is off by x0 exp(-a) a^2 h / 2 = 0.0025, the variance by less
    check_moments(x, 2 * np.exp(-1.5), 0.64 * (1 - np.exp(-3)) / 3, extra=0.003)


@pytest.mark.parametrize('s', [0.0, 0.25, 0.5, 1.0])
def test_geometric_brownian_motion_has_its_exact_moments_in_every_sense(s):
    mu, sigma, seconds = 0.2, 0.5, 1.0
    model = replace(SYSTEMS['geometric_brownian_motion'](mu=mu, sigma=sigma).model, s=s)
    x = last(model, start(3.0, count=20_000), seconds, 100)
    # in Ito's sense the drift is (mu + s sigma^2) x; log x is Gaussian
    drift = mu + s * sigma**2 - sigma**2 / 2
    # h / 2 of (mu + s sigma^2)^2 and of the noise's own terms of that size: 0.01 / 2 * 0.3
    check_moments(np.log(x), np.log(3) + drift * seconds, sigma**2 * seconds, extra=0.002)


def test_the_sense_of_noise_that_is_coupled_counts_by_the_derivatives_of_the_vielbein():
    # dx1 = x2 o dv, dx2 = -x1 o dv turns by an angle v on a circle in Stratonovich's sense, and
    # E exp(i v) = exp(-t / 2)
    model = StateModel(('a', 'b'), lambda x, t: np.zeros_like(x),
                       lambda x, t: np.stack([x[1], -x[0]])[:, None], multiplicative=True, s=0.5)
    x = last(model, start(1.0, 0.0, count=20_000), 0.5, 200)
    np.testing.assert_allclose(x.mean(axis=1), [np.exp(-0.25), 0], atol=5 * 0.7 / 141)
    # a step of h makes the radius stray by (dv^2 - h) / 2: by h sqrt(200 / 2) = 0.025 in the end
    np.testing.assert_allclose(np.hypot(*x), 1, atol=6 * 0.025)
    assert np.hypot(*x).mean() == pytest.approx(1, abs=5 * 0.025 / 141)


def test_a_linear_model_that_changes_with_time_has_its_exact_moments():
    def F(t):
        return np.array([[-0.5, 1 + np.sin(t)], [-1 - t, -0.2 * t]])

    def e(t):
        return np.array([[1.0, t, 0.0], [0.0, np.cos(t), 0.5]])

    def noise(t):
        return Q * (1 + t)

    def moments(t, values):
        m, P = values[:2], values[2:].reshape(2, 2)
        return np.concatenate([F(t) @ m + [t, 1.0], (
            F(t) @ P + P @ F(t).T + e(t) @ noise(t) @ e(t).T).ravel()])

    model = StateModel(('a', 'b'), lambda x, t: (F(t) @ x) + np.array([[t], [1.0]]), e, noise,
                       time_dependent=True)
    exact = solve_ivp(moments, (0.3, 1.5), [1.0, 2.0, 0, 0, 0, 0], rtol=1e-9).y[:, -1]
    x = simulate(model, start(1.0, 2.0, count=20_000), [0.3, 0.8, 1.5], rng(), 100)[-1]
    # steps of 0.006: covariances of about 7 are off by one step's share, halved: 7 * 0.006 / 2
    check_moments(x, exact[:2], exact[2:].reshape(2, 2), extra=0.02)


def test_moments_converge_at_first_order_in_the_length_of_a_substep():
    mu, seconds = -1.0, 1.0
    model = SYSTEMS['geometric_brownian_motion'](mu=mu, sigma=0.02).model
    x0, steps = start(1.0, count=4_000), np.array([2, 4, 8, 16])
    errors = [abs(last(model, x0, seconds, n).mean() - np.exp(mu * seconds)) for n in steps]
    # so little noise leaves 0.02 exp(-1) / sqrt(4000) = 1e-4 beside the least error, 0.012
    order = -np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert order == pytest.approx(1.0, abs=0.15)


def test_substeps_make_a_steep_drift_harmless():
    model = SYSTEMS['double_well']().model
    coarse = simulate(model, start(3.0, count=10), np.arange(6) * 0.2, rng())
    fine = simulate(model, start(3.0, count=10), np.arange(6) * 0.2, rng(), substeps=20)
    assert np.all(np.abs(coarse[-1]) > 1e9) and np.all(np.abs(fine[-1] - 1) < 0.3)


def test_paths_that_leave_the_box_are_drawn_anew():
    model, times, draws = SYSTEMS['wiener']().model, np.arange(0, 2, 0.05), []

    def draw(generator):
        draws.append(generator.normal(size=1))
        return draws[-1]

    path = simulate_inside(model, draw, times, rng(3), [-1.0], [0.9])
    assert path.shape == (40, 1) and path[0].tolist() == draws[-1].tolist()
    generator = rng(3)
    drawn = [simulate(model, generator.normal(size=1), times, generator) for _ in draws]
    assert drawn[-1].tobytes() == path.tobytes()
    assert [path.min() >= -1 and path.max() <= 0.9 for path in drawn] == (
        [False] * (len(drawn) - 1) + [True])
    # of those that left, some came back
    assert any(-1 <= path[-1, 0] <= 0.9 for path in drawn[:-1])


def test_says_where_no_path_stays_in_the_box():
    with pytest.raises(RuntimeError, match=r'^attempts: expected .* got none in 7$'):
        simulate_inside(SYSTEMS['wiener']().model, lambda generator: [5.0], [0.0, 1.0], rng(),
                        [-1.0], [1.0], attempts=7)


def test_measurements_have_the_mean_h_and_the_covariance_r_of_their_time():
    R = np.array([[2.0, 0.7], [0.7, 1.0]])
    sensor = Sensor(lambda x, t: np.stack([x[0] + t, x[0] * x[1]]), lambda t: R * t)
    y = measure(sensor, start(1.0, 3.0, count=40_000), 4.0, rng())
    check_moments(y, [5.0, 3.0], 4 * R)
    assert measure(sensor, [1.0, 3.0], 4.0, rng()).shape == (2,)


def test_measured_angles_stay_on_the_circle():
    sensor = Sensor(lambda x, t: x, np.eye(2), angular=(True, False))
    y = measure(sensor, start(3.0, 3.0, count=20_000), 0.0, rng())
    assert np.all(np.abs(y[0]) <= np.pi) and y[0].min() < -2 and y[1].max() > np.pi
    # the mean direction of a wrapped Gaussian is that of the Gaussian, within 1 / sqrt(20000)
    assert np.angle(np.exp(1j * y[0]).mean()) == pytest.approx(3.0, abs=5 * 0.012)


def test_a_measured_path_begins_at_0_and_its_increments_have_the_covariance_c_dt():
    C = np.array([[0.5, 0.2], [0.2, 0.3]])
    times = np.array([0.0, 0.5, 0.6])
    sensor = Sensor(lambda x, t: np.stack([x[0], -2 * x[0]]), C)
    y = measure_path(sensor, np.ones((3, 1, 40_000)), times, rng())
    assert y.shape == (3, 2, 40_000) and not y[0].any()
    check_moments(y[1], [0.5, -1.0], C * 0.5)
    check_moments(y[2] - y[1], [0.1, -0.2], C * 0.1)
    together = np.concatenate([y[1], y[2] - y[1]])
    assert np.all(np.abs(np.cov(together)[:2, 2:]) < 5 * 0.5 / 200)


def test_a_measured_path_whose_noise_changes_with_time_has_the_covariance_of_its_time():
    sensor = Sensor(lambda x, t: x[0] * np.ones((2,) + (1,) * (x.ndim - 1)),
                    lambda t: t * np.array([[0.5, 0.2], [0.2, 0.3]]))
    y = measure_path(sensor, np.ones((3, 1, 40_000)), [1.0, 3.0, 3.5], rng())
    C = np.array([[0.5, 0.2], [0.2, 0.3]])
    check_moments(y[1], [2.0, 2.0], C * 2)
    check_moments(y[2] - y[1], [0.5, 0.5], 3 * C * 0.5)


def test_a_measured_path_gathers_h_and_not_its_value_at_one_end():
    sensor = Sensor(lambda x, t: x**2 + t, [[1e-16]], time_dependent=True)
    times = np.linspace(0.0, 1.0, 101)
    y = measure_path(sensor, times[:, None], times, rng())
    # 1 / 3 + 1 / 2; the rule has the error h'' dt^2 / 12 = 2e-5, and the noise 1e-8
    assert y[-1, 0] == pytest.approx(5 / 6, abs=3e-5)


def test_a_coarse_measured_path_has_the_moments_of_the_continuous_one():
    model = SYSTEMS['wiener']().model
    times, sensor = np.array([0.0, 1.0, 2.0]), Sensor(lambda x, t: x, [[0.04]])
    fine = refined(times, 20)
    x = simulate(model, np.zeros((1, 20_000)), fine, rng())
    y = measure_path(sensor, x, fine, rng(2))[::20]
    # the integral of Brownian motion has the variance t^3 / 3, and t^2 / 2 with its end; cutting
    # it into 20 leaves out 1 / 12 / 20^2 of it
    check_moments(np.concatenate([y[1], x[20]]), [0, 0], [[1 / 3 + 0.04, 0.5], [0.5, 1.0]],
                  extra=0.001)


def test_finer_times_hold_the_coarse_ones_bit_for_bit():
    times = np.array([0.1, 0.4, 0.45, 1.3])
    fine = refined(times, 7)
    assert fine[::7].tobytes() == times.tobytes() and len(fine) == 22
    assert np.all(np.diff(fine) > 0)
