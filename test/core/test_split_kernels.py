"""The kernel split by axis: what each factor does, and how near the product comes to the truth."""

from dataclasses import replace
import itertools

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from oracles import gaussian, linear_moments
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, split_kernel
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.kernels.split import axis_moments, symmetric_kernel
from pif_ros.core.kernels.tilted import half_width, lattice_weights, NARROW
from pif_ros.core.models import StateModel
from pif_ros.core.systems import (benes, coupled_trigonometric, double_well, lorenz_63,
                                  ornstein_uhlenbeck)
import pytest

SEEDS = st.integers(0, 2**32 - 1)


def moved(K, p, steps):
    """Return a density after some steps, the order turned at every other one."""
    for k in range(steps):
        p = (K.turned if k % 2 else K) @ p
    return p


def l1(p, q, grid):
    return float(np.abs(p - q).sum() * grid.cell_volume)


# Weights on a lattice

@given(SEEDS, st.floats(-4, 2.5))
def test_weights_have_mass_1_and_the_moments_that_they_can_have_and_none_is_negative(seed, log_v):
    rng = np.random.default_rng(seed)
    mean = np.append(rng.uniform(-0.5, 0.5, 40), [-0.5, 0, 0.5, 1e-12])
    variance = 10**log_v * rng.uniform(0.3, 1, 44)
    half = half_width(variance, 1e-5)
    w, nodes = lattice_weights(mean, variance, half), np.arange(-half, half + 1)
    # whatever is on whole numbers with this mean has the variance |m| (1 - |m|) at least
    possible = np.maximum(variance, np.abs(mean) * (1 - np.abs(mean)))
    assert w.min() >= 0
    np.testing.assert_allclose(w.sum(axis=0), 1, atol=1e-14)
    np.testing.assert_allclose(nodes @ w, mean, atol=1e-13 * half)
    np.testing.assert_allclose((nodes**2) @ w - mean**2, possible, rtol=1e-11, atol=1e-14)


@pytest.mark.parametrize('variance', [1 / 3, 0.4, 0.489])
def test_five_nodes_have_four_moments_of_a_gaussian_wherever_the_mean_is(variance):
    mean = np.linspace(-0.5, 0.5, 101)
    w = lattice_weights(mean, np.full(101, variance), half_width(np.array([variance]), 1e-5))
    assert w.shape == (5, 101) and w.min() >= 0
    moves = np.arange(-2, 3)[:, None] - mean
    for power, moment in ((1, 0), (2, variance), (3, 0), (4, 3 * variance**2)):
        np.testing.assert_allclose((moves**power * w).sum(axis=0), moment, atol=1e-14)


@pytest.mark.parametrize('variance', [NARROW, 0.5, 1.0, 30.0])
def test_wide_weights_are_a_gaussian_but_for_a_tilt(variance):
    mean = np.linspace(-0.5, 0.5, 9)
    half = half_width(np.array([variance]), 1e-5)
    log_w = np.log(lattice_weights(mean, np.full(9, variance), half))
    # log w = a + b k + c k^2; the last step of Newton is linear in w: 1e-3 and less squared
    bend = np.diff(log_w, n=2, axis=0)
    np.testing.assert_allclose(bend, bend.mean(axis=0) * np.ones_like(bend), atol=1e-3)
    if variance >= 1:
        # next to no aliasing, exp(-2 pi^2): the tilt only makes up for the tails, some 1e-5 far
        # out, so it is 1e-3
        assert bend.mean() == pytest.approx(-1 / variance, rel=2e-3)


# Each factor

@st.composite
def cases(draw):
    """Give a random model of quadratic drift, (C, B, a) of it, a grid, settings and a time."""
    rng = np.random.default_rng(draw(SEEDS))
    n = draw(st.integers(1, 3))
    shape = tuple(int(v) for v in rng.integers(7, (60, 13, 9)[n - 1], n))
    periodic = tuple(bool(v) for v in rng.integers(0, 2, n))
    width = rng.uniform(0.5, 2, n)
    grid = Grid(-width, width, shape, periodic)
    C, B, a = rng.normal(size=(n, n, n)), rng.normal(size=(n, n)), rng.normal(size=n)
    step = draw(st.floats(0.001, 0.05))

    def drift(x, t):
        flat = x.reshape(n, -1)
        f = np.einsum('ijk,jN,kN->iN', C, flat, flat) + B @ flat + a[:, None] * np.cos(t)
        return f.reshape(x.shape)

    deviation = grid.spacing * rng.uniform(0, 2, n) / np.sqrt(step)
    model = StateModel(tuple('abc'[:n]), drift, np.diag(deviation), time_dependent=True)
    return model, (C, B), grid, KernelSettings(step), float(rng.uniform(0, 2))


