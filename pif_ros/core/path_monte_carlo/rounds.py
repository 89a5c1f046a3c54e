"""Rounds of moves, and what is learned in the first of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.path_monte_carlo import hamiltonian, particles, tempering
from pif_ros.core.path_monte_carlo.hamiltonian import Precision, Tuning
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from pif_ros.core.path_monte_carlo.settings import SamplerSettings

Array = NDArray[np.float64]

#: Leaps of a Hamiltonian move at most, however short they are.
LEAPS = 32
#: Particles from which the first paths are drawn where the moves have none.
FIRST_PARTICLES = 64

#: Diagonal and lower blocks of a precision, for each of the shares.
Curvatures = list[tuple[Array, Array]]


@dataclass(frozen=True, eq=False)
class Round:
    """
    Paths (n, N + 1, K chains) after a round, those of the whole likelihood first.

    acceptance: of Hamiltonian moves, (K,); changed: share of the chains in which the particle
    move changed the state, (N + 1,); exchanged: of the exchanges, (K - 1,); NaN where there were
    none.
    """

    paths: Array
    acceptance: Array
    changed: Array
    exchanged: Array


def advanced(posterior: PathPosterior, settings: SamplerSettings, paths: Array, tuning: Tuning,
             number: int, rng: Generator) -> Round:
    """Return the paths after the number-th round: particles, then moves and exchanges in turns."""
    count, chains = len(tuning.shares), settings.chains
    changed = np.full(paths.shape[1], np.nan)
    if settings.particles:
        after = particles.renewed(posterior, paths[..., :chains], settings.particles, rng)
        changed = np.any(after != paths[..., :chains], axis=0).mean(axis=1)
        paths = np.concatenate([after, paths[..., chains:]], axis=2)
    accepted, exchanged = [np.full(count, np.nan)], [np.full(count - 1, np.nan)]
    for k in range(number * settings.moves, (number + 1) * settings.moves):
        # of random length, since one of fixed length may come back to where it began
        leaps = math.ceil(rng.uniform(0, settings.travel) / tuning.steps.mean())
        moved = hamiltonian.move(posterior, paths, tuning, min(max(leaps, 1), LEAPS), rng)
        accepted.append(moved.acceptance.reshape(count, -1).mean(axis=1))
        exchange = tempering.exchange(posterior.log_likelihood(moved.paths).reshape(count, -1),
                                      tuning.shares, bool(k % 2), rng)
        exchanged.append(exchange.acceptance)
        paths = moved.paths[..., (exchange.order * chains + np.arange(chains)).ravel()]
    return Round(paths, _mean(accepted), changed, _mean(exchanged))


def warmed_up(posterior: PathPosterior, settings: SamplerSettings, rng: Generator,
              told: Callable[[int], None]) -> tuple[Array, Tuning]:
    """
    Return paths (n, N + 1, K chains) and a tuning after the warm-up.

    After each of its first three quarters, preconditioners and the ladder of shares are those of
    the quarter's average; steps are adapted all along.  told: the number of rounds done.
    """
    shares = tempering.first_shares(settings.temperatures, settings.least_share)
    paths = particles.begun(posterior, len(shares) * settings.chains,
                            settings.particles or FIRST_PARTICLES, rng)
    # leapfrog in d dimensions is stable for steps of order d^(-1/4)
    steps = np.full(len(shares), (paths.shape[0] * paths.shape[1])**-0.25)
    tuning = Tuning(shares, _masses([_curvatures(posterior, paths, shares)]), steps)
    learned: list[Curvatures] = []
    exchanged: list[Array] = []
    for k in range(settings.warm_up):
        turn = advanced(posterior, settings, paths, tuning, k, rng)
        paths = turn.paths
        if settings.moves:
            tuning = replace(tuning, steps=hamiltonian.adapted(
                tuning.steps, turn.acceptance, len(learned)))
            learned.append(_curvatures(posterior, paths, tuning.shares))
            exchanged.append(turn.exchanged)
        if 4 * len(learned) >= settings.warm_up and 4 * k < 3 * settings.warm_up:
            tuning = Tuning(_respaced(tuning.shares, exchanged), _masses(learned), tuning.steps)
            learned, exchanged = [], []
        told(k + 1)
    return paths, tuning


def _curvatures(posterior: PathPosterior, paths: Array, shares: Array) -> Curvatures:
    return [posterior.curvature(group, share)
            for group, share in zip(np.split(paths, len(shares), axis=2), shares)]


def _masses(learned: list[Curvatures]) -> tuple[Precision, ...]:
    """Return the averages over rounds, share by share."""
    return tuple(Precision(np.mean([diagonal for diagonal, _ in rounds], axis=0),
                           np.mean([below for _, below in rounds], axis=0))
                 for rounds in zip(*learned))


def _respaced(shares: Array, exchanged: list[Array]) -> Array:
    acceptance = _mean(exchanged)
    known = len(shares) > 2 and np.all(np.isfinite(acceptance))
    return tempering.respaced(shares, acceptance) if known else shares


def _mean(values: list[Array]) -> Array:
    """Return the mean of arrays, number by number, over those that are not NaN."""
    known = np.isfinite(values)
    with np.errstate(invalid='ignore'):
        return np.asarray(np.where(known, values, 0.0).sum(axis=0) / known.sum(axis=0))
