"""What the filter believes."""

from hypothesis import given, strategies as st
import numpy as np
from oracles import gaussian
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
import pytest
from scipy import stats

SEEDS = st.integers(0, 2**32 - 1)


def random_belief(seed, periodic=(False, True)):
    density = np.random.default_rng(seed).gamma(0.3, size=(7, 9))
    return GridBelief(Grid((-1, 0), (2, 5), (7, 9), periodic), density).normalised()


def test_a_uniform_belief_has_mass_one_the_middle_as_mean_and_the_variance_of_a_box():
    belief = GridBelief.uniform(Grid((-1, 2), (3, 5), (40, 60)))
    assert belief.mass == pytest.approx(1, rel=1e-12)
    np.testing.assert_allclose(belief.mean(), [1, 3.5], rtol=1e-12)
    # n point masses have the variance (width^2 - dx^2) / 12
    box = (np.array([4, 3])**2 - np.array([0.1, 0.05])**2) / 12
    np.testing.assert_allclose(belief.covariance(), np.diag(box), atol=1e-12)
    assert belief.entropy() == pytest.approx(np.log(4 * 3), rel=1e-12)


def test_a_gaussian_has_its_density_mean_covariance_and_entropy():
    S = np.array([[0.5, 0.3], [0.3, 0.4]])
    grid = Grid((-6, -6), (6, 6), (96, 96))
    belief = GridBelief.gaussian(grid, [0.3, -0.2], S)
    # the tail beyond 8 sigma holds 1e-15; sampling at q cells leaves exp(-2 pi^2 q^2) < 1e-16,
    # where q = 3, the narrowest conditional width
    np.testing.assert_allclose(belief.density.ravel(), gaussian(grid.points, [0.3, -0.2], S),
                               rtol=1e-10)
    np.testing.assert_allclose(belief.mean(), [0.3, -0.2], atol=1e-10)
    np.testing.assert_allclose(belief.covariance(), S, atol=1e-10)
    exact = stats.multivariate_normal([0, 0], S).entropy()
    assert belief.entropy() == pytest.approx(exact, abs=1e-10)


@given(st.floats(-0.99, 0.99), st.floats(-8, 0), st.floats(-8, 0), st.floats(-0.98, 0.98),
       st.booleans())
def test_a_gaussian_narrower_than_a_cell_keeps_mass_one_within_a_cell_of_its_mean(
        mean, log_first, log_second, correlation, periodic):
    first, second = 10**log_first, 10**log_second
    S = [[first**2, correlation * first * second], [correlation * first * second, second**2]]
    grid = Grid((-1, -1), (1, 1), (7, 7), (periodic, periodic))
    belief = GridBelief.gaussian(grid, [mean, -mean], S)
    assert belief.mass == pytest.approx(1, rel=1e-12)
    if max(first, second) < 1e-2:
        d = grid.wrap(belief.mean() - [mean, -mean])
        # half a cell is as far as the nearest centre may be
        assert np.all(np.abs(d) <= grid.spacing / 2 + 1e-9)


@given(SEEDS)
def test_moments_equal_sums_over_all_cells_with_the_circular_mean_where_the_axis_is_one(seed):
    belief = random_belief(seed)
    grid = belief.grid
    cells = [(x, p * grid.cell_volume) for x, p in zip(grid.points.T, belief.density.ravel())]
    mean = belief.mean()
    assert mean[0] == pytest.approx(sum(x[0] * w for x, w in cells), abs=1e-12)
    # the resultant of the angles points to the circular mean: no sine is left about it
    sine = sum(w * np.sin((x[1] - mean[1]) * 2 * np.pi / 5) for x, w in cells)
    cosine = sum(w * np.cos((x[1] - mean[1]) * 2 * np.pi / 5) for x, w in cells)
    assert sine == pytest.approx(0, abs=1e-12) and cosine > 0
    assert 0 <= mean[1] <= 5
    covariance = np.zeros((2, 2))
    for x, w in cells:
        turns = [x - mean + [0, 5 * k] for k in (-2, -1, 0, 1, 2)]
        d = min(turns, key=lambda d: abs(d[1]))
        covariance += w * np.outer(d, d)
    np.testing.assert_allclose(belief.covariance(), covariance, atol=1e-12)


