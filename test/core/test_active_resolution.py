"""Finer and coarser cells: what they keep."""

import numpy as np
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.focus import _taken
from pif_ros.core.active.resolution import halved, paired, widths
from pif_ros.core.active.window import Window
from pif_ros.core.grid import Grid
import pytest

#: Its own cells are 2 wide; the patches are on those of 1.
LINE = Grid((-20.0,), (20.0,), (20,))
FINE = Window(LINE, (1,), (0,), (40,))
PLANE = Grid((-20.0, -20.0), (20.0, 20.0), (80, 80))


def gaussian(sigma, mean=0.3):
    x = FINE.grid.axes[0]
    return Patch(FINE, np.exp(-0.5 * ((x - mean) / sigma)**2)
                 / np.sqrt(2 * np.pi) / sigma)


def moments(patch):
    belief = ActiveBelief(patch.window.base, (patch,))
    return belief.mass, belief.mean()[0], belief.covariance()[0, 0]


@pytest.mark.parametrize('change', [halved, paired])
@pytest.mark.parametrize('sigma', [1.3, 2.0, 4.0])
def test_mass_mean_and_nearly_the_variance_are_kept(change, sigma):
    before = moments(gaussian(sigma))
    after = moments(change(gaussian(sigma), 0))
    assert after[0] == pytest.approx(before[0], rel=1e-12)
    # halving: to the share of mass far out where the slope is cut off
    assert after[1] == pytest.approx(before[1], abs=2e-4)
    # pairing moves each half by a quarter of the new cell, whose width is 2
    gained = {halved: 0.0, paired: 0.25**2 * 2**2}[change]
    assert after[2] - before[2] == pytest.approx(gained, abs=3e-3)


def test_a_pair_of_rough_cells_keeps_its_mean_too():
    rng = np.random.default_rng(0)
    patch = Patch(Window(LINE, (1,), (7,), (9,)), rng.random(9))
    before, after = moments(patch), moments(paired(patch, 0))
    assert after[:2] == pytest.approx(before[:2], rel=1e-12)


def test_halving_is_second_order_accurate():
    errors = []
    for cells in (20, 40, 80):
        line = Grid((-10.0,), (10.0,), (cells,))
        patch = halved(Patch(Window.whole(line), np.exp(-0.5 * (line.axes[0] / 2)**2)), 0)
        x = patch.window.grid.axes[0]
        inside = np.abs(x) < 9
        errors.append(np.abs(patch.density - np.exp(-0.5 * (x / 2)**2))[inside].max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.8)


def test_nothing_is_ever_negative():
    rng = np.random.default_rng(1)
    p = np.where(rng.random((30, 30)) < 0.2, rng.random((30, 30)), 0.0)
    patch = Patch(Window(PLANE, (0, 0), (3, 5), (30, 30)), p)
    for axis in (0, 1):
        patch = halved(patch, axis)
        assert patch.density.min() >= 0
    assert paired(patch, 0).density.min() >= 0
    assert patch.mass == pytest.approx(p.sum() * 0.25, rel=1e-12)


def test_a_circle_is_halved_and_paired_round_itself():
    circle = Grid((-np.pi,), (np.pi,), (24,), (True,))
    p = 1 + 0.5 * np.cos(circle.axes[0] - 3.0)
    patch = halved(Patch(Window.whole(circle), p), 0)
    assert patch.window.shape == (48,) and patch.window.circles == (True,)
    fine = 1 + 0.5 * np.cos(patch.window.grid.axes[0] - 3.0)
    # second order: (2 pi / 24)^2 / 16 of the curvature
    np.testing.assert_allclose(patch.density, fine, atol=0.004)
    again = paired(patch, 0)
    assert again.window == Window.whole(circle)
    assert again.mass == pytest.approx(float(p.sum() * circle.cell_volume), rel=1e-12)


def test_the_width_of_a_gaussian_is_its_standard_deviation_given_the_others():
    precision = np.array([[1.0, 0.8], [0.8, 1.0]]) / 4
    d = PLANE.points
    p = np.exp(-0.5 * np.einsum('ik,ij,jk->k', d, precision, d)).reshape(PLANE.shape)
    # differences over a cell of a fourth of the width see it a half per cent too wide
    np.testing.assert_allclose(widths(Patch(Window.whole(PLANE), p)), 2 / 0.5, rtol=0.01)


def test_the_width_of_many_humps_is_that_of_one():
    x = FINE.grid.axes[0]
    hump = np.exp(-0.5 * (x / 1.5)**2)
    two = np.exp(-0.5 * ((x - 10) / 1.5)**2) + 0.1 * np.exp(-0.5 * ((x + 10) / 1.5)**2)
    assert widths(Patch(FINE, two))[0] == pytest.approx(widths(Patch(FINE, hump))[0], rel=1e-3)


def test_the_width_is_that_of_the_shape_however_little_of_it_is_left():
    p = np.ones(PLANE.shape)
    assert widths(Patch(Window.whole(PLANE), 1e-310 * p)) == pytest.approx(
        widths(Patch(Window.whole(PLANE), p)))


def around(patch):
    """Return what lies in each cell of the circle that a patch is on."""
    [cells], [first] = patch.window.cells, patch.window.offset
    found = np.zeros(cells)
    np.add.at(found, (first + np.arange(len(patch.density))) % cells, patch.density)
    return found


@pytest.mark.parametrize('count', [5, 23, 24, 25, 47, 48, 60])
@pytest.mark.parametrize('first', [0, 17, 24, -5, 100])
def test_what_goes_round_a_circle_comes_to_lie_on_it(first, count):
    circle = Grid((0.0,), (2 * np.pi,), (12,), (True,))
    p = np.random.default_rng(count).random(count)
    patch = Patch.at(circle, (1,), (first,), p)
    assert patch.density.shape == patch.window.shape
    wanted = np.zeros(24)
    np.add.at(wanted, (first + np.arange(count)) % 24, p)
    np.testing.assert_allclose(around(patch), wanted, rtol=1e-14)


@pytest.mark.parametrize('count', range(15, 25))
@pytest.mark.parametrize('change', [halved, paired])
def test_next_to_all_of_a_circle_is_changed_as_any_part_of_it_is(change, count):
    circle = Grid((0.0,), (2 * np.pi,), (12,), (True,))
    p = np.sin(np.pi * (np.arange(count) + 0.5) / count)**2
    before = Patch.at(circle, (1,), (17,), p)
    after = change(before, 0)
    assert after.density.shape == after.window.shape

    def moment(patch, k):
        cells = patch.window.cells[0]
        turn = np.exp(2j * np.pi * k * (np.arange(cells) + 0.5) / cells)
        return around(patch) @ turn * patch.window.spacing[0]

    assert moment(after, 0) == pytest.approx(moment(before, 0), rel=1e-12)
    # to be joined takes a twelfth of a squared cell's part of the first harmonic
    assert abs(moment(after, 1) - moment(before, 1)) < 0.02 * moment(before, 0).real


@pytest.mark.parametrize('count', range(15, 25))
def test_what_is_taken_out_of_a_circle_stays_where_it_was(count):
    circle = Grid((0.0,), (2 * np.pi,), (12,), (True,))
    whole = Patch(Window(circle, (1,), (0,), (24,)), np.random.default_rng(count).random(24))
    part = _taken(whole.window, whole.density.copy(), Window(circle, (1,), (17,), (count,)))
    taken = around(part) > 0
    assert taken.sum() == min(count + 4, 24)
    np.testing.assert_array_equal(around(part)[taken], whole.density[taken])
