"""A kernel in a wavelet basis: the same operator, and how much of it matters."""

import functools
import sys

from hypothesis import given, strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, wavelets
from pif_ros.core.kernels.wavelets import WaveletBasis, WaveletKernel
from pif_ros.core.systems import coupled_trigonometric, ornstein_uhlenbeck
import pytest
import pywt
from scipy import sparse

SEEDS = st.integers(0, 2**32 - 1)
#: Filters whose printed digits are good to 1e-15.
EXACT = ['haar', 'db2', 'db4', 'coif2']
PLANE = Grid((-5, -5), (5, 5), (30, 24))


def box(*shape, periodic=()):
    return Grid((0,) * len(shape), (1,) * len(shape), shape, periodic)


def random_kernel(seed, size):
    """Return a kernel that loses mass in some columns."""
    rng = np.random.default_rng(seed)
    K = rng.random((size, size)) * (rng.random((size, size)) < 0.2)
    return sparse.csr_array(K / np.maximum(K.sum(axis=0), 1e-9)
                            * np.minimum(2 * rng.random(size), 1.0))


@functools.lru_cache
def plane_kernel(steps):
    """Return so many steps of 0.02, dense where they are many."""
    K = dirac_feynman(coupled_trigonometric().model, PLANE, KernelSettings(0.02))
    return sparse.csr_array(np.linalg.matrix_power(K.toarray(), steps)) if steps > 1 else K


def whole_matrix(basis):
    """Return W (coefficients, cells), a column for each cell."""
    return basis.analyse(np.eye(np.prod(basis.cells)))


# The basis


@pytest.mark.parametrize('cells, level', [(8, 1), (8, 3), (20, 2), (64, 5), (2, 1)])
@pytest.mark.parametrize('wavelet', ['haar', 'db4', 'sym8', 'coif3'])
@pytest.mark.filterwarnings('ignore:Level value')
def test_an_axis_is_transformed_as_pywavelets_does_it(cells, level, wavelet):
    x = np.random.default_rng(1).normal(size=cells)
    exact = np.concatenate(pywt.wavedec(x, wavelet, mode='periodization', level=level))
    found = WaveletBasis.make(box(cells), wavelet, level).analyse(x)
    # the digits of PyWavelets' filters
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12)


@pytest.mark.filterwarnings('ignore:Level value')
@pytest.mark.parametrize('shape, level', [((8, 12), 2), ((4, 6, 8), 1), ((2, 4, 2, 6), 1)])
def test_axes_are_transformed_one_after_another(shape, level):
    x = exact = np.random.default_rng(2).normal(size=shape)
    for axis in range(len(shape)):
        exact = np.concatenate(pywt.wavedec(exact, 'db2', mode='periodization', level=level,
                                            axis=axis), axis=axis)
    found = WaveletBasis.make(box(*shape), 'db2', level).analyse(x.ravel())
    np.testing.assert_allclose(found, exact.ravel(), atol=1e-13)


@pytest.mark.parametrize('shape, level, padded', [
    ((16,), 3, (16,)), ((13,), 2, (16,)), ((6, 8), 1, (6, 8)), ((7, 5), 2, (8, 8)),
    ((3, 4, 5), 1, (4, 4, 6))])
@pytest.mark.parametrize('wavelet', EXACT)
def test_the_basis_is_orthonormal_with_padding_or_without(shape, level, padded, wavelet):
    basis = WaveletBasis.make(box(*shape), wavelet, level)
    W = whole_matrix(basis)
    assert basis.padded == padded
    np.testing.assert_allclose(W.T @ W, np.eye(W.shape[1]), atol=1e-12)
    if padded == shape:
        np.testing.assert_allclose(W @ W.T, np.eye(len(W)), atol=1e-12)
    c = np.random.default_rng(3).normal(size=len(W))
    np.testing.assert_allclose(basis.synthesise(c), W.T @ c, atol=1e-12)


# The operator