def moves_of(grid):
    """Return the move from each cell (last axis) to each cell, the short way round, (n, N, N)."""
    return grid.wrap(grid.points[:, :, None] - grid.points[:, None, :])


@given(cases())
@settings(max_examples=60, deadline=None)
def test_every_factor_moves_along_its_axis_alone_with_the_moments_of_the_equation(case):
    model, (C, B), grid, how, t = case
    tau, h, x, moves = t + how.time_step / 2, how.time_step, grid.points, moves_of(grid)
    f, checked = model.drift(x, tau), 0
    for d, factor in enumerate(split_kernel(model, grid, how, t).factors):
        dense, dx, g = factor.toarray(), grid.spacing[d], model.diffusion(tau)[d, d]
        mass = dense.sum(axis=0)
        assert dense.min() >= 0 and mass.max() < 1 + 1e-12
        aside = np.abs(np.delete(moves, d, axis=0)).max(axis=0, initial=0) > 1e-9
        assert not dense[aside].any()
        # dm/ds = f + f' m + s g f'' / 2, dV/ds = 2 f' V + g from 0 to h
        slope, bend = ((C[d, d] + C[d, :, d]) @ x + B[d, d]), 2 * C[d, d, d]
        z = h * slope
        mean = h * f[d] * np.expm1(z) / z + h**2 * g * bend / 2 * (np.expm1(z) - z) / z**2
        variance = h * g * np.expm1(2 * z) / (2 * z)
        between = mean / dx % 1
        variance = np.maximum(variance, between * (1 - between) * dx**2)
        # columns that nothing leaves, nor goes half-way round
        farthest = np.abs(mean) + 4.5 * np.sqrt(variance) + 2 * dx
        whole = farthest < (grid.upper[d] - grid.lower[d]) / 2
        assert grid.periodic[d] <= np.allclose(mass, 1, atol=1e-12)
        whole &= mass > 1 - 1e-12
        found = np.einsum('ij,ij->j', moves[d], dense)
        spread = np.einsum('ij,ij->j', moves[d]**2, dense) - found**2
        np.testing.assert_allclose(found[whole], mean[whole], atol=1e-9 * dx)
        np.testing.assert_allclose(spread[whole], variance[whole], rtol=1e-9, atol=1e-9 * dx**2)
        checked += whole.sum()
    assert checked or max(grid.shape) < 40


@given(cases(), SEEDS)
@settings(max_examples=30, deadline=None)
def test_the_kernel_is_the_product_of_its_dense_matrices_for_one_density_and_for_many(case, seed):
    model, _, grid, how, t = case
    K = split_kernel(model, grid, how, t)
    dense = np.eye(grid.size)
    for factor in K.factors:
        dense = factor.toarray() @ dense
    p = np.random.default_rng(seed).uniform(size=(grid.size, 5))
    np.testing.assert_allclose(K @ p, dense @ p, rtol=1e-12)
    np.testing.assert_array_equal(K @ p[:, 0], (K @ p)[:, 0])
    np.testing.assert_allclose(K.T @ p, dense.T @ p, rtol=1e-12)
    backwards = np.linalg.multi_dot([np.eye(grid.size), *(f.toarray() for f in K.factors)])
    np.testing.assert_allclose(K.turned @ p, backwards @ p, rtol=1e-12)
    assert K.nnz == sum(np.count_nonzero(f.toarray()) for f in K.factors)
    assert K.shape == (grid.size, grid.size)


