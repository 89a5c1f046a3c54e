"""Which cells are kept: what is dropped, what lives on, and what that costs."""

import numpy as np
from pif_ros.core.active import RegionSettings
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.focus import fitted
from pif_ros.core.active.regions import DEAD, regions
from pif_ros.core.active.window import Window
from pif_ros.core.grid import Grid
import pytest

PLANE = Grid((-50.0, -50.0), (50.0, 50.0), (200, 200))
ROUND = Grid((-50.0, -np.pi), (50.0, np.pi), (200, 72), (False, True))


def humps(grid, *places, weights=None, sigma=1.0):
    """Return a belief of Gaussians, on all cells."""
    p = np.zeros(grid.size)
    for place, weight in zip(places, weights or np.ones(len(places))):
        d = grid.wrap(grid.points - np.array(place)[:, None])
        p += weight * np.exp(-0.5 * (d * d).sum(axis=0) / sigma**2)
    whole = ActiveBelief(grid, (Patch(Window.whole(grid), p.reshape(grid.shape)),))
    return whole.normalised()


def overlap(a, b):
    return all(x < y + m and y < x + n for x, y, n, m in zip(
        a.window.offset, b.window.offset, a.window.shape, b.window.shape))


def test_disjoint_humps_are_disjoint_patches():
    belief = regions(humps(PLANE, (-20, -20), (15, 30), (30, -10)), 1e-6)
    assert len(belief.patches) == 3
    assert not any(overlap(a, b) for a in belief.patches for b in belief.patches if a is not b)
    assert sorted(patch.mass for patch in belief.patches) == pytest.approx([1 / 3] * 3, abs=1e-5)


@pytest.mark.parametrize('negligible', [1e-3, 1e-5, 1e-8])
def test_what_is_dropped_is_counted_and_no_more_than_allowed(negligible):
    before = humps(PLANE, (0, 0), (3, 1))
    after = regions(before, negligible)
    assert 0 < after.dropped <= negligible
    assert after.mass == pytest.approx(before.mass - after.dropped, abs=1e-12)
    again = regions(after, negligible)
    assert after.dropped <= again.dropped <= 2 * negligible


def test_a_light_hump_is_trimmed_by_its_own_measure_and_lives_until_it_is_dead():
    belief = regions(humps(PLANE, (-20, 0), (20, 0)), 1e-6)
    heavy, light = belief.patches
    size = light.window.size
    for _ in range(11):
        light = Patch(light.window, light.density * 0.1)
        belief = regions(ActiveBelief(PLANE, (heavy, light)), 1e-6)
        assert len(belief.patches) == 2
        light = min(belief.patches, key=lambda patch: patch.mass)
        # the trimming of what is trimmed takes a few more cells, whatever the weight
        assert light.window.size > 0.5 * size
    light = Patch(light.window, light.density * 0.01 * DEAD / 1e-12)
    belief = regions(ActiveBelief(PLANE, (heavy, light)), 1e-6)
    assert len(belief.patches) == 1
    assert belief.dropped >= light.mass / (heavy.mass + light.mass)


def test_a_ring_is_cut_into_patches_that_save_most_of_its_box():
    yard = Grid((-50.0, -50.0), (50.0, 50.0), (1000, 1000))
    p = np.exp(-0.5 * ((np.hypot(*yard.points) - 40) / 0.2)**2).reshape(yard.shape)
    ring = regions(ActiveBelief(yard, (Patch(Window.whole(yard), p),)), 1e-6)
    assert len(ring.patches) > 4
    assert ring.size < 0.3 * 820**2
    assert ring.mass == pytest.approx(p.sum() * yard.cell_volume, rel=2e-6)


def test_patches_that_meet_become_one_and_nothing_is_lost():
    both = humps(PLANE, (0, 0), (1, 0))
    p = both.patches[0].density
    left, right = p.copy(), p.copy()
    left[101:], right[:101] = 0, 0
    parts = [regions(ActiveBelief(PLANE, (Patch(Window.whole(PLANE), half),)), 1e-9).patches
             for half in (left, right)]
    one = regions(ActiveBelief(PLANE, parts[0] + parts[1]), 1e-9)
    assert len(one.patches) == 1
    np.testing.assert_allclose(one.on(PLANE, (0, 1)).density, p, atol=1e-8)


@pytest.mark.parametrize('heading', [0.0, 3.1])
def test_a_circle_is_cut_open_where_nothing_is(heading):
    whole = humps(ROUND, (5.0, heading), sigma=0.4)
    belief = regions(whole, 1e-6)
    assert belief.patches[0].window.circles == (False, False)
    assert belief.patches[0].window.shape[1] < 60
    np.testing.assert_allclose(belief.mean(), [5.0, heading], atol=1e-5)
    np.testing.assert_allclose(belief.covariance(), whole.covariance(), atol=1e-4)


def test_patches_on_both_sides_of_a_seam_are_joined_across_it():
    whole = humps(ROUND, (5.0, np.pi), sigma=0.4)
    p = whole.patches[0].density
    left, right = p.copy(), p.copy()
    left[:, 36:], right[:, :36] = 0, 0
    parts = [regions(ActiveBelief(ROUND, (Patch(Window.whole(ROUND), half),)), 1e-9).patches
             for half in (left, right)]
    one = regions(ActiveBelief(ROUND, parts[0] + parts[1]), 1e-9)
    assert len(one.patches) == 1
    np.testing.assert_allclose(one.on(ROUND, (0, 1)).density, p, atol=1e-8)
    assert abs(one.mean()[1]) == pytest.approx(np.pi, abs=1e-6)


def test_of_a_belief_without_mass_no_patch_is_left():
    nothing = ActiveBelief(PLANE, (Patch(Window.whole(PLANE), np.zeros(PLANE.shape)),), 0.25)
    left = fitted(nothing, RegionSettings())
    assert (left.patches, left.mass, left.dropped) == ((), 0.0, 0.25)


@pytest.mark.parametrize('places', [[(0, 0), (30, 3)], [(0, 0), (30, 0)], [(199, 199), (0, 199)],
                                    [(199, 5)]])
def test_a_single_cell_is_a_patch_too_and_keeps_its_mass(places):
    p = np.zeros(PLANE.shape)
    for place in places:
        p[place] = 1.0
    whole = ActiveBelief(PLANE, (Patch(Window.whole(PLANE), p),))
    belief = regions(whole, 1e-6)
    assert len(belief.patches) == len(places)
    assert all(min(patch.window.shape) >= 2 for patch in belief.patches)
    np.testing.assert_array_equal(belief.on(PLANE, (0, 1)).density, p)
