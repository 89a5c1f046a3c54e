"""Predict and correct: the Dirac-Feynman filter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cached_property, lru_cache, partial
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.controls import Controls, NANOSECONDS, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import (chosen_form, compile_loops, KernelSettings, ladder,
                                  longer_kernel, Operator, operator_of, OperatorSettings,
                                  SplitKernel, step_kernel, step_remarks, stored_weights, turned)
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.posterior import posterior, warm_up
from pif_ros.core.predictive import Predictive

Array = NDArray[np.float64]

#: What the kernels of a model that changes with time may take together.
KEPT_BYTES = 5e8


class Held(Protocol):
    """What is kept in memory."""

    @property
    def nbytes(self) -> int:
        """Return how many bytes it takes there."""

    @property
    def mass(self) -> float:
        """Return the probability that is left of it."""


Belief = TypeVar('Belief', bound=Held)


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

    def predict(self, belief: Belief, from_ns: int, to_ns: int,
                controls: Controls = NO_CONTROLS) -> Belief:
        """
        Return the belief carried from one stamp to a later one, in steps from the first.

        Whole steps may be taken in any number of calls: the result is the same to the bit.
        controls: what drives a model with inputs; a step in which it changes is cut there.
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


class Expecting(Filter[Belief], Protocol[Belief]):
    """A filter that can say what it expects, which one of a measured path cannot."""

    def predictive(self, belief: Belief, sensor: str, at_ns: int) -> Predictive:
        """Return what is expected of a sensor: the density of its measurement, mass 1."""

    def mixed(self, belief: Belief, other: Belief, share: float, at_ns: int) -> Belief:
        """Return (1 - share) of a belief and a share of another, both of mass 1 before."""


