"""The particle filter."""

import warnings

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from oracles import gaussian, kalman
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import ParticleBelief, ParticleFilter
from pif_ros.core.rivals.cloud import systematic
from pif_ros.core.systems import benes, ornstein_uhlenbeck, sine_cubic_drift, wiener
from pif_ros.core.tracker import Tracker
import pytest
from scipy import stats

SECOND = 1_000_000_000
SEEDS = st.integers(0, 2**32 - 1)
F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
LINEAR = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
H, R = np.array([[1.0, -0.5], [0.3, 1.0]]), np.array([[0.2, 0.12], [0.12, 0.15]])
SENSORS = {'both': Sensor(lambda x, t: np.tensordot(H, x, 1), R)}
MEAN, COVARIANCE = np.array([0.5, -0.3]), np.array([[0.2, 0.1], [0.1, 0.15]])
#: One Euler step of 0.5 throws what is far out further out still.
CUBIC = StateModel(('x',), lambda x, t: x - x**3, np.eye(1))


def direct(variance=1.0):
    return Sensor(lambda x, t: x, [[variance]])


def track(filter_, belief, measurements, gap):
    """Yield belief and log evidence after each of some measurements."""
    [name] = filter_.sensors
    for k, y in enumerate(measurements):
        belief = filter_.predict(belief, k * gap, (k + 1) * gap)
        belief, log_evidence = filter_.correct(belief, y, name, (k + 1) * gap)
        yield belief, log_evidence


def cloud(points, log_weights=None, box=None):
    """Return a belief of particles (n, N), equal ones where no weights are given."""
    points = np.asarray(points, dtype=float)
    equal = np.full(points.shape[1], -np.log(points.shape[1]))
    return ParticleBelief(points, equal if log_weights is None else np.asarray(log_weights), box)


def same_bits(one, other):
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.log_weights, other.log_weights)


# Against exact filters


def euler_kalman(ys, h, substeps):
    """Return mean, covariance and log evidence for the chain that Euler makes of LINEAR."""
    m, P, log_evidence = MEAN, COVARIANCE, 0.0
    A, noise = np.eye(2) + h * F, h * E @ Q @ E.T
    for y in ys:
        for _ in range(substeps):
            m, P = A @ m, A @ P @ A.T + noise
        v, S = y - H @ m, H @ P @ H.T + R
        log_evidence += np.log(gaussian(v, np.zeros(2), S))
        gain = P @ H.T @ np.linalg.inv(S)
        m, P = m + gain @ v, P - gain @ H @ P
    return m, P, log_evidence


def simulated(steps, h, substeps):
    """Return what is measured along a path that Euler's method makes of LINEAR."""
    rng = np.random.default_rng(3)
    x, ys = rng.multivariate_normal(MEAN, COVARIANCE), []
    for _ in range(steps):
        for _ in range(substeps):
            x = x + h * F @ x + E @ rng.multivariate_normal(np.zeros(3), h * Q)
        ys.append(H @ x + rng.multivariate_normal(np.zeros(2), R))
    return np.array(ys)


