"""Chains of paths, and what can be read off them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.path_monte_carlo.diagnostics import (effective_sample_size, split_r_hat,
                                                       standard_error)
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from pif_ros.core.path_monte_carlo.rounds import advanced, warmed_up
from pif_ros.core.path_monte_carlo.settings import SamplerSettings
from pif_ros.core.rivals.cloud import ParticleBelief

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Average:
    """The mean of something over paths, and its standard error, by the effective sample size."""

    mean: Array
    standard_error: Array


@dataclass(frozen=True, eq=False)
class PathSample:
    """
    Paths drawn from a posterior.

    names: of the n states; stamps_ns: N + 1; paths: (chains, draws, N + 1, n); acceptance: share
    of the Hamiltonian moves that were accepted; renewal: share of the particle moves that changed
    the state, (N + 1,); exchange: share of the exchanges between temperatures that were accepted,
    (temperatures - 1,); NaN where there were none.
    """

    names: tuple[str, ...]
    stamps_ns: tuple[int, ...]
    paths: Array
    acceptance: float
    renewal: Array
    exchange: Array

    @cached_property
    def r_hat(self) -> Array:
        """Return rank-normalised split R-hat of every state, (N + 1, n)."""
        return split_r_hat(self.paths)

    @cached_property
    def effective_sample_size(self) -> Array:
        """Return the bulk effective sample size of every state, (N + 1, n)."""
        return effective_sample_size(self.paths, ranked=True)

    def mean(self) -> Array:
        """Return the means, (N + 1, n)."""
        return np.asarray(self.paths.mean(axis=(0, 1)))

    def covariance(self) -> Array:
        """Return the covariances, (N + 1, n, n)."""
        d = self.paths - self.mean()
        return np.einsum('cdki,cdkj->kij', d, d) / (d.shape[0] * d.shape[1])

    def average(self, function: Callable[[Array], Array]) -> Average:
        """Return the average of a function of states (n, ...), such as np.abs; (N + 1, ...)."""
        values = np.asarray(function(np.moveaxis(self.paths, -1, 0)), dtype=float)
        if values.ndim == self.paths.ndim:
            values = np.moveaxis(values, 0, -1)
        return Average(values.mean(axis=(0, 1)), standard_error(values))

    def at(self, stamp_ns: int) -> Array:
        """Return the states at one of the stamps, (chains, draws, n)."""
        if stamp_ns not in self.stamps_ns:
            raise ValueError(f'stamp_ns: expected one of the {len(self.stamps_ns)} stamps of the '
                             f'path, got {stamp_ns}')
        return self.paths[:, :, self.stamps_ns.index(stamp_ns)]

    def marginal(self, stamp_ns: int, grid: Grid, axes: Sequence[int]) -> GridBelief:
        """
        Return the density of some states at a stamp, counted in the cells of a grid of as many.

        Its mass is the share of paths on the grid.
        """
        x = self.at(stamp_ns)[..., list(axes)].reshape(-1, len(axes)).T
        equal = np.full(x.shape[1], -np.log(x.shape[1]))
        return ParticleBelief(x, equal).on(grid, range(len(axes)))


def sample(posterior: PathPosterior, settings: SamplerSettings = SamplerSettings(),
           seed: int = 0, progress: Callable[[float], None] | None = None) -> PathSample:
    """
    Return paths drawn from a posterior, the same ones for the same seed.

    Each round renews a chain by a particle filter conditioned on it, which changes between humps
    of the posterior, and then by Hamiltonian moves, which change many states at once, however
    many.  Whether it was long enough, r_hat tells.  progress: told the share that is done.
    """
    rng, rounds = np.random.default_rng(seed), settings.draws * settings.thinning
    told, total = progress or (lambda share: None), settings.warm_up + rounds
    paths, tuning = warmed_up(posterior, settings, rng, lambda k: told(k / total))
    kept, turns = np.empty((settings.draws,) + paths.shape[:2] + (settings.chains,)), []
    for k in range(rounds):
        turn = advanced(posterior, settings, paths, tuning, k, rng)
        paths = turn.paths
        kept[k // settings.thinning] = paths[..., :settings.chains]
        turns.append((turn.acceptance[0], turn.changed, turn.exchanged))
        told((settings.warm_up + k + 1) / total)
    acceptance, changed, exchanged = (np.array(values) for values in zip(*turns))
    # (draws, n, N + 1, chains)
    return PathSample(posterior.model.names, posterior.stamps_ns,
                      np.ascontiguousarray(kept.transpose(3, 0, 2, 1)),
                      float(acceptance.mean()), changed.mean(axis=0),
                      np.nanmean(exchanged, axis=0))
