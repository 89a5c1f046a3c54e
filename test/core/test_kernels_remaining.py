"""Kernels where little is left to them: cut tails, worlds' edges, directions that are long."""

import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, split, split_kernel
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.kernels.stored import fingerprint
from pif_ros.core.kernels.tilted import half_width, lattice_weights
from pif_ros.core.models import StateModel
import pytest


def test_a_step_keeps_mass_mean_and_variance_however_much_of_its_tails_is_left_out():
    grid, at = Grid((-20,), (20,), (40,)), np.arange(40)
    for tolerance in (0.1, 0.09, 0.05):
        for variance in (0.7, 0.78, 0.8, 30.0):
            model = StateModel(('x',), lambda x, t: 0.5 + 0 * x, [[np.sqrt(variance)]])
            K = split_kernel(model, grid, KernelSettings(1.0, tolerance=tolerance))
            p = K @ (at == 18.0)
            assert p.min() >= 0
            np.testing.assert_allclose([p.sum(), at @ p, (at - 18.5)**2 @ p],
                                       [1, 18.5, variance], rtol=1e-9)


def test_weights_with_cut_tails_are_a_hump_of_the_right_moments():
    mean = np.linspace(-0.5, 0.5, 9)
    for tolerance in (0.1, 0.05, 0.01):
        for variance in np.geomspace(0.31, 3000, 40):
            half = half_width(np.array([variance]), tolerance)
            nodes = np.arange(-half, half + 1)
            w = lattice_weights(mean, np.full(9, variance), half)
            assert w.min() >= 0 and np.all(w[half] >= w[[0, -1]].max(axis=0))
            np.testing.assert_allclose(nodes @ w, mean, atol=1e-9 * variance)
            np.testing.assert_allclose(nodes**2 @ w - mean**2, variance, rtol=1e-9)


def test_weights_that_are_no_numbers_are_refused(monkeypatch):
    monkeypatch.setattr(split, 'half_width', lambda variance, tolerance: 1)
    model = StateModel(('x',), lambda x, t: 0 * x, [[2.0]])
    with np.errstate(all='ignore'), pytest.raises(ValueError, match='^tolerance: .* got 0.1$'):
        split_kernel(model, Grid((-20,), (20,), (40,)), KernelSettings(1.0, tolerance=0.1))


@pytest.mark.parametrize('more, r', [
    # past the edge: a wall, something stiffer
    (lambda x: np.where(np.abs(x) <= 2, 0, -30 * np.sign(x) - x), 0.5),
    (lambda x: 50 * (np.clip(x, -2, 2) - x), 0.5),
    # nothing at the centres of cells, nor at the corners in the first
    (lambda x: 3 * np.sin(40 * np.pi * (x - 2)), 0.5),
    (lambda x: 0.3 * np.sin(20 * np.pi * (x - 0.05)), 0.25)])
def test_models_with_other_kernels_have_other_fingerprints(more, r):
    grid, settings = Grid((-2,), (2,), (40,)), KernelSettings(0.1, r=r)
    plain, other = (StateModel(('x',), drift, [[1.0]]) for drift in (
        lambda x, t: -x, lambda x, t: -x + more(x)))
    kernels = [dirac_feynman(model, grid, settings).toarray() for model in (plain, other)]
    assert np.abs(kernels[0] - kernels[1]).sum(axis=0).max() > 1e-3
    assert fingerprint(plain, grid, settings) != fingerprint(other, grid, settings)


def test_a_drift_that_differs_on_one_midpoint_only_has_another_fingerprint():
    def kinked(x, t):
        return np.where((x[0] == 1.1) & (x[1] == 1.0), 1.0, 0.0) - x

    grid, settings = Grid((0, 0), (2, 2), (10, 10)), KernelSettings(0.1)
    plain, other = (StateModel(('x', 'y'), f, np.eye(2)) for f in (lambda x, t: -x, kinked))
    assert fingerprint(plain, grid, settings) != fingerprint(other, grid, settings)


@pytest.mark.parametrize('rho', [0.3, 0.5, 0.9, 0.999999])
def test_noise_that_is_long_on_one_axis_is_widened_by_no_more_than_is_said(rho):
    def widened(long, short):
        D = np.array([[long**2, rho * long * short], [rho * long * short, short**2]])
        axes, others = integer_directions(D, 32)
        return np.diag(axes) + sum(w * np.outer(v, v) for w, v in others) - D

    for long in (50.0, 100.0, 300.0):
        more = widened(long, 1.0)
        np.testing.assert_allclose(more, more[0, 0] * np.eye(2), atol=1e-8)
        assert -1e-8 <= more[0, 0] < (long**2 + 1) / 32**2 / 2
    # nothing where it is as long on both
    assert rho > 0.99 or np.abs(widened(100.0, 100.0)).max() < 1e-8
