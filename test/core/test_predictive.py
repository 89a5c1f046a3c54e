"""What is expected to be measured, and how often one is surprised as much."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.active import ActiveBelief, ActiveGridFilter, Patch, Window
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.predictive import Predictive
from pif_ros.core.rivals import (ExtendedKalmanFilter, GaussianBelief, ParticleFilter,
                                 UnscentedKalmanFilter)
from pif_ros.core.systems import ornstein_uhlenbeck, position_2d, range_sensor
import pytest
from scipy import stats

SIGMA = 0.5
LINE = Sensor(lambda x, t: x, [[SIGMA**2]])
PLANE = Sensor(lambda x, t: x, [[1.0, 0.3], [0.3, 0.5]])
SOLID = Sensor(lambda x, t: x, np.eye(3))


def of(sensor, weights, expected):
    return Predictive(sensor, np.array(weights), np.array(expected, dtype=float),
                      sensor.noise(0.0))


def tail_by_sums(weights, expected, y, sigma=SIGMA):
    """Return P(p(Y) <= p(y)) by a plain sum over many points."""
    line = np.linspace(min(expected) - 10 * sigma, max(expected) + 10 * sigma, 100_001)

    def p(v):
        return sum(w * stats.norm.pdf(v, h, sigma) for w, h in zip(weights, expected))

    density = p(line)
    return density[density <= p(y)].sum() * (line[1] - line[0])


@given(st.lists(st.tuples(st.floats(0.05, 1), st.floats(-6, 6)), min_size=2, max_size=5),
       st.floats(-8, 8))
@settings(max_examples=25, deadline=None)
def test_the_tail_of_one_number_is_that_of_a_sum_over_a_fine_line(humps, y):
    weights, expected = map(np.array, zip(*humps))
    weights /= weights.sum()
    exact = tail_by_sums(weights, expected, y)
    # a hump is an eighth of a cell off at most in its width: a few percent of its tail, and a
    # level that just touches a hump's top takes or leaves the width of a cell there
    assert of(LINE, weights, [expected]).tail([y]) == pytest.approx(exact, rel=0.1, abs=0.02)
    if 1e-10 < exact < 0.01:
        assert of(LINE, weights, [expected]).tail([y]) == pytest.approx(exact, rel=0.15)


def test_a_measurement_between_two_humps_is_an_outlier_and_one_on_either_is_none():
    two = of(LINE, [0.5, 0.5], [[-3.0, 3.0]])
    assert two.tail([0.0]) < 1e-7
    assert two.tail([3.0]) > 0.9 and two.tail([-3.0]) > 0.9
    # a Gaussian with the same mean and variance would have it the other way round
    assert stats.chi2.sf(0.0, 1) > stats.chi2.sf(3.0**2 / (9 + SIGMA**2), 1)


@pytest.mark.parametrize('sensor', [LINE, PLANE, SOLID])
@pytest.mark.parametrize('z', [0.5, 2.0, 4.0])
def test_the_tail_of_a_single_gaussian_is_that_of_chi_square(sensor, z):
    m = sensor.size
    y = np.linalg.cholesky(sensor.noise(0.0)) @ np.full(m, z / np.sqrt(m))
    exact = stats.chi2.sf(z * z, m)
    assert of(sensor, [1.0], np.zeros((m, 1))).tail(y) == pytest.approx(exact, rel=1e-9)
    # twice the same in one place is no single one any more: the lattice and the sample must tell
    assert of(sensor, [0.4, 0.6], np.zeros((m, 2))).tail(y) == pytest.approx(exact, rel=0.25)


def test_the_tail_of_two_numbers_on_a_ring_is_that_of_many_draws():
    rng, angle = np.random.default_rng(3), np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ring = of(PLANE, np.full(60, 1 / 60), 5 * np.stack([np.cos(angle), np.sin(angle)]))
    around = rng.integers(60, size=40_000)
    drawn = (ring.expected[:, around]
             + np.linalg.cholesky(PLANE.noise(0.0)) @ rng.standard_normal((2, 40_000)))

    def p(y):
        return sum(stats.multivariate_normal.pdf(y, h, PLANE.noise(0.0)) for h in ring.expected.T)

    density = p(drawn.T)
    for y in ([0.0, 0.0], [5.0, 0.0], [0.0, 7.5], [2.5, 0.5]):
        exact = np.mean(density <= p(y))
        # the lattice's few percent, and three deviations of the count of so many draws
        assert ring.tail(y) == pytest.approx(
            exact, abs=1e-4 + 0.06 * exact + 3 * np.sqrt(exact / 40_000))


@pytest.mark.parametrize('sensor, size', [(LINE, 1), (PLANE, 2), (SOLID, 3)])
def test_of_what_is_drawn_from_it_the_tail_is_uniform(sensor, size):
    rng = np.random.default_rng(5)
    expected = rng.normal(0, 4, (size, 7))
    weights = rng.dirichlet(np.ones(7))
    one = of(sensor, weights, expected)
    L, tails = np.linalg.cholesky(sensor.noise(0.0)), []
    for which in rng.choice(7, 400, p=weights):
        tails.append(one.tail(expected[:, which] + L @ rng.standard_normal(size)))
    assert stats.kstest(tails, 'uniform').pvalue > 0.01


def test_angles_go_round():
    compass = Sensor(lambda x, t: x, [[0.01]], angular=(True,))
    south = of(compass, [0.5, 0.5], [[3.1, -3.1]])
    assert south.tail([np.pi]) > 0.95
    assert south.tail([2.9]) == pytest.approx(south.tail([-2.9]), rel=1e-9)
    # the same on a line, a turn further on
    straight = of(Sensor(lambda x, t: x, [[0.01]]), [0.5, 0.5], [[3.1, 2 * np.pi - 3.1]])
    assert south.tail([2.9]) == pytest.approx(straight.tail([2.9]), rel=0.05)


def test_nothing_expected_or_far_beyond_all_of_it_has_no_tail():
    assert of(LINE, [], np.zeros((1, 0))).tail([0.0]) == 0.0
    assert of(LINE, [], np.zeros((1, 0))).log_density([0.0]) == -np.inf
    assert of(LINE, [0.5, 0.5], [[0.0, 1.0]]).tail([1e6]) == 0.0
    plane = Sensor(lambda x, t: x, [[0.04, 0.0], [0.0, 0.04]])
    assert of(plane, [0.5, 0.5], [[0.0, 1.0], [0.0, 1.0]]).tail([-1e308, 1e-308]) == 0.0


def test_a_covariance_that_is_none_expects_nothing():
    for S in ([[-1.0]], [[0.0]], [[np.nan]]):
        broken = Predictive.gaussian(LINE, np.zeros(1), np.array(S))
        assert broken.tail([0.0]) == 0.0 and broken.log_density([0.0]) == -np.inf


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('sensor', [LINE, PLANE, SOLID])
@pytest.mark.parametrize('count', [1, 2])
def test_beyond_all_numbers_nothing_is_expected(sensor, count):
    one = of(sensor, [1 / count] * count, np.zeros((sensor.size, count)))
    for y in (1e308, -1e308, 1e160):
        given_ = np.array([y, 1e-308, -y][:sensor.size])
        assert one.tail(given_) == 0.0 and one.log_density(given_) == -np.inf


GRID = Grid((-4,), (4,), (160,))
FILTER = DiracFeynmanFilter(ornstein_uhlenbeck().model, GRID, {
    'place': LINE, 'square': Sensor(lambda x, t: x**2, [[0.04]]),
    'undefined': Sensor(lambda x, t: np.sqrt(x), [[0.04]])}, KernelSettings(0.05))
TWO = FILTER.mixed(GridBelief.gaussian(GRID, [-2], [[0.1]]),
                   GridBelief.gaussian(GRID, [1], [[0.2]]), 0.3, 0)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('size', [1e160, 1e300, 1.7e308])
def test_what_is_beyond_all_numbers_has_no_tail_and_is_told_without_a_warning(size):
    pair = Sensor(lambda x, t: x[:2], np.array([[1e-4, 0.99e-4], [0.99e-4, 1e-4]]))
    expected = Predictive(pair, np.array([0.5, 0.5]), np.array([[0.0, 1.0], [0.0, 1.0]]),
                          np.asarray(pair.covariance))
    # the second of these is inf - inf when it is whitened
    for y in ((size, 0.0), (size, size), (-size, size)):
        assert expected.tail(y) == 0.0


@pytest.mark.parametrize('name, y', [('place', 0.3), ('square', 3.1), ('undefined', 1.2)])
def test_the_density_of_what_is_expected_is_the_evidence(name, y):
    expected = FILTER.predictive(TWO, name, 0)
    evidence = FILTER.correct(TWO, [y], name, 0)[1]
    if name == 'undefined':
        # what has no likelihood counts for nothing in the one, and is left out of the other
        evidence -= np.log(TWO.density[GRID.points[0].reshape(-1) >= 0].sum() * GRID.cell_volume)
    assert expected.log_density([y]) == pytest.approx(evidence, abs=2e-3)


def test_cells_that_are_wider_than_the_sensor_resolves_are_cut():
    coarse = DiracFeynmanFilter(FILTER.model, Grid((-4,), (4,), (16,)), {
        'place': Sensor(lambda x, t: x, [[0.05**2]])}, KernelSettings(0.05))
    belief = GridBelief.uniform(coarse.grid)
    # uniform from -4 to 4, whichever centre is near: a comb would have holes of T = 0
    tails = [coarse.predictive(belief, 'place', 0).tail([y]) for y in np.linspace(-2, 2, 21)]
    assert min(tails) > 0.05


def test_all_filters_expect_the_same_where_the_belief_is_gaussian():
    system, grid = position_2d(), Grid((-10, -10), (10, 10), (80, 80))
    sensors = {'range': range_sensor((-30.0, 5.0), 0.5)}
    mean, P, y = np.array([2.0, 1.0]), np.array([[0.6, 0.1], [0.1, 0.4]]), [33.5]
    full = DiracFeynmanFilter(system.model, grid, sensors, KernelSettings(0.1))
    active = ActiveGridFilter(system.model, grid, sensors, 0.1)
    many = ParticleFilter(system.model, sensors, 0.1, grid, 20_000)
    kalman = [kind(system.model, sensors, 0.1, grid)
              for kind in (ExtendedKalmanFilter, UnscentedKalmanFilter)]
    tails = [filter_.predictive(filter_.gaussian(mean, P), 'range', 0).tail(y)
             for filter_ in (full, active, many, *kalman)]
    assert isinstance(kalman[0].gaussian(mean, P), GaussianBelief)
    # so far away a range is all but linear; 20,000 particles tell a tail of a tenth to a few %
    assert tails == pytest.approx([tails[0]] * 5, rel=0.06)
    assert 0.01 < tails[0] < 0.3


@pytest.mark.parametrize('sigma', [0.3, 0.02])
@pytest.mark.parametrize('kind', ['active', 'full'])
def test_of_what_is_drawn_the_tail_is_uniform_whatever_the_width_of_the_cells(kind, sigma):
    world = Grid((-8, -8), (8, 8), (16, 16))
    sensors = {'position': position_2d().sensors['position'](sigma=sigma)}
    model, rng = position_2d().model, np.random.default_rng(11)
    filter_ = (ActiveGridFilter(model, world, sensors, 0.1) if kind == 'active' else
               DiracFeynmanFilter(model, world, sensors, KernelSettings(0.1)))
    belief = GridBelief.gaussian(world, [0.3, -0.2], 2.0 * np.eye(2))
    cells = rng.choice(world.size, 60, p=belief.density.ravel() * world.cell_volume)
    # anywhere in a cell
    x = world.points[:, cells] + rng.uniform(-0.5, 0.5, (2, 60))
    given = belief if kind == 'full' else ActiveBelief(
        world, (Patch(Window.whole(world), belief.density),))
    one = filter_.predictive(given, 'position', 0)
    tails = [one.tail(y) for y in (x + sigma * rng.standard_normal((2, 60))).T]
    # the step of the density from cell to cell is not that of a smooth one
    assert min(tails) > 1e-4 and stats.kstest(tails, 'uniform').statistic < 0.25


CUBE = Grid((-20,) * 3, (20,) * 3, (40,) * 3)
STILL = StateModel(('a', 'b', 'c'), lambda x, t: np.zeros_like(x), np.eye(3))


@pytest.mark.parametrize('size, states', [(1, (0,)), (1, None), (3, None)])
def test_cells_too_many_to_be_cut_are_no_comb(size, states):
    sigma, rng = 0.05, np.random.default_rng(3)
    # 64,000 cells, twenty deviations wide each, of which all is as likely
    sensor = Sensor(lambda x, t: x[:size], sigma**2 * np.eye(size), states=states)
    filter_ = DiracFeynmanFilter(STILL, CUBE, {'s': sensor}, KernelSettings(0.1))
    expected = filter_.predictive(filter_.uniform(), 's', 0)
    tails = [expected.tail(y) for y in rng.uniform(-17, 17, (20 if size == 1 else 4, size))]
    assert min(tails) > 1e-3 and 0.2 < np.median(tails) < 0.8


def ring_of_ranges():
    """Return what ranges to three places are expected of a robot on a ring about the origin."""
    angle, radius = np.meshgrid(np.linspace(-np.pi, np.pi, 160, endpoint=False),
                                np.linspace(3.4, 4.6, 13))
    weights = stats.norm.pdf(radius, 4, 0.2).ravel()
    sensor = Sensor(lambda x, t: np.stack([np.hypot(x[0] - a, x[1] - b)
                                           for a, b in ((8, 0), (-8, 3), (0, -8))]),
                    0.04 * np.eye(3))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)]).reshape(2, -1)
    return sensor, Predictive.of_points(sensor, weights, points, 0.0)


def test_the_hole_of_a_ring_is_empty_for_three_numbers_too():
    sensor, expected = ring_of_ranges()
    for radius in (2.5, 2.0, 1.0, 0.0):
        assert expected.tail(sensor.function(np.array([radius, 0.5]), 0.0)) < 1e-4
    assert expected.tail(sensor.function(np.array([4.0, 0.5]), 0.0)) > 0.5


@pytest.mark.parametrize('place', [(4.2, 0.4), (3.3, 0.5)])
def test_the_tail_of_three_numbers_is_that_of_many_draws(place):
    sensor, expected = ring_of_ranges()
    rng = np.random.default_rng(8)
    of = rng.choice(len(expected.weights), 400, p=expected.weights)
    drawn = expected.expected[:, of] + 0.2 * rng.standard_normal((3, 400))
    y = sensor.function(np.array(place), 0.0)
    rarer = np.mean([expected.log_density(each) <= expected.log_density(y) for each in drawn.T])
    assert expected.tail(y) == pytest.approx(rarer, rel=0.35, abs=0.02)


def test_two_numbers_with_an_angle_are_as_exact_as_two_without():
    rng = np.random.default_rng(4)
    # a bearing about +-pi, which a line has in two places
    x = np.stack([5 + 0.6 * rng.standard_normal(500), np.pi + 0.2 * rng.standard_normal(500)])
    R, weights = np.diag([0.09, 0.04]), np.full(500, 1 / 500)
    line, circle = (Sensor(lambda x, t: x, R, angular=(False, angular))
                    for angular in (False, True))
    around = np.stack([x[0], (x[1] + np.pi) % (2 * np.pi) - np.pi])
    for y in ((5.0, np.pi), (6.5, np.pi + 0.5), (3.0, np.pi - 0.9)):
        assert Predictive(circle, weights, around, R).tail(y) == pytest.approx(
            Predictive(line, weights, x, R).tail(y), rel=1e-6)
