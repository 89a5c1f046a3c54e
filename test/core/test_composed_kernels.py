"""Several steps in one operator: the power of the matrix, without its least weights."""

from importlib import import_module
import tracemalloc

from hypothesis import given, strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.kernels.composed import composed
from pif_ros.core.systems import coupled_trigonometric, ornstein_uhlenbeck, wiener
import pytest
from scipy import sparse

module = import_module('pif_ros.core.kernels.composed')

GRID = Grid((-6, -6), (6, 6), (25, 25))
KERNEL = dirac_feynman(coupled_trigonometric().model, GRID, KernelSettings(0.05))
SEEDS = st.integers(0, 2**32 - 1)


def random_kernel(seed):
    """Return a kernel of up to 30 cells that loses mass in some columns, all of it in others."""
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 30))
    K = rng.random((size, size))**8 * (rng.random((size, size)) < 0.3)
    return sparse.csr_array(K / np.maximum(K.sum(axis=0), 1e-9)
                            * np.minimum(2 * rng.random(size), 1.0))


def column_errors(operator, exact):
    return np.abs(operator.toarray() - exact).sum(axis=0)


@given(SEEDS, st.integers(1, 40), st.sampled_from([0, 1e-6, 1e-3, 0.1]))
def test_is_the_power_of_the_dense_matrix_to_the_tolerance_in_every_column(
        seed, steps, tolerance):
    K = random_kernel(seed)
    exact = np.linalg.matrix_power(K.toarray(), steps)
    # 1e-16 a step is rounding
    assert column_errors(composed(K, steps, tolerance), exact).max() <= tolerance + 1e-14


@given(SEEDS, st.integers(1, 40), st.sampled_from([1e-3, 0.1]))
def test_weights_stay_positive_and_a_column_keeps_the_mass_of_the_whole_power(
        seed, steps, tolerance):
    K = random_kernel(seed)
    found = composed(K, steps, tolerance)
    assert isinstance(found, sparse.csr_array)
    assert found.nnz == 0 or found.data.min() > 0
    np.testing.assert_allclose(found.toarray().sum(axis=0),
                               np.linalg.matrix_power(K.toarray(), steps).sum(axis=0),
                               rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize('steps', [2, 5, 10, 20])
@pytest.mark.parametrize('tolerance', [1e-2, 1e-4])
def test_the_kernel_of_a_plane_loses_weights_within_the_tolerance(steps, tolerance):
    exact = np.linalg.matrix_power(KERNEL.toarray(), steps)
    found = composed(KERNEL, steps, tolerance)
    assert column_errors(found, exact).max() <= tolerance
    whole = composed(KERNEL, steps, 0)
    assert column_errors(whole, exact).max() < 1e-13
    # two steps hold little that is small
    assert found.nnz < (0.8 if steps > 2 else 1) * whole.nnz


@pytest.mark.parametrize('rare', np.geomspace(1e-4, 0.1, 16))
def test_errors_that_add_up_from_step_to_step_stay_within_the_tolerance(rare):
    # one cell on, seldom two: what a part of the steps lacks is never made up for by another
    K = sparse.csr_array((1 - rare) * np.eye(80, k=-1) + rare * np.eye(80, k=-2))
    exact = np.linalg.matrix_power(K.toarray(), 32)
    assert column_errors(composed(K, 32, 0.01), exact).max() <= 0.01


def test_what_leaves_the_grid_stays_left():
    # a Gaussian at the edge: half of its mass is outside, less what came back on the way
    grid = Grid((-6,), (6,), (120,))
    K = dirac_feynman(wiener().model, grid, KernelSettings(0.05))
    mass = np.ones(120) @ np.linalg.matrix_power(K.toarray(), 20)
    found = np.asarray(composed(K, 20, 0.1).sum(axis=0)).ravel()
    assert mass[0] < 0.5 < 0.99 < mass[60]
    np.testing.assert_allclose(found, mass, rtol=1e-12)


def test_the_mean_and_the_variance_of_a_linear_model_are_those_of_the_steps():
    grid = Grid((-6,), (6,), (120,))
    K = dirac_feynman(ornstein_uhlenbeck().model, grid, KernelSettings(0.05))
    p = GridBelief.gaussian(grid, [1.0], [[0.04]]).density
    q = GridBelief(grid, composed(K, 16, 1e-4) @ p)
    for _ in range(16):
        p = K @ p
    # 1e-4 of the mass, moved by a few standard deviations of 0.6 at most
    assert q.mean()[0] == pytest.approx(GridBelief(grid, p).mean()[0], abs=1e-4)
    assert q.covariance()[0, 0] == pytest.approx(GridBelief(grid, p).covariance()[0, 0], abs=1e-3)


def test_a_step_is_the_kernel_itself():
    assert composed(KERNEL, 1, 0.1) is KERNEL


def test_equals_a_few_columns_at_a_time(monkeypatch):
    whole = composed(KERNEL, 5, 1e-3)
    monkeypatch.setattr(module, 'CHUNK', 2000)
    parts = composed(KERNEL, 5, 1e-3)
    np.testing.assert_array_equal(whole.toarray(), parts.toarray())


def test_takes_less_memory_than_the_whole_power_would(monkeypatch):
    grid = Grid((-6, -6), (6, 6), (40, 40))
    K = dirac_feynman(coupled_trigonometric().model, grid, KernelSettings(0.05))
    monkeypatch.setattr(module, 'CHUNK', 1 << 14)
    tracemalloc.start()
    composed(K, 8, 0.1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # measured: a third of it
    assert peak < 0.5 * 12 * composed(K, 8, 0).nnz


@pytest.mark.parametrize('steps', [0, -1, 2.5, float('nan'), '2'])
def test_refuses_what_is_no_number_of_steps(steps):
    with pytest.raises(ValueError, match='^steps: expected a whole number, 1 or more, got'):
        composed(KERNEL, steps, 1e-3)


@pytest.mark.parametrize('tolerance', [-1e-9, 0.2, float('nan')])
def test_refuses_what_is_no_tolerance(tolerance):
    with pytest.raises(ValueError, match='^tolerance: expected a number from 0 to 0.1, got'):
        composed(KERNEL, 2, tolerance)
