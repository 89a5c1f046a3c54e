"""The humps of a belief, whatever kind it is of; how much it knows, and what lies at the edge."""

from collections import deque
import itertools
import tracemalloc

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.focus import fitted
from pif_ros.core.active.pieces import FEW
from pif_ros.core.active.regions import regions
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.window import Window
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous.path import PathBelief
from pif_ros.core.grid import Grid
from pif_ros.core.modes import connected, densest, MOST, NEARLY_ALL
from pif_ros.core.rivals.cloud import ParticleBelief, SEVERAL
from pif_ros.core.rivals.gaussian import GaussianBelief
import pytest
from scipy import stats

SEEDS = st.integers(0, 2**32 - 1)
SHAPES = [(17,), (7, 9), (4, 5, 6), (3, 4, 3, 5), (2, 2), (2, 7)]


def random_belief(seed):
    """Return a belief of random cells on a small grid of random axes, circles among them."""
    rng = np.random.default_rng(seed)
    # on a circle of two cells the short way round is either way
    shape = SHAPES[rng.integers(4)]
    grid = Grid(rng.uniform(-3, 0, len(shape)), rng.uniform(1, 4, len(shape)), shape,
                rng.random(len(shape)) < 0.5)
    density = rng.gamma(rng.choice([0.1, 0.3, 3.0]), size=shape)
    return GridBelief(grid, density).normalised()


# By brute force


def neighbours(cell, grid):
    """Yield the cells that share a side or a corner with a cell."""
    for shift in itertools.product((-1, 0, 1), repeat=grid.ndim):
        other = [c + d for c, d in zip(cell, shift)]
        for i, count in enumerate(grid.shape):
            if grid.periodic[i]:
                other[i] %= count
        if all(0 <= c < count for c, count in zip(other, grid.shape)):
            yield tuple(other)


def flooded(cells, grid):
    """Return the connected parts of a set of cells."""
    left, parts = set(cells), []
    while left:
        queue, part = deque([left.pop()]), set()
        while queue:
            cell = queue.popleft()
            part.add(cell)
            for other in neighbours(cell, grid):
                if other in left:
                    left.remove(other)
                    queue.append(other)
        parts.append(part)
    return parts


def in_order(belief, share):
    """Return the densest cells that together hold a share, and their weights."""
    w = belief.density / belief.density.sum()
    found, held = [], 0.0
    for flat in sorted(range(w.size), key=lambda k: -w.flat[k]):
        if held >= share - 1e-13:
            break
        found.append(tuple(int(i) for i in np.unravel_index(flat, w.shape)))
        held += w.flat[flat]
    return found, w


def moments(cells, w, grid):
    """Return mass, mean and covariance of some cells, one by one."""
    x = {c: np.array([grid.axes[i][k] for i, k in enumerate(c)]) for c in cells}
    mass = sum(w[c] for c in cells)
    mean = sum(w[c] * x[c] for c in cells) / mass
    for i in np.flatnonzero(grid.periodic):
        low, period = grid.lower[i], grid.upper[i] - grid.lower[i]
        turn = sum(w[c] * np.exp(2j * np.pi * (x[c][i] - low) / period) for c in cells)
        mean[i] = low + np.angle(turn) % (2 * np.pi) * period / (2 * np.pi)
    d = {c: grid.wrap(x[c] - mean) for c in cells}
    return mass, mean, sum(w[c] * np.outer(d[c], d[c]) for c in cells) / mass


def score(cell, core, grid):
    """Return the log of the core's Gaussian there, up to a constant."""
    mass, mean, covariance = core
    C = covariance + np.diag(grid.spacing**2) / 12
    d = grid.wrap(np.array([grid.axes[i][k] for i, k in enumerate(cell)]) - mean)
    return np.log(mass) - 0.5 * np.linalg.slogdet(C)[1] - 0.5 * d @ np.linalg.solve(C, d)