def runs(particles, seeds, threshold=0.5):
    """Return means (seeds, 2), covariances and total log evidences of runs on the same data."""
    ys, found = simulated(6, 0.05, 4), []
    for seed in range(seeds):
        filter_ = ParticleFilter(LINEAR, SENSORS, 0.05, None, particles, seed, threshold)
        steps = list(track(filter_, filter_.gaussian(MEAN, COVARIANCE), ys, 4 * SECOND // 20))
        belief = steps[-1][0]
        found.append((belief.mean(), belief.covariance(), sum(e for _, e in steps)))
    return (*map(np.array, zip(*found)), *euler_kalman(ys, 0.05, 4))


@pytest.mark.parametrize('threshold', [0.0, 0.5, 1.0])
def test_evidence_is_without_bias_and_moments_are_the_kalman_filters(threshold):
    means, covariances, logs, m, P, log_exact = runs(500, 100, threshold)
    ratio = np.exp(logs - log_exact)
    error = ratio.std() / np.sqrt(len(ratio))
    # four standard errors, of which one is small enough to tell
    assert error < 0.09
    assert abs(ratio.mean() - 1) < 4 * error
    if not threshold:
        # a handful of particles is left, and a mean over so few is biased
        return
    # a weighted mean has a bias of a few P^(1/2) / N, 0.002, beside its standard error
    np.testing.assert_allclose(means.mean(axis=0), m,
                               atol=4 * means.std(axis=0).max() / 10 + 0.002)
    np.testing.assert_allclose(covariances.mean(axis=0), P,
                               atol=4 * covariances.std(axis=0).max() / 10 + 0.002)


def test_errors_fall_with_the_root_of_the_number_of_particles():
    few, many = runs(250, 40), runs(4000, 40)
    for one, other in ((few[0], many[0]), (few[2], many[2])):
        # 4, and each of the two known to 1 / sqrt(2 * 40) = 11 %, so 16 %; three of these
        ratio = one.std(axis=0) / other.std(axis=0)
        assert np.all(np.abs(np.log(ratio / 4)) < 3 * 0.16)


def test_equals_the_exact_filter_where_the_belief_is_two_humps():
    # f = tanh x, y = x + w: the posterior is cosh(x) N(m, P) over its integral, with m and P of
    # the Kalman filter of Brownian motion
    filter_ = ParticleFilter(benes().model, {'far': direct(25.0)}, 0.02, None, 20_000, seed=1)
    ys = np.array([[0.5], [-1.0], [0.8], [0.2]])
    # N(0.1, 0.2) cosh(x) is the even mixture of N(0.1 +- 0.2, 0.2), weighed by exp(+- 0.1)
    start = filter_.gaussian([0.0], [[0.2]])
    up = np.arange(20_000) < 20_000 / (1 + np.exp(-0.2))
    belief = cloud(start.points + 0.1 + np.where(up, 0.2, -0.2))
    exact = kalman(np.zeros((1, 1)), np.eye(1), [0.1], [[0.2]], [
        (1.0, y, np.eye(1), np.array([[25.0]])) for y in ys])
    for (belief, _), m, P, _ in zip(track(filter_, belief, ys, SECOND), *exact):
        mean, variance = m + P @ np.tanh(m), P + P**2 * (1 - np.tanh(m)**2)
        # four standard errors with the fewest that are effective, N / 2, and Euler's h / 2
        error = 4 * np.sqrt(variance[0, 0] / 10_000) + 0.01
        assert belief.mean()[0] == pytest.approx(mean[0], abs=error)
        assert belief.covariance()[0, 0] == pytest.approx(variance[0, 0], rel=0.05)


@pytest.mark.parametrize('s', [0.0, 0.5])
def test_equals_the_kalman_filter_of_the_logarithm_for_geometric_brownian_motion(s):
    # Ito's dx = mu x dt + sigma x dv is log x of drift mu - sigma^2 / 2
    mu, sigma, gap, R = 0.3, 0.4, 0.5, 0.04
    model = StateModel(('x',), lambda x, t: (mu - s * sigma**2) * x,
                       lambda x, t: sigma * x[None], multiplicative=True, s=s)
    filter_ = ParticleFilter(model, {'log': Sensor(lambda x, t: np.log(x), [[R]])}, 0.01, None,
                             20_000, seed=2)
    start = filter_.gaussian([0.0], [[0.1]])
    belief = ParticleBelief(np.exp(start.points), start.log_weights)
    m, P, ys = 0.0, 0.1, [[0.3], [0.1], [0.7], [0.4]]
    for (belief, log_evidence), [y] in zip(track(filter_, belief, ys, SECOND // 2), ys):
        m, P = m + (mu - sigma**2 / 2) * gap, P + sigma**2 * gap
        exact = stats.norm(m, np.sqrt(P + R)).logpdf(y)
        m, P = m + P / (P + R) * (y - m), P * R / (P + R)
        # four standard errors of a fifth of the particles, and Euler's h sigma^2
        error = 4 * np.sqrt(P / 4000) + 0.0016
        assert belief.weights @ np.log(belief.points[0]) == pytest.approx(m, abs=error)
        assert log_evidence == pytest.approx(exact, abs=4 / np.sqrt(4000))


def test_equals_the_grid_filter_with_the_same_steps_where_the_sign_is_unseen():
    # the kernel with r = 0 is that of Euler's method; [TM, Example 4]
    system = sine_cubic_drift()
    sensors = {'square': system.sensors['square']()}
    grid = DiracFeynmanFilter(system.model, Grid((-12,), (12,), (600,)), sensors,
                              KernelSettings(0.0025, r=0, weights='sampled'))
    swarm = ParticleFilter(system.model, sensors, 0.0025, None, 20_000)
    ys = np.array([1.2, 0.3, 2.4, 4.1, 3.0, 1.9])[:, None]**2
    known = track(grid, GridBelief.gaussian(grid.grid, [0.0], [[1.0]]), ys, SECOND // 20)
    found = track(swarm, swarm.gaussian([0.0], [[1.0]]), ys, SECOND // 20)
    for (density, log_exact), (belief, log_evidence) in zip(known, found):
        x, w = np.abs(grid.grid.axes[0]), density.density * grid.grid.cell_volume
        mean = w @ x
        # the second measurement is far from what is believed: some 500 particles are effective
        error = 4 * np.sqrt(w @ (x - mean)**2 / 500)
        assert belief.weights @ np.abs(belief.points[0]) == pytest.approx(mean, abs=error)
        assert log_evidence == pytest.approx(log_exact, abs=4 / np.sqrt(500))


# Steps


@pytest.mark.parametrize('s', [0.0, 0.5])
def test_a_step_has_the_mean_and_the_covariance_of_eulers(s):
    def vielbein(x, t):
        a, b = x
        return np.stack([np.stack([a, 0 * a, b]), np.stack([b, a * b, t + a])])

    model = StateModel(('a', 'b'), lambda x, t: np.stack([x[1], -x[0]]), vielbein, Q,
                       multiplicative=True, s=s)
    x, t, h, count = np.array([[1.3], [-0.7]]), 2.0, 0.01, 200_000
    belief = ParticleFilter(model, {}, h, None, count).predict(
        cloud(np.repeat(x, count, axis=1)), 2 * SECOND, 2 * SECOND + round(h * SECOND))
    e, (a, b) = vielbein(x, t)[..., 0], x[:, 0]
    # de_ia/dx_k by hand
    slopes = np.array([[[1, 0], [0, 0], [0, 1]], [[0, 1], [b, a], [1, 0]]])
    f = np.array([b, -a]) + s * np.einsum('iak,ab,kb->i', slopes, Q, e)
    g = e @ Q @ e.T
    # five standard errors
    np.testing.assert_allclose(belief.mean(), x[:, 0] + h * f, atol=5 * np.sqrt(
        h * g.max() / count))
    np.testing.assert_allclose(belief.covariance(), h * g, atol=5 * h * g.max() * np.sqrt(
        2 / count))


def test_noise_of_different_steps_is_independent_and_of_the_right_size():
    rate = StateModel(('x', 'y'), lambda x, t: np.zeros_like(x), lambda t: np.sqrt(t) * E, Q)
    filter_ = ParticleFilter(rate, {}, 0.1, None, 200_000)
    belief = filter_.predict(cloud(np.zeros((2, 200_000))), SECOND, SECOND + 1_230_000_000)
    # 12 steps of 0.1 from 1, 1.1, and one of 0.03 from 2.2; five standard errors
    g = E @ Q @ E.T * (0.1 * np.sum(1 + 0.1 * np.arange(12)) + 0.03 * 2.2)
    np.testing.assert_allclose(belief.covariance(), g, atol=5 * g.max() * np.sqrt(1e-5))


@given(cuts=st.lists(st.integers(0, 8), max_size=4), rest=st.integers(0, 499_999_999),
       start=st.sampled_from([0, 17, 2**62, 2**63 - 5 * SECOND]), seed=SEEDS,
       threshold=st.sampled_from([0.0, 0.5, 1.0]))
def test_whole_steps_in_one_call_or_in_many_give_the_same_bits(
        cuts, rest, start, seed, threshold):
    # with weights that ask for resampling, and particles that die on the way
    rng = np.random.default_rng(seed)
    log_w = rng.normal(0, rng.uniform(0, 4), size=50)
    belief = cloud(rng.normal(0, 3, size=(1, 50)), log_w - np.log(np.exp(log_w).sum()))
    filter_ = ParticleFilter(CUBIC, {}, 0.5, None, 50, seed, threshold)
    step = filter_.time_step_ns
    whole = filter_.predict(belief, start, start + 8 * step + rest)
    now = start
    for cut in sorted(start + step * cut for cut in cuts):
        belief, now = filter_.predict(belief, now, cut), cut
    same_bits(filter_.predict(belief, now, start + 8 * step + rest), whole)


def test_the_posterior_is_the_same_whatever_forecasts_were_asked_for():
    filter_ = ParticleFilter(ornstein_uhlenbeck().model, {'s': direct(0.1)}, 0.05, None, 300, 5)
    quiet, busy = (Tracker(filter_, filter_.gaussian([0.0], [[1.0]])) for _ in range(2))
    rng = np.random.default_rng(2)
    for k in range(20):
        for tracker in (quiet, busy):
            tracker.observe(Measurement(k * 170_000_001, 's', (np.sin(k),)))
        for _ in range(3):
            busy.forecast(k * 170_000_001 + int(rng.integers(0, SECOND)))
    same_bits(quiet.estimate().belief, busy.estimate().belief)
    assert quiet.estimate().total_log_evidence == busy.estimate().total_log_evidence


def test_a_seed_gives_the_same_bits_again_and_another_one_others():
    ys = np.zeros((5, 2))
    filters = [ParticleFilter(LINEAR, SENSORS, 0.05, None, 200, seed) for seed in (7, 7, 8)]
    one, again, other = ([*track(f, f.gaussian(MEAN, COVARIANCE), ys, SECOND // 5)][-1]
                         for f in filters)
    same_bits(one[0], again[0])
    assert one[1] == again[1] != other[1]
    assert not np.any(one[0].points == other[0].points)


def test_verbs_leave_the_belief_they_are_given_alone():
    filter_ = ParticleFilter(LINEAR, SENSORS, 0.05, None, 100)
    belief = filter_.correct(filter_.gaussian(MEAN, COVARIANCE), [3.0, -2.0], 'both', 0)[0]
    points, log_weights = belief.points.copy(), belief.log_weights.copy()
    filter_.correct(filter_.predict(belief, 0, SECOND), [0.0, 0.0], 'both', SECOND)
    same_bits(belief, ParticleBelief(points, log_weights))


# Resampling


@given(SEEDS, st.integers(1, 40))
def test_systematic_resampling_has_no_bias_and_no_count_is_off_by_one(seed, count):
    rng = np.random.default_rng(seed)
    weights = rng.exponential(size=count)**4 * (rng.random(count) < 0.8)
    weights[rng.integers(count)] += 1e-3
    share = count * weights / weights.sum()
    combs = (np.arange(500) + 0.5) / 500
    counts = np.array([np.bincount(systematic(weights, u), minlength=count) for u in combs])
    assert np.all(counts.sum(axis=1) == count)
    assert np.all(np.abs(counts - share) < 1)
    assert np.all(counts[:, weights == 0] == 0)
    # the mean over u, summed at midpoints: each count jumps twice
    np.testing.assert_allclose(counts.mean(axis=0), share, atol=2 / 500)


@pytest.mark.parametrize('u', [0.0, 1e-300, 0.5, np.nextafter(1, 0)])
def test_no_tooth_of_the_comb_is_lost_to_rounding(u):
    for count in [*range(1, 300), 5000, 100_000]:
        weights = np.append(np.random.default_rng(count).random(count), np.zeros(3))
        picks = systematic(weights, u)
        assert len(picks) == len(weights) and picks.max() < count and np.all(np.diff(picks) >= 0)


def test_the_cloud_is_resampled_before_a_step_when_it_is_thin():
    filter_ = ParticleFilter(wiener().model, {}, 0.1, None, 4)
    for weights, thin in (([0.25] * 4, False), ([0.4, 0.4, 0.1, 0.1], False),
                          ([0.9, 0.1, 0.0, 0.0], True)):
        with np.errstate(divide='ignore'):
            belief = cloud([[0.0, 10.0, 20.0, 30.0]], np.log(weights))
        after = filter_.predict(belief, 0, SECOND // 10)
        assert (after.effective_size == pytest.approx(4)) == (thin or weights[0] == 0.25)
        assert belief.effective_size == pytest.approx(1 / np.sum(np.square(weights)))
        if thin:
            # 0.9 of 4 are 3 or 4, 0.1 are none or one
            assert np.sum(np.abs(after.points[0]) < 5) >= 3 and after.points.max() < 15


# Soundness


@pytest.mark.parametrize('y', [5.0, 50.0, -50.0, 1e6])
def test_after_an_outlier_all_numbers_are_finite_and_the_filter_recovers(y):
    filter_ = ParticleFilter(wiener().model, {'s': direct()}, 0.1, None, 500)
    belief = filter_.gaussian([0.0], [[0.01]])
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        for k in range(40):
            belief, log_evidence = filter_.correct(belief, [y if k < 3 else 0.0], 's', k * SECOND)
            assert np.isfinite(log_evidence) and belief.mass == pytest.approx(1)
            belief = filter_.predict(belief, k * SECOND, (k + 1) * SECOND)
            assert np.all(np.isfinite([belief.mean()[0], belief.covariance()[0, 0]]))
    assert abs(belief.mean()[0]) < 1


def test_an_outlier_is_weighed_by_bayes_rule_as_far_as_the_particles_reach():
    # particles on a lattice stand for a density, here N(0, 1); y is 50 standard deviations away
    x = np.linspace(-40, 40, 8001)
    belief = cloud(x[None], stats.norm.logpdf(x) + np.log(0.01))
    filter_ = ParticleFilter(wiener().model, {'s': direct()}, 0.1)
    belief, log_evidence = filter_.correct(belief, [50.0], 's', 0)
    assert belief.mean()[0] == pytest.approx(25)
    assert log_evidence == pytest.approx(stats.norm(0, np.sqrt(2)).logpdf(50))


@pytest.mark.parametrize('function, y', [
    (lambda x, t: x, float('nan')),
    (lambda x, t: x, float('inf')),
    (lambda x, t: np.full_like(x, np.nan), 0.0),
])
def test_a_measurement_that_no_particle_allows_leaves_the_belief_and_has_no_evidence(function, y):
    filter_ = ParticleFilter(wiener().model, {'s': Sensor(function, [[1.0]])}, 0.1)
    before = filter_.gaussian([0.0], [[1.0]])
    after, log_evidence = filter_.correct(before, [y], 's', 0)
    assert after is before and log_evidence == -np.inf


def test_particles_where_the_sensor_is_undefined_are_excluded():
    def root(x, t):
        with np.errstate(invalid='ignore'):
            return np.sqrt(x)

    filter_ = ParticleFilter(wiener().model, {'root': Sensor(root, [[1.0]])}, 0.1)
    belief, log_evidence = filter_.correct(cloud([[-1.0, 1.0, 4.0, -2.0]]), [1.5], 'root', 0)
    likelihood = stats.norm([1, 2]).pdf(1.5)
    np.testing.assert_allclose(belief.weights, [0, *likelihood / likelihood.sum(), 0])
    assert log_evidence == pytest.approx(np.log(likelihood.sum() / 4))


@pytest.mark.parametrize('threshold', [0.0, 0.5])
def test_particles_that_blow_up_die_and_the_rest_goes_on(threshold):
    filter_ = ParticleFilter(CUBIC, {'s': direct()}, 0.5, None, 5, threshold=threshold)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        belief = filter_.predict(cloud([[0.1, 1e3, 0.5, -50.0, 80.0]]), 0, 3 * SECOND)
        # two effective particles of five are resampled, where 0.5 is the threshold
        assert np.count_nonzero(belief.weights) == (5 if threshold else 2)
        assert belief.mass == pytest.approx(0.4)
        assert np.all(np.isfinite(belief.points)) and np.abs(belief.mean()[0]) < 5
        corrected, log_evidence = filter_.correct(belief, [0.0], 's', 3 * SECOND)
        # the evidence counts what has died as lost
        likelihood = stats.norm.pdf(belief.points[0])
        assert log_evidence == pytest.approx(np.log(0.4 * (belief.weights @ likelihood)))
        assert corrected.mass == pytest.approx(1)


def test_when_all_particles_are_dead_the_mass_is_zero_and_nothing_else_happens():
    filter_ = ParticleFilter(CUBIC, {'s': direct()}, 0.5, Grid((-9,), (9,), (8,)), 50)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        dead = filter_.predict(filter_.gaussian([100.0], [[1.0]]), 0, 20 * SECOND)
        assert dead.mass == 0
        same_bits(filter_.predict(dead, 0, SECOND), dead)
        after, log_evidence = filter_.correct(dead, [0.0], 's', 0)
        assert after is dead and log_evidence == -np.inf
        found = [dead.mean(), dead.mode(), dead.covariance(), dead.on(filter_.box, [0]).density]
        assert all(np.all(np.isfinite(values)) for values in found)


def test_a_particle_ten_widths_of_the_box_away_is_dead_and_a_nearer_one_is_not():
    model = StateModel(('x', 'y'), lambda x, t: np.array([[1.0], [0.0]]) + 0 * x, 1e-9 * np.eye(2))
    filter_ = ParticleFilter(model, {}, 1.0, Grid((0, -np.pi), (4, np.pi), (4, 4), (False, True)),
                             threshold=0.0)
    points = np.array([[40.9, 41.1, -38.1, 2.0], [0.0, 0.0, 0.0, 400.0]])
    belief = filter_.predict(cloud(points, box=filter_.box), 0, SECOND)
    np.testing.assert_array_equal(np.isfinite(belief.log_weights), [True, False, True, True])
    # without a box there is no telling
    free = ParticleFilter(model, {}, 1.0, threshold=0.0)
    assert free.predict(cloud(points), 0, SECOND).mass == pytest.approx(1)


def test_remarks_say_when_the_step_is_too_long_for_the_box():
    # of x - x^3 an Euler step of h throws out what lies beyond (1 + 2 / h)^(1/2) or so: 2.2 at
    # 0.5 s, and 14 at 0.01 s
    box = Grid((-10,), (10,), (20,))
    [remark] = ParticleFilter(CUBIC, {}, 0.5, box).remarks()
    assert remark.startswith('kernel.time_step: ') and '0.5 s' in remark
    dead = float(remark.split()[1].rstrip('%'))
    # 78 % start beyond, and noise of 0.7 throws out some more
    assert 70 < dead < 97
    assert ParticleFilter(CUBIC, {}, 0.01, box).remarks() == []
    assert ParticleFilter(CUBIC, {}, 0.5).remarks() == []


def test_noise_that_vanishes_at_times_is_no_noise_then():
    model = StateModel(('x', 'y'), lambda x, t: np.ones_like(x), np.eye(2),
                       lambda t: np.diag([0.0, t]))
    belief = ParticleFilter(model, {}, 0.1).predict(cloud(np.zeros((2, 9))), 0, SECOND // 10)
    np.testing.assert_allclose(belief.points, 0.1)


def test_ten_states_need_no_box():
    model = StateModel(tuple(f'x{i}' for i in range(10)), lambda x, t: -x, np.eye(10))
    filter_ = ParticleFilter(model, {'s': Sensor(lambda x, t: x, np.eye(10))}, 0.05, None, 20_000)
    belief = filter_.predict(filter_.gaussian(np.ones(10), np.eye(10)), 0, SECOND)
    # Euler's variance of the 20 steps; five standard errors
    variance = 0.95**40 + 0.05 * np.sum(0.95**(2 * np.arange(20)))
    np.testing.assert_allclose(belief.mean(), 0.95**20, atol=5 * np.sqrt(variance / 20_000))
    np.testing.assert_allclose(belief.covariance(), variance * np.eye(10), atol=0.05)
    # ten axes leave a handful of particles in a cell
    assert np.all(np.abs(belief.mode()) < 2)


# Circles


def test_moments_and_mode_of_a_cloud_across_the_cut_are_those_of_one_away_from_it():
    box = Grid((-np.pi, 0), (np.pi, 4), (36, 8), (True, False))
    rng = np.random.default_rng(9)
    away = np.stack([rng.normal(0, 0.4, 2000), rng.uniform(0, 4, 2000)])
    across = away + [[np.pi - 0.1], [0]]
    across[0] = (across[0] + np.pi) % (2 * np.pi) - np.pi
    one, other = cloud(away, box=box), cloud(across, box=box)
    # the circular mean is near the mean, not the mean
    shift = one.mean() + [np.pi - 0.1, 0] - other.mean()
    np.testing.assert_allclose((shift + np.pi) % (2 * np.pi) - np.pi, 0, atol=1e-12)
    np.testing.assert_allclose(one.covariance(), other.covariance(), atol=1e-12)
    shift = one.mode() + [np.pi - 0.1, 0] - other.mode()
    np.testing.assert_allclose((shift + np.pi) % (2 * np.pi) - np.pi, 0, atol=1e-9)
    np.testing.assert_allclose(one.on(box, [0]).covariance(), one.covariance()[:1, :1], rtol=0.05)


def test_states_that_go_round_stay_in_the_box_and_bearings_are_compared_on_the_circle():
    model = StateModel(('theta',), lambda x, t: np.full_like(x, 3.0), 0.3 * np.eye(1))
    box = Grid((-np.pi,), (np.pi,), (36,), (True,))
    filter_ = ParticleFilter(model, {'compass': Sensor(lambda x, t: x, [[0.01]], (True,))}, 0.1,
                             box, 4000)
    belief = filter_.predict(filter_.gaussian([3.0], [[0.01]]), 0, SECOND)
    assert np.all((-np.pi <= belief.points) & (belief.points <= np.pi))
    # four standard errors
    assert belief.mean()[0] == pytest.approx(6 - 2 * np.pi, abs=4 * np.sqrt(0.1 / 4000))
    start = filter_.gaussian([3.1], [[0.02]])
    belief, _ = filter_.correct(start, [-3.1], 'compass', 0)
    assert belief.mean()[0] == pytest.approx(3.1 + (2 * np.pi - 6.2) * 2 / 3 - 2 * np.pi,
                                             abs=4 * np.sqrt(0.02 / 3 / 2000))


# What can be read off


def test_on_the_cells_of_a_grid_it_is_the_histogram_of_the_axes_asked_for():
    rng = np.random.default_rng(11)
    grid = Grid((-1, -2, 0), (1, 2, 2 * np.pi), (5, 6, 7), (False, False, True))
    points = rng.normal(0, [[0.5], [1.5], [4.0]], size=(3, 3000))
    log_w = rng.normal(size=3000)
    belief = cloud(points, log_w - np.log(np.exp(log_w).sum()))
    found = belief.on(grid, [2, 0])
    counts, _, _ = np.histogram2d(points[2] % (2 * np.pi), points[0], (7, 5),
                                  ((0, 2 * np.pi), (-1, 1)), weights=belief.weights)
    assert found.grid == grid.select([2, 0])
    np.testing.assert_allclose(found.density * found.grid.cell_volume, counts, atol=1e-15)
    assert found.mass == pytest.approx(belief.weights[np.abs(points[0]) <= 1].sum())


def test_the_mode_is_in_the_denser_of_two_humps_and_not_between_them():
    rng = np.random.default_rng(12)
    humps = np.concatenate([rng.normal(-2, 0.4, size=(2, 2800)),
                            rng.normal(3, 0.4, size=(2, 2200))], axis=1)
    # half a standard deviation of a hump
    np.testing.assert_allclose(cloud(humps).mode(), -2, atol=0.2)
    # the same by weights
    weights = np.where(np.arange(5000) < 2800, 1.0, 2.0)
    np.testing.assert_allclose(
        cloud(humps, np.log(weights / weights.sum())).mode(), 3, atol=0.2)
    # one that carries all
    with np.errstate(divide='ignore'):
        alone = np.log(np.arange(5000) == 17)
    np.testing.assert_allclose(cloud(humps, alone).mode(), humps[:, 17])
    assert cloud(np.full((2, 9), 5.0)).mode() == pytest.approx([5, 5])


def test_moments_about_a_point_are_those_about_the_mean_and_the_distance_squared():
    belief = cloud(np.random.default_rng(13).normal(size=(2, 100)))
    about = np.array([1.0, -2.0])
    d = belief.mean() - about
    np.testing.assert_allclose(belief.covariance(about), belief.covariance() + np.outer(d, d))


def test_starts_with_the_moments_that_are_asked_for():
    box = Grid((-1, 2), (3, 8), (5, 5))
    filter_ = ParticleFilter(LINEAR, {}, 0.1, box, 100_000)
    belief = filter_.gaussian(MEAN, COVARIANCE)
    # five standard errors
    np.testing.assert_allclose(belief.mean(), MEAN, atol=5 * np.sqrt(0.2e-5))
    np.testing.assert_allclose(belief.covariance(), COVARIANCE, atol=5 * 0.2 * np.sqrt(2e-5))
    even = filter_.uniform()
    assert np.all(box.contains(even.points)) and even.mass == pytest.approx(1)
    cells = even.on(box, [0, 1]).density.ravel() * box.cell_volume * 100_000
    assert stats.chisquare(cells).pvalue > 1e-3


# Refusals


@pytest.mark.parametrize('settings', [
    {'particles': 0}, {'particles': 2.5}, {'particles': float('nan')}, {'seed': -1},
    {'seed': 0.5}, {'threshold': 1.1}, {'threshold': float('nan')}, {'time_step': 0.0},
    {'box': Grid((0,), (1,), (4,))}])
def test_refuses_settings_that_make_no_filter(settings):
    [name] = settings
    with pytest.raises(ValueError, match=f'{name}: expected .* got'):
        ParticleFilter(LINEAR, {}, **{'time_step': 0.1, **settings})


def test_refuses_a_start_that_is_no_gaussian_and_to_predict_backwards():
    filter_ = ParticleFilter(LINEAR, {}, 0.1)
    with pytest.raises(ValueError, match='mean: expected'):
        filter_.gaussian([np.nan, 0], COVARIANCE)
    with pytest.raises(ValueError, match='covariance: expected'):
        filter_.gaussian(MEAN, np.zeros((2, 2)))
    with pytest.raises(ValueError, match='box: expected'):
        filter_.uniform()
    with pytest.raises(ValueError, match='to_ns: expected a stamp from 5 on, got 4'):
        filter_.predict(filter_.gaussian(MEAN, COVARIANCE), 5, 4)
