"""Moves of paths: each leaves the posterior as it is."""

import numpy as np
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.path_monte_carlo import hamiltonian, particles, PathPosterior, tempering
from pif_ros.core.path_monte_carlo.hamiltonian import Precision, Tuning
import pytest

MS = 1_000_000
F = np.array([[-0.6, 1.8], [-1.5, -0.2]])
E = np.array([[0.9, 0.2], [0.1, 1.4]])
H, R = np.array([[1.0, -0.5]]), np.array([[0.3]])
MEAN, COVARIANCE = np.array([0.5, -0.3]), np.array([[0.5, 0.1], [0.1, 0.3]])
MEASURED = [(t * MS, 's', [y]) for t, y in (
    (100, 1.0), (150, 0.2), (250, 0.9), (350, 0.7), (400, -0.1))]


def posterior_of(r, changing=False):
    """Return a posterior that is Gaussian: a linear model, with steps of 100 and of 50 ms."""
    model = StateModel(('a', 'b'), lambda x, t: np.tensordot(F, x, 1),
                       (lambda t: E * (1 + t)) if changing else E)
    return PathPosterior(model, {'s': Sensor(lambda x, t: np.tensordot(H, x, 1), R)},
                         KernelSettings(0.1, r=r), MEAN, COVARIANCE, MEASURED, 0)


def exact(posterior, changing=False, share=1.0):
    """
    Return mean (n (N + 1),) and covariance of the path, by least squares, state by state.

    share: of the log likelihood, as that of a noise of R / share.
    """
    t, r = np.array(posterior.stamps_ns) / 1e9, posterior.kernel.r
    length = len(t)
    rows, wanted = [np.eye(2, 2 * length)], [MEAN]
    noises = [COVARIANCE]
    for k in range(length - 1):
        eps, row = t[k + 1] - t[k], np.zeros((2, 2 * length))
        row[:, 2 * k:2 * k + 2] = -np.eye(2) - (1 - r) * eps * F
        row[:, 2 * k + 2:2 * k + 4] = np.eye(2) - r * eps * F
        factor = 1 + t[k] + r * eps if changing else 1
        rows, wanted = rows + [row], wanted + [np.zeros(2)]
        noises.append(eps * E @ E.T * factor**2)
    for stamp, _, y in MEASURED:
        k, row = posterior.stamps_ns.index(stamp), np.zeros((1, 2 * length))
        row[:, 2 * k:2 * k + 2] = H
        rows, wanted, noises = rows + [row], wanted + [y], noises + [R / share]
    precision = sum(a.T @ np.linalg.solve(S, a) for a, S in zip(rows, noises))
    covariance = np.linalg.inv(precision)
    return covariance @ sum(a.T @ np.linalg.solve(S, b)
                            for a, b, S in zip(rows, wanted, noises)), covariance


def drawn(mean, covariance, count, rng):
    """Return paths (2, N + 1, count) of a Gaussian."""
    z = rng.standard_normal((len(mean), count))
    flat = mean[:, None] + np.linalg.cholesky(covariance) @ z
    return flat.reshape(-1, 2, count).transpose(1, 0, 2)


def assert_distributed(paths, mean, covariance):
    """Check the first two moments of independent paths against a Gaussian's."""
    flat = paths.transpose(1, 0, 2).reshape(len(mean), -1)
    count = flat.shape[1]
    z = np.linalg.solve(np.linalg.cholesky(covariance), flat - mean[:, None])
    # of 12 means and 78 second moments none is 4.5 standard errors off, by chance 6e-4
    assert np.abs(z.mean(axis=1)).max() * np.sqrt(count) < 4.5
    errors = (z @ z.T / count - np.eye(len(mean))) * np.sqrt(count)
    assert (np.abs(errors) / np.sqrt(1 + np.eye(len(mean)))).max() < 4.5


def tuned(mass, step):
    return Tuning(np.ones(1), (mass,), np.array([step]))