def modes_one_by_one(belief, share):
    """Return (mass, mean, covariance) of every hump, by loops over cells."""
    inside, w = in_order(belief, share)
    everything, _ = in_order(belief, max(share, NEARLY_ALL))
    parts = flooded(inside, belief.grid)
    cores = [moments(part, w, belief.grid) for part in parts]
    full = [set(part) for part in parts]
    for cell in set(everything) - set(inside):
        full[int(np.argmax([score(cell, core, belief.grid) for core in cores]))].add(cell)
    return sorted((moments(part, w, belief.grid) for part in full), key=lambda m: -m[0])


@given(SEEDS, st.floats(0.05, 0.97))
def test_the_densest_pieces_are_the_fewest_that_hold_an_amount(seed, amount):
    rng = np.random.default_rng(seed)
    density = rng.gamma(0.2, size=50).round(rng.integers(1, 9))
    mass = density * rng.uniform(0.5, 2.0, 50)
    mass /= mass.sum()
    found = densest(density, mass, amount)
    order = sorted(range(50), key=lambda k: (-density[k], k))
    held = np.cumsum(mass[order])
    count = int(np.count_nonzero(held < amount - 1e-14)) + 1
    assert set(np.flatnonzero(found)) == set(order[:count])


def test_what_is_empty_is_never_among_the_densest():
    density = np.array([0.0, 2.0, 0.0, 1.0])
    for amount in (0.9, 1.0, 7.0):
        assert densest(density, density / 3, amount).tolist() == [False, True, False, True]


@given(SEEDS, st.floats(0.02, 0.9))
def test_what_hangs_together_is_what_a_flood_reaches(seed, filled):
    rng = np.random.default_rng(seed)
    shape = SHAPES[rng.integers(len(SHAPES))]
    grid = Grid((0,) * len(shape), (1,) * len(shape), shape, rng.random(len(shape)) < 0.5)
    cells = np.union1d(np.flatnonzero(rng.random(grid.size) < filled), rng.integers(grid.size))
    part = connected(cells, grid)
    places = [tuple(map(int, np.unravel_index(cell, shape))) for cell in cells]
    found = {frozenset(places[k] for k in np.flatnonzero(part == number))
             for number in np.unique(part)}
    assert found == {frozenset(part) for part in flooded(places, grid)}


@given(SEEDS, st.sampled_from([0.3, 0.7, 0.95]))
def test_the_modes_are_those_found_cell_by_cell(seed, share):
    belief = random_belief(seed)
    expected = modes_one_by_one(belief, share)
    found = belief.modes(share, most=100)
    assert len(found) == len(expected)
    assert_allclose([m.mass for m in found], [mass for mass, *_ in expected], atol=1e-12)
    for mode in found:
        # those of equal mass may come in any order
        near = min(expected, key=lambda m: abs(m[0] - mode.mass)
                   + np.abs(belief.grid.wrap(m[1] - mode.mean)).sum())
        assert_allclose(belief.grid.wrap(mode.mean - near[1]), 0, atol=1e-9)
        assert_allclose(mode.covariance, near[2], atol=1e-9)


# On all cells


def two_humps(grid, light, heavy, S, T):
    """Return 0.3 of one Gaussian and 0.7 of another, normalised."""
    return GridBelief(grid, 0.3 * GridBelief.gaussian(grid, light, S).density
                      + 0.7 * GridBelief.gaussian(grid, heavy, T).density)


S = np.array([[0.5, 0.3], [0.3, 0.4]])
T = np.array([[0.8, -0.2], [-0.2, 0.3]])


@pytest.mark.parametrize('shift', [0.0, 4.0, 5.9])
def test_two_gaussians_are_two_modes_of_their_masses_means_and_covariances(shift):
    grid = Grid((-10, -6), (10, 6), (200, 120), (False, True))
    light, heavy = [-5, grid.wrap(np.array([0, -2 + shift]))[1]], [4, 2]
    modes = two_humps(grid, light, heavy, S, T).modes()
    assert len(modes) == 2
    # what is left out, 1e-4 of the mass at four sigma and more: r^2 / 2 = 9, so that no variance
    # lacks more than 1e-3 of itself
    assert_allclose([m.mass for m in modes], [0.7, 0.3], atol=1e-4)
    assert_allclose(grid.wrap(modes[0].mean - heavy), 0, atol=1e-3)
    assert_allclose(grid.wrap(modes[1].mean - light), 0, atol=1e-3)
    assert_allclose(modes[0].covariance, T, atol=1.2e-3)
    assert_allclose(modes[1].covariance, S, atol=1.2e-3)


