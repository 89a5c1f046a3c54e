"""Kernels where little is left to them: cut tails, worlds' edges, directions that are long."""

import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, split, split_kernel
from pif_ros.core.kernels.tilted import half_width, lattice_weights
from pif_ros.core.models import StateModel
import pytest


def test_a_step_keeps_mass_mean_and_variance_however_much_of_its_tails_is_left_out():
    grid, at = Grid((-20,), (20,), (40,)), np.arange(40)
    for tolerance in (0.1, 0.09, 0.05, 0.01):
        for variance in (0.5, 0.7, 0.78, 0.8, 1.3, 30.0):
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
            w, nodes = lattice_weights(mean, np.full(9, variance), half), np.arange(-half, half + 1)
            assert w.min() >= 0 and np.all(w[half] >= w[[0, -1]].max(axis=0))
            np.testing.assert_allclose(nodes @ w, mean, atol=1e-9 * variance)
            np.testing.assert_allclose(nodes**2 @ w - mean**2, variance, rtol=1e-9)


def test_weights_that_are_no_numbers_are_refused(monkeypatch):
    monkeypatch.setattr(split, 'half_width', lambda variance, tolerance: 1)
    model = StateModel(('x',), lambda x, t: 0 * x, [[2.0]])
    with np.errstate(all='ignore'), pytest.raises(ValueError, match='^tolerance: expected .* 0.1$'):
        split_kernel(model, Grid((-20,), (20,), (40,)), KernelSettings(1.0, tolerance=0.1))