def test_a_hump_across_the_seam_of_a_circle_has_the_moments_of_the_same_hump_elsewhere():
    S = np.array([[0.2, 0.1], [0.1, 0.3]])
    grid = Grid((-4, -np.pi), (4, np.pi), (80, 64), (False, True))
    seam = GridBelief.gaussian(grid, [0, np.pi - 0.05], S)
    middle = GridBelief.gaussian(grid, [0, 0.05], S)
    # cut off: half a turn is 5.7 sigma, 1e-8 of the mass
    np.testing.assert_allclose(seam.covariance(), middle.covariance(), atol=1e-6)
    np.testing.assert_allclose(seam.covariance(), S, atol=1e-6)
    assert grid.wrap(seam.mean() - [0, np.pi - 0.05]) == pytest.approx(0, abs=1e-7)


@given(SEEDS)
def test_second_moments_about_a_point_are_the_covariance_and_the_square_of_the_way(seed):
    belief = random_belief(seed, periodic=(False, False))
    d = np.array([0.7, -3.0])
    about = belief.covariance(about=belief.mean() + d)
    np.testing.assert_allclose(about, belief.covariance() + np.outer(d, d), atol=1e-12)


def test_statistics_are_those_of_the_density_scaled_to_mass_one():
    belief = random_belief(1)
    leaky = GridBelief(belief.grid, belief.density * 0.25)
    assert leaky.mass == pytest.approx(0.25, rel=1e-12)
    np.testing.assert_allclose(leaky.mean(), belief.mean(), rtol=1e-12)
    np.testing.assert_allclose(leaky.covariance(), belief.covariance(), rtol=1e-12)
    assert leaky.entropy() == pytest.approx(belief.entropy(), rel=1e-12)
    assert leaky.modes()[0].mass == pytest.approx(belief.modes()[0].mass, rel=1e-12)


@pytest.mark.parametrize('axes', [[0], [2], [0, 1], [2, 0], [1, 2, 0], [0, 1, 2]])
def test_a_marginal_sums_over_the_other_axes_and_keeps_the_order_asked_for(axes):
    grid = Grid((0, 0, 0), (1, 2, 3), (2, 3, 4), (True, False, False))
    density = np.random.default_rng(5).random(grid.shape)
    belief = GridBelief(grid, density).normalised()
    marginal = belief.marginal(axes)
    expected = np.zeros([grid.shape[i] for i in axes])
    for index in np.ndindex(*grid.shape):
        expected[tuple(index[i] for i in axes)] += belief.density[index] * grid.cell_volume
    assert marginal.grid == grid.select(axes)
    np.testing.assert_allclose(marginal.density * marginal.grid.cell_volume, expected, rtol=1e-12)


@given(SEEDS, st.floats(0.01, 0.99))
def test_a_region_of_highest_density_is_the_smallest_with_its_share(seed, share):
    belief = random_belief(seed)
    weights = belief.density * belief.grid.cell_volume
    region = belief.highest_density_region(share)
    assert weights[region].sum() >= share - 1e-12
    assert weights[region].sum() - weights[region].min() < share + 1e-12
    assert weights[region].min() >= weights[~region].max()


def test_modes_are_the_humps_heaviest_first_with_their_own_moments():
    grid = Grid((-10,), (10,), (400,))
    light = GridBelief.gaussian(grid, [-5], [[0.25]]).density
    heavy = GridBelief.gaussian(grid, [4], [[0.5]]).density
    modes = GridBelief(grid, 0.3 * light + 0.7 * heavy).modes(share=0.9999)
    assert len(modes) == 2
    # what lies outside the region, 1e-4 of the mass at about four sigma
    np.testing.assert_allclose([m.mass for m in modes], [0.7, 0.3], atol=1e-4)
    np.testing.assert_allclose([m.mean[0] for m in modes], [4, -5], atol=1e-3)
    np.testing.assert_allclose([m.covariance[0, 0] for m in modes], [0.5, 0.25], atol=2e-3)


def cells(*where):
    density = np.zeros((6, 6))
    for index in where:
        density[index] = 1.0
    return density