def test_a_single_hump_is_all_of_the_belief():
    grid = Grid((-6, -6), (6, 6), (96, 96))
    belief = GridBelief.gaussian(grid, [0.3, -0.2], S)
    [mode] = belief.modes()
    assert NEARLY_ALL <= mode.mass <= 1
    assert_allclose(mode.mean, [0.3, -0.2], atol=1e-3)
    assert_allclose(mode.covariance, S, rtol=1.2e-3)


def test_of_many_specks_the_heaviest_are_told():
    grid = Grid((0, 0), (1, 1), (100, 100))
    p = np.zeros(grid.shape)
    p[::2, ::2] = np.random.default_rng(4).permutation(np.linspace(1, 3, 2500)).reshape(50, 50)
    modes = GridBelief(grid, p).modes(0.99)
    assert len(modes) == MOST
    assert_allclose([m.mass for m in modes], np.sort(p.ravel() / p.sum())[::-1][:MOST],
                    rtol=0.01)
    masses = [m.mass for m in GridBelief(grid, p).modes(0.99, most=3)]
    assert len(masses) == 3 and masses == sorted(masses, reverse=True)


def test_a_share_of_nothing_is_the_densest_cell_and_all_that_lies_around():
    belief = GridBelief.gaussian(Grid((-6, -6), (6, 6), (40, 40)), [1, 1], S)
    [mode] = belief.modes(0.0)
    assert_allclose(mode.mean, belief.mean(), atol=1e-3)


@pytest.mark.parametrize('periodic', [(False, False), (True, False), (True, True)])
def test_the_mass_at_the_edge_is_that_of_the_outermost_cells(periodic):
    belief = random_belief(3)
    grid = Grid((-1, 0), (2, 5), (7, 9), periodic)
    belief = GridBelief(grid, np.random.default_rng(3).gamma(0.3, size=(7, 9)))
    w = belief.density / belief.density.sum()
    expected = sum(w[i, j] for i, j in np.ndindex(7, 9)
                   if (not periodic[0] and i in (0, 6)) or (not periodic[1] and j in (0, 8)))
    assert belief.edge_mass() == pytest.approx(expected, abs=1e-12)


# In patches


YARD = Grid((-50.0, -50.0), (50.0, 50.0), (200, 200), (False, True))


def patch(grid, level, first, density):
    return Patch(Window.of(grid, level, first, density.shape), density)


def same_modes(found, expected, atol=1e-9):
    assert_allclose([m.mass for m in found], [m.mass for m in expected], atol=atol)
    for one, other in zip(found, expected):
        assert_allclose(YARD.wrap(one.mean - other.mean), 0, atol=atol)
        assert_allclose(one.covariance, other.covariance, atol=atol)


def ring(grid):
    """Return a thin ring, a hump inside it, and one across the seam."""
    p = np.exp(-0.5 * ((np.hypot(*grid.points) - 30) / 0.8)**2)
    for place, weight in (([3, 5], 9.0), ([-20, 49.5], 3.0)):
        d = grid.wrap(grid.points - np.array(place)[:, None])
        p += weight * np.exp(-0.5 * (d * d).sum(axis=0) / 1.5**2)
    return GridBelief(grid, p.reshape(grid.shape)).normalised()


