"""The Dirac-Feynman-Yau filter: the whole density, given a measured path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous.increments import Increments
from pif_ros.core.continuous.path import correct_by_path, path_log_peak, PathBelief
from pif_ros.core.continuous.splitting import Splitting, Symmetric
from pif_ros.core.continuous.yau import YauSteps
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor, StateModel

Array = NDArray[np.float64]

#: How the path's increment and the state's steps are put together; see DiracFeynmanYauFilter.
SCHEMES = ('symmetric', 'splitting', 'post', 'pre', 'pre_printed')


@dataclass(frozen=True, eq=False)
class DiracFeynmanYauFilter:
    """
    The filter that keeps the whole density on a grid while a path is measured  [PMC, section 6].

    sensors: the one whose path it is; average_cells: as of DiracFeynmanFilter, for the first two
    schemes.  From one stamp of the path to the next, eps seconds and dy later, by scheme:

    symmetric: half of the increment's likelihood, N(dy; h eps, C eps)^(1/2), the state's
    Dirac-Feynman steps, the other half; the most accurate;
    splitting: the state's steps, then all of it;
    post: exp(h^T C^-1 dy), then the Yau equation's steps: the post-measurement form;
    pre: the Yau equation's steps, then exp(h^T C^-1 dy): the pre-measurement form, read once it
    has the increment that it starts the next step with;
    pre_printed: the same read before that, so that what is believed lacks the last increment.
    """

    model: StateModel
    grid: Grid
    sensors: Mapping[str, Sensor]
    kernel: KernelSettings
    scheme: str = 'symmetric'
    average_cells: bool = True
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Refuse all but one sensor, an unknown scheme, and a grid that does not fit the model."""
        Increments.of_the_only(self.sensors)
        if self.scheme not in SCHEMES:
            raise ValueError(f'scheme: expected one of {", ".join(SCHEMES)}, got {self.scheme!r}')
        object.__setattr__(self, 'time_step_ns', self._state.time_step_ns)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> PathBelief[GridBelief]:
        """Return a Gaussian before the first stamp of the path; ValueError where it is none."""
        return PathBelief.before_the_path(GridBelief.gaussian(self.grid, mean, covariance))

    def uniform(self) -> PathBelief[GridBelief]:
        """Return the belief that knows nothing but the box, before the first stamp of the path."""
        return PathBelief.before_the_path(GridBelief.uniform(self.grid))

    def predict(self, belief: PathBelief[GridBelief], from_ns: int,
                to_ns: int, controls: Controls = NO_CONTROLS) -> PathBelief[GridBelief]:
        """
        Return what is believed of a later stamp as long as the path is not known further.

        In steps as of DiracFeynmanFilter.  Raises ValueError where to_ns lies before from_ns.
        """
        return belief.forecast(self._state.predict(belief.now, from_ns, to_ns))

    def correct(self, belief: PathBelief[GridBelief], y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[PathBelief[GridBelief], float]:
        """
        Return the belief given the path's values y (m,) at a stamp, and log p(dy | all before).

        The steps since the path's last stamp are taken anew, so that a forecast in between leaves
        no trace.  For values that make no increment see correct_by_path.
        """
        return correct_by_path(belief, y, self.sensors[sensor], at_ns, self._advanced)

    def log_peak(self, belief: PathBelief[GridBelief], sensor: str, at_ns: int) -> float:
        """Return the log evidence of an increment just as the belief is sure it is."""
        return path_log_peak(belief, self.sensors[sensor], at_ns)

    def describe(self) -> str:
        """Return the scheme and the size of grid and kernel; what can be is made now."""
        if isinstance(self._scheme, YauSteps) and not self.model.changes_with_time:
            self._scheme.step(0)
        return f'{self.scheme} scheme for a measured path, {self._state.describe()}'

    def remarks(self) -> list[str]:
        """Return how the grid fits the increments of a step, a sentence where it does not."""
        average = self.average_cells and not isinstance(self._scheme, YauSteps)
        return [remark for name, sensor in self.sensors.items() for remark in GridLikelihood(
            self.grid, Increments(sensor).sensor(self.time_step_ns), average).remarks(name)]

    def _advanced(self, anchor: GridBelief, dy: Array, from_ns: int,
                  to_ns: int) -> tuple[GridBelief, GridBelief, float]:
        belief, log_evidence = self._scheme.advance(anchor, dy, from_ns, to_ns)
        if self.scheme == 'pre_printed':
            before, _ = self._scheme.advance(anchor, np.zeros_like(dy), from_ns, to_ns)
            return before, belief, log_evidence
        return belief, belief, log_evidence

    @cached_property
    def _state(self) -> DiracFeynmanFilter:
        return DiracFeynmanFilter(self.model, self.grid, {}, self.kernel,
                                  average_cells=self.average_cells)

    @cached_property
    def _scheme(self) -> Symmetric | Splitting | YauSteps:
        increments = Increments.of_the_only(self.sensors)
        if self.scheme == 'symmetric':
            return Symmetric(self._state, increments)
        if self.scheme == 'splitting':
            return Splitting(self._state, increments)
        # with the step that the state's filter has made of the settings'
        return YauSteps(self.model, self.grid, self._state.kernel, increments,
                        first=self.scheme == 'post')