@given(SEEDS, st.sampled_from([((16,), ()), ((11,), (True,)), ((5, 6), ()),
                               ((4, 7), (True, False)), ((3, 4, 2), ())]), st.sampled_from(EXACT))
def test_without_a_threshold_it_is_the_dense_product_and_moves_densities_as_the_kernel_does(
        seed, where, wavelet):
    grid = box(*where[0], periodic=where[1])
    K = random_kernel(seed, grid.size)
    found = WaveletKernel.make(K, grid, wavelet, 1, 0.0)
    W = whole_matrix(found.basis)
    np.testing.assert_allclose(found.coefficients.toarray(), W @ K @ W.T, atol=1e-12)
    p = np.random.default_rng(seed).random(grid.size)
    np.testing.assert_allclose(found @ p, K @ p, atol=1e-11)
    assert isinstance(found.coefficients, sparse.csr_array)
    assert found.shape == K.shape and found.nnz == found.coefficients.nnz


@given(SEEDS, st.sampled_from([1e-6, 1e-3, 0.03, 0.3]), st.sampled_from(EXACT))
def test_a_threshold_leaves_the_mass_of_every_column_as_it_was(seed, threshold, wavelet):
    grid = box(7, 6)
    K = random_kernel(seed, 42)
    found = WaveletKernel.make(K, grid, wavelet, 2, threshold)
    W = whole_matrix(found.basis)
    np.testing.assert_allclose(np.ones(42) @ (W.T @ found.coefficients.toarray()),
                               np.ones(42) @ (K @ W.T), atol=1e-10)


