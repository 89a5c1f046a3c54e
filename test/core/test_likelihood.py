"""The likelihood of a measurement in every cell."""

import tracemalloc

from hypothesis import given, strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor
from pif_ros.core.posterior import Terms
from pif_ros.core.systems import bearing_sensor, range_sensor
import pytest
from scipy import stats


def flat(grid):
    return GridBelief.uniform(grid).density.ravel()


def averages(grid, sensor, y, points, t=0.0):
    """Return the log of the likelihood's average over each cell, from so many points per axis."""
    inner = (np.arange(points) + 0.5) / points - 0.5
    offsets = np.stack(np.meshgrid(*[inner] * grid.ndim, indexing='ij')).reshape(grid.ndim, -1)
    found = []
    for centre in grid.points.T:
        x = centre[:, None] + offsets * grid.spacing[:, None]
        h, R = sensor.function(x, t), sensor.noise(t)
        v = np.asarray(y)[:, None] - h
        for i in np.flatnonzero(sensor.angular):
            v[i] = np.angle(np.exp(1j * v[i]))
        square = np.einsum('ik,ij,jk->k', v, np.linalg.inv(R), v)
        found.append(np.mean(np.exp(-square / 2)) / np.sqrt(np.linalg.det(2 * np.pi * R)))
    with np.errstate(divide='ignore'):
        return np.log(found)


def test_cells_that_resolve_the_sensor_take_the_density_at_their_centre():
    R = np.array([[2.0, 0.7], [0.7, 1.0]])
    grid = Grid((-1, -1), (1, 1), (8, 8))
    sensor = Sensor(lambda x, t: np.stack([x[0] * x[1], np.sin(x[0])]), R)
    found = GridLikelihood(grid, sensor).log(np.array([0.3, -2.0]), flat(grid), 0.0)
    exact = [stats.multivariate_normal([x * y, np.sin(x)], R).logpdf([0.3, -2.0])
             for x, y in grid.points.T]
    np.testing.assert_allclose(found, exact, rtol=1e-12)
    assert GridLikelihood(grid, sensor).remarks('s') == []


@given(st.floats(-3, 3), st.floats(0.02, 0.49))
def test_a_cell_wider_than_two_standard_deviations_takes_the_average(y, sigma):
    # y = x + sigma w: the average over a cell is a difference of two distribution functions
    grid = Grid((-3.5,), (3.5,), (7,))
    sensor = Sensor(lambda x, t: x, [[sigma**2]])
    found = GridLikelihood(grid, sensor).log(np.array([y]), flat(grid), 0.0)
    edges = np.linspace(-3.5, 3.5, 8)
    exact = np.diff(stats.norm(y, sigma).cdf(edges))
    # points at most a deviation apart; they see the edge of the cell, where the density jumps to
    # nothing, to a few per cent of its height there, and the heights add up to 1
    np.testing.assert_allclose(np.exp(found), exact, atol=0.03)


@given(st.floats(-1.5, 1.5), st.floats(0.51, 3))
def test_at_the_centres_of_narrower_cells_a_likelihood_sums_to_its_integral(y, sigma):
    grid = Grid((-20.5,), (20.5,), (41,))
    sensor = Sensor(lambda x, t: x, [[sigma**2]])
    found = GridLikelihood(grid, sensor).log(np.array([y]), flat(grid), 0.0)
    np.testing.assert_allclose(found, stats.norm(grid.axes[0], sigma).logpdf(y), rtol=1e-9)
    # Poisson's sum: off by 2 exp(-2 pi^2 sigma^2 / dx^2) at most, and the next harmonic
    bound = 2 * np.exp(-2 * np.pi**2 * sigma**2) + 2 * np.exp(-8 * np.pi**2 * sigma**2)
    assert np.exp(found).sum() == pytest.approx(1, abs=bound + 1e-9)


