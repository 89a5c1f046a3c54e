"""Predict and correct: the Dirac-Feynman filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, lru_cache
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import (kernel_of, KernelSettings, Operator, operator_of,
                                  OperatorSettings, stored_elements)
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor, StateModel
from scipy import sparse

Array = NDArray[np.float64]
Belief = TypeVar('Belief')

NANOSECONDS = 1_000_000_000
#: A density below this is none: a subnormal number costs as much as a hundred others.
NEGLIGIBLE = 1e-290
#: An evidence below this share of the largest likelihood may have lost digits to underflow.
UNSAFE = 1e-200
#: What the kernels of a model that changes with time may take together.
KEPT_BYTES = 5e8


class Filter(Protocol[Belief]):
    """Two verbs on a belief, and a word on itself; what every filter of this package can do."""

    @property
    def time_step_ns(self) -> int:
        """Return the length of a step in nanoseconds."""

    @property
    def model(self) -> StateModel:
        """Return how the world moves."""

    @property
    def sensors(self) -> Mapping[str, Sensor]:
        """Return the sensors by name."""

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> Belief:
        """Return the belief to start with where a mean (n,) and a covariance (n, n) are known."""

    def uniform(self) -> Belief:
        """Return the belief to start with where nothing is known but the box."""

    def predict(self, belief: Belief, from_ns: int, to_ns: int) -> Belief:
        """
        Return the belief carried from one stamp to a later one, in steps from the first.

        Whole steps may be taken in any number of calls: the result is the same to the bit.
        """

    def correct(self, belief: Belief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[Belief, float]:
        """Return the belief given a measurement, and the log evidence of that measurement."""

    def log_peak(self, belief: Belief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement that is just as the belief is sure it is."""

    def describe(self) -> str:
        """Return what the filter is, in a line; what can be made beforehand is made now."""

    def remarks(self) -> list[str]:
        """Return what a user should know of how well it can work, a sentence each."""