@given(cases())
@settings(max_examples=20, deadline=None)
def test_what_leaves_the_grid_is_what_a_larger_grid_has_beyond_it(case):
    model, _, grid, how, t = case
    how = replace(how, tolerance=1e-10)
    cells = [0 if round_ else 3 for round_ in grid.periodic]
    beyond = grid.spacing * cells
    larger = Grid(grid.lower - beyond, grid.upper + beyond,
                  tuple(np.array(grid.shape) + 2 * np.array(cells)), grid.periodic)
    inside = np.arange(larger.size).reshape(larger.shape)[tuple(
        slice(c, c + n) for c, n in zip(cells, grid.shape))].ravel()
    for own, whole in zip(split_kernel(model, grid, how, t).factors,
                          split_kernel(model, larger, how, t).factors):
        # the larger grid may cut the tails further out, of which there are 1e-10, 6 deviations off
        np.testing.assert_allclose(own.toarray(), whole.toarray()[np.ix_(inside, inside)],
                                   atol=1e-8)


def test_a_periodic_axis_is_a_circle():
    # the same drift turned round by three cells
    def model(turn):
        return StateModel(('a',), lambda x, t: 3 * np.sin(x - turn), [[1.0]])

    grid = Grid((-np.pi,), (np.pi,), (20,), (True,))
    one, two = (split_kernel(model(3 * k * grid.spacing[0]), grid, KernelSettings(0.1))
                for k in (0, 1))
    turned = np.roll(one.factors[0].toarray(), (3, 3), (0, 1))
    np.testing.assert_allclose(two.factors[0].toarray(), turned, atol=1e-12)


def test_noise_of_many_turns_of_a_circle_leaves_nothing_known():
    grid = Grid((-1.0,), (1.0,), (30,), (True,))
    [factor] = split_kernel(StateModel(('a',), lambda x, t: np.sin(np.pi * x), [[10.0]]), grid,
                            KernelSettings(0.5)).factors
    # 3.5 turns: exp(-2 pi^2 3.5^2) is nothing, and the tails that are left out hold 1e-5
    np.testing.assert_allclose(factor.toarray(), 1 / 30, rtol=1e-4)
    assert factor.nnz == 900


def test_the_moments_are_those_of_the_equation_to_second_order():
    f, slope, bend, g = 0.7, -1.3, 0.9, 0.8
    errors = []
    for h in (0.1, 0.05):
        mean, variance = axis_moments(*(np.array([h * v]) for v in (f, slope, bend)), h * g)
        errors.append(np.array([mean[0] - h * f - h**2 / 2 * (f * slope + g * bend / 2),
                                variance[0] - g * h * (1 + slope * h)]))
    # what is left is of third order
    np.testing.assert_allclose(errors[0] / errors[1], 8, rtol=0.1)


@pytest.mark.parametrize('step', [0.01, 0.3, 2.0, 50.0])
def test_a_linear_drift_is_carried_exactly_however_long_the_step(step):
    system, grid = ornstein_uhlenbeck(a=1.0, sigma=1.0), Grid((-8.0,), (8.0,), (200,))
    [factor] = split_kernel(system.model, grid, KernelSettings(step, tolerance=1e-9)).factors
    p = gaussian(grid.points, [1.0], [[0.1]])
    found, x = factor @ p, grid.points[0]
    # m = e^-t, P = 0.1 e^-2t + (1 - e^-2t) / 2
    variance = 0.1 * np.exp(-2 * step) - np.expm1(-2 * step) / 2
    mean = x @ found / found.sum()
    assert mean == pytest.approx(np.exp(-step), abs=1e-9)
    # 0.08 is the width of a cell; means between nodes of thin columns spread by nothing
    assert x**2 @ found / found.sum() - mean**2 == pytest.approx(variance, rel=1e-6)


def test_a_drift_that_is_rough_from_cell_to_cell_or_ends_at_the_grid_is_taken_as_it_is():
    def drift(x, t):
        return np.where(np.abs(x) < 1, np.sign(x) * 100, np.nan)

    grid = Grid((-1.0,), (1.0,), (40,))
    dense = split_kernel(StateModel(('a',), drift, [[1.0]]), grid, KernelSettings(
        0.001)).factors[0].toarray()
    move = (grid.points[0] @ dense / dense.sum(axis=0)) - grid.points[0]
    # 100 * 0.001 either way, from all cells that the edge is far from
    np.testing.assert_allclose(move[8:20], -0.1, atol=1e-12)
    np.testing.assert_allclose(move[20:32], 0.1, atol=1e-12)