@pytest.mark.parametrize('sigma', [0.1, 0.03, 0.01, 0.003, 0.001])
@pytest.mark.parametrize('y', [0.0, 0.01, -0.12, 0.217])
def test_however_narrow_a_likelihood_the_cell_around_it_takes_all_of_it(sigma, y):
    grid = Grid((-1.5,), (1.5,), (3,))
    sensor = Sensor(lambda x, t: x, [[sigma**2]])
    found = GridLikelihood(grid, sensor).log(np.array([y]), flat(grid), 0.0)
    exact = np.diff(stats.norm(y, sigma).cdf([-0.5, 0.5]))[0]
    assert found[1] == pytest.approx(np.log(exact), abs=0.05)


@pytest.mark.parametrize('y', [0.05, 0.15, 0.2, 0.25])
def test_a_cell_within_which_the_sensor_turns_back_takes_its_average_too(y):
    # y = x^2 + w around 0: the same at both edges of the cell, but not within it
    grid = Grid((-10.5,), (10.5,), (21,))
    sensor = Sensor(lambda x, t: x**2, [[0.01]])
    found = GridLikelihood(grid, sensor).log(np.array([y]), flat(grid), 0.0)
    exact = averages(grid, sensor, [y], 2000)
    assert found[10] == pytest.approx(exact[10], abs=0.05)


def test_a_sensor_that_changes_with_time_is_averaged_by_its_slope_at_that_time():
    grid = Grid((-10,), (10,), (20,))
    sensor = Sensor(lambda x, t: x * t, [[0.01]], time_dependent=True)
    found = GridLikelihood(grid, sensor).log(np.array([5.0]), flat(grid), 1.0)
    # y = 5 lies on the edge between two cells: half of the likelihood is in either
    np.testing.assert_allclose(np.exp(found[[14, 15]]), 0.5, atol=0.05)


@pytest.mark.parametrize('sensor, y', [
    (range_sensor([0.3, -0.2], 0.05), [1.7]),
    (range_sensor([0.3, -0.2], 0.05, scale=1.1, bias=0.4), [2.0]),
    (bearing_sensor([0.3, -0.2], 0.05), [np.pi - 0.02]),
    (bearing_sensor([0.3, -0.2], 0.05), [-np.pi - 0.02]),
    (Sensor(lambda x, t: x, [[0.02, 0.012], [0.012, 0.01]]), [0.4, 0.7]),
])
def test_rings_rays_and_correlated_noise_on_wide_cells_are_averages(sensor, y):
    grid = Grid((-2, -2), (2, 2), (10, 10))
    found = GridLikelihood(grid, sensor).log(np.array(y), flat(grid), 0.0)
    # 120 points per axis resolve the narrowest of these by 15 points to a deviation
    exact = averages(grid, sensor, y, 120)
    peak = exact.max()
    assert np.sum(exact > peak - 2) >= 3
    # 8 points per axis, up to a deviation apart, and a jump at the edge of the cell
    np.testing.assert_allclose(np.exp(found - peak), np.exp(exact - peak), atol=0.06)


@pytest.mark.parametrize('y', [1.03, 1.5, 2.2])
def test_a_ring_a_fiftieth_of_a_cell_wide_lights_up_every_cell_it_crosses(y):
    # a range to 1 cm on cells of half a metre; the cell with the landmark in it is left out
    grid = Grid((-3, -3), (3, 3), (12, 12))
    sensor = range_sensor([0.3, -0.2], 0.01)
    found = GridLikelihood(grid, sensor).log(np.array([y]), flat(grid), 0.0)
    exact = averages(grid, sensor, [y], 400)
    crossed = exact > exact.max() - 1
    assert crossed.sum() > 5
    # 400 points are a tenth of a deviation apart: exact; half of it either way would be noticed
    np.testing.assert_allclose(found[crossed], exact[crossed], atol=0.4)