@pytest.mark.parametrize('where, periodic, count', [
    ([(2, 2), (3, 3)], (False, False), 1),
    ([(2, 2), (4, 2)], (False, False), 2),
    ([(0, 2), (5, 2)], (False, False), 2),
    ([(0, 2), (5, 2)], (True, False), 1),
    ([(2, 0), (2, 5)], (True, False), 2),
    ([(0, 0), (5, 0), (0, 5), (5, 5)], (True, True), 1),
    ([(0, 3), (5, 2)], (True, False), 1),
    ([(0, 0), (5, 5)], (True, True), 1),
    ([(0, 0), (5, 5)], (True, False), 2),
])
def test_a_mode_hangs_together_over_sides_corners_and_periodic_edges(where, periodic, count):
    belief = GridBelief(Grid((0, 0), (6, 6), (6, 6), periodic), cells(*where))
    assert len(belief.modes(share=0.999)) == count


def test_a_single_cell_is_a_mode_without_width_and_its_centre_is_mean_and_mode():
    grid = Grid((0, 0), (6, 6), (6, 6), (True, False))
    belief = GridBelief(grid, cells((5, 1))).normalised()
    [mode] = belief.modes()
    np.testing.assert_allclose([belief.mean(), belief.mode(), mode.mean], [[5.5, 1.5]] * 3)
    np.testing.assert_allclose(mode.covariance, 0, atol=1e-12)


GRID = Grid((0, 0), (4, 4), (8, 8))


@pytest.mark.parametrize('mean, covariance, wanted, got', [
    ([1], np.eye(2), 'mean: expected 2 finite numbers', '[1.0]'),
    ([1, float('nan')], np.eye(2), 'mean: expected 2 finite numbers', 'nan'),
    ([1, 4.1], np.eye(2), 'mean: expected a point on the grid', '4.1'),
    ([1, 1], np.eye(3), 'covariance: expected 2 x 2 numbers', '3 x 3'),
    ([1, 1], [1, 1], 'covariance: expected 2 x 2 numbers', '2'),
    ([1, 1], [[1, 0], [0, float('inf')]], 'covariance: expected finite numbers', 'inf'),
    ([1, 1], [[1, 0.5], [0, 1]], 'covariance: expected a symmetric matrix', '0.5'),
    ([1, 1], [[1, 2], [2, 1]], 'covariance: expected a positive definite matrix', '2.0'),
    ([1, 1], [[1, 0], [0, 0]], 'covariance: expected a positive definite matrix', '0.0'),
])
def test_refuses_what_is_no_gaussian_in_one_line_with_what_was_wanted_and_what_came(
        mean, covariance, wanted, got):
    with pytest.raises(ValueError) as error:
        GridBelief.gaussian(GRID, mean, covariance)
    line = str(error.value)
    assert line.startswith(wanted) and got in line.split('got')[1] and '\n' not in line


@given(st.floats(-np.pi, np.pi), st.floats(0.1, 10), st.floats(0.1, 10))
def test_takes_a_covariance_that_is_symmetric_but_for_rounding(turn, first, second):
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    covariance = rotation @ np.diag([first, second]) @ rotation.T
    assert GridBelief.gaussian(GRID, [1, 1], covariance).mass == pytest.approx(1)


@pytest.mark.parametrize('deviation', [1.0, 2.0, 3.5])
def test_a_wide_gaussian_goes_round_a_circle(deviation):
    circle = Grid((-np.pi,), (np.pi,), (360,), (True,))
    belief = GridBelief.gaussian(circle, [2.5], [[deviation**2]])
    wrapped = sum(stats.norm.pdf(circle.points[0], 2.5 + 2 * np.pi * turn, deviation)
                  for turn in range(-20, 21))
    np.testing.assert_allclose(belief.density, wrapped, rtol=1e-3)


@pytest.mark.parametrize('rho', [0.9, 0.9999, 0.99999999])
def test_a_gaussian_thinner_than_a_cell_along_a_diagonal_is_where_it_belongs(rho):
    deviations, grid = np.array([5.0, 3.1]), Grid((-30, -30), (30, 30), (60, 60))
    covariance = np.outer(deviations, deviations) * np.array([[1, rho], [rho, 1]])
    belief = GridBelief.gaussian(grid, [0.3, 0.2], covariance)
    np.testing.assert_allclose(belief.mean(), [0.3, 0.2], atol=0.02)
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance())), deviations, atol=0.06)
