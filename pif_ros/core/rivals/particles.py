"""The particle filter."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import check_covariance
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.predictive import Predictive
from pif_ros.core.rivals.cloud import ParticleBelief, systematic
from pif_ros.core.rivals.passage import check_box, driven_steps, known, LARGEST, step_ns, wrapped
from pif_ros.core.simulation import spectral_root

Array = NDArray[np.float64]

#: What random numbers are for: each purpose has its own key, so that no two share any.
NOISE, RESAMPLING, START, MIXING = 1, 2, 3, 4
#: A particle this many widths of the box away from its middle has blown up.
FAR = 10.0
#: How many steps a trial of the step's length takes, and what share may die in it without a word.
TRIAL, DYING = 10, 0.01
#: Weights as equal as this are equal: the rounding of their sum must not resample them.
EQUAL = 1 - 1e-9


@dataclass(frozen=True, eq=False)
class ParticleFilter:
    """
    The bootstrap particle filter: sequential importance resampling  [Gordon et al. 1993].

    time_step: seconds per Euler-Maruyama step of the drift in Ito's sense; box: what a uniform
    belief fills, and which states go round; it does not hold the particles, but one that is ten
    widths of it away has blown up; particles: how many; threshold: before a step, the cloud is
    resampled if its effective size is below this share of the particles.

    The posterior is a function of the ordered measurements and the seed: the random numbers of
    a step are those of its stamp, whoever asks for it and however often.
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    time_step: float
    box: Grid | None = None
    particles: int = 5000
    seed: int = 0
    threshold: float = 0.5
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds, and refuse what makes no filter."""
        put = object.__setattr__
        put(self, 'time_step_ns', step_ns(self.time_step))
        check_box(self.box, self.model.ndim)
        if not 1 <= self.particles < 2**63 or self.particles != int(self.particles):
            raise ValueError(f'particles: expected a whole number from 1 on, got {self.particles}')
        if not 0 <= self.seed < 2**64 or self.seed != int(self.seed):
            raise ValueError(f'seed: expected a whole number from 0 to 2^64 - 1, got {self.seed}')
        if not 0 <= self.threshold <= 1:
            raise ValueError(f'threshold: expected a share from 0 to 1, got {self.threshold}')
        put(self, 'particles', int(self.particles))
        put(self, 'seed', int(self.seed))

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> ParticleBelief:
        """Return particles drawn from a Gaussian, cut nowhere; ValueError for a bad covariance."""
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        if mean.shape != (self.model.ndim,) or not np.all(np.isfinite(mean)):
            raise ValueError(f'mean: expected {self.model.ndim} finite numbers, '
                             f'got {mean.tolist()}')
        check_covariance('covariance', covariance, self.model.ndim)
        z = self._random(START, 0).standard_normal((self.model.ndim, self.particles))
        return self._cloud(mean[:, None] + np.linalg.cholesky(covariance) @ z)

    def uniform(self) -> ParticleBelief:
        """Return particles drawn evenly from the box."""
        box = known(self.box)
        low, high = np.array(box.lower)[:, None], np.array(box.upper)[:, None]
        u = self._random(START, 0).random((box.ndim, self.particles))
        return self._cloud(low + (high - low) * u)

    @np.errstate(over='ignore', invalid='ignore', divide='ignore')
    def predict(self, belief: ParticleBelief, from_ns: int, to_ns: int,
                controls: Controls = NO_CONTROLS) -> ParticleBelief:
        """
        Return the particles moved to a later stamp; ValueError for an earlier one.

        A particle that blows up dies where it was last: its weight is 0 from then on.
        """
        x, log_w, weighed = belief.points, belief.log_weights, None
        for start, length, model in driven_steps(self.model, controls, from_ns, to_ns,
                                                 self.time_step_ns):
            if log_w is not weighed:
                if log_w.max() == -np.inf:
                    break
                x, log_w = self._resampled(x, log_w, start)
                weighed = log_w
            x, log_w = self._living(x, self._moved(model, x, start, length / NANOSECONDS), log_w)
        return ParticleBelief(x, log_w, belief.box)

    @np.errstate(over='ignore', invalid='ignore', divide='ignore')
    def correct(self, belief: ParticleBelief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[ParticleBelief, float]:
        """
        Return the particles weighed by a measurement, and the log of the evidence's estimate.

        Where no particle allows the measurement, the belief stays as it was and the evidence is
        -inf.  The product of the evidences estimates p(y_1, .., y_k) without bias; its logarithm,
        the sum of what is returned, does not.
        """
        seen, t = self.sensors[sensor], at_ns / NANOSECONDS
        expected = np.asarray(seen.function(belief.points, t), dtype=float)
        # fmax: a likelihood that is not defined is none
        log_w = np.fmax(belief.log_weights + seen.log_likelihood(y, expected, t), -np.inf)
        peak = float(log_w.max())
        if not math.isfinite(peak):
            return belief, -math.inf
        log_evidence = peak + math.log(np.exp(log_w - peak).sum())
        log_w -= log_evidence
        return ParticleBelief(belief.points, log_w, belief.box), log_evidence

    def log_peak(self, belief: ParticleBelief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement just as the belief is sure it is."""
        return self.sensors[sensor].log_peak(at_ns / NANOSECONDS)

    def predictive(self, belief: ParticleBelief, sensor: str, at_ns: int) -> Predictive:
        """Return what is expected of a sensor: the density of its measurement, mass 1."""
        w = np.zeros(0) if belief.mass == 0 else belief.weights
        return Predictive.of_points(self.sensors[sensor], w, belief.points[:, :len(w)],
                                    at_ns / NANOSECONDS)

    def mixed(self, belief: ParticleBelief, other: ParticleBelief, share: float,
              at_ns: int) -> ParticleBelief:
        """
        Return (1 - share) of a belief and a share of another, both of mass 1 before.

        Other particles, drawn at random, take the places of as many of the belief's.
        """
        if belief.mass == 0:
            return other
        if belief.points is other.points:
            w = (1 - share) * belief.weights + share * other.weights
            return ParticleBelief(belief.points, _logs(w), belief.box)
        count = min(max(round(share * self.particles), 1), self.particles)
        rng = self._random(MIXING, at_ns)
        ours = _drawn(belief.weights, self.particles - count, rng)
        theirs = _drawn(other.weights, count, rng)
        w = np.repeat([(1 - share) / max(len(ours), 1), share / count], [len(ours), count])
        return ParticleBelief(np.concatenate([belief.points[:, ours], other.points[:, theirs]],
                                             axis=1), _logs(w / w.sum()), belief.box)

    def describe(self) -> str:
        """Return what the filter is."""
        return f'particle filter with {self.particles:,} particles'

    def remarks(self) -> list[str]:
        """Return a sentence where the step is too long for particles from all over the box."""
        if self.box is None:
            return []
        dead = 1 - self.predict(self.uniform(), 0, TRIAL * self.time_step_ns).mass
        if dead < DYING:
            return []
        return [f'kernel.time_step: {dead:.0%} of particles from all over the box blow up within '
                f'{TRIAL} steps of {self.time_step:g} s, and die; shorter steps keep them']

    def _cloud(self, x: Array) -> ParticleBelief:
        equal = np.full(self.particles, -math.log(self.particles))
        return ParticleBelief(wrapped(x, self.box), equal, self.box)

    def _random(self, purpose: int, at_ns: int) -> np.random.Generator:
        """Return the random numbers for a purpose at a stamp: 2^128 blocks, then the next."""
        return np.random.Generator(np.random.Philox(
            key=np.array([self.seed, purpose], dtype=np.uint64),
            counter=np.array([0, 0, at_ns % 2**64, 0], dtype=np.uint64)))

    def _resampled(self, x: Array, log_w: Array, at_ns: int) -> tuple[Array, Array]:
        """Return the particles, resampled where too few of them carry the weight."""
        peak, count = float(log_w.max()), len(log_w)
        w = np.exp(log_w - peak)
        total = float(w.sum())
        if total * total >= EQUAL * self.threshold * count * float(w @ w):
            return x, log_w
        picks = systematic(w, self._random(RESAMPLING, at_ns).random())
        return x.take(picks, axis=1), np.full(count, peak + math.log(total / count))

    def _moved(self, model: StateModel, x: Array, at_ns: int, h: float) -> Array:
        """Return x + f h + e dv, dv ~ N(0, Q h)  [Kloeden and Platen 1992, section 10.2]."""
        t = at_ns / NANOSECONDS
        factor = self._factor_at(t)
        z = self._random(NOISE, at_ns).standard_normal((factor.shape[1], x.shape[1]))
        moved = (math.sqrt(h) * factor) @ z
        if model.multiplicative:
            moved = np.einsum('ia...,a...->i...', model.vielbein_at(x, t), moved)
        moved += x
        moved += h * model.ito_drift(x, t)
        return wrapped(moved, self.box)

    def _living(self, x: Array, moved: Array, log_w: Array) -> tuple[Array, Array]:
        """Return the particles after a move; those that blew up stay, with weight 0."""
        low, high = self._reach
        # a comparison with NaN is false
        if np.all(low < moved.min(axis=1)) and np.all(moved.max(axis=1) < high):
            return moved, log_w
        alive = np.all((low[:, None] < moved) & (moved < high[:, None]), axis=0)
        return np.where(alive, moved, x), np.where(alive, log_w, -np.inf)

    @cached_property
    def _reach(self) -> tuple[Array, Array]:
        """Return the least and the largest states that are not taken for blown up, (n,) each."""
        if self.box is None:
            high = np.full(self.model.ndim, LARGEST)
            return -high, high
        low, high = np.array(self.box.lower), np.array(self.box.upper)
        return (low + high) / 2 - FAR * (high - low), (low + high) / 2 + FAR * (high - low)

    def _factor_at(self, t: float) -> Array:
        """Return e Q^(1/2) where e is the same for all states, else Q^(1/2)."""
        model = self.model
        if callable(model.noise_covariance) or (callable(model.vielbein)
                                                and not model.multiplicative):
            return _factor(model, t)
        return self._constant_factor

    @cached_property
    def _constant_factor(self) -> Array:
        return _factor(self.model, 0.0)


def _drawn(weights: Array, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Return so many particles, drawn by their weights with a comb whose place is random."""
    teeth = (np.arange(count) + rng.random()) / max(count, 1)
    order = rng.permutation(len(weights))
    found = np.searchsorted(np.cumsum(weights[order]), teeth)
    return order[found.clip(0, len(weights) - 1)]


def _logs(w: Array) -> Array:
    with np.errstate(divide='ignore'):
        return np.log(w)


def _factor(model: StateModel, t: float) -> Array:
    # Q may be singular at times, and has no Cholesky root then
    half = spectral_root(model.noise(t))
    return half if model.multiplicative else model.vielbein_at(np.zeros(model.ndim), t) @ half
