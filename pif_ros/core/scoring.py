"""How good an estimate is: errors, coverage, distances between densities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from scipy import stats

Array = NDArray[np.float64]


def rmse(errors: Array) -> float:
    """Return the root of the mean squared length of errors (N, n)."""
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=1))))


def mahalanobis_squared(errors: Array, covariances: Array) -> Array:
    """Return e^T P^-1 e of errors (N, n) with covariances (N, n, n), shape (N,)."""
    return np.einsum('ki,ki->k', errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def coverage(errors: Array, covariances: Array, sigmas: float) -> float:
    """Return the share of errors (N, n) within an ellipse of so many sigmas."""
    return float(np.mean(mahalanobis_squared(errors, covariances) < sigmas**2))


def honest_coverage(sigmas: float, n: int) -> float:
    """Return the coverage that a Gaussian of n dimensions is due: 0.393 and 0.865 in the plane."""
    return float(stats.chi2.cdf(sigmas**2, n))


def l1_distance(p: GridBelief, q: GridBelief) -> float:
    """Return the integral of |p - q| of two densities on the same grid, 0 to 2."""
    return float(np.abs(p.density - q.density).sum() * p.grid.cell_volume)
