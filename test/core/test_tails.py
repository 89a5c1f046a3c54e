"""How often a density is no larger than at a place."""

import tracemalloc

import numpy as np
from pif_ros.core.models import Sensor
from pif_ros.core.predictive import Predictive
from pif_ros.core.tails import tail
import pytest
from scipy import stats


def of_two_far_apart(m, z, share):
    """Return the exact tail at z deviations from the first of two, which has a share."""
    rest = 1 - share
    return (share * stats.chi2.sf(z * z, m)
            + rest * stats.chi2.sf(max(z * z + 2 * np.log(rest / share), 0.0), m))


@pytest.mark.parametrize('m', [1, 2])
@pytest.mark.parametrize('apart', [40.0, 2e3, 2e4, 1e9, 1e200])
@pytest.mark.parametrize('share', [0.5, 0.3, 1 - 1e-7])
def test_what_is_far_away_does_not_blur_what_is_near(m, apart, share):
    for z in (1.0, 3.0, 4.0):
        v = np.stack([np.zeros(m), np.full(m, apart)], axis=1)
        v[0] -= z
        exact = of_two_far_apart(m, z, share)
        # a hump is an eighth of a cell off at most in its width: a few percent of its tail
        assert tail(np.array([share, 1 - share]), v) == pytest.approx(exact, rel=0.15)


def test_places_that_spread_too_far_for_fine_cells_are_compared_on_coarse_ones():
    # a hundred places far from each other, of which the light half are on coarse cells
    x = np.arange(100) * 1e3
    weights = np.where(np.arange(100) % 2, 1.0, 1e-3)
    v = np.stack([x, np.zeros(100)])
    v[0, 1::2] -= 0.5
    v -= v[:, :1]
    heavy, light = v.copy(), v.copy()
    heavy -= heavy[:, 1:2]
    # on a heavy place all is less dense; on a light one next to nothing is
    assert tail(weights / weights.sum(), heavy) > 0.9
    assert tail(weights / weights.sum(), light) < 5e-3


def test_a_crowd_in_two_places_is_smoothed_as_in_one():
    rng = np.random.default_rng(2)
    cloud = rng.normal(size=(3, 2000))
    far = cloud + np.array([[4e3], [0.0], [0.0]])
    weights = np.full(2000, 1 / 2000)
    for x in ([0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [4.0, 2.0, 0.0]):
        place = np.array(x)[:, None]
        one = tail(weights, cloud - place)
        both = tail(np.tile(weights / 2, 2), np.concatenate([cloud, far], axis=1) - place)
        assert both == pytest.approx(one, rel=0.3)


@pytest.mark.parametrize('sigma', [1e-3, 1e-5, 1e-8])
def test_a_narrow_angle_takes_no_more_memory_than_a_wide_one(sigma):
    compass = Sensor(lambda x, t: x, [[sigma**2]], angular=(True,))
    two = Predictive(compass, np.array([0.5, 0.5]), np.array([[0.0, 2.0]]), compass.noise(0.0))
    tracemalloc.start()
    found = two.tail([3 * sigma])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == pytest.approx(of_two_far_apart(1, 3.0, 0.5), rel=0.1)
    assert peak < 20e6


@pytest.mark.parametrize('m', [5, 10, 20, 40])
def test_a_crowd_of_many_numbers_has_a_tail_at_once(m):
    v = np.random.default_rng(3).normal(size=(m, 1000)) * 50
    assert 0.5 < tail(np.full(1000, 1e-3), v - v[:, :1]) <= 1


@pytest.mark.parametrize('far', [0.0, 40.0])
def test_a_cluster_on_the_seam_of_a_narrow_angle_is_one(far):
    turn, line = 2 * np.pi / 5e-4, np.linspace(-3, 3, 101)
    share = stats.norm.pdf(line)
    weights = np.concatenate([share, 9 * share]) / (10 * share.sum())
    place = np.concatenate([line + 2, line + turn / 2 - far])
    found = tail(weights, (place[None] + turn / 2) % turn - turn / 2, turn)
    # both humps are Gaussians of variance 1 + that of the points, cut at three of its deviations
    width = np.sqrt(1 + (share @ line**2) / share.sum())
    level = np.log(0.1) - (2 / width)**2 / 2
    exact = (0.1 * stats.chi2.sf((2 / width)**2, 1)
             + 0.9 * stats.chi2.sf(2 * (np.log(0.9) - level), 1))
    assert found == pytest.approx(exact, rel=0.05)


@pytest.mark.parametrize('span', [1e6, 1e9, 1e15])
def test_a_wide_span_of_one_number_takes_no_more_memory(span):
    rng = np.random.default_rng(5)
    v = np.stack([span * rng.random(1000), rng.normal(size=1000)])
    tracemalloc.start()
    found = tail(np.full(1000, 1e-3), v - v[:, :1])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert 0 < found <= 1 and peak < 50e6
