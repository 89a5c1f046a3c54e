"""Rounds of moves, and what is learned in the first of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.path_monte_carlo import hamiltonian, particles
from pif_ros.core.path_monte_carlo.hamiltonian import Precision
from pif_ros.core.path_monte_carlo.posterior import PathPosterior
from pif_ros.core.path_monte_carlo.settings import SamplerSettings

Array = NDArray[np.float64]

#: Leaps of a Hamiltonian move at most, however short they are.
LEAPS = 32
#: Particles from which the first paths are drawn where the moves have none.
FIRST_PARTICLES = 64
TAIL = 0.5


@dataclass(frozen=True, eq=False)
class Tuning:
    """The preconditioner of Hamiltonian moves and the step of their leaps."""

    mass: Precision
    step: float


@dataclass(frozen=True, eq=False)
class Round:
    """
    Paths (n, N + 1, chains) after a round.

    acceptance: share of Hamiltonian moves accepted; changed: share of chains in which the
    particle move changed the state, (N + 1,); NaN where there were none.
    """

    paths: Array
    acceptance: float
    changed: Array


def advanced(posterior: PathPosterior, settings: SamplerSettings, paths: Array, tuning: Tuning,
             rng: Generator) -> Round:
    """Return the paths (n, N + 1, chains) after a particle move and Hamiltonian ones."""
    changed, acceptance = np.full(paths.shape[1], np.nan), []
    if settings.particles:
        before = paths
        start = int(rng.integers(paths.shape[1])) if rng.random() < TAIL else 0
        paths = particles.renewed(posterior, before, settings.particles, rng, start)
        changed = np.any(paths != before, axis=0).mean(axis=1)
    for _ in range(settings.moves):
        # of random length, since one of fixed length may come back to where it began
        leaps = math.ceil(rng.uniform(0, settings.travel) / tuning.step)
        moved = hamiltonian.move(posterior, paths, tuning.mass, tuning.step,
                                 min(max(leaps, 1), LEAPS), rng)
        paths = moved.paths
        acceptance.append(float(moved.acceptance.mean()))
    return Round(paths, float(np.mean(acceptance)) if acceptance else math.nan, changed)


def warmed_up(posterior: PathPosterior, settings: SamplerSettings, rng: Generator,
              told: Callable[[int], None]) -> tuple[Array, Tuning]:
    """
    Return paths (n, N + 1, chains) and a tuning after the warm-up.

    The preconditioner is averaged over chains and over the second quarter of the rounds; the step
    is adapted all along, and once more from there.  told: the number of rounds done.
    """
    paths = particles.begun(posterior, settings.chains, settings.particles or FIRST_PARTICLES,
                            rng)
    # leapfrog in d dimensions is stable for steps of order d^(-1/4)
    first = (paths.shape[0] * paths.shape[1])**-0.25
    tuning, since = Tuning(Precision(*posterior.curvature(paths)), first), 0
    learned = []
    for k in range(settings.warm_up):
        turn = advanced(posterior, settings, paths, tuning, rng)
        paths, since = turn.paths, since + 1
        if settings.moves:
            step = hamiltonian.adapted(tuning.step, turn.acceptance, since)
            tuning = replace(tuning, step=step)
        if settings.warm_up <= 4 * k < 2 * settings.warm_up:
            learned.append(posterior.curvature(paths))
        elif learned:
            tuning, since = Tuning(_averaged(learned), tuning.step), 0
            learned = []
        told(k + 1)
    return paths, tuning


def _averaged(learned: list[tuple[Array, Array]]) -> Precision:
    diagonal, below = zip(*learned)
    return Precision(np.mean(diagonal, axis=0), np.mean(below, axis=0))