@pytest.mark.parametrize('steps', [1, 20])
@pytest.mark.parametrize('threshold', [1e-3, 1e-2])
def test_densities_stay_positive_and_keep_or_lose_the_mass_that_the_kernel_does(steps, threshold):
    K = plane_kernel(steps)
    found = WaveletKernel.make(K, PLANE, 'db4', 2, threshold)
    # near enough to a corner to lose mass
    p = q = GridBelief.gaussian(PLANE, [3.0, -3.0], 0.3 * np.eye(2)).density.ravel()
    lowest = 0.0
    for _ in range(20 // steps):
        lowest = min(lowest, found.basis.synthesise(found.coefficients @ found.analyse(q)).min())
        mass, p, q = (K @ q).sum(), K @ p, found @ q
        assert q.min() >= 0
        assert q.sum() == pytest.approx(mass, rel=1e-10)
    # without the cut it would not hold, and the edge was met
    assert lowest < 0 and p.sum() * PLANE.cell_volume < 0.95


@pytest.mark.parametrize('steps', [1, 20])
def test_the_error_falls_with_the_threshold_and_the_elements_rise(steps):
    K = plane_kernel(steps)
    p = GridBelief.gaussian(PLANE, [1.0, -1.0], 0.5 * np.eye(2)).density.ravel()
    exact, spread = K @ p, K.toarray()
    l1, l2, nnz = [], [], []
    for threshold in (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 0.0):
        found = WaveletKernel.make(K, PLANE, 'db4', 2, threshold)
        W = whole_matrix(found.basis)
        l1.append(np.abs(found @ p - exact).sum() * PLANE.cell_volume)
        l2.append(np.linalg.norm(W.T @ found.coefficients.toarray() @ W - spread))
        nnz.append(found.nnz)
    for errors in (l1, l2):
        assert np.all(np.diff(errors) < 0)
        # by more than a factor of 3 for each 10 on the average, down to rounding
        assert errors[-2] < errors[0] / 3**4 and errors[-1] < 1e-11
    assert np.all(np.diff(nnz) > 0)
    # each of the elements that are gone was below the threshold, 1e-3; mass takes no more again
    assert l2[2] < 2 * 1e-3 * found.shape[0]


def test_many_steps_stay_in_the_basis():
    K = plane_kernel(1)
    found = WaveletKernel.make(K, PLANE, 'db4', 2, 0.0)
    p = GridBelief.gaussian(PLANE, [1.0, -1.0], 0.5 * np.eye(2)).density.ravel()
    c = found.analyse(p)
    for _ in range(30):
        c, p = found.coefficients @ c, K @ p
    np.testing.assert_allclose(found.synthesise(c), p, atol=1e-11)


def test_a_narrow_step_takes_more_elements_in_the_basis_and_a_wide_one_fewer():
    # a step of 0.6 cells is banded; 50 of them, four cells wide, are smooth
    ratios = []
    for steps in (1, 50):
        K = plane_kernel(steps)
        p = GridBelief.gaussian(PLANE, [1.0, -1.0], 0.5 * np.eye(2)).density.ravel()
        found = WaveletKernel.make(K, PLANE, 'db4', 2, 1e-3)
        assert np.abs(found @ p - K @ p).sum() * PLANE.cell_volume < 0.02
        ratios.append(found.nnz / (K.toarray() > 1e-4).sum())
    assert ratios[0] > 3 and ratios[1] < 1 / 3


def test_a_linear_drift_keeps_its_mean_and_variance():
    grid = Grid((-6,), (6,), (100,))
    K = dirac_feynman(ornstein_uhlenbeck().model, grid, KernelSettings(0.1))
    found = WaveletKernel.make(K, grid, 'db4', 2, 1e-4)
    p = q = GridBelief.gaussian(grid, [1.0], [[0.2]]).density
    for _ in range(10):
        p, q = K @ p, found @ q
    p, q = GridBelief(grid, p), GridBelief(grid, q)
    # ten steps, each off by a threshold of 1e-4 in about ten cells, a unit away
    assert q.mean()[0] == pytest.approx(p.mean()[0], abs=1e-3)
    assert q.covariance()[0, 0] == pytest.approx(p.covariance()[0, 0], abs=3e-3)


def test_equals_a_few_columns_at_a_time(monkeypatch):
    whole = WaveletKernel.make(plane_kernel(1), PLANE, 'db4', 2, 1e-3)
    monkeypatch.setattr(wavelets, 'CHUNK', 5000)
    parts = WaveletKernel.make(plane_kernel(1), PLANE, 'db4', 2, 1e-3)
    np.testing.assert_allclose(whole.coefficients.toarray(), parts.coefficients.toarray(),
                               atol=1e-14)


def test_nothing_stays_nothing():
    found = WaveletKernel.make(plane_kernel(1), PLANE)
    np.testing.assert_array_equal(found @ np.zeros(PLANE.size), np.zeros(PLANE.size))


# Refusals


@pytest.mark.parametrize('wavelet, wanted', [
    ('db99', 'the name of a discrete wavelet'), ('', 'the name of a discrete wavelet'),
    ('morl', 'the name of a discrete wavelet'), ('bior2.2', 'an orthogonal one'),
    ('dmey', 'an orthogonal one'),
])
def test_refuses_what_is_no_orthogonal_wavelet(wavelet, wanted):
    with pytest.raises(ValueError, match=f"^wavelet: expected {wanted}, got '{wavelet}'$"):
        WaveletBasis.make(PLANE, wavelet, 1)


@pytest.mark.parametrize('level', [0, -1, 5, 1.5, float('nan')])
def test_refuses_a_level_that_the_grid_does_not_have(level):
    with pytest.raises(ValueError, match='^level: expected a whole number from 1 to 4 on a grid '
                                         f'of 30 x 24 cells, got {level}$'):
        WaveletBasis.make(PLANE, 'db4', level)


@pytest.mark.parametrize('threshold', [-1e-9, 1.0, float('nan')])
def test_refuses_what_is_no_threshold(threshold):
    with pytest.raises(ValueError, match='^threshold: expected a number from 0 to below 1, got'):
        WaveletKernel.make(plane_kernel(1), PLANE, 'db4', 1, threshold)


def test_names_the_package_that_is_missing(monkeypatch):
    monkeypatch.setitem(sys.modules, 'pywt', None)
    with pytest.raises(ImportError, match='^wavelet: expected the package PyWavelets, .* got'):
        WaveletKernel.make(plane_kernel(1), PLANE)
