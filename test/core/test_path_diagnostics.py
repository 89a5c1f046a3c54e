"""Whether chains have mixed, and what they are worth."""

import numpy as np
from pif_ros.core.path_monte_carlo import effective_sample_size, split_r_hat
from pif_ros.core.path_monte_carlo.diagnostics import standard_error
import pytest
from scipy.signal import lfilter


def autoregressive(phi, chains, draws, seed=0):
    """Return stationary chains x_k = phi x_(k-1) + w of unit variance, (chains, draws)."""
    rng = np.random.default_rng(seed)
    w = rng.standard_normal((chains, draws)) * np.sqrt(1 - phi**2)
    w[:, 0] = rng.standard_normal(chains)
    return lfilter([1], [1, -phi], w, axis=1)


# Effective sample size


@pytest.mark.parametrize('phi', [-0.6, 0.0, 0.5, 0.9, 0.97])
@pytest.mark.parametrize('ranked', [False, True])
def test_autoregressive_chains_are_worth_what_their_autocorrelation_says(phi, ranked):
    # N (1 - phi) / (1 + phi): over 40 seeds the estimate itself is good to some percent, and
    # ranks of Gaussians are Gaussian
    exact = 4 * 4000 * (1 - phi) / (1 + phi)
    found = [effective_sample_size(autoregressive(phi, 4, 4000, seed), ranked)
             for seed in range(40)]
    assert np.mean(found) == pytest.approx(exact, rel=0.05)
    assert np.std(found) < 0.25 * exact


def test_the_standard_error_is_the_spread_of_means_over_seeds():
    means, errors = [], []
    for seed in range(400):
        x = autoregressive(0.8, 4, 500, seed) * 3 + 7
        means.append(x.mean())
        errors.append(standard_error(x))
    # a standard deviation of 400 is good to 4 %, twice that is allowed
    assert np.mean(errors) == pytest.approx(np.std(means), rel=0.08)


def test_chains_that_do_not_meet_are_worth_as_many_draws_as_there_are_chains():
    x = autoregressive(0.0, 8, 1000) * 0.01 + np.arange(8)[:, None]
    assert effective_sample_size(x) < 20


def test_heavy_tails_do_not_spoil_the_bulk():
    x = autoregressive(0.5, 4, 2000)
    cauchy = np.sign(x) * np.exp(np.abs(x)**3)
    assert effective_sample_size(cauchy, ranked=True) == pytest.approx(
        effective_sample_size(x, ranked=True), rel=1e-9)


def test_each_quantity_is_judged_on_its_own():
    x = np.stack([autoregressive(phi, 4, 500) for phi in (0.0, 0.5, 0.9, 0.2)], axis=-1)
    both = effective_sample_size(x.reshape(4, 500, 2, 2))
    np.testing.assert_allclose(both.ravel(), [effective_sample_size(x[..., j]) for j in range(4)])
    np.testing.assert_allclose(split_r_hat(x.reshape(4, 500, 2, 2)).ravel(),
                               [split_r_hat(x[..., j]) for j in range(4)])


# R-hat


def test_r_hat_of_chains_apart_is_their_spread_over_that_within():
    # variance 1 within, means that are 0, 0, 0, 0 and 4 halves' worth of d: B / n = 4 d^2 / 15
    x, d = autoregressive(0.0, 5, 100_000), 1.5
    x[0] += d
    expected = np.sqrt(1 + np.var(np.repeat([d, 0, 0, 0, 0], 2), ddof=1))
    # the variances are good to 0.3 %, the means to 0.01
    assert split_r_hat(x, ranked=False) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize('ranked', [False, True])
def test_r_hat_is_one_where_chains_agree(ranked):
    assert split_r_hat(autoregressive(0.3, 4, 4000), ranked) == pytest.approx(1, abs=0.003)
    assert split_r_hat(np.ones((4, 100)), ranked) == 1


@pytest.mark.parametrize('spoil', [
    lambda x: x + np.array([[0], [0], [0], [1.0]]),
    lambda x: x + np.linspace(0, 2, x.shape[1]),
    lambda x: x * np.array([[1], [1], [1], [3.0]]),
])
def test_r_hat_sees_other_means_a_trend_and_another_spread(spoil):
    assert split_r_hat(spoil(autoregressive(0.0, 4, 1000))) > 1.05


def test_ranks_see_other_places_where_there_are_no_moments():
    rng = np.random.default_rng(1)
    x = rng.standard_cauchy((4, 2000))
    assert split_r_hat(x) < 1.01
    x[0] += 2
    assert split_r_hat(x) > 1.05 > split_r_hat(x, ranked=False)


def test_refuses_what_is_too_short():
    with pytest.raises(ValueError, match=r'^draws: expected .* 4 draws or more, got shape \(4, 3'):
        split_r_hat(np.ones((4, 3)))
