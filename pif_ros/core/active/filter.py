"""Predict and correct, where the belief is and nowhere else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.active.belief import ActiveBelief, Patch, seen_cells
from pif_ros.core.active.compiled import warm_up
from pif_ros.core.active.flow import flow, parting_rate
from pif_ros.core.active.focus import fitted, focused, loosened
from pif_ros.core.active.measured import corrected
from pif_ros.core.active.parting import MOST, moved_on_finer, parting
from pif_ros.core.active.priors import around, is_gaussian
from pif_ros.core.active.regions import thick
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.transport import Mask, Moves, Noise, SPREAD
from pif_ros.core.active.window import Window, wrapped
from pif_ros.core.belief import GridBelief
from pif_ros.core.controls import Controls, NANOSECONDS, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.predictive import Predictive

Array = NDArray[np.float64]

#: By what share of a cell neighbouring cells may part or meet in a step that has noise: half of it
#: comes before and half after the drift, which is of second order in this.
PARTED = 0.5
#: How often they may in any step: the many short ones that it is cut into would take for ever.
STIFFEST = 5e4
#: A patch whose neighbours part so many times less than those of another takes steps of its own:
#: in too short ones thin noise is widened by the lattice.
ALIKE = 8
#: Cells along an axis that correlated noise goes at once, at most.
LONGEST = 32
#: Times of a period, or of a day, at which noise that is a function of time is looked at.
LOOKS, WHILE = 7, (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 86400.0)


@dataclass(frozen=True, eq=False)
class ActiveGridFilter:
    """
    The filter that keeps the whole density, but only where there is some.

    grid: the world, and its widest cells, never all of them made; time_step:
    seconds of the longest step, which is shorter where neighbouring cells part; average_cells:
    whether a likelihood narrower than a cell is averaged over it; region: which cells are kept.
    Raises ValueError for a model whose noise depends on the state, or is correlated among more
    than three states at some times that are looked at; predict does so at all others.
    """

    model: StateModel
    grid: Grid
    sensors: Mapping[str, Sensor]
    time_step: float
    average_cells: bool = True
    region: RegionSettings = RegionSettings()
    time_step_ns: int = field(init=False)

    def __post_init__(self) -> None:
        """Hold the step in whole nanoseconds, and refuse what does not fit the model."""
        if self.grid.ndim != self.model.ndim:
            raise ValueError(f'grid: expected {self.model.ndim} axes, one for each state, '
                             f'got {self.grid.ndim}')
        if not 0 < self.time_step < np.inf:
            raise ValueError('time_step: expected a positive number of seconds, '
                             f'got {self.time_step!r}')
        refused = unsuited(self.model)
        if refused:
            raise ValueError(f'region: {refused}')
        object.__setattr__(self, 'time_step_ns', max(round(self.time_step * NANOSECONDS), 1))

    def cells_of(self, mean: ArrayLike, covariance: ArrayLike) -> int:
        """Return how many cells a Gaussian density is made on, 0 where there is none."""
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        return (around(self.grid, mean, covariance, self.region).size
                if is_gaussian(self.grid, mean, covariance) else 0)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> ActiveBelief:
        """Return a Gaussian density, cut at the edges of the world."""
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        window = around(self.grid, mean, covariance, self.region)
        # a window may begin below the upper edge of a circle, and go on beyond it
        low, turn = np.array(window.grid.lower), np.subtract(self.grid.upper, self.grid.lower)
        if mean.shape == low.shape:
            mean = np.where(self.grid.periodic, low + (mean - low) % turn, mean)
        belief = GridBelief.gaussian(window.grid, mean, covariance)
        return fitted(ActiveBelief(self.grid, (Patch(window, belief.density),)), self.region)

    def uniform(self) -> ActiveBelief:
        """Return the density that knows nothing but the world; it has all of its cells."""
        density = GridBelief.uniform(self.grid).density
        return ActiveBelief(self.grid, (Patch(Window.whole(self.grid), density),))

    def predict(self, belief: ActiveBelief, from_ns: int, to_ns: int,
                controls: Controls = NO_CONTROLS) -> ActiveBelief:
        """
        Return the density carried from one stamp to a later one.

        Whole steps are counted from from_ns; a remainder is a shorter step.  Raises ValueError
        where to_ns lies before from_ns, and for a drift that is too stiff to be followed.
        """
        if to_ns < from_ns:
            raise ValueError(f'to_ns: expected a stamp from {from_ns} on, got {to_ns}')
        for start_ns in range(from_ns, to_ns, self.time_step_ns):
            belief = self._carried(belief, start_ns, min(start_ns + self.time_step_ns, to_ns),
                                   controls)
        return belief

    def correct(self, belief: ActiveBelief, y: ArrayLike, sensor: str,
                at_ns: int) -> tuple[ActiveBelief, float]:
        """
        Return the density given a measurement y of a sensor, and log p(y | all before it).

        Where the cells are too wide for what it leaves, they are halved before it and it is used
        anew.  The evidence counts what has left the world as lost.  Where no cell of the belief
        allows the measurement at all, the belief stays as it is and the evidence is -inf.
        """
        measured = (np.asarray(y, dtype=float), self.sensors[sensor], at_ns / NANOSECONDS,
                    self.average_cells)
        prior, (posterior, log_evidence) = belief, corrected(belief, *measured)
        if log_evidence == -np.inf:
            return belief, log_evidence
        for _ in range(self.region.finest):
            finer = focused(prior, posterior, self.region)
            if finer is None:
                break
            anew, log_anew = corrected(finer, *measured)
            if log_anew == -np.inf:
                # what wide cells allowed is seen between the centres of finer ones
                break
            prior, posterior, log_evidence = finer, anew, log_anew
        return fitted(posterior, self.region), log_evidence

    def log_peak(self, belief: ActiveBelief, sensor: str, at_ns: int) -> float:
        """Return the log evidence of a measurement that is just as the belief is sure it is."""
        return self.sensors[sensor].log_peak(at_ns / NANOSECONDS)

    def predictive(self, belief: ActiveBelief, sensor: str, at_ns: int) -> Predictive:
        """Return what is expected of a sensor: the density of its measurement, mass 1."""
        seen = self.sensors[sensor].states
        parts = [seen_cells(patch, seen) for patch in belief.patches]
        if not parts:
            return Predictive.of_points(self.sensors[sensor], np.zeros(0),
                                        np.zeros((self.grid.ndim, 0)), at_ns / NANOSECONDS)
        w, x, spacing = (np.concatenate(each, axis=-1) for each in zip(*parts))
        return Predictive.of_cells(self.sensors[sensor], w, x, spacing, at_ns / NANOSECONDS,
                                   self.average_cells)

    def mixed(self, belief: ActiveBelief, other: ActiveBelief, share: float,
              at_ns: int) -> ActiveBelief:
        """Return (1 - share) of a belief and a share of another, both of mass 1 before."""
        if not belief.mass > 0:
            return other
        parts = ((belief, (1 - share) / belief.mass), (other, share / other.mass))
        return fitted(ActiveBelief(self.grid, tuple(
            Patch(patch.window, patch.density * scale)
            for each, scale in parts for patch in each.patches)), self.region)

    def describe(self) -> str:
        """Return what the world is like, in a line; what is compiled is compiled now."""
        warm_up()
        return (f'Dirac-Feynman filter on the active ones of '
                f'{" x ".join(map(str, self.grid.shape))} cells, each axis of which is halved up '
                f'to {self.region.finest} times where the belief is narrow')

    def remarks(self) -> list[str]:
        """Return nothing: the cells adapt."""
        return []

    def _carried(self, belief: ActiveBelief, from_ns: int, to_ns: int,
                 controls: Controls) -> ActiveBelief:
        """Return a belief after the time of a step, in as few as its noise and its drift allow."""
        rates = [parting_rate(self.model, patch.window, from_ns, to_ns, controls)
                 for patch in belief.patches]
        noise = self._noise(from_ns, to_ns)
        thin = all(_is_thin(*noise(patch.window)) for patch in belief.patches)
        seconds, rate = (to_ns - from_ns) / NANOSECONDS, max(rates, default=0.0)
        if seconds * rate > STIFFEST:
            raise ValueError(f'drift: expected neighbouring cells to part at most {STIFFEST:g} '
                             f'times in a step of {seconds:g} s, got {seconds * rate:.2g} times: '
                             'take a shorter step, or a world without such places')
        counts = [1 if thin else max(1, int(np.ceil(seconds * each / PARTED))) for each in rates]
        count = max(counts, default=1)
        slow = [ALIKE * each < count for each in counts]
        if any(slow):
            return _joined(belief, slow,
                           lambda part: self._carried(part, from_ns, to_ns, controls))
        ends = [from_ns + (to_ns - from_ns) * k // count for k in range(count + 1)]
        region = self.region.shared(count)
        for start_ns, end_ns in zip(ends, ends[1:]):
            belief = self._stepped(belief, start_ns, end_ns, controls, rate, thin, region)
        return belief

    def _stepped(self, belief: ActiveBelief, from_ns: int, to_ns: int, controls: Controls,
                 rate: float, thin: bool, region: RegionSettings) -> ActiveBelief:
        """Return a belief after a step, or after two of half its length where it falls apart."""
        moves, noise = self._moves(from_ns, to_ns, controls, rate), self._noise(from_ns, to_ns)
        halvings = [parting(patch, moves) if thin else None for patch in belief.patches]
        middle_ns = (from_ns + to_ns) // 2
        if any(often is not None and often.max() > MOST for often in halvings) \
                and from_ns < middle_ns:
            half = region.shared(2)
            first = self._stepped(belief, from_ns, middle_ns, controls, rate, thin, half)
            return self._stepped(first, middle_ns, to_ns, controls, rate, thin, half)
        variance = self._variance(from_ns, to_ns)
        patches = [moved_on_finer(loosened(patch, variance, region), moves, noise, often)
                   for patch, often in zip(belief.patches, halvings)]
        dropped = belief.dropped + max(belief.mass - sum(patch.mass for patch in patches), 0.0)
        inside = [_in_the_world(patch) for patch in patches]
        return fitted(ActiveBelief(belief.base, tuple(p for p in inside if p is not None),
                                   dropped), region)

    def _variance(self, from_ns: int, to_ns: int) -> Array:
        """Return the covariance of the noise in a step, eps g  [TM, Eq. 93], (n, n)."""
        return ((to_ns - from_ns) / NANOSECONDS
                * self.model.diffusion((from_ns + to_ns) / 2 / NANOSECONDS))

    def _noise(self, from_ns: int, to_ns: int) -> Noise:
        """Return what tells the variance of the noise in a step in cells."""
        variance = self._variance(from_ns, to_ns)
        return lambda window: integer_directions(
            variance / np.outer(window.spacing, window.spacing), LONGEST)

    def _moves(self, from_ns: int, to_ns: int, controls: Controls, rate: float) -> Moves:
        """Return what tells how far the drift moves the cells of a window in a step."""
        alike = tuple(self.model.homogeneous)

        def moves(window: Window, held: Mask) -> Array:
            axes = [axis.mean(keepdims=True) if i in alike else axis
                    for i, axis in enumerate(window.grid.axes)]
            x = np.stack(np.meshgrid(*axes, indexing='ij'))
            places = np.flatnonzero(held.any(axis=alike, keepdims=True))
            start = wrapped(self.grid, np.take(x.reshape(len(x), -1), places, axis=1))
            cells = np.zeros_like(x)
            end = flow(self.model, window, start, from_ns, to_ns, controls, rate)
            for along, far, width in zip(cells, end - start, window.spacing):
                along.reshape(-1)[places] = far / width
            return cells
        return moves


def unsuited(model: StateModel) -> str:
    """Return why a model cannot be kept where it is alone, '' where it can."""
    if model.multiplicative:
        return ("expected 'full' where the noise depends on the state, got a vielbein that is a "
                'function of it')
    found = [model.diffusion(t) for t in _times(model)]
    try:
        for g in found:
            integer_directions(g, LONGEST)
    except ValueError as error:
        return f"expected 'full' for this {error}"
    return ''


def _times(model: StateModel) -> Sequence[float]:
    """Return some times at which the noise of a model may differ, in seconds."""
    if not callable(model.vielbein) and not callable(model.noise_covariance):
        return (0.0,)
    return [model.period * k / LOOKS for k in range(LOOKS)] if model.period else WHILE


def _joined(belief: ActiveBelief, chosen: Sequence[bool],
            carried: Callable[[ActiveBelief], ActiveBelief]) -> ActiveBelief:
    """Return a belief of which the patches that are chosen, and all others, have been carried."""
    patches: list[Patch] = []
    dropped = belief.dropped
    for side in (True, False):
        part = ActiveBelief(belief.base, tuple(
            patch for patch, mine in zip(belief.patches, chosen) if mine is side))
        end = carried(part)
        patches += end.patches
        dropped += end.dropped * part.mass / belief.mass
    return ActiveBelief(belief.base, tuple(patches), dropped)


def _is_thin(variance: Array, across: Sequence[tuple[float, tuple[int, ...]]]) -> bool:
    """Return whether the noise of a step is less than what sharing a place spreads."""
    return bool(np.all(variance <= SPREAD)) and all(strength <= SPREAD for strength, _ in across)


def _in_the_world(patch: Patch) -> Patch | None:
    """Return what of a patch has not left the world, None where nothing has stayed."""
    window, box, first = patch.window, [], []
    for offset, count, cells, round_ in zip(window.offset, window.shape, window.cells,
                                            window.base.periodic):
        low, high = (0, count) if round_ else (max(-offset, 0), min(count, cells - offset))
        if high - low < 1:
            return None
        box.append(slice(low, high))
        first.append(offset + low)
    return thick(window, first, patch.density[tuple(box)])
