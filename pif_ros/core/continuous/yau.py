"""The Yau equation's steps: of the state, and of what the path's noise makes of its slope."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous.increments import Increments
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import StateModel
from pif_ros.core.posterior import NEGLIGIBLE
from scipy import sparse

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

#: Moves that are worked on at a time.
CHUNK = 1 << 18


@dataclass(frozen=True, eq=False)
class YauSteps:
    """
    Steps of K_Y = K exp(-(eps / 2) h^T C^-1 h), h at x^(r)  [PMC, Eq. 39], and exp(h^T C^-1 dy).

    first: whether that comes before a step, at x', or after it, at x''.  By themselves both leave
    the range of numbers.  So what K_Y has of h where the increment meets it goes with the
    increment into -|dy - h eps|^2 / (2 C eps), and a step has only what h differs by, relative to
    the largest of it.
    """

    model: StateModel
    grid: Grid
    settings: KernelSettings
    increments: Increments
    first: bool

    def advance(self, belief: GridBelief, dy: Array, from_ns: int,
                to_ns: int) -> tuple[GridBelief, float]:
        """
        Return what is believed an increment dy (m,) later, and log p(dy | all before).

        The path is taken for straight between its stamps: each step has its share of dy.
        """
        # v_i = K_Y [exp(h^T C^-1 dy) v_(i-1)], or exp(h^T C^-1 dy) [K_Y v_(i-1)]
        # [PMC, Eqs. 25, 37]
        p, total = belief.density.ravel(), self.increments.log_peak(to_ns - from_ns, to_ns)
        step_ns = max(round(self.settings.time_step * NANOSECONDS), 1)
        for at_ns in range(from_ns, to_ns, step_ns):
            ns = min(step_ns, to_ns - at_ns)
            K, log_scale = self.step(at_ns, ns / step_ns)
            seen_ns = at_ns if self.first else at_ns + ns
            log_l = self._likelihood(ns).log(dy * (ns / (to_ns - from_ns)), p,
                                             seen_ns / NANOSECONDS)
            p = p if self.first else K @ p
            p, log_mass = weighed(p, log_l + log_scale)
            p = K @ p if self.first else p
            total += log_mass - self.increments.log_peak(ns, seen_ns)
        mass = float(p.sum()) * self.grid.cell_volume
        if not (mass > 0 and np.isfinite(total)):
            return belief, -np.inf
        return (GridBelief(self.grid, (p / mass).reshape(self.grid.shape)),
                float(total + np.log(mass)))

    def step(self, at_ns: int, fraction: float = 1.0) -> tuple[sparse.csr_array, Array]:
        """
        Return the weights of a step from a stamp, 0 to 1, and log scales (size,).

        A scale is that of the cell at which the increment meets the step.  A fraction a of a step
        is (1 - a) I + a K, with a of the exponent.
        """
        changes = self.model.changes_with_time or self.increments.changes_with_time
        return self._steps(at_ns if changes else 0, fraction)

    @cached_property
    def _likelihood(self) -> Callable[[int], GridLikelihood]:
        return lru_cache(maxsize=16)(lambda ns: GridLikelihood(
            self.grid, self.increments.sensor(ns), average_cells=False))

    @cached_property
    def _steps(self) -> Callable[[int, float], tuple[sparse.csr_array, Array]]:
        return lru_cache(maxsize=16)(self._scaled)

    @cached_property
    def _moves(self) -> Callable[[int], tuple[sparse.csr_array, Indices, Array]]:
        return lru_cache(maxsize=16)(self._made)

    def _scaled(self, at_ns: int, fraction: float) -> tuple[sparse.csr_array, Array]:
        K, met, exponent = self._moves(at_ns)
        with np.errstate(divide='ignore'):
            log_w, log_stay = np.log(fraction * K.data), np.log(1 - fraction)
        log_w += fraction * exponent
        scale = np.full(self.grid.size, log_stay)
        np.maximum.at(scale, met, log_w)
        scale[scale == -np.inf] = 0.0
        w = np.exp(log_w - scale[met])
        w[w < NEGLIGIBLE] = 0.0
        moved = sparse.csr_array((w, K.indices, K.indptr), K.shape)
        if fraction < 1:
            stay = np.exp(log_stay - scale)
            moved = (moved + sparse.dia_array((stay[None], [0]), shape=K.shape)).tocsr()
        return moved, scale

    def _made(self, at_ns: int) -> tuple[sparse.csr_array, Indices, Array]:
        """Return K, and for each move where the increment meets it and its exponent less that."""
        t, r, eps = at_ns / NANOSECONDS, self.settings.r, self.settings.time_step
        K = dirac_feynman(self.model, self.grid, self.settings, t)
        to, from_ = np.repeat(np.arange(self.grid.size), np.diff(K.indptr)), K.indices
        met, x, exponent = from_ if self.first else to, self.grid.points, np.empty(K.nnz)
        with np.errstate(all='ignore'):
            own = self._square(x, t + r * eps)
            for k in range(0, K.nnz, CHUNK):
                some = slice(k, k + CHUNK)
                start = x[:, from_[some]]
                within = start + r * self.grid.wrap(x[:, to[some]] - start)
                exponent[some] = self._square(within, t + r * eps) - own[met[some]]
        exponent *= -0.5 * eps
        exponent[np.isnan(exponent)] = -np.inf
        return K, met, exponent

    def _square(self, x: Array, t: float) -> Array:
        """Return h^T C^-1 h at states (n, N)."""
        v = np.asarray(self.increments.path.function(x, t), dtype=float)
        v = np.linalg.inv(np.linalg.cholesky(self.increments.path.noise(t))) @ v
        return np.einsum('ik,ik->k', v, v)


def weighed(p: Array, log_weight: Array) -> tuple[Array, float]:
    """Return p times a weight, scaled to the sum 1, and the log of its sum; p, -inf where 0."""
    with np.errstate(divide='ignore'):
        log_p = np.log(p)
    log_p += log_weight
    log_p[np.isnan(log_p)] = -np.inf
    peak = float(log_p.max())
    if not np.isfinite(peak):
        return p, -np.inf
    log_p -= peak
    w = np.exp(log_p, out=log_p)
    total = float(w.sum())
    w /= total
    w -= NEGLIGIBLE
    return np.maximum(w, 0.0, out=w), peak + float(np.log(total))
