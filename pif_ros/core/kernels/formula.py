"""One Dirac-Feynman step in formulas: the density of its end, given its beginning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]


def log_transition_density(model: StateModel, x_to: Array, x_from: Array,
                           settings: KernelSettings, t: float = 0.0) -> Array:
    """
    Return log P(t + eps, x'' | t, x') of one step for states (n, ...)  [Sensors, Eqs. 18, 47].

    As the formula has it, so that with r or s > 0 and the exponential its mass is not 1; f, e and
    Q are taken at t + r eps.  Where the diffusion matrix is singular it is NaN or infinite.
    """
    dx = x_to - x_from
    f, log_jacobian = drift_terms(model, x_from + settings.r * dx, settings, t)
    if model.noise_bends:
        return _bent(model, x_from, dx, f, log_jacobian, settings, t)
    g = model.diffusion_at(x_from, t + settings.r * settings.time_step)
    return gaussian(dx - settings.time_step * f, settings.time_step * g) + log_jacobian


def drift_terms(model: StateModel, x: Array, settings: KernelSettings,
                t: float) -> tuple[Array, Array]:
    """Return the drift f (n, ...) and the log of its share of the Jacobian (...) at x^(r)."""
    r, eps = settings.r, settings.time_step
    f = np.asarray(model.drift(x, t + r * eps), dtype=float)
    if r == 0:
        return f, np.zeros(x.shape[1:])
    D = model.jacobian(x, t + r * eps)
    if settings.jacobian == 'exponential':
        # exp(-r eps div f)  [Sensors, Eq. 19]
        return f, -r * eps * np.einsum('ii...->...', D)
    # |det(1 - r eps df/dx)|, of which the exponential is the expansion
    with np.errstate(divide='ignore'):
        return f, np.log(np.abs(determinant(-r * eps * D)))


def action(dx: Sequence[Array] | Array, f: Array, g: Array, eps: float) -> Array:
    """Return J^T g^-1 J / (2 eps) with J = x'' - x' - eps f  [Sensors, Eq. 19]."""
    whiten = np.linalg.inv(np.linalg.cholesky(2 * eps * g))
    J = [dx[i] - eps * f[i] for i in range(len(g))]
    total = np.zeros(J[0].shape)
    for i in range(len(g)):
        z = whiten[i, i] * J[i]
        for j in np.flatnonzero(whiten[i, :i]):
            z += whiten[i, j] * J[j]
        total += z * z
    return total


def gaussian(v: Array, covariance: Array) -> Array:
    """Return log N(v; 0, covariance) of vectors (n, ...), covariances (n, n, ...) or narrower."""
    square = np.einsum('i...,i...->...', v, solved(covariance, v))
    log_det = np.log(np.abs(determinant(covariance, 0.0)))
    return np.asarray(-0.5 * (square + log_det + len(v) * np.log(2 * np.pi)))


def _bent(model: StateModel, x_from: Array, dx: Array, f: Array, log_jacobian: Array,
          settings: KernelSettings, t: float) -> Array:
    """Return log P where e is taken at x^(s) = x' + s dx, given f and its Jacobian at x^(r)."""
    eps, s, tau = settings.time_step, model.s, t + settings.r * settings.time_step
    x = x_from + s * dx
    # noise of covariance 1 through e Q^(1/2)
    root = np.asarray(np.linalg.cholesky(model.noise(tau)), dtype=float)
    e = _times(model.vielbein_at(x, tau), root)
    de = np.moveaxis(_times(np.moveaxis(model.vielbein_jacobian_at(x, tau), 2, 0), root, 2), 0, 2)
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        if settings.jacobian == 'exponential':
            # J = x'' - x' - eps f + s eps e Q u, u_b = d_i e_ib  [Sensors, Eq. 50, its sign put
            # right: with the printed one nothing converges]
            u = np.einsum('ibi...->b...', de)
            J = dx - eps * f + s * eps * np.einsum('ia...,a...->i...', e, u)
            # (d_i e_ja) Q_ab (d_j e_ib) - u_a Q_ab u_b  [Sensors, Eq. 48, its indices put right]
            bend = np.einsum('jai...,iaj...->...', de, de) - np.einsum('a...,a...->...', u, u)
            g = np.einsum('ia...,ja...->ij...', e, e)
            return gaussian(J, eps * g) + log_jacobian - s * s * eps / 2 * bend
        # the noise that led to x'', and how much of it leads to as much of x''
        dv = solved(e, dx - eps * f)
        D = -s * np.einsum('iaj...,a...->ij...', de, dv)
        if settings.r:
            D -= settings.r * eps * model.jacobian(x_from + settings.r * dx, tau)
        log_det = np.log(np.abs(determinant(D) / determinant(e, 0.0)))
        square = np.einsum('a...,a...->...', dv, dv)
    return np.asarray(log_det - square / (2 * eps) - len(dv) / 2 * np.log(2 * np.pi * eps))


def _times(e: Array, root: Array, axis: int = 1) -> Array:
    """Return e root, over the axis of e that belongs to the noise."""
    if np.array_equal(root, np.eye(len(root))):
        return e
    return np.moveaxis(np.tensordot(e, root, (axis, 0)), -1, axis)


def solved(A: Array, b: Array) -> Array:
    """Return x of A x = b, matrices (n, n, ...), vectors (n, ...); inf where there is none."""
    if len(b) == 1:
        return np.asarray(b / A[0])
    if len(b) == 2:
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        return np.stack([(A[1, 1] * b[0] - A[0, 1] * b[1]) / det,
                         (A[0, 0] * b[1] - A[1, 0] * b[0]) / det])
    regular = determinant(A, 0.0) != 0
    A = np.where(regular, A, np.eye(len(b)).reshape(A.shape[:2] + (1,) * (A.ndim - 2)))
    x = np.linalg.solve(np.moveaxis(A, (0, 1), (-2, -1)), np.moveaxis(b, 0, -1)[..., None])
    return np.where(regular, np.moveaxis(x[..., 0], -1, 0), np.inf)


def determinant(D: Array, added: float = 1.0) -> Array:
    """Return det(D + added 1) of matrices (n, n, ...)."""
    if len(D) == 1:
        return added + D[0, 0]
    if len(D) == 2:
        return (added + D[0, 0]) * (added + D[1, 1]) - D[0, 1] * D[1, 0]
    return np.linalg.det(np.moveaxis(D, (0, 1), (-2, -1)) + added * np.eye(len(D)))
