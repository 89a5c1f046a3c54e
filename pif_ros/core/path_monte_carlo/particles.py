"""Particle moves of whole paths, which change between humps of the posterior."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.kernels.formula import action, drift_terms
from pif_ros.core.path_monte_carlo.posterior import log_transition, PathPosterior

Array = NDArray[np.float64]
Integers = NDArray[np.intp]

#: Particles are drawn anew where fewer than this share of them still count.
RESAMPLE = 0.5
#: How many times as many particles there are up to the first measurement, which leaves few.
MORE_AT_FIRST = 8


@dataclass(frozen=True, eq=False)
class _Cloud:
    """
    The P particles of one stamp in each of B filters.

    states (n, B, P); log_weights (B, P); parents (B, P): whose step each of them is; drawn (B,):
    whether the parents were drawn by weight.
    """

    states: Array
    log_weights: Array
    parents: Integers
    drawn: NDArray[np.bool_]


def renewed(posterior: PathPosterior, paths: Array, particles: int, rng: Generator) -> Array:
    """
    Return new paths (n, N + 1, B), each renewed by a particle filter of its own.

    Particle 0 of each filter is held on its path, and the new path is traced back with the past
    weighed anew wherever parents were drawn: a move that leaves the posterior as it is, however
    few the particles  [Andrieu, Doucet and Holenstein 2010; Whiteley 2010].
    """
    return _traced(posterior, _forward(posterior, paths, paths.shape[2], particles, rng), rng)


def begun(posterior: PathPosterior, count: int, particles: int, rng: Generator) -> Array:
    """Return count paths (n, N + 1, count), each from an ordinary particle filter of its own."""
    return _traced(posterior, _forward(posterior, None, count, particles, rng), rng)


def _forward(posterior: PathPosterior, paths: Array | None, count: int, particles: int,
             rng: Generator) -> list[_Cloud]:
    """Return the particles of all stamps; up to the first measurement there are more."""
    clouds = [_first(posterior, paths, count, MORE_AT_FIRST * particles, rng)]
    for k in range(len(posterior.stamps_ns) - 1):
        fewer = particles if posterior.first_seen <= k else MORE_AT_FIRST * particles
        clouds.append(_next(posterior, paths, clouds[-1], k, fewer, rng))
    return clouds


def _first(posterior: PathPosterior, paths: Array | None, count: int, particles: int,
           rng: Generator) -> _Cloud:
    root = np.linalg.cholesky(np.asarray(posterior.covariance))
    noise = rng.standard_normal((posterior.ndim, count, particles))
    x = np.reshape(posterior.mean, (-1, 1, 1)) + np.tensordot(root, noise, axes=1)
    if paths is not None:
        x[..., 0] = paths[:, 0]
    return _Cloud(x, posterior.log_likelihood_at(0, x), _stay(count, particles),
                  np.zeros(count, dtype=bool))


def _next(posterior: PathPosterior, paths: Array | None, cloud: _Cloud, k: int, particles: int,
          rng: Generator) -> _Cloud:
    """Return so many particles a step later."""
    parents, log_w, drawn = _resampled(cloud.log_weights, particles, paths is not None, rng)
    x_from = np.take_along_axis(cloud.states, parents[None], axis=2)
    model, steps = posterior.model, posterior.step[k]
    eps, g = steps.settings.time_step, steps.diffusion
    f = np.asarray(model.drift(x_from, steps.t), dtype=float)
    x = x_from + eps * f + np.tensordot(np.linalg.cholesky(eps * g),
                                        rng.standard_normal(x_from.shape), axes=1)
    if paths is not None:
        x[..., 0] = paths[:, k + 1]
    if steps.settings.r > 0:
        # moved by r = 0, and weighed by how much likelier the move is by r
        dx = x - x_from
        f_r, log_jacobian = drift_terms(model, x_from + steps.settings.r * dx, steps.settings,
                                        steps.t)
        log_w = log_w + (log_jacobian + action(dx, f, g, eps) - action(dx, f_r, g, eps))
    return _Cloud(x, log_w + posterior.log_likelihood_at(k + 1, x), parents, drawn)


def _resampled(log_w: Array, particles: int, conditioned: bool,
               rng: Generator) -> tuple[Integers, Array, NDArray[np.bool_]]:
    """
    Return parents (B, particles) of log weights (B, P), log weights after it, and who drew (B,).

    A filter draws where few of its particles count, and all do where particles is not P.  Each of
    the new ones is then a child of any by weight, independently, but for particle 0, which is its
    own where it is held on a path.
    """
    count, before = log_w.shape
    w = _weights(log_w)
    drawn = (1 / np.square(w).sum(axis=1) < RESAMPLE * before) | (particles < before)
    parents = np.array(_stay(count, particles))
    rows = np.flatnonzero(drawn)
    if len(rows):
        # one search for all filters: each has a unit of the line to itself
        unit = np.arange(len(rows))[:, None]
        edges = np.minimum(np.cumsum(w[rows], axis=1), 1.0) + unit
        drops = rng.random((len(rows), particles)) + unit
        found = np.searchsorted(edges.ravel(), drops.ravel()).reshape(drops.shape) - unit * before
        parents[rows] = np.minimum(found, before - 1)
        parents[rows, 0] *= not conditioned
        log_w = np.where(drawn[:, None], 0.0, log_w[:, :particles])
    return parents, log_w, drawn


def _stay(count: int, particles: int) -> Integers:
    return np.broadcast_to(np.arange(particles), (count, particles))


def _traced(posterior: PathPosterior, clouds: list[_Cloud], rng: Generator) -> Array:
    """Return a path (n, N + 1, B) through the particles, drawn backward in time."""
    chosen = _drawn(clouds[-1].log_weights, rng)
    path = [_pick(clouds[-1].states, chosen)]
    for k in range(len(clouds) - 2, -1, -1):
        before, after = clouds[k], clouds[k + 1]
        chosen = _pick(after.parents, chosen)
        if after.drawn.any():
            # p(x' | x'', y_1 .. y_k) ~ w P(x'' | x')
            log_w = before.log_weights + log_transition(
                posterior.model, path[-1][..., None], before.states, posterior.step[k])
            chosen = np.where(after.drawn, _drawn(log_w, rng), chosen)
        path.append(_pick(before.states, chosen))
    return np.stack(path[::-1], axis=1)


def _drawn(log_w: Array, rng: Generator) -> Integers:
    """Return an index (B,) by weight for each row of log weights (B, P)."""
    # the largest of log w + Gumbel noise; row by row the weights need not sum to 1
    return np.argmax(np.nan_to_num(log_w, nan=-np.inf) + rng.gumbel(size=log_w.shape), axis=1)


def _weights(log_w: Array) -> Array:
    """Return weights (B, P) that sum to 1, equal ones where all particles fail."""
    log_w = np.nan_to_num(log_w, nan=-np.inf)
    peak = log_w.max(axis=1, keepdims=True)
    w = np.where(np.isfinite(peak), np.exp(log_w - np.where(np.isfinite(peak), peak, 0.0)), 1.0)
    return w / w.sum(axis=1, keepdims=True)


def _pick(of: NDArray, chosen: Integers) -> NDArray:
    """Return what stands at an index (B,) of the last axis (..., B, P), shape (..., B)."""
    return of[..., np.arange(len(chosen)), chosen]
