"""Hamiltonian moves of whole paths, preconditioned by the precision of a path."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from scipy import linalg

Array = NDArray[np.float64]

#: The mean share of moves that are accepted at the best step  [Beskos et al. 2013: 0.65 to 0.8].
ACCEPTANCE = 0.75


@dataclass(frozen=True, eq=False)
class Precision:
    """
    A symmetric matrix M of blocks (n, n), none but on the diagonal and next to it.

    diagonal: (N + 1, n, n); below: (N, n, n).  Raises numpy's LinAlgError where it is not
    positive definite.
    """

    diagonal: Array
    below: Array

    @cached_property
    def _root(self) -> Array:
        """Return the bands of L, M = L L^T: row d holds what lies d below the diagonal."""
        length, n, _ = self.diagonal.shape
        bands = np.zeros((2 * n, length, n))
        for i in range(n):
            for j in range(n):
                if i >= j:
                    bands[i - j, :, j] = self.diagonal[:, i, j]
                bands[n + i - j, :-1, j] = self.below[:, i, j]
        return np.asarray(linalg.cholesky_banded(bands.reshape(2 * n, -1), lower=True))

    def solve(self, paths: Array) -> Array:
        """Return M^-1 times paths (n, N + 1, B)."""
        solved = linalg.cho_solve_banded((self._root, True), _flat(paths), check_finite=False)
        return _path(solved, paths.shape)

    def coloured(self, noise: Array) -> Array:
        """Return L times paths (n, N + 1, B): of covariance M where theirs is 1."""
        v = _flat(noise)
        out = self._root[0][:, None] * v
        for d in range(1, len(self._root)):
            out[d:] += self._root[d, :-d, None] * v[:-d]
        return _path(out, noise.shape)


@dataclass(frozen=True, eq=False)
class Moved:
    """Paths (n, N + 1, B) after a move, and the probability with which each was accepted (B,)."""

    paths: Array
    acceptance: Array


@np.errstate(over='ignore', invalid='ignore', divide='ignore')
def move(posterior: PathPosterior, paths: Array, mass: Precision, step: float, leaps: int,
         rng: Generator) -> Moved:
    """
    Return paths (n, N + 1, B) after a Hamiltonian move each  [Duane et al. 1987].

    H(x, p) = U(x) + p^T M^-1 p / 2, leaps of the leapfrog with a step in units in which the
    posterior, were it Gaussian of precision M, would have unit width.
    """
    p = mass.coloured(rng.standard_normal(paths.shape))
    before = posterior.log_density(paths) - _kinetic(mass, p)
    x, p = paths, p + step / 2 * posterior.gradient(paths)
    for k in range(leaps):
        x = x + step * mass.solve(p)
        p = p + (step if k < leaps - 1 else step / 2) * posterior.gradient(x)
    after = posterior.log_density(x) - _kinetic(mass, p)
    # a path that flew away is not accepted
    acceptance = np.nan_to_num(np.exp(np.minimum(after - before, 0.0)))
    accepted = rng.random(len(acceptance)) < acceptance
    return Moved(np.where(accepted, x, paths), acceptance)


def adapted(step: float, acceptance: float, number: int) -> float:
    """Return a step nearer to the one of the right acceptance, after so many of its kind."""
    # log step += gain (share accepted - wanted)  [Robbins and Monro 1951]
    return float(step * np.exp((acceptance - ACCEPTANCE) / (1 + number)**0.6))


def _kinetic(mass: Precision, p: Array) -> Array:
    return np.asarray(0.5 * np.einsum('ik...,ik...->...', p, mass.solve(p)))


def _flat(paths: Array) -> Array:
    """Return paths (n, N + 1, B) as columns ((N + 1) n, B)."""
    return paths.transpose(1, 0, 2).reshape(-1, paths.shape[2])


def _path(columns: Array, shape: tuple[int, ...]) -> Array:
    n, length, count = shape
    return np.asarray(columns).reshape(length, n, count).transpose(1, 0, 2)