@dataclass(frozen=True, eq=False)
class DiracFeynmanFilter:
    """
    The filter that keeps the whole density on a grid  [Sensors, section 4.2].

    sensors: by name; average_cells: whether a likelihood narrower than a cell is averaged over it
    instead of taken at its centre; significance: a measurement corrects only cells with more than
    this share of the densest one's density, and empties the others, 0 for all; operator: how
    the kernel becomes the operator that moves the density.
    """

    model: StateModel
    grid: Grid
    sensors: Mapping[str, Sensor]
    kernel: KernelSettings
    average_cells: bool = True
    significance: float = 0.0
    operator: OperatorSettings = OperatorSettings()
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds, and refuse what does not fit the model."""
        if self.grid.ndim != self.model.ndim:
            raise ValueError(f'grid: expected {self.model.ndim} axes, one for each state, '
                             f'got {self.grid.ndim}')
        if not 0 <= self.significance < 1:
            raise ValueError('significance: expected a share, 0 to below 1, '
                             f'got {self.significance!r}')
        if self.model.changes_with_time and self.operator != OperatorSettings():
            raise ValueError('operator: expected none of steps, file and wavelet where the model '
                             f'changes with time, got {self.operator}')
        object.__setattr__(self, 'time_step_ns', self._kernel_ns * self.operator.steps)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> GridBelief:
        """Return a Gaussian density, cut at the edges of the grid."""
        return GridBelief.gaussian(self.grid, mean, covariance)

    def uniform(self) -> GridBelief:
        """Return the density that knows nothing but the grid."""
        return GridBelief.uniform(self.grid)

    def predict(self, belief: GridBelief, from_ns: int, to_ns: int) -> GridBelief:
        """
        Return the density carried from one stamp to a later one.

        Whole steps are counted from from_ns; a remainder, a fraction a of a step, is the mixture
        (1 - a) I + a K: positive, keeps mass, exact in the mean of a constant drift, and first
        order in a otherwise.  Raises ValueError where to_ns lies before from_ns.
        """
        if to_ns < from_ns:
            raise ValueError(f'to_ns: expected a stamp from {from_ns} on, got {to_ns}')
        if to_ns == from_ns:
            return belief
        strides, left = divmod(to_ns - from_ns, self.time_step_ns)
        steps, rest = divmod(left, self._kernel_ns)
        p, t = belief.density.ravel(), from_ns
        for _ in range(strides):
            # p(x'') = sum_x' K(x'', x') p(x')  [Sensors, Eq. 26]
            p, t = self.operator_at(t) @ p, t + self.time_step_ns
        for _ in range(steps):
            p, t = self.kernel_at(t) @ p, t + self._kernel_ns
        if rest:
            a = rest / self._kernel_ns
            moved = self.kernel_at(t) @ p
            p = moved * a + p * (1 - a)
        return GridBelief(self.grid, p.reshape(self.grid.shape))

    @np.errstate(over='ignore', invalid='ignore')
    def correct(self, belief: GridBelief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[GridBelief, float]:
        """
        Return the density given a measurement y of a sensor, and log p(y | all before it).

        The evidence counts what has left the grid as lost.  Where no cell of the belief allows
        the measurement at all, the belief stays as it is and the evidence is -inf.
        """
        p = belief.density.ravel()
        cells = self._significant(p)
        if cells is not None:
            p = p[cells]
        log_l = self._likelihoods[sensor].log(np.asarray(y, dtype=float), p,
                                              at_ns / NANOSECONDS, cells)
        peak = log_l.max()
        posterior = _posterior(p, log_l, peak)
        evidence = posterior.sum()
        if not evidence > UNSAFE:
            # an outlier, or cells without a likelihood: with logs of the prior too
            log_l, peak = _log_joint(p, log_l)
            if not np.isfinite(peak):
                return belief, -np.inf
            posterior = np.exp(log_l - peak)
            evidence = posterior.sum()
        posterior /= evidence * self.grid.cell_volume
        posterior -= NEGLIGIBLE
        np.maximum(posterior, 0.0, out=posterior)
        if cells is not None:
            corrected, posterior = posterior, np.zeros(self.grid.size)
            posterior[cells] = corrected
        return (GridBelief(self.grid, posterior.reshape(self.grid.shape)),
                float(peak + np.log(evidence * self.grid.cell_volume)))

    def log_peak(self, belief: GridBelief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement that is just as the belief is sure it is."""
        return self.sensors[sensor].log_peak(at_ns / NANOSECONDS)

    def kernel_at(self, t_ns: int) -> sparse.csr_array:
        """Return the kernel of the step that starts at a stamp."""
        if not self.model.changes_with_time:
            return self._kernels(0)
        period_ns = self._period_ns
        # exactly, since a period that is rounded drifts away over many
        return self._kernels(round(t_ns % period_ns) if period_ns else t_ns)

    def operator_at(self, t_ns: int) -> Operator:
        """Return the operator of the time_step_ns that start at a stamp."""
        if self.operator.steps == 1 and not self.operator.wavelet:
            return self.kernel_at(t_ns)
        return self._whole_operator

    def describe(self) -> str:
        """Return the size of grid and kernel; the first kernel is made now."""
        cells = f'Dirac-Feynman filter on {" x ".join(map(str, self.grid.shape))} cells'
        if self.model.changes_with_time:
            return f'{cells}, a kernel for every step'
        operator, how = self.operator_at(0), self.operator
        basis = f' in the basis {how.wavelet}' if how.wavelet else ''
        steps = f' of {how.steps} steps' if how.steps > 1 else ''
        return (f'{cells}, a kernel{steps} of {operator.nnz:,} weights{basis} '
                f'({12e-6 * operator.nnz:.1f} MB)')

    def remarks(self) -> list[str]:
        """Return how the grid fits the sensors, a sentence for each that it does not fit."""
        return [remark for name, likelihood in self._likelihoods.items()
                for remark in likelihood.remarks(name)]

    def _significant(self, p: Array) -> NDArray[np.intp] | None:
        """Return the cells that a measurement corrects, None for all."""
        if not self.significance or not p.max() > 0:
            return None
        return np.flatnonzero(p > self.significance * p.max())

    @cached_property
    def _kernels(self) -> Callable[[int], sparse.csr_array]:
        # a model that changes with time comes back to the same stamps when it replays, and to
        # the same phases of its period
        phases = self._period_ns / self._kernel_ns
        most = KEPT_BYTES / (12 * stored_elements(self.model, self.grid, self.kernel))
        count = max(16, phases if phases.denominator == 1 else 0)
        return lru_cache(maxsize=max(2, int(min(count, most))))(lambda t_ns: kernel_of(
            self.model, self.grid, self.kernel, self.operator, t_ns / NANOSECONDS))

    @cached_property
    def _whole_operator(self) -> Operator:
        return operator_of(self.kernel_at(0), self.grid, self.kernel, self.operator)

    @cached_property
    def _period_ns(self) -> Fraction:
        return Fraction(self.model.period) * NANOSECONDS

    @property
    def _kernel_ns(self) -> int:
        return max(round(self.kernel.time_step * NANOSECONDS), 1)

    @cached_property
    def _likelihoods(self) -> Mapping[str, GridLikelihood]:
        return {name: GridLikelihood(self.grid, sensor, self.average_cells)
                for name, sensor in self.sensors.items()}


def _posterior(p: Array, log_l: Array, peak: float) -> Array:
    """Return p(y | x) p(x) up to the factor exp(peak)  [Sensors, Eq. 27]."""
    factor = np.subtract(log_l, peak)
    np.exp(factor, out=factor)
    factor *= p
    return factor


def _log_joint(p: Array, log_l: Array) -> tuple[Array, float]:
    """Return log p(y | x) p(x), -inf where either is not, and its maximum."""
    with np.errstate(divide='ignore'):
        log_joint = np.where(np.isnan(log_l), -np.inf, log_l) + np.log(p)
    return log_joint, float(log_joint.max())