def test_patches_have_the_modes_entropy_and_edge_of_the_grid_that_they_are_cut_from():
    full = ring(YARD)
    whole = ActiveBelief(YARD, (Patch(Window.whole(YARD), full.density),))
    cut = regions(whole, 1e-9)
    assert len(full.modes()) == 3 and len(cut.patches) > 1
    for belief in (whole, cut):
        # 1e-9 of each patch is left out, up to 50 m away from a mean
        same_modes(belief.modes(), full.modes(), atol=1e-5)
        assert belief.entropy() == pytest.approx(full.entropy(), abs=1e-6)
        assert belief.edge_mass() == pytest.approx(full.edge_mass(), abs=1e-8)


@pytest.mark.parametrize('seed', range(5))
def test_patches_that_overlap_are_one_density(seed):
    full, rng = ring(YARD), np.random.default_rng(seed)
    shares = rng.dirichlet([0.5] * 3, size=YARD.shape).transpose(2, 0, 1)
    belief = ActiveBelief(YARD, tuple(Patch(Window.whole(YARD), full.density * share)
                                      for share in shares))
    # the last cell of a region may be cut between patches: 1e-6 of the mass, 50 m away
    same_modes(belief.modes(), full.modes(), atol=3e-3)
    assert belief.entropy() == pytest.approx(full.entropy(), abs=1e-9)


def test_a_hump_on_cells_of_several_sizes_is_one_with_its_moments():
    full = ring(YARD)
    belief = fitted(ActiveBelief(YARD, (Patch(Window.whole(YARD), full.density),)),
                    RegionSettings(negligible=1e-7, resolution=3))
    assert len({p.window.level for p in belief.patches}) > 1
    # which cells of its rim belong to a hump depends on how wide they are
    found, expected = belief.modes(), full.modes()
    assert_allclose([m.mass for m in found], [m.mass for m in expected], atol=1e-3)
    for one, other in zip(found, expected):
        assert_allclose(YARD.wrap(one.mean - other.mean), 0, atol=0.02)
        assert_allclose(one.covariance, other.covariance, atol=5e-3 * other.covariance.max())


def test_one_wide_cell_touches_the_fine_ones_beside_it_and_no_others():
    level, wide = (2, 0), np.array([[1.0]])
    beside = patch(YARD, level, (44, 30), np.ones((4, 1)))
    apart = patch(YARD, level, (45, 30), np.ones((4, 1)))
    one = patch(YARD, (0, 0), (10, 30), wide)
    assert len(ActiveBelief(YARD, (one, beside)).modes(0.9999)) == 1
    assert len(ActiveBelief(YARD, (one, apart)).modes(0.9999)) == 2
    across = patch(YARD, (0, 1), (10, 399), wide), patch(YARD, (0, 0), (10, 0), wide)
    assert len(ActiveBelief(YARD, across).modes(0.9999)) == 1


def test_a_single_cell_among_1e12_is_a_mode_and_the_others_are_never_made():
    world = Grid((0,) * 4, (1000,) * 4, (1000,) * 4)
    places = [(3, 4, 5, 6), (900, 4, 5, 6)]
    belief = ActiveBelief(world, tuple(
        patch(world, (9, 9, 9, k), np.array(place) * 2**np.array([9, 9, 9, k]),
              np.full((2,) * 4, 1.0 + k)) for k, place in enumerate(places)))
    tracemalloc.start()
    modes = belief.modes()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # a bit for each would be 125 GB
    assert peak < 1e7
    fine = 2.0**-9
    assert_allclose([m.mass for m in modes], [0.5, 0.5])
    assert_allclose(sorted((m.mean for m in modes), key=lambda x: x[0]),
                    [[3 + fine, 4 + fine, 5 + fine, 7], [900 + fine, 4 + fine, 5 + fine, 6.5]])


def test_the_world_s_edge_is_its_outermost_wide_cells_however_fine_those_are_cut():
    p = np.random.default_rng(7).gamma(0.3, size=YARD.shape)
    whole = Patch(Window.whole(YARD), p)
    w = p / p.sum()
    expected = w[0].sum() + w[-1].sum()
    assert ActiveBelief(YARD, (whole,)).edge_mass() == pytest.approx(expected, abs=1e-12)
    fine = ActiveBelief(YARD, (patch(YARD, (2, 1), (0, 0), np.kron(p, np.ones((4, 2)))),))
    assert fine.edge_mass() == pytest.approx(expected, abs=1e-12)


