"""Hamiltonian moves of whole paths, preconditioned by the precision of a path."""

from __future__ import annotations

from collections.abc import Callable
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
class Tuning:
    """
    What Hamiltonian moves of K groups of chains go by.

    shares: of the likelihood that counts, (K,); masses: K precisions; steps: of the leapfrog,
    (K,), in units in which the posterior, were it Gaussian of that precision, has unit width.
    """

    shares: Array
    masses: tuple[Precision, ...]
    steps: Array


@dataclass(frozen=True, eq=False)
class Moved:
    """Paths (n, N + 1, B) after a move, and the probability with which each was accepted (B,)."""

    paths: Array
    acceptance: Array


@np.errstate(over='ignore', invalid='ignore', divide='ignore')
def move(posterior: PathPosterior, paths: Array, tuning: Tuning, leaps: int,
         rng: Generator) -> Moved:
    """
    Return paths (n, N + 1, B) after a Hamiltonian move each  [Duane et al. 1987].

    H(x, p) = U(x) + p^T M^-1 p / 2, by so many leaps of the leapfrog.  B / K paths in a row
    belong to each group of the tuning.
    """
    count = paths.shape[2] // len(tuning.shares)
    share, step = (np.repeat(values, count) for values in (tuning.shares, tuning.steps))
    p = _by_group(Precision.coloured, tuning, rng.standard_normal(paths.shape))
    before = posterior.log_density(paths, share) - _kinetic(tuning, p)
    x, p = paths, p + step / 2 * posterior.gradient(paths, share)
    for k in range(leaps):
        x = x + step * _by_group(Precision.solve, tuning, p)
        p = p + (step if k < leaps - 1 else step / 2) * posterior.gradient(x, share)
    after = posterior.log_density(x, share) - _kinetic(tuning, p)
    # a path that flew away is not accepted
    acceptance = np.nan_to_num(np.exp(np.minimum(after - before, 0.0)))
    accepted = rng.random(len(acceptance)) < acceptance
    return Moved(np.where(accepted, x, paths), acceptance)


def adapted(steps: Array, acceptance: Array, number: int) -> Array:
    """Return steps nearer to those of the right acceptance, after so many of their kind."""
    # log step += gain (share accepted - wanted)  [Robbins and Monro 1951]
    return np.asarray(steps * np.exp((acceptance - ACCEPTANCE) / (1 + number)**0.6))


def _by_group(function: Callable[[Precision, Array], Array], tuning: Tuning,
              paths: Array) -> Array:
    groups = np.split(paths, len(tuning.masses), axis=2)
    return np.concatenate([function(mass, group) for mass, group in zip(tuning.masses, groups)],
                          axis=2)


def _kinetic(tuning: Tuning, p: Array) -> Array:
    return np.asarray(0.5 * np.einsum('ik...,ik...->...', p,
                                      _by_group(Precision.solve, tuning, p)))


def _flat(paths: Array) -> Array:
    """Return paths (n, N + 1, B) as columns ((N + 1) n, B)."""
    return paths.transpose(1, 0, 2).reshape(-1, paths.shape[2])


def _path(columns: Array, shape: tuple[int, ...]) -> Array:
    n, length, count = shape
    return np.asarray(columns).reshape(length, n, count).transpose(1, 0, 2)