def test_a_drift_that_is_not_finite_is_refused_with_its_place():
    model = StateModel(('a',), lambda x, t: 1 / (x - 0.25), [[1.0]])
    with np.errstate(divide='ignore'), pytest.raises(
            ValueError, match=r'^drift: expected finite numbers in every cell, got inf on axis 0 '
                              r'at \[0.25\]$'):
        split_kernel(model, Grid((-1.0,), (1.0,), (4,)), KernelSettings(0.01))


# Correlated noise

@given(SEEDS, st.integers(2, 3))
def test_noise_is_taken_apart_into_integer_directions(seed, n):
    root = np.random.default_rng(seed).normal(size=(n, n + 2))
    g = root @ root.T
    along, others = integer_directions(g)
    assert along.min() >= 0 and all(strength > 0 for strength, _ in others)
    assert len(others) + np.count_nonzero(along) <= n * (n + 1) // 2
    whole = np.diag(along) + sum((s * np.outer(v, v) for s, v in others), np.zeros((n, n)))
    np.testing.assert_allclose(whole, g, atol=1e-9 * np.trace(g))


def test_axes_that_are_not_correlated_stay_apart_and_four_that_are_cannot_be():
    g = np.eye(4)
    g[0, 2] = g[2, 0] = -0.4
    along, others = integer_directions(g)
    np.testing.assert_allclose(along, [0.6, 1, 0.6, 1])
    [(strength, direction)] = others
    assert strength == pytest.approx(0.4) and np.abs(direction).tolist() == [1, 0, 1, 0]
    assert direction[0] == -direction[2]
    with pytest.raises(ValueError, match='^noise: expected at most 3 axes .*, got 4$'):
        integer_directions(np.eye(4) + 0.1)


def test_a_correlation_along_a_direction_of_a_thousand_cells_is_refused():
    line = np.array([1.0, 1000.3])
    with pytest.raises(ValueError, match='^noise: expected a correlation that moves of some'):
        integer_directions(np.outer(line, line))


@pytest.mark.parametrize('n, cells, steps', [(2, 60, 40), (3, 40, 10)])
def test_equals_the_exact_gaussian_when_linear_with_correlated_noise(n, cells, steps):
    F = np.array([[-0.6, 0.8, 0.2], [-0.5, -0.2, 0.1], [0.3, 0.0, -0.4]])[:n, :n]
    g = np.array([[1.0, 0.4, -0.2], [0.4, 0.8, 0.1], [-0.2, 0.1, 0.9]])[:n, :n]
    model = StateModel(tuple('abc'[:n]), lambda x, t: np.tensordot(F, x, 1),
                       np.linalg.cholesky(g))
    grid = Grid((-6.0,) * n, (6.0,) * n, (cells,) * n)
    K = split_kernel(model, grid, KernelSettings(1 / steps, tolerance=1e-7))
    start = gaussian(grid.points, np.full(n, 0.5), 0.5 * np.eye(n))
    transition, noise = linear_moments(F, g, 1.0)
    exact = gaussian(grid.points, transition @ np.full(n, 0.5),
                     0.5 * transition @ transition.T + noise)
    # second order in the step: about (1 / steps)^2, times 0.5 for the order of the factors
    assert l1(moved(K, start, steps), exact, grid) < (0.002 if n == 2 else 0.008)


# The product, against the truth

def run(model, grid, seconds, steps, mean, variance, tolerance=1e-9):
    """Return a Gaussian of independent axes after some seconds in some steps."""
    K = split_kernel(model, grid, KernelSettings(seconds / steps, tolerance=tolerance))
    return moved(K, gaussian(grid.points, mean, np.diag(variance)), steps)


@pytest.mark.parametrize('model, grid, seconds, steps, mean, variance', [
    (benes().model, Grid((-8.0,), (8.0,), (160,)), 0.8, (2, 4, 8, 32), [0.5], [0.3]),
    (double_well(sigma=1.0).model, Grid((-2.5,), (2.5,), (120,)), 0.2, (4, 8, 16, 64),
     [0.3], [0.1]),
    (coupled_trigonometric().model, Grid((-6.0,) * 2, (6.0,) * 2, (80,) * 2), 0.8,
     (4, 8, 16, 32), [0.5, 0.0], [1.0, 1.0]),
    (lorenz_63(sigma_x=20.0).model, Grid((-40.0, -40.0, -20.0), (40.0, 40.0, 60.0), (40,) * 3),
     0.06, (2, 4, 8), [0.0, 0.0, 20.0], [40.0] * 3)])