def test_cells_without_belief_are_not_worth_an_average():
    asked = []

    def h(x, t):
        asked.append(x.size)
        return x

    grid = Grid((0,), (100,), (100,))
    likelihood = GridLikelihood(grid, Sensor(h, [[0.01]]))
    density = np.full(100, 1e-12)
    density[50] = 1.0
    likelihood.log(np.array([50.5]), density, 0.0)
    asked.clear()
    found = likelihood.log(np.array([50.2]), density, 0.0)
    assert sum(asked) <= 32
    # the cell holds all of the likelihood but what lies more than 0.2 to the left of y
    assert found[50] == pytest.approx(np.log(stats.norm(0, 0.1).cdf(2 * 0.1)), abs=0.02)


def test_cells_with_little_belief_are_still_worth_an_average():
    grid = Grid((0,), (100,), (100,))
    density = np.full(100, 1e-12)
    density[50], density[60] = 1.0, 1e-6
    found = GridLikelihood(grid, Sensor(lambda x, t: x, [[0.01]])).log(
        np.array([60.2]), density, 0.0)
    assert found[60] == pytest.approx(np.log(stats.norm(0, 0.1).cdf(2)), abs=0.02)


def test_without_averages_every_cell_takes_its_centre_and_the_remark_says_what_follows():
    grid = Grid((0,), (10,), (10,))
    likelihood = GridLikelihood(grid, Sensor(lambda x, t: x, [[0.01]]), average_cells=False)
    found = likelihood.log(np.array([3.0]), flat(grid), 0.0)
    np.testing.assert_allclose(found, stats.norm(grid.axes[0], 0.1).logpdf(3.0), rtol=1e-12)
    [remark] = likelihood.remarks('lidar')
    assert "'lidar'" in remark and '100%' in remark and '10.0' in remark
    assert 'average_cells' in remark and '\n' not in remark


def test_cells_that_are_few_are_some_and_not_0_percent():
    steep = Sensor(lambda x, t: np.where(x > 999, 10 * (x - 999), 0.0), [[1.0]])
    [remark] = GridLikelihood(Grid((0,), (1000,), (1000,)), steep).remarks('lidar')
    assert remark.startswith('grid.shape: some of the cells are wider')


def test_a_cell_that_is_partly_out_of_the_sensors_domain_averages_over_the_rest():
    def root(x, t):
        with np.errstate(invalid='ignore'):
            return np.sqrt(x)

    grid = Grid((-1.5,), (1.5,), (3,))
    found = GridLikelihood(grid, Sensor(root, [[0.01]])).log(np.array([0.3]), flat(grid), 0.0)
    assert np.isnan(found[0])
    assert np.isfinite(found[2])


