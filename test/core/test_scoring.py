"""How good an estimate is."""

import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.scoring import (
    coverage, honest_coverage, l1_distance, mahalanobis_squared, rmse)
import pytest
from scipy.spatial.distance import mahalanobis


def test_rmse_is_the_root_of_the_mean_squared_length():
    assert rmse(np.array([[3.0, 4.0], [0.0, 0.0], [5.0, 12.0]])) == pytest.approx(
        np.sqrt((25 + 0 + 169) / 3), rel=1e-15)


def test_mahalanobis_distances_equal_scipys():
    rng = np.random.default_rng(0)
    errors, roots = rng.normal(size=(20, 3)), rng.normal(size=(20, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1) + np.eye(3)
    exact = [mahalanobis(e, np.zeros(3), np.linalg.inv(P))**2
             for e, P in zip(errors, covariances)]
    np.testing.assert_allclose(mahalanobis_squared(errors, covariances), exact, rtol=1e-10)


@pytest.mark.parametrize('n', [1, 2, 3])
@pytest.mark.parametrize('sigmas', [1.0, 2.0])
def test_an_honest_gaussian_covers_what_it_should(n, sigmas):
    rng = np.random.default_rng(n)
    root = rng.normal(size=(n, n)) + 2 * np.eye(n)
    errors = rng.normal(size=(20_000, n)) @ root.T
    covariances = np.broadcast_to(root @ root.T, (20_000, n, n))
    # four deviations of a share of 20,000
    assert coverage(errors, covariances, sigmas) == pytest.approx(
        honest_coverage(sigmas, n), abs=0.015)


def test_the_honest_coverage_has_its_closed_forms():
    assert honest_coverage(1, 1) == pytest.approx(0.682689492137086, rel=1e-12)
    assert honest_coverage(2, 1) == pytest.approx(0.954499736103642, rel=1e-12)
    for k in (0.5, 1, 2, 3):
        assert honest_coverage(k, 2) == pytest.approx(1 - np.exp(-k**2 / 2), rel=1e-12)


def test_the_l1_distance_is_0_of_equals_2_of_strangers_and_that_of_two_gaussians():
    grid = Grid((-10,), (10,), (2000,))
    one, other, far = (GridBelief.gaussian(grid, [m], [[s**2]])
                       for m, s in ((0, 1), (1, 1), (9, 0.05)))
    assert l1_distance(one, one) == 0
    assert l1_distance(one, far) == pytest.approx(2, abs=1e-8)
    # equal widths cross half-way: 2 (2 Phi(1 / 2) - 1); the kink costs the square of a cell
    assert l1_distance(one, other) == pytest.approx(2 * 0.382924922548026, abs=1e-4)
