"""Transition densities: the formulas and the filter against simulation and Fokker-Planck."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter, NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, log_transition_density
from pif_ros.core.models import StateModel
from pif_ros.core.simulation import simulate
from pif_ros.reproduction.fokker_planck import fokker_planck, point
from pif_ros.reproduction.study import Entry, Expected, Outcome

Array = NDArray[np.float64]

#: Euler steps of a simulated path.
SUBSTEPS = 50

L1 = 'L1'
SIMULATION = 'L1 to simulation'
MASS = 'mass'


@dataclass(frozen=True)
class Setting:
    """
    A way to a transition density, and its line in the table.

    filtered: by the filter's prediction on the grid, whose columns are normalised, instead of by
    the formula composed as it is printed.
    """

    role: str
    r: float
    jacobian: str
    steps: int
    filtered: bool = False

    def entry(self, seconds: float) -> Entry:
        """Return the line of the table for so many seconds."""
        return Entry(self.name, self.role, f'steps of {seconds / self.steps:g} s')

    @property
    def name(self) -> str:
        """Return what it is called."""
        how = {'exponential': 'exp(-r eps div f)', 'determinant': 'det(1 - r eps df/dx)'}
        jacobian = '' if self.r == 0 else f', {how[self.jacobian]}'
        count = 'one step' if self.steps == 1 else f'{self.steps} steps'
        return f'{"filter" if self.filtered else "formula"}, r = {self.r:g}{jacobian}, {count}'


#: Returns the density of a model on a grid so many seconds after each of some points, (S, size).
Reference = Callable[[StateModel, Grid, Sequence[float], float], Array]


def converged(model: StateModel, grid: Grid, starts: Sequence[float], seconds: float) -> Array:
    """Return the solution of the Fokker-Planck equation, extrapolated from two grids."""
    fine = Grid(grid.lower, grid.upper, (2 * grid.size,))
    p = fokker_planck(model, fine, starts, seconds).reshape(len(starts), grid.size, 2).mean(axis=2)
    # the error is of second order in the cell
    return (4 * p - fokker_planck(model, grid, starts, seconds)) / 3


@dataclass(frozen=True, eq=False)
class Densities:
    """
    What the pictures of a transition case show.

    bins: grid of the histograms; simulated: (S, bins.size); by_entry: on grid, (S, grid.size);
    truth: which entry that is.
    """

    starts: Sequence[float]
    grid: Grid
    bins: Grid
    simulated: Array
    by_entry: Mapping[str, Array]
    truth: str


@dataclass(frozen=True, eq=False)
class TransitionCase:
    """
    Where a scalar process is some seconds after it was at each of some points.

    grid: of the formulas, whose number of cells is a multiple of bins, the cells of the histogram
    of so many simulated paths; truth: what they are held against, and how it is called.
    """

    name: str
    title: str
    printed: str
    model: StateModel
    starts: Sequence[float]
    seconds: float
    grid: Grid
    bins: int
    paths: int
    settings: Sequence[Setting]
    truth: tuple[str, Reference] = ('Fokker-Planck equation', converged)
    expected: Sequence[Expected] = ()
    remarks: Sequence[str] = ()
    median: bool = False
    covered: str = ''

    @property
    def entries(self) -> Sequence[Entry]:
        """Return the lines of the table."""
        return (*(setting.entry(self.seconds) for setting in self.settings),
                Entry(self.truth[0], 'optimum', ''))

    def run(self, seed: int, keep: bool) -> Outcome:
        """Return the distances to the reference and to the histogram of this seed's paths."""
        bins = Grid(self.grid.lower, self.grid.upper, (self.bins,))
        simulated = self._simulated(np.random.default_rng(seed), bins)
        scores = {name: self._scores(p, simulated, bins) for name, p in self._densities.items()}
        return Outcome(scores, Densities(self.starts, self.grid, bins, simulated,
                                         self._densities, self.truth[0]) if keep else None)

    def _scores(self, p: Array, simulated: Array, bins: Grid) -> dict[str, float]:
        dx, reference = self.grid.cell_volume, self._densities[self.truth[0]]
        binned = p.reshape(len(p), self.bins, -1).mean(axis=2)
        masses = p.sum(axis=1) * dx
        l1 = np.abs(p - reference).sum(axis=1) * dx
        apart = np.abs(binned - simulated).sum(axis=1) * bins.cell_volume
        return {L1: float(l1.mean()), **{l1_from(x): float(d) for x, d in zip(self.starts, l1)},
                SIMULATION: float(apart.mean()),
                MASS: float(masses[np.argmax(np.abs(masses - 1))])}

    def _simulated(self, rng: np.random.Generator, bins: Grid) -> Array:
        x0 = np.repeat(np.array(self.starts), self.paths)[None]
        x = simulate(self.model, x0, np.array([0.0, self.seconds]), rng, SUBSTEPS)[-1]
        counts = [np.histogram(ends, self.bins, (bins.lower[0], bins.upper[0]))[0]
                  for ends in x.reshape(len(self.starts), -1)]
        return np.array(counts) / (self.paths * bins.cell_volume)

    @cached_property
    def _densities(self) -> Mapping[str, Array]:
        """Return the densities on the grid by entry, (S, grid.size); they hold for all seeds."""
        name, truth = self.truth
        found = {setting.name: (self._predicted if setting.filtered else self._composed)(setting)
                 for setting in self.settings}
        return {**found, name: truth(self.model, self.grid, self.starts, self.seconds)}

    def _composed(self, setting: Setting) -> Array:
        """Return the formula's density composed with itself by quadrature  [TM, Eq. 9]."""
        kernel = KernelSettings(self.seconds / setting.steps, setting.r, setting.jacobian)
        x, starts = self.grid.points, np.array([self.starts])
        p = np.exp(log_transition_density(self.model, x[:, None], starts[..., None], kernel))
        if setting.steps > 1:
            step = np.exp(log_transition_density(self.model, x[:, None], x[..., None], kernel))
            for _ in range(setting.steps - 1):
                p = p @ step * self.grid.cell_volume
        return p

    def _predicted(self, setting: Setting) -> Array:
        """Return the density that the filter predicts."""
        filter_ = DiracFeynmanFilter(self.model, self.grid, {}, KernelSettings(
            self.seconds / setting.steps, setting.r, setting.jacobian))
        end = round(self.seconds * NANOSECONDS)
        return np.stack([filter_.predict(GridBelief(self.grid, point(self.grid, x)), 0,
                                         end).density for x in self.starts])


def l1_from(x: float) -> str:
    """Return the name of the score of a starting point."""
    return f"L1, x' = {x:g}"
