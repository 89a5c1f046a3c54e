"""One Dirac-Feynman step in formulas: its density, and the first two moments of its move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]


@dataclass(frozen=True)
class KernelSettings:
    """
    How a kernel is made.

    time_step: seconds; r: where between x' and x'' the drift is taken, 0 to 1; jacobian:
    'determinant' for |det(1 - r eps df/dx)|, 'exponential' for its printed expansion
    exp(-r eps div f); extent: largest move in cells on each axis, 0 for as wide as the kernel
    needs; weights: 'sampled' takes the density at the cell centres, 'moments' keeps mass, mean and
    covariance however thin the noise is against a cell, 'auto' chooses by the noise; tolerance:
    the share of a Gaussian's tail that is left out; noise_inflation: alpha of the papers' way with
    thin noise, which takes g = alpha dx on each axis for the model's own, 0 for none.  Raises
    ValueError for what makes no kernel.
    """

    time_step: float
    r: float = 0.5
    jacobian: str = 'determinant'
    extent: int = 0
    weights: str = 'auto'
    tolerance: float = 1e-5
    noise_inflation: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what makes no kernel."""
        for name, wanted, holds in (
                ('time_step', 'a nanosecond or more, in seconds',
                 1e-9 <= self.time_step < math.inf),
                ('r', 'a number from 0 to 1', 0 <= self.r <= 1),
                ('jacobian', "'determinant' or 'exponential'",
                 self.jacobian in ('determinant', 'exponential')),
                ('extent', 'a number of cells, 0 or more', self.extent >= 0),
                ('weights', "'auto', 'sampled' or 'moments'",
                 self.weights in ('auto', 'sampled', 'moments')),
                ('tolerance', 'a number from 1e-12 to 0.1', 1e-12 <= self.tolerance <= 0.1),
                ('noise_inflation', 'a number, 0 or more',
                 0 <= self.noise_inflation < math.inf)):
            if not holds:
                raise ValueError(f'{name}: expected {wanted}, got {getattr(self, name)!r}')


def log_transition_density(model: StateModel, x_to: Array, x_from: Array,
                           settings: KernelSettings, t: float = 0.0) -> Array:
    """
    Return log P(t + eps, x'' | t, x') of one step for states (n, ...)  [Sensors, Eqs. 18, 19].

    As the formula has it, so that with r > 0 and the exponential its mass is not 1; f, e and Q
    are taken at t + r eps.  The diffusion matrix must be regular.
    """
    dx, n = x_to - x_from, model.ndim
    f, log_jacobian = drift_terms(model, x_from + settings.r * dx, settings, t)
    g = model.diffusion(t + settings.r * settings.time_step)
    constant = -0.5 * (n * np.log(2 * np.pi * settings.time_step) + np.linalg.slogdet(g)[1])
    return constant + log_jacobian - action(dx, f, g, settings.time_step)


def drift_terms(model: StateModel, x: Array, settings: KernelSettings,
                t: float) -> tuple[Array, Array]:
    """Return the drift f (n, ...) and the log of the step's Jacobian (...) at x^(r)."""
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
        return f, np.log(np.abs(_determinant(-r * eps * D)))


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


@dataclass(frozen=True, eq=False)
class StepMoments:
    """
    The move in one step from each of N states: its mean (n, N) and covariance (n, n, N).

    settled: where they are those of the settings' r; elsewhere they are those of r = 0.
    """

    mean: Array
    covariance: Array
    settled: NDArray[np.bool_]


def step_moments(model: StateModel, x: Array, spacing: Array, settings: KernelSettings,
                 t: float, iterations: int = 4) -> StepMoments:
    """
    Return the moments of one step from states x (n, N), on cells of a spacing (n,).

    The density peaks where J = 0, d = eps f(x + r d), and has there the covariance
    A^-1 eps g A^-T, A = 1 - r eps df/dx.  Where that says nothing, since A is nearly singular,
    Newton's iteration does not settle, or A changes much within a cell, the moments are an Euler
    step's.  Raises ValueError for a drift that is not finite.
    """
    r, eps = settings.r, settings.time_step
    tau, n = t + r * eps, len(x)
    g = eps * model.diffusion(tau)
    euler = eps * np.asarray(model.drift(x, tau), dtype=float)
    undefined = ~np.all(np.isfinite(euler), axis=0)
    if undefined.any():
        at = x[:, np.argmax(undefined)]
        raise ValueError(f'drift: expected finite numbers in every cell, got '
                         f'{(euler[:, np.argmax(undefined)] / eps).tolist()} at {at.tolist()}')
    spread = np.broadcast_to(g[..., None], (n, n, x.shape[1]))
    if r == 0:
        return StepMoments(euler, spread, np.ones(x.shape[1], dtype=bool))
    move, error, one = np.zeros_like(euler), euler, np.eye(n)[..., None]
    A, settled = one, ~_rough(model, x, spacing, r * eps, tau)
    for _ in range(iterations):
        A = one - r * eps * model.jacobian(x + r * move, tau)
        settled &= _determinant(A - one) > 0.3
        A = np.where(settled, A, one)
        move = move + _solve(A, error)
        error = eps * np.asarray(model.drift(x + r * move, tau), dtype=float) - move
    settled &= np.all(np.abs(error) <= 1e-2 * np.sqrt(np.diag(g))[:, None]
                      + 1e-6 * np.abs(euler) + 1e-3 * spacing[:, None], axis=0)
    inverse = np.moveaxis(np.linalg.inv(np.moveaxis(A, -1, 0)), 0, -1)
    bent = np.einsum('ijk,jl,mlk->imk', inverse, g, inverse)
    return StepMoments(np.where(settled, move, euler), np.where(settled, bent, spread), settled)


def _rough(model: StateModel, x: Array, spacing: Array, r_eps: float,
           tau: float) -> NDArray[np.bool_]:
    """Return where r eps df/dx changes so much within a cell that one value is an accident."""
    D = model.jacobian(x, tau)
    rough = np.zeros(x.shape[1], dtype=bool)
    for part in (-1 / 2, -1 / 4, 1 / 4, 1 / 2):
        for shift in np.diag(spacing * part):
            change = model.jacobian(x + shift[:, None], tau) - D
            rough |= ~(r_eps * np.sqrt(np.einsum('ij...,ij...->...', change, change)) < 0.3)
    return rough


def _determinant(D: Array) -> Array:
    """Return det(1 + D) of matrices (n, n, ...)."""
    if len(D) == 1:
        return 1 + D[0, 0]
    if len(D) == 2:
        return (1 + D[0, 0]) * (1 + D[1, 1]) - D[0, 1] * D[1, 0]
    return np.linalg.det(np.moveaxis(D, (0, 1), (-2, -1)) + np.eye(len(D)))


def _solve(A: Array, b: Array) -> Array:
    """Solve A x = b for matrices (n, n, N) and vectors (n, N)."""
    x = np.linalg.solve(np.moveaxis(A, -1, 0), b.T[..., None])[..., 0].T
    return np.asarray(x, dtype=float)