@dataclass(frozen=True, eq=False)
class DiracFeynmanFilter:
    """
    The filter that keeps the whole density on a grid  [Sensors, section 4.2].

    sensors: by name; average_cells: whether a likelihood narrower than a cell is averaged over it
    instead of taken at its centre; significance: a measurement corrects only cells with more than
    this share of the densest one's density, and empties the others, 0 for all; operator: how
    the kernel becomes the operator that moves the density; form: that of the kernel, as chosen.
    """

    model: StateModel
    grid: Grid
    sensors: Mapping[str, Sensor]
    kernel: KernelSettings
    average_cells: bool = True
    significance: float = 0.0
    operator: OperatorSettings = OperatorSettings()
    form: str = field(init=False)

    def __post_init__(self) -> None:
        """Choose the form of the kernel, and refuse what does not fit the model."""
        if self.grid.ndim != self.model.ndim:
            raise ValueError(f'grid: expected {self.model.ndim} axes, one for each state, '
                             f'got {self.grid.ndim}')
        if self.model.inputs:
            raise ValueError('model: expected one without inputs, whose kernel can be made '
                             f'beforehand, got the inputs {", ".join(self.model.inputs)}')
        if not 0 <= self.significance < 1:
            raise ValueError('significance: expected a share, 0 to below 1, '
                             f'got {self.significance!r}')
        if self.model.changes_with_time and self.operator != OperatorSettings():
            raise ValueError('operator: expected none of steps, file and wavelet where the model '
                             f'changes with time, got {self.operator}')
        # a kernel takes as long as the clock goes on in its step
        object.__setattr__(self, 'kernel', replace(self.kernel,
                                                   time_step=self._kernel_ns / NANOSECONDS))
        object.__setattr__(self, 'form', chosen_form(self.model, self.grid, self.kernel,
                                                     self.operator))

    def with_sensors(self, sensors: Mapping[str, Sensor]) -> DiracFeynmanFilter:
        """Return a filter with other sensors, and this one's kernels."""
        other = replace(self, sensors=sensors)
        vars(other).update(_kernels=self._kernels, _strides=self._strides)
        return other

    def shares_kernels(self, other: DiracFeynmanFilter) -> bool:
        """Return whether this filter and another have one kernel in memory."""
        return self._kernels is other._kernels

    @cached_property
    def time_step_ns(self) -> int:
        """Return the longest step that is taken, in nanoseconds."""
        return self._strides[0][0]

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> GridBelief:
        """Return a Gaussian density, cut at the edges of the grid."""
        return GridBelief.gaussian(self.grid, mean, covariance)

    def uniform(self) -> GridBelief:
        """Return the density that knows nothing but the grid."""
        return GridBelief.uniform(self.grid)

    def predict(self, belief: GridBelief, from_ns: int, to_ns: int,
                controls: Controls = NO_CONTROLS) -> GridBelief:
        """
        Return the density carried from one stamp to a later one.

        In the steps of steps().  Raises ValueError where to_ns lies before from_ns.
        """
        if to_ns < from_ns:
            raise ValueError(f'to_ns: expected a stamp from {from_ns} on, got {to_ns}')
        if to_ns == from_ns:
            return belief
        p = belief.density.ravel()
        for t, operator_at, a in self.steps(from_ns, to_ns):
            # p(x'') = sum_x' K(x'', x') p(x')  [Sensors, Eq. 26]
            moved = operator_at(t) @ p
            p = moved if a == 1 else moved * a + p * (1 - a)
        return GridBelief(self.grid, p.reshape(self.grid.shape))

    def steps(self, from_ns: int,
              to_ns: int) -> Iterator[tuple[int, Callable[[int], Operator], float]]:
        """
        Give each step of a prediction: its stamp, what gives its operator K, and a share a of it.

        The longest first, counted from from_ns; a remainder, a fraction a of a step, is the
        mixture (1 - a) I + a K: positive, keeps mass, exact in the mean of a constant drift, and
        first order in a otherwise.
        """
        t = from_ns
        for length, operator_at in self._strides:
            for _ in range((to_ns - t) // length):
                yield t, operator_at, 1.0
                t += length
        if t < to_ns:
            yield t, self.kernel_at, (to_ns - t) / self._kernel_ns

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
        log_l = self._likelihoods[sensor].terms(np.asarray(y, dtype=float), p,
                                                at_ns / NANOSECONDS, cells)
        found = posterior(p, log_l, self.grid.cell_volume)
        if found is None:
            return belief, -np.inf
        p, log_evidence = found
        if cells is not None:
            corrected, p = p, np.zeros(self.grid.size)
            p[cells] = corrected
        return GridBelief(self.grid, p.reshape(self.grid.shape)), log_evidence

    def log_peak(self, belief: GridBelief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement that is just as the belief is sure it is."""
        return self.sensors[sensor].log_peak(at_ns / NANOSECONDS)

    def predictive(self, belief: GridBelief, sensor: str, at_ns: int) -> Predictive:
        """Return what is expected of a sensor: the density of its measurement, mass 1."""
        t, seen = at_ns / NANOSECONDS, self.sensors[sensor].states
        if seen and len(seen) < self.grid.ndim:
            return Predictive.of_marginal(self.sensors[sensor], belief.marginal(seen), seen,
                                          self.grid, t, self.average_cells)
        width = self._likelihoods[sensor].widths if self.average_cells else None
        return Predictive.of_cells(self.sensors[sensor], belief.density.ravel(), self.grid.points,
                                   self.grid.spacing, t, self.average_cells, width)

    def mixed(self, belief: GridBelief, other: GridBelief, share: float,
              at_ns: int) -> GridBelief:
        """Return (1 - share) of a belief and a share of another, both of mass 1 before."""
        if not belief.mass > 0:
            return other
        return GridBelief(self.grid, belief.density * ((1 - share) / belief.mass)
                          + other.density * (share / other.mass))

    def kernel_at(self, t_ns: int) -> Operator:
        """Return the kernel of the step that starts at a stamp; split, it alternates its order."""
        phase = 0
        if self.model.changes_with_time:
            # exactly, since a period that is rounded drifts away over many
            phase = round(t_ns % self._period_ns) if self._period_ns else t_ns
        return turned(self._kernels(phase), self._kernel_ns, t_ns)

    def operator_at(self, t_ns: int) -> Operator:
        """Return the operator of the time_step_ns that start at a stamp."""
        return self._strides[0][1](t_ns)

    def describe(self) -> str:
        """Return the size of grid and kernel; the first kernel is made now, and loops compiled."""
        warm_up()
        if self.form == 'split':
            compile_loops(self.kernel.dtype.itemsize)
        cells = f'Dirac-Feynman filter on {" x ".join(map(str, self.grid.shape))} cells'
        if self.model.changes_with_time:
            return f'{cells}, a kernel for every step'
        operator, how = self.operator_at(0), self.operator
        basis = f' in the basis {how.wavelet}' if how.wavelet else ''
        count = self.time_step_ns // self._kernel_ns
        steps = f' of {count} steps' if count > 1 else ''
        split = ' split by axis,' if self.form == 'split' else ''
        size = operator.nbytes if isinstance(operator, SplitKernel) else 12 * operator.nnz
        return (f'{cells}, a kernel{steps}{split} of {operator.nnz:,} weights{basis} '
                f'({1e-6 * size:.1f} MB)')

    def remarks(self) -> list[str]:
        """Return how the grid fits step and sensors, a sentence for each that it does not fit."""
        split = self._kernels(0) if self.form == 'split' else None
        return step_remarks(self.model, self.grid, self.kernel, split) + [
            remark for name, likelihood in self._likelihoods.items()
            for remark in likelihood.remarks(name)]

    def _significant(self, p: Array) -> NDArray[np.intp] | None:
        """Return the cells that a measurement corrects, None for all."""
        if not self.significance or not p.max() > 0:
            return None
        return np.flatnonzero(p > self.significance * p.max())

    @cached_property
    def _strides(self) -> Sequence[tuple[int, Callable[[int], Operator]]]:
        """Return lengths of steps in nanoseconds, the longest first, with what gives operators."""
        single = [(self._kernel_ns, self.kernel_at)]
        if self.operator.steps > 1 or self.operator.wavelet:
            whole = self._kernel_ns * self.operator.steps
            return [(whole, lambda t_ns: self._whole_operator), *single]
        if not self.kernel.macro_error:
            return single
        rungs = ladder(lambda seconds: longer_kernel(
            self.model, self.grid, replace(self.kernel, time_step=seconds), self.form),
            self._kernels(0), self.grid, self.kernel.time_step, self.kernel.macro_error)
        return [(self._kernel_ns << j, partial(turned, rung, self._kernel_ns << j))
                for j, rung in enumerate(rungs)][::-1]

    @cached_property
    def _kernels(self) -> Callable[[int], Operator]:
        # a model that changes with time comes back to the same stamps when it replays, and to
        # the same phases of its period
        phases = self._period_ns / self._kernel_ns
        most = KEPT_BYTES / (12 * stored_weights(self.model, self.grid, self.kernel, self.form))
        count = max(16, phases if phases.denominator == 1 else 0)
        return lru_cache(maxsize=max(2, int(min(count, most))))(
            lambda t_ns: step_kernel(self.model, self.grid, self.kernel, self.operator, self.form,
                                     t_ns / NANOSECONDS))

    @cached_property
    def _whole_operator(self) -> Operator:
        return operator_of(self._kernels(0), self.grid, self.kernel, self.operator)

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