def test_halves_at_the_edge_of_the_world_stay_there():
    near = np.array([-49.8, 0.0])
    d = YARD.points - near[:, None]
    p = np.exp(-0.5 * (d * d).sum(axis=0) / 0.4**2).reshape(YARD.shape)
    belief = fitted(ActiveBelief(YARD, (Patch(Window.whole(YARD), p),)),
                    RegionSettings(resolution=3)).normalised()
    assert belief.patches[0].window.level[0] > 0 and belief.patches[0].window.offset[0] == 0
    shown = belief.on(YARD, (0, 1))
    assert shown.mass == pytest.approx(1, abs=1e-12)
    assert not shown.density[10:].any()
    [mode] = belief.modes()
    # at the edge half of the hump is cut off: 0.4 * sqrt(2 / pi) = 0.3 beyond the middle at most
    assert np.all(np.abs(mode.mean - near) < 0.35)
    assert belief.edge_mass() == pytest.approx(shown.density[0].sum() * YARD.cell_volume, abs=1e-9)


def test_pieces_of_very_different_cells_are_bounded_and_keep_the_moments():
    d = np.arange(-40, 40)[:, None]**2 + np.arange(-40, 40)**2
    sharp = patch(YARD, (8, 8), (100 * 256, 100 * 256), 1e3 * np.exp(-d / 200.0))
    belief = ActiveBelief(YARD, (Patch(Window.whole(YARD), np.ones(YARD.shape)), sharp))
    found = belief._pieces()
    # 40,000 cells in 65,536 each would be too many
    assert YARD.size < len(found.mass) <= FEW and found.mass.sum() == pytest.approx(1, abs=1e-12)
    mean = found.points[0] @ found.mass
    assert mean == pytest.approx(belief.mean()[0], abs=1e-9)
    assert (found.points[0] - mean)**2 @ found.mass == pytest.approx(
        belief.covariance()[0, 0], rel=1e-9)
    assert len(belief.modes(share=0.9 * sharp.mass / belief.mass)) == 1


# What keeps no grid


def cloud(x, box=None, weights=None):
    count = x.shape[1]
    w = np.full(count, 1 / count) if weights is None else weights
    with np.errstate(divide='ignore'):
        return ParticleBelief(x, np.log(w), box)


def drawn(seed, count=4000):
    """Return particles of 0.3 of one Gaussian and 0.7 of another."""
    rng = np.random.default_rng(seed)
    light, heavy = round(0.3 * count), round(0.7 * count)
    return np.concatenate([rng.multivariate_normal([-5, -2], S, light).T,
                           rng.multivariate_normal([4, 2], T, heavy).T], axis=1)


@pytest.mark.parametrize('seed', range(5))
def test_particles_of_two_gaussians_are_two_modes_with_the_moments_of_each(seed):
    x = drawn(seed)
    modes = cloud(x).modes()
    assert len(modes) == 2
    # what lies outside, 1e-4 of the mass and less than ten particles
    assert_allclose([m.mass for m in modes], [0.7, 0.3], atol=3e-3)
    for mode, part in zip(modes, (x[:, 1200:], x[:, :1200])):
        assert_allclose(mode.mean, part.mean(axis=1), atol=0.02)
        assert_allclose(mode.covariance, np.cov(part), atol=0.03)


def test_dead_particles_do_not_blur_those_that_live():
    x, w = drawn(0), np.full(4000, 1 / 4000)
    modes = cloud(np.column_stack([x, [1e90, -1e90]]), weights=np.append(w, 0.0)).modes()
    assert [m.mass for m in modes] == pytest.approx([m.mass for m in cloud(x).modes()])