def test_averages_in_four_dimensions_fit_into_memory():
    # 3 points per axis are 81 per cell; on 38,000 cells the belief itself takes 0.3 MB
    grid = Grid((0,) * 4, (1,) * 4, (14,) * 4)
    likelihood = GridLikelihood(grid, Sensor(lambda x, t: x**2, 1e-4 * np.eye(4)))
    density = flat(grid)
    tracemalloc.start()
    likelihood.log(np.full(4, 0.3), density, 0.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


@pytest.mark.parametrize('cells', [None, np.arange(5, 60)])
def test_what_is_asked_for_once_is_what_it_is_for_many(cells):
    grid = Grid((-5.0, -5.0), (5.0, 5.0), (12, 10))
    p = GridBelief.gaussian(grid, [0.5, 1.0], np.eye(2)).density.ravel()
    p = p if cells is None else p[cells]
    sensor, y = range_sensor((0.3, 0.2), 0.1), np.array([1.1])
    many = GridLikelihood(grid, sensor).log(y, p, 0.0, cells)
    assert np.ptp(many) > 100
    np.testing.assert_array_equal(
        GridLikelihood(grid, sensor, once=True).log(y, p, 0.0, cells), many)


@pytest.mark.parametrize('h, y', [
    (lambda x: np.exp(x), np.exp(0.8)),
    # the field of a beacon, all but infinite in the middle cell
    (lambda x: 1 / np.maximum(np.abs(x - 20), 1e-9)**2, 0.25),
    (lambda x: np.exp(17 * x), 1.7),
    # a measurement, not the grid, that is far away
    (lambda x: x, 1e5),
])
@pytest.mark.parametrize('cells', [None, np.arange(0, 399, 3)])
def test_however_wide_the_range_of_a_sensor_no_digits_are_lost(h, y, cells):
    grid = Grid((0,), (40,), (401,))
    x = grid.axes[0] if cells is None else grid.axes[0][cells]
    p = np.full(len(x), 1 / 40)
    found = GridLikelihood(grid, Sensor(lambda x, t: h(x), [[0.01]]), average_cells=False).log(
        np.array([y]), p, 0.0, cells)
    with np.errstate(over='ignore'):
        exact = stats.norm(h(x), 0.1).logpdf(y)
    np.testing.assert_allclose(found, exact, rtol=1e-9, atol=1e-9)


def test_a_sensor_of_moderate_range_is_taken_by_its_terms_though_it_is_undefined_somewhere():
    grid = Grid((0,), (40,), (401,))
    for nothing in (np.nan, np.inf):
        sensor = Sensor(lambda x, t: np.where(x < 30, x, nothing), [[0.01]])
        likelihood = GridLikelihood(grid, sensor, average_cells=False)
        assert isinstance(likelihood.terms(np.array([3.0]), flat(grid), 0.0), Terms)


@pytest.mark.parametrize('edge', [1.9999, 1.95, 2.0001, 3.9])
@pytest.mark.parametrize('side', [1, -1])
def test_up_to_the_edge_of_a_field_of_view_no_measurement_is_lost_between_cells(edge, side):
    # y = x + w on cells of twenty deviations, all alike before: 1 / 4 for whatever is seen
    grid = Grid((min(0, 4 * side),), (max(0, 4 * side),), (20,))
    sensor = Sensor(lambda x, t: np.where(side * x < edge, x, np.nan), [[1e-4]])
    for y in (1.7, 1.83, 1.87, 1.9, 1.93):
        log_l = GridLikelihood(grid, sensor).log(np.array([side * y]), flat(grid), 0.0)
        evidence = np.nansum(np.exp(log_l)) * 0.2 / 4
        # all that is seen of it, and points that are a quarter of a deviation apart
        seen = stats.norm(y, 0.01).cdf(edge)
        assert evidence == pytest.approx(0.25 * seen, rel=0.1)


@pytest.mark.parametrize('y', [0.205, 0.21, 0.29, 0.3])
def test_a_hole_in_a_field_of_view_is_the_same_from_either_side(y):
    grid, evidence = Grid((-2,), (2,), (20,)), []
    for side in (1, -1):
        sensor = Sensor(lambda x, t, side=side: np.where(
            (side * x > 0.221) & (side * x < 0.28), np.nan, x), [[0.003**2]])
        log_l = GridLikelihood(grid, sensor).log(np.array([side * y]), flat(grid), 0.0)
        evidence.append(np.nansum(np.exp(log_l)) * 0.2 / 4)
    np.testing.assert_allclose(evidence, 0.25, rtol=0.1)


def test_a_sensor_of_two_numbers_sees_along_the_edge_of_its_half_plane():
    grid, evidence = Grid((0, 0), (4, 4), (20, 20)), []
    for side in (1, -1):
        sensor = Sensor(lambda x, t, side=side: np.where(
            side * (x[:1] - 2) < -1e-3, x[1:], np.nan), [[1e-4]])
        log_l = GridLikelihood(grid, sensor).log(np.array([2.03]), flat(grid), 0.0)
        evidence.append(np.nansum(np.exp(log_l)) * 0.04 / 16)
    np.testing.assert_allclose(evidence, 1 / 8, rtol=0.1)