WAYS = pytest.mark.parametrize('r, changing', [(0.0, False), (0.5, False), (1.0, True)])


@WAYS
@pytest.mark.parametrize('count, draw_below', [(3, 2.0), (5, 0.5)])
def test_particle_moves_of_few_particles_leave_the_posterior_as_it_is(
        r, changing, count, draw_below, monkeypatch):
    # from exact draws on, so that whatever a move spoils grows; with draws at every step, and
    # with as many as there usually are
    monkeypatch.setattr(particles, 'RESAMPLE', draw_below)
    monkeypatch.setattr(particles, 'MORE_AT_FIRST', 2)
    posterior, rng = posterior_of(r, changing), np.random.default_rng(count)
    mean, covariance = exact(posterior, changing)
    paths = before = drawn(mean, covariance, 8000, rng)
    for _ in range(15):
        paths = particles.renewed(posterior, paths, count, rng)
    assert_distributed(before, mean, covariance)
    assert_distributed(paths, mean, covariance)
    assert np.mean(np.any(paths != before, axis=0), axis=1).min() > 0.5


@WAYS
def test_hamiltonian_moves_leave_each_share_of_the_likelihood_as_it_is(r, changing):
    # far too long a step and crude preconditioners: a fair part is rejected, and rightly so
    posterior, rng = posterior_of(r, changing), np.random.default_rng(1)
    shares = np.array([1.0, 0.2])
    laws = [exact(posterior, changing, share) for share in shares]
    before = np.concatenate([drawn(*law, 8000, rng) for law in laws], axis=2)
    masses = []
    for share in shares:
        diagonal, below = posterior.curvature(before, share)
        masses.append(Precision(diagonal * np.array([[2.0, 0.3], [0.3, 0.7]]), below * 0.5))
    tuning = Tuning(shares, tuple(masses), np.array([1.0, 1.2]))
    moved = hamiltonian.move(posterior, before, tuning, 3, rng)
    for part, law in zip((slice(8000), slice(8000, None)), laws):
        assert 0.2 < moved.acceptance[part].mean() < 0.8
        assert_distributed(moved.paths[..., part], *law)


def test_small_steps_keep_the_energy_and_are_accepted():
    posterior, rng = posterior_of(0.5), np.random.default_rng(2)
    mean, covariance = exact(posterior)
    before = drawn(mean, covariance, 200, rng)
    mass = Precision(*posterior.curvature(before))
    lost = [1 - hamiltonian.move(posterior, before, tuned(mass, step), round(2 / step),
                                 np.random.default_rng(3)).acceptance.mean()
            for step in (0.4, 0.2, 0.1)]
    # the leapfrog's energy error is of second order in its step
    orders = np.log2(np.divide(lost[:-1], lost[1:]))
    assert np.all((1.7 < orders) & (orders < 2.3))
    assert lost[-1] < 0.01


def test_a_path_that_flies_away_is_not_accepted():
    posterior, rng = posterior_of(0.5), np.random.default_rng(2)
    before = drawn(*exact(posterior), 10, rng)
    mass = Precision(*posterior.curvature(before))
    moved = hamiltonian.move(posterior, before, tuned(mass, 1e200), 5, rng)
    np.testing.assert_array_equal(moved.paths, before)
    np.testing.assert_array_equal(moved.acceptance, 0)


def test_a_filter_without_a_path_to_hold_gives_nearly_the_posterior():
    posterior, rng = posterior_of(0.5), np.random.default_rng(7)
    mean, covariance = exact(posterior)
    paths = particles.begun(posterior, 500, 100, rng)
    flat = paths.transpose(1, 0, 2).reshape(len(mean), -1)
    spread = np.sqrt(np.diag(covariance))
    # 1 / sqrt(500) of a standard deviation by chance, and 1 / 100 of bias
    assert np.abs((flat.mean(axis=1) - mean) / spread).max() < 0.2
    assert np.abs(flat.std(axis=1) / spread - 1).max() < 0.2