def test_is_of_second_order_in_the_step(model, grid, seconds, steps, mean, variance):
    # on one grid, whose own error all have: noise of .8 cells and more in the shortest step
    *coarse, finest = (run(model, grid, seconds, n, mean, variance) for n in steps)
    errors = [l1(p, finest, grid) for p in coarse]
    for (n, one), (m, two) in itertools.pairwise(zip(steps, errors)):
        # as h^2 - h_finest^2 goes, to 20 %; first order would give 2 to 3
        expected = (n**-2 - steps[-1]**-2) / (m**-2 - steps[-1]**-2)
        assert one / two == pytest.approx(expected, rel=0.2)
        assert one / two > 3.4


def test_a_symmetric_kernel_is_of_second_order_with_no_order_to_alternate():
    model = lorenz_63(sigma_x=20.0).model
    grid = Grid((-40.0, -40.0, -20.0), (40.0, 40.0, 60.0), (40,) * 3)
    start = gaussian(grid.points, [0.0, 0.0, 20.0], 40 * np.eye(3))
    densities = []
    for steps in (2, 4, 8):
        K = symmetric_kernel(model, grid, KernelSettings(0.06 / steps, tolerance=1e-9))
        assert len(K.factors) == 5
        assert all(one is two for one, two in zip(K.factors, K.turned.factors))
        p = start
        for _ in range(steps):
            p = K @ p
        densities.append(p)
    one, two = (l1(p, densities[-1], grid) for p in densities[:-1])
    # (1/4 - 1/64) / (1/16 - 1/64) = 5 to 20 %; first order would give 3
    assert one / two == pytest.approx(5, rel=0.2)


def test_equals_the_exact_density_of_benes():
    # p(x, t | x0) = cosh(x) / cosh(x0) exp(-t / 2) N(x; x0, t)  [Benes 1981]
    grid, t = Grid((-9.0,), (9.0,), (180,)), 1.0
    start = gaussian(grid.points, [0.4], [[0.2]])
    x = grid.points[0]
    exact = np.array([np.sum(np.cosh(at) / np.cosh(x) * np.exp(-t / 2) * start
                             * gaussian(x[None] - at, [0.0], [[t]])) for at in x]) * 0.1
    for steps, most in ((10, 2e-3), (40, 1.3e-4)):
        K = split_kernel(benes().model, grid, KernelSettings(t / steps, tolerance=1e-8))
        assert l1(moved(K, start, steps), exact, grid) < most


@pytest.mark.parametrize('cells, most', [(62, 0.003), (100, 0.0002)])
def test_reaches_the_papers_second_example_at_its_own_step(cells, most):
    # noise of 0.52 and 0.83 cells in a step; a sampled Gaussian is at .064 and .0007
    model, grid = coupled_trigonometric().model, Grid((-6.0,) * 2, (6.0,) * 2, (cells,) * 2)
    fine = Grid((-6.0,) * 2, (6.0,) * 2, (3 * cells,) * 2)
    # every third centre of the fine grid is one of the coarse; half the step is wide on it
    reference, half = (run(model, fine, 0.5, steps, [0.0, 0.0], [1.0, 1.0])
                       for steps in (100, 50))
    exact = (4 * reference - half) / 3
    found = run(model, grid, 0.5, 50, [0.0, 0.0], [1.0, 1.0], 1e-5)
    assert l1(found, exact.reshape(fine.shape)[1::3, 1::3].ravel(), grid) < most


def test_is_the_tabulated_kernel_where_both_are_sure():
    # two ways to the same density: one sampled in the plane, its steps a quarter as long
    model, grid = coupled_trigonometric().model, Grid((-6.0,) * 2, (6.0,) * 2, (90,) * 2)
    start = gaussian(grid.points, [0.5, -0.5], np.eye(2) / 2)
    T = dirac_feynman(model, grid, KernelSettings(0.02, weights='sampled', tolerance=1e-8))
    table = start
    for _ in range(10):
        table = T @ table
    # the tabulated kernel is of first order: half a step of 0.02 times slopes of 1
    assert l1(moved(split_kernel(model, grid, KernelSettings(0.02)), start, 10),
              table, grid) < 0.005
