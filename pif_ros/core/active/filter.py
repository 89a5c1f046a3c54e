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
from pif_ros.core.active.parting import MOST, moved_on_finer, parting
from pif_ros.core.active.regions import thick
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.transport import Mask, Moves, Noise, SPREAD
from pif_ros.core.active.window import RolledGrid, Window, wrapped
from pif_ros.core.belief import GridBelief
from pif_ros.core.controls import Controls, NANOSECONDS, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.predictive import Predictive

Array = NDArray[np.float64]

#: By what share of a cell neighbouring cells may part or meet in a step that has noise: half of it
#: comes before and half after the drift, which is of second order in this.
PARTED = 0.5
#: A patch whose neighbours part so many times less than those of another takes steps of its own:
#: in too short ones thin noise is widened by the lattice.
ALIKE = 8
#: Cells along an axis that correlated noise goes at once, at most.
LONGEST = 32
#: A product below this share of the largest likelihood may have lost digits to underflow.
UNSAFE = 1e-200
#: Within how many standard deviations a Gaussian prior is kept.
AROUND = 6.0
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
        return (_around(self.grid, mean, covariance, self.region).size
                if _is_gaussian(self.grid, mean, covariance) else 0)

    def gaussian(self, mean: ArrayLike, covariance: ArrayLike) -> ActiveBelief:
        """Return a Gaussian density, cut at the edges of the world."""
        mean, covariance = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
        window = _around(self.grid, mean, covariance, self.region)
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
        where to_ns lies before from_ns.
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
        y, t, prior = np.asarray(y, dtype=float), at_ns / NANOSECONDS, belief
        posterior, log_evidence = self._corrected(prior, y, sensor, t)
        if log_evidence == -np.inf:
            return belief, log_evidence
        for _ in range(self.region.finest):
            finer = focused(prior, posterior, self.region)
            if finer is None:
                break
            anew, log_anew = self._corrected(finer, y, sensor, t)
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

    def _corrected(self, belief: ActiveBelief, y: Array, sensor: str,
                   t: float) -> tuple[ActiveBelief, float]:
        """Return p(y | x) p(x) / p(y) cell by cell, and log p(y)  [Sensors, Eq. 27]."""
        log_l = [self._log_likelihood(patch, y, sensor, t) for patch in belief.patches]
        p = [patch.density for patch in belief.patches]
        joint, peak = _product(p, log_l)
        if peak == -np.inf:
            return belief, -np.inf
        evidence = sum(float(q.sum() * patch.window.spacing.prod())
                       for q, patch in zip(joint, belief.patches))
        patches = tuple(Patch(patch.window, q / evidence)
                        for q, patch in zip(joint, belief.patches))
        return ActiveBelief(belief.base, patches), peak + float(np.log(evidence))

    @np.errstate(all='ignore')
    def _log_likelihood(self, patch: Patch, y: Array, sensor: str, t: float) -> Array:
        """Return log p(y | x), a shape that broadcasts to the patch's; -inf where undefined."""
        seen, grid, p = self.sensors[sensor].states, patch.window.grid, patch.density
        unseen = tuple(i for i in range(grid.ndim) if seen is not None and i not in seen)
        if unseen:
            # two cells stand for all of an axis that the sensor does not see
            shape = tuple(2 if i in unseen else count for i, count in enumerate(grid.shape))
            grid = Grid(grid.lower, grid.upper, shape, grid.periodic)
            p = np.broadcast_to(p.max(axis=unseen, keepdims=True), shape)
        grid = RolledGrid.of(grid, self.grid)
        likelihood = GridLikelihood(grid, self.sensors[sensor], self.average_cells, once=True)
        log_l = likelihood.log(y, p.ravel(), t).reshape(grid.shape)
        one = tuple(slice(0, 1) if i in unseen else slice(None) for i in range(grid.ndim))
        return np.where(np.isnan(log_l[one]), -np.inf, log_l[one])


@np.errstate(all='ignore')
def _product(p: Sequence[Array], log_l: Sequence[Array]) -> tuple[list[Array], float]:
    """Return p exp(log_l - peak), and the peak; with logs of p too where it would underflow."""
    peak = max((float(part.max()) for part in log_l), default=-np.inf)
    if np.isfinite(peak):
        joint = [density * np.exp(part - peak) for density, part in zip(p, log_l)]
        if sum(float(q.sum()) for q in joint) > UNSAFE:
            return joint, peak
    log_joint = [np.log(density) + part for density, part in zip(p, log_l)]
    peak = max((float(part.max()) for part in log_joint), default=-np.inf)
    return [np.exp(part - peak) for part in log_joint], peak


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


def _is_gaussian(grid: Grid, mean: Array, covariance: Array) -> bool:
    """Return whether a mean on the grid and a covariance make a Gaussian."""
    return bool(mean.shape == (grid.ndim,) and covariance.shape == (grid.ndim, grid.ndim)
                and np.all(np.isfinite(mean)) and np.all(grid.contains(mean))
                and np.all(np.isfinite(covariance))
                and np.all(np.linalg.eigvalsh(covariance) > 0))


def _around(grid: Grid, mean: Array, covariance: Array, region: RegionSettings) -> Window:
    """Return cells that hold a Gaussian, and are as fine as it needs; all where it is none."""
    if not _is_gaussian(grid, mean, covariance):
        return Window.whole(grid)
    # the width given all other states, as features are measured
    narrow = 1 / np.sqrt(np.diag(np.linalg.inv(covariance)))
    level = np.clip(np.ceil(np.log2(region.resolution * grid.spacing / narrow)), 0, region.finest)
    while True:
        window = _box_around(grid, mean, np.sqrt(np.diag(covariance)), level.astype(int))
        if window.size <= grid.size or not level.any():
            return window
        level[np.argmax(level)] -= 1


def _box_around(grid: Grid, mean: Array, spread: Array, level: NDArray[np.int64]) -> Window:
    """Return the cells of a level within some standard deviations of a point."""
    width, shape = grid.spacing / np.exp2(level), np.array(grid.shape) << level
    reach = AROUND * spread + 2 * width
    first = np.floor((mean - reach - grid.lower) / width)
    last = np.ceil((mean + reach - grid.lower) / width)
    circle = np.array(grid.periodic)
    first = np.where(circle, first, np.clip(first, 0, shape - 2))
    last = np.where(circle, last, np.clip(last, first + 2, shape))
    return Window.of(grid, level, first, last - first)


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
