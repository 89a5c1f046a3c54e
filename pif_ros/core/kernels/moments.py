"""The first two moments of one Dirac-Feynman step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.kernels.formula import Array, determinant
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel

#: Where e changes by more than this within its own step, the step's density is no single hump.
BENT = 0.3


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
    step's.  Multiplicative noise adds what its sense does to the mean, and where it changes much
    within its own step that says nothing too.  Raises ValueError for a drift or a vielbein that
    is not finite.
    """
    r, eps = settings.r, settings.time_step
    tau, n = t + r * eps, len(x)
    g = eps * model.diffusion_at(x, tau)
    euler = eps * model.ito_drift(x, tau)
    without = ~np.all(np.isfinite(g), axis=(0, 1))
    if without.any():
        at = x[:, np.argmax(without)].tolist()
        raise ValueError('vielbein: expected finite numbers in every cell, got '
                         f'{model.vielbein_at(x, tau)[..., np.argmax(without)].tolist()} at {at}')
    undefined = ~np.all(np.isfinite(euler), axis=0)
    if undefined.any():
        at = x[:, np.argmax(undefined)]
        raise ValueError(f'drift: expected finite numbers in every cell, got '
                         f'{(euler[:, np.argmax(undefined)] / eps).tolist()} at {at.tolist()}')
    smooth = noise_roughness(model, x, eps, tau) < BENT
    if r == 0:
        return StepMoments(euler, g, smooth)
    drift = eps * np.asarray(model.drift(x, tau), dtype=float)
    move, error, one = np.zeros_like(drift), drift, np.eye(n)[..., None]
    A, settled = one, smooth & ~_rough(model, x, spacing, r * eps, tau)
    for _ in range(iterations):
        A = one - r * eps * model.jacobian(x + r * move, tau)
        settled &= determinant(A - one) > 0.3
        A = np.where(settled, A, one)
        move = move + _solve(A, error)
        error = eps * np.asarray(model.drift(x + r * move, tau), dtype=float) - move
    settled &= np.all(np.abs(error) <= 1e-2 * np.sqrt(np.einsum('iik->ik', g))
                      + 1e-6 * np.abs(drift) + 1e-3 * spacing[:, None], axis=0)
    inverse = np.moveaxis(np.linalg.inv(np.moveaxis(A, -1, 0)), 0, -1)
    bent = np.einsum('ijk,jlk,mlk->imk', inverse, g, inverse)
    return StepMoments(np.where(settled, move + euler - drift, euler),
                       np.where(settled, bent, g), settled)


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


def noise_roughness(model: StateModel, x: Array, eps: float, tau: float) -> Array:
    """Return by which share e changes within its own step from states (n, N), shape (N,)."""
    if not model.noise_bends:
        return np.zeros(x.shape[1])
    de = model.vielbein_jacobian_at(x, tau)
    change = np.einsum('iaj...,ab,ibj...->...', de, model.noise(tau), de)
    return np.asarray(model.s * np.sqrt(eps * change))


def _solve(A: Array, b: Array) -> Array:
    """Solve A x = b for matrices (n, n, N) and vectors (n, N)."""
    x = np.linalg.solve(np.moveaxis(A, -1, 0), b.T[..., None])[..., 0].T
    return np.asarray(x, dtype=float)
