"""One step of a patch: mass, mean and variance, and where everything lands."""

import itertools

import numpy as np
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.transport import deposited, heated, moved, noise_kernel
from pif_ros.core.active.window import Window
from pif_ros.core.grid import Grid
import pytest

pytestmark = pytest.mark.usefixtures('way')
WORLD = Grid((-10.0, -10.0, -np.pi), (10.0, 10.0, np.pi), (40, 50, 24), (False, False, True))


def patch_of(rng, level=(0, 1, 0), offset=(12, 40, 20), shape=(6, 7, 8)):
    return Patch(Window(WORLD, level, offset, shape), rng.random(shape))


def along(variance):
    """Return noise along the axes alone."""
    return lambda window: (variance, [])


def linear_moments(patch):
    """Return mean and variance of each coordinate, as if no axis were a circle."""
    w = patch.density / patch.density.sum()
    x = np.stack(np.meshgrid(*patch.window.grid.axes, indexing='ij'))
    mean = np.array([(w * axis).sum() for axis in x])
    return mean, np.array([(w * (axis - m)**2).sum() for axis, m in zip(x, mean)])


@pytest.mark.parametrize('variance', [1e-12, 1e-5, 6e-4, 1e-3, 1 / 36, 0.028, 0.1, 1.0, 30.0])
def test_noise_has_its_variance_and_where_it_is_wide_its_fourth_moment(variance):
    w = noise_kernel(variance)
    k = np.arange(len(w)) - len(w) // 2
    assert np.all(w >= 0)
    assert w.sum() == pytest.approx(1, abs=1e-14)
    assert (w * k**2).sum() == pytest.approx(variance, rel=1e-9)
    if variance >= 1:
        # what a Gaussian sampled every deviation or oftener misses: exp(-2 pi^2) of it
        assert (w * k**4).sum() == pytest.approx(3 * variance**2, rel=1e-5)