def test_particles_that_all_fail_leave_the_path_where_it_is():
    # the measurement allows only what the path has
    posterior = PathPosterior(
        StateModel(('x',), lambda x, t: 0 * x, np.eye(1)),
        {'s': Sensor(lambda x, t: np.where(x == 0.25, x, np.nan), [[1.0]])},
        KernelSettings(0.1), [0.0], [[1.0]], [(100 * MS, 's', [0.0]), (300 * MS, 's', [0.0])], 0)
    before = np.full((1, 4, 3), 0.25)
    after = particles.renewed(posterior, before, 10, np.random.default_rng(0))
    np.testing.assert_array_equal(after[:, 1], before[:, 1])
    np.testing.assert_array_equal(after[:, 3], before[:, 3])


# Exchanges


def test_exchanges_leave_each_share_of_the_likelihood_as_it_is():
    posterior, rng, count = posterior_of(0.5), np.random.default_rng(4), 30_000
    shares = np.array([1.0, 0.3, 0.05])
    laws = [exact(posterior, share=share) for share in shares]
    paths = np.concatenate([drawn(*law, count, rng) for law in laws], axis=2)
    for number in range(10):
        log_l = posterior.log_likelihood(paths).reshape(3, -1)
        swap = tempering.exchange(log_l, shares, bool(number % 2), rng)
        paths = paths[..., (swap.order * count + np.arange(count)).ravel()]
        assert np.flatnonzero(np.isfinite(swap.acceptance)).tolist() == [number % 2]
        assert 0.2 < np.nanmean(swap.acceptance) < 0.9
    for group, law in zip(np.split(paths, 3, axis=2), laws):
        assert_distributed(group, *law)


def test_a_likelihood_that_is_none_is_not_exchanged_for_one():
    log_l = np.array([[0.0, -np.inf, -np.inf], [-np.inf, 0.0, -np.inf]])
    swap = tempering.exchange(log_l, np.array([1.0, 0.5]), False, np.random.default_rng(0))
    np.testing.assert_array_equal(swap.order, [[0, 1, 0], [1, 0, 1]])


def test_shares_are_respaced_until_neighbours_exchange_equally_often():
    # rejections that are a length: the integral of 1 / (share + 0.1) between neighbours, scaled
    shares = tempering.first_shares(7, 0.05)
    assert shares[0] == 1 and shares[-1] == pytest.approx(0.05) and np.all(np.diff(shares) < 0)
    for _ in range(6):
        rejected = -np.diff(np.log(shares + 0.1)) / 5
        shares = tempering.respaced(shares, 1 - rejected)
    rejected = -np.diff(np.log(shares + 0.1))
    assert shares[0] == 1 and shares[-1] == pytest.approx(0.05)
    np.testing.assert_allclose(rejected, rejected.mean(), rtol=0.02)


def test_a_precision_is_its_dense_matrix():
    rng = np.random.default_rng(0)
    root = np.zeros((12, 12))
    for k in range(4):
        root[3 * k:3 * k + 3, 3 * k:3 * k + 3] = np.tril(rng.normal(size=(3, 3))) + 3 * np.eye(3)
        root[3 * k + 3:3 * k + 6, 3 * k:3 * k + 3] = rng.normal(size=(3, 3))[:max(0, 9 - 3 * k)]
    M = root @ root.T
    blocks = M.reshape(4, 3, 4, 3).transpose(0, 2, 1, 3)
    precision = Precision(blocks[range(4), range(4)], blocks[range(1, 4), range(3)])
    v = rng.normal(size=(3, 4, 5))
    flat = v.transpose(1, 0, 2).reshape(12, 5)
    for found, dense in ((precision.solve(v), np.linalg.solve(M, flat)),
                         (precision.coloured(v), np.linalg.cholesky(M) @ flat)):
        np.testing.assert_allclose(found.transpose(1, 0, 2).reshape(12, 5), dense, rtol=1e-10)
