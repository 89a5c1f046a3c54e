"""The state's steps and the path's increment, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous.increments import Increments
from pif_ros.core.filters import DiracFeynmanFilter, NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import scale_of, Sensor, StateModel

Array = NDArray[np.float64]

#: A belief is never multiplied by more than this before a step.
LARGEST = 1e100


@dataclass(frozen=True, eq=False)
class Splitting:
    """
    The steps, then the increment's likelihood: the splitting-up approximation.

    N(dy; h eps, C eps) is exp(h^T C^-1 dy - eps h^T C^-1 h / 2) but for a factor.

    state: the filter whose steps these are.
    """

    state: DiracFeynmanFilter
    increments: Increments

    def advance(self, belief: GridBelief, dy: Array, from_ns: int,
                to_ns: int) -> tuple[GridBelief, float]:
        """Return what is believed an increment dy (m,) later, and log p(dy | all before)."""
        belief = self.state.predict(belief, from_ns, to_ns)
        return self._by(to_ns - from_ns).correct(belief, dy, 'dy', to_ns)

    @cached_property
    def _by(self) -> Callable[[int], DiracFeynmanFilter]:
        """Return, by nanoseconds, the filter that corrects by the increment."""
        return lru_cache(maxsize=16)(lambda ns: replace(
            self.state, sensors={'dy': self.increments.sensor(ns)}))


@dataclass(frozen=True, eq=False)
class Symmetric:
    """
    N(dy; h eps, C eps)^(1/2), the steps, the other half: of second order in eps where h is linear.

    state: the filter whose steps these are.
    """

    state: DiracFeynmanFilter
    increments: Increments

    def advance(self, belief: GridBelief, dy: Array, from_ns: int,
                to_ns: int) -> tuple[GridBelief, float]:
        """Return what is believed an increment dy (m,) later, and log p(dy | all before)."""
        ns = to_ns - from_ns
        half, whole = self._half(ns), belief.density * self._wanting(ns, from_ns)
        belief, before = half.correct(GridBelief(belief.grid, whole), dy, 'dy', from_ns)
        belief = self.state.predict(belief, from_ns, to_ns)
        belief, after = half.correct(belief, dy, 'dy', to_ns)
        # N(v; 0, S)^(1/2) = N(v; 0, 2 S) 2^(m / 2) / N(0; 0, S)^(1/2)
        peaks = sum(self.increments.log_peak(ns, at_ns) for at_ns in (from_ns, to_ns))
        return belief, before + after + len(dy) * float(np.log(2)) - 0.5 * peaks

    def _wanting(self, ns: int, from_ns: int) -> Array:
        """
        Return by what the halves are short of a probability of dy, grid.shape.

        Over all dy they integrate to exp(-|h'' - h'|^2 eps / 8), in units of C^(1/2), and over a
        step h'' - h' ~ N(0, eps H g H^T): det(1 + eps^2 C^-1 H g H^T / 4)^(-1/2) together.
        """
        changes = self.state.model.changes_with_time or self.increments.changes_with_time
        return self._shortfall(ns, from_ns if changes else 0).reshape(self.state.grid.shape)

    @cached_property
    def _half(self) -> Callable[[int], DiracFeynmanFilter]:
        """Return, by nanoseconds, the filter that corrects by half of the increment."""
        return lru_cache(maxsize=16)(lambda ns: replace(
            self.state, sensors={'dy': self.increments.sensor(ns, 0.5)}))

    @cached_property
    def _shortfall(self) -> Callable[[int, int], Array]:
        @np.errstate(over='ignore', invalid='ignore')
        def at(ns: int, at_ns: int) -> Array:
            spread = self._spread(at_ns)
            square = np.linalg.det(np.eye(spread.shape[-1]) + (ns / NANOSECONDS / 2)**2 * spread)
            return np.sqrt(np.fmin(square, LARGEST))
        return lru_cache(maxsize=16)(at)

    @cached_property
    def _spread(self) -> Callable[[int], Array]:
        return lru_cache(maxsize=2)(lambda at_ns: slope_spread(
            self.state.model, self.increments.path, self.state.grid, at_ns / NANOSECONDS))


@np.errstate(all='ignore')
def slope_spread(model: StateModel, sensor: Sensor, grid: Grid, t: float) -> Array:
    """Return W H g H^T W^T, C^-1 = W^T W, on a grid, (size, m, m); 0 where h has no slope."""
    W = np.linalg.inv(np.linalg.cholesky(sensor.noise(t)))
    x, scale = grid.points, scale_of(grid.spacing)
    WH = np.einsum('ij,jkn->nik', W, sensor.jacobian(x, t, scale))
    spread = WH @ np.moveaxis(model.diffusion_at(x, t), -1, 0) @ WH.swapaxes(1, 2)
    return np.where(np.all(np.isfinite(spread), axis=(1, 2), keepdims=True), spread, 0.0)