def test_noise_twice_is_the_noise_of_both():
    both = np.convolve(noise_kernel(1.1), noise_kernel(1.9))
    one = noise_kernel(3.0)
    middle = slice(len(both) // 2 - len(one) // 2, len(both) // 2 + len(one) // 2 + 1)
    # sampled, the narrower one is off by 2 exp(-2 pi^2 1.1), 7e-10, and its width by a thousand of
    # these, since it is made to have its variance
    np.testing.assert_allclose(both[middle], one, atol=1e-6)


def test_no_noise_and_no_drift_leave_a_patch_alone():
    patch = patch_of(np.random.default_rng(0))
    still = moved(patch, lambda window, held: np.zeros((3,) + window.shape), along(np.zeros(3)))
    a = ActiveBelief(WORLD, (patch,)).on(WORLD, (0, 1, 2)).density
    b = ActiveBelief(WORLD, (still,)).on(WORLD, (0, 1, 2)).density
    np.testing.assert_allclose(b, a, atol=1e-15)


@pytest.mark.parametrize('offset', [(12, 40, 20), (12, 40, 3)], ids=['across pi', 'below pi'])
@pytest.mark.parametrize('spread', [0.0, 0.1, 0.25])
def test_a_deposit_is_what_cell_by_cell_it_should_be(spread, offset):
    rng = np.random.default_rng(1)
    patch = patch_of(rng, offset=offset)
    move = rng.normal(0.0, 3.0, (3,) + patch.window.shape)
    result = deposited(patch, move, np.full(3, spread))
    expected = {}
    for cell in itertools.product(*map(range, patch.window.shape)):
        shares = [{}, {}, {}]
        for i in range(3):
            place = offset[i] + cell[i] + move[(i,) + cell]
            middle = int(np.rint(place))
            d = place - middle
            v = max(spread, abs(d) * (1 - abs(d)))
            for step, w in ((-1, (v + d * d - d) / 2), (0, 1 - v - d * d),
                            (1, (v + d * d + d) / 2)):
                node = middle + step
                shares[i][node % 24 if i == 2 else node] = w
        for nodes in itertools.product(*(share.items() for share in shares)):
            key = tuple(node for node, _ in nodes)
            w = np.prod([weight for _, weight in nodes])
            expected[key] = expected.get(key, 0.0) + w * patch.density[cell]
    assert result.density.sum() == pytest.approx(sum(expected.values()), rel=1e-12)
    for key, value in expected.items():
        place = [(k - start) % 24 if i == 2 else k - start
                 for i, (k, start) in enumerate(zip(key, result.window.offset))]
        assert result.density[tuple(place)] == pytest.approx(value, abs=1e-12)


def test_a_move_that_is_the_same_along_an_axis_may_be_given_once():
    rng = np.random.default_rng(2)
    patch = patch_of(rng)
    move = rng.normal(0.0, 2.0, (3, 1, 1, 8))
    few = deposited(patch, move, np.full(3, 0.25))
    all_ = deposited(patch, np.broadcast_to(move, (3,) + patch.window.shape), np.full(3, 0.25))
    assert few.window == all_.window
    np.testing.assert_array_equal(few.density, all_.density)


@pytest.mark.parametrize('variance', [0.25, 0.6, 3.0])
def test_a_step_keeps_mass_and_has_mean_and_variance_exactly(variance):
    rng = np.random.default_rng(3)
    wide = Grid(WORLD.lower, WORLD.upper, (40, 50, 96), WORLD.periodic)
    patch = Patch(Window(wide, (0, 1, 0), (12, 40, 40), (6, 7, 8)), rng.random((6, 7, 8)))
    move = np.array([1.37, -2.2, 0.41])
    after = moved(patch, lambda window, held: move.reshape(3, 1, 1, 1),
                  along(np.full(3, variance)))
    cell = patch.window.spacing
    # but for planes with less than 1e-9 of the densest cell, some of them on each side
    assert after.mass == pytest.approx(patch.mass, rel=1e-8)
    (mean, square), (mean_after, square_after) = linear_moments(patch), linear_moments(after)
    np.testing.assert_allclose(mean_after - mean, move * cell, atol=1e-7)
    np.testing.assert_allclose(square_after - square, variance * cell**2, rtol=1e-6)


def test_thin_noise_is_spread_no_more_than_two_nodes_must():
    p = np.zeros(9)
    p[4] = 1.0
    line = Grid((0.0,), (9.0,), (9,))
    patch = Patch(Window(line, (0,), (0,), (9,)), p)
    for d in (0.0, 0.1, 0.5, 0.8):
        after = moved(patch, lambda window, held: np.array([[d]]), along(np.zeros(1)))
        belief = ActiveBelief(line, (after,))
        assert belief.mean()[0] == pytest.approx(4.5 + d, abs=1e-14)
        # the least that a distribution on whole numbers with this mean can have
        assert belief.covariance()[0, 0] == pytest.approx(d * (1 - d), abs=1e-13)


def test_a_full_circle_stays_one_and_loses_nothing():
    rng = np.random.default_rng(4)
    patch = patch_of(rng, offset=(12, 40, 0), shape=(6, 7, 24))
    after = heated(deposited(patch, rng.normal(0, 30, (3,) + patch.window.shape),
                             np.full(3, 0.25)), np.full(3, 2.0))
    assert after.window.circles == (False, False, True)
    assert after.mass == pytest.approx(patch.mass, rel=1e-12)


def test_what_is_heated_all_round_a_circle_becomes_even():
    circle = Grid((-np.pi,), (np.pi,), (16,), (True,))
    p = np.zeros(16)
    p[3] = 1.0
    after = heated(Patch(Window.whole(circle), p), np.array([400.0]))
    # exp(-variance (2 pi / 16)^2 / 2) is 4e-14
    np.testing.assert_allclose(after.density, 1 / 16, atol=1e-11)


@pytest.mark.parametrize('offset', [0, 5, 12])
def test_a_patch_that_grows_all_round_a_circle_becomes_the_circle(offset):
    circle = Grid((-np.pi,), (np.pi,), (16,), (True,))
    p = np.random.default_rng(5).random(12)
    whole = np.zeros(16)
    whole[(offset + np.arange(12)) % 16] = p
    grown = heated(Patch(Window(circle, (0,), (offset,), (12,)), p), np.array([1.5]))
    expected = heated(Patch(Window.whole(circle), whole), np.array([1.5]))
    assert grown.window == expected.window
    np.testing.assert_allclose(grown.density, expected.density, rtol=1e-12)


def test_what_the_drift_does_not_tell_or_takes_out_of_the_world_is_lost_and_nothing_else():
    line = Grid((0.0,), (20.0,), (20,))
    p = np.arange(1.0, 9.0)
    move = np.array([[0.0, np.nan, 1.0, np.inf, -np.inf, 1e300, -1e300, 2.0]])
    after = deposited(Patch(Window(line, (0,), (6,), (8,)), p), move, np.zeros(1))
    first = after.window.offset[0]
    assert after.density[6 - first] == 1.0
    assert after.density[6 + 2 + 1 - first] == 3.0
    assert after.density[6 + 7 + 2 - first] == 8.0
    # what is finite but far lands outside, on either side
    assert after.density[:-first].sum() == 7.0
    assert after.density[20 - first:].sum() == 6.0
    assert after.density.sum() == 25.0


@pytest.mark.parametrize('variance', [3.0, 60.0, 400.0])
def test_noise_that_reaches_several_times_round_a_circle_is_wrapped(variance):
    circle = Grid((-np.pi,), (np.pi,), (16,), (True,))
    p = np.random.default_rng(6).random(16)
    after = heated(Patch(Window.whole(circle), p), np.array([variance]))
    kernel = noise_kernel(variance)
    expected = np.zeros(16)
    for j, w in itertools.product(range(16), enumerate(kernel)):
        expected[(j + w[0] - len(kernel) // 2) % 16] += w[1] * p[j]
    np.testing.assert_allclose(after.density, expected, rtol=1e-12)


@pytest.mark.parametrize('variance', [0.3, 4.0, 90.0, 900.0])
def test_noise_of_any_width_goes_round_two_circles(variance):
    rng = np.random.default_rng(8)
    torus = Grid((0.0, 0.0), (9.0, 12.0), (9, 12), (True, True))
    for shape, offset in (((9, 12), (0, 0)), ((3, 12), (7, 0)), ((8, 2), (4, 11)),
                          ((2, 3), (8, 10))):
        patch = Patch(Window(torus, (0, 0), offset, shape), rng.random(shape))
        kernel, exact = noise_kernel(variance), np.zeros((9, 12))
        reach = len(kernel) // 2
        for i, j in np.ndindex(shape):
            row, column = np.zeros(9), np.zeros(12)
            for k, w in enumerate(kernel):
                row[(offset[0] + i + k - reach) % 9] += w
                column[(offset[1] + j + k - reach) % 12] += w
            exact += patch.density[i, j] * np.outer(row, column)
        found = ActiveBelief(torus, (heated(patch, np.full(2, variance)),)).on(torus, (0, 1))
        np.testing.assert_allclose(found.density, exact, atol=1e-12)