@pytest.mark.parametrize('ndim', [1, 2, 3, 4])
@pytest.mark.parametrize('count', [300, 5000])
def test_particles_of_one_gaussian_are_one_mode(ndim, count):
    for seed in range(3):
        x = np.random.default_rng(seed).standard_normal((ndim, count))
        assert len(cloud(x).modes()) == 1


def test_particles_across_a_seam_are_one_mode_with_a_circular_mean():
    box = Grid((-10, -np.pi), (10, np.pi), (50, 50), (False, True))
    x = np.random.default_rng(1).standard_normal((2, 3000)) * [[1.0], [0.3]]
    x[1] = (x[1] + np.pi - 0.1 + np.pi) % (2 * np.pi) - np.pi
    [mode] = cloud(x, box).modes()
    assert abs(box.wrap(mode.mean - [0, np.pi - 0.1])[1]) < 0.02
    assert_allclose(np.diag(mode.covariance), [1.0, 0.09], rtol=0.1)


@pytest.mark.parametrize('x, weights', [
    (np.full((2, 50), 3.0), None), (np.array([[2.0], [1.0]]), None),
    (np.array([[2.0, 9.0], [1.0, 1e90]]), np.array([1.0, 0.0])),
    (np.array([[0.0, 1e6, 0.0], [0.0, 0.0, 1e6]]), None)])
def test_any_cloud_has_a_mode_with_finite_moments(x, weights):
    belief = cloud(x, weights=weights)
    modes = belief.modes()
    assert modes and all(np.all(np.isfinite(m.mean)) and m.mass > 0 for m in modes)
    assert np.isfinite(belief.entropy())
    if x.shape[1] == 50:
        assert_allclose(modes[0].mean, [3, 3])
        assert_allclose(modes[0].covariance, 0, atol=1e-12)


def test_a_few_particles_are_no_hump_of_their_own_but_several_are():
    rng = np.random.default_rng(2)
    heavy = rng.standard_normal((2, 1000))
    for count, humps in ((SEVERAL // 2, 1), (5 * SEVERAL, 2)):
        x = np.concatenate([heavy, 12 + 0.3 * rng.standard_normal((2, count))], axis=1)
        assert len(cloud(x).modes(0.999)) == humps


def test_particles_tell_what_lies_at_the_edge_of_their_box_and_beyond():
    box = Grid((0, 0), (10, 10), (10, 10), (False, True))
    x = np.array([[0.5, 1.5, 9.5, -3.0, 8.5], [0.1, 0.1, 5.0, 5.0, 9.9]])
    assert cloud(x, box).edge_mass() == pytest.approx(0.6)
    assert cloud(x).edge_mass() == 0


def test_a_mean_and_a_covariance_are_one_mode_until_they_are_lost():
    belief = GaussianBelief(np.array([1.0, 2.0]), S)
    [mode] = belief.modes()
    assert (mode.mass, mode.mean.tolist(), mode.covariance.tolist()) == (1, [1, 2], S.tolist())
    assert belief.entropy() == pytest.approx(
        stats.multivariate_normal([1, 2], S).entropy(), abs=1e-12)
    assert GaussianBelief(np.full(2, np.nan), S).modes() == []


@pytest.mark.parametrize('seed', range(3))
def test_particles_know_about_as_much_as_what_they_are_drawn_from(seed):
    x = np.random.default_rng(seed).multivariate_normal([0, 0], S, 1000).T
    exact = stats.multivariate_normal([0, 0], S).entropy()
    # three times the spread of the mean of -log p, sqrt(n / 2 / 1000); a histogram as fine without
    # any smoothing lacks 0.18
    assert cloud(x).entropy() == pytest.approx(exact, abs=0.1)


def test_what_is_believed_along_a_path_is_told_of_now():
    inner = random_belief(5)
    belief = PathBelief(inner, random_belief(6))
    assert belief.entropy() == inner.entropy() and belief.edge_mass() == inner.edge_mass()
    same = [(m.mass, m.mean.tolist()) for m in inner.modes()]
    assert [(m.mass, m.mean.tolist()) for m in belief.modes()] == same
