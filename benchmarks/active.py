"""Tracking with one per cent of the cells holding the mass: those cells, against all of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

from benchmarks.engine import numpy_alone
from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active import ActiveGridFilter, RegionSettings
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.systems import lorenz_63

Array = NDArray[np.float64]

SECOND = 1_000_000_000
WORLD, STEP, NOISE = Grid((-25, -30, 0), (25, 30, 60), (100, 100, 100)), 0.01, 4.5
#: Standard deviations of the sensor: one per cent of the cells holds the mass with the second.
MEASURED = (1.0, 8.0)
START, SPREAD, MEASUREMENTS, EVERY = np.array([1.5, -1.5, 25.0]), 4 * np.eye(3), 12, 1
ALL, SKIPPING, ACTIVE = 'all cells', 'all cells, empty ones skipped', 'active cells'


def run(effort: Effort) -> Table:
    """Return the time of predict and correct on a thousand thousand cells."""
    model = lorenz_63(sigma_x=NOISE).model
    full = DiracFeynmanFilter(model, WORLD, {}, KernelSettings(STEP, form='split'))
    rows, notes, goals = [], [], []
    for spread in MEASURED:
        more, note, goal = _tracked(full, spread, effort)
        rows += more
        notes.append(note)
        goals.append(goal)
    return Table('Tracking where the belief is', rows, [
        f'lorenz_63 with noise {NOISE:g}, all states measured every {STEP:g} s.', *notes], goals)


def _tracked(full: DiracFeynmanFilter, spread: float,
             effort: Effort) -> tuple[list[Row], str, Goal]:
    """Time the three ways with a sensor of a standard deviation."""
    system = lorenz_63(sigma_x=NOISE, sigma_y=spread)
    sensors = {'position': system.sensors['position']()}
    times = STEP * EVERY * np.arange(MEASUREMENTS + 1)
    rng = np.random.default_rng(5)
    path = simulate(system.model, START, times, rng, substeps=10)
    measured = np.array([measure(sensors['position'], x, t, rng)
                         for x, t in zip(path[1:], times[1:])])
    # two, since each keeps the kernel of its own way
    filters: dict[str, Any] = {
        ALL: replace(full, sensors=sensors), SKIPPING: full.with_sensors(sensors),
        ACTIVE: ActiveGridFilter(full.model, WORLD, sensors, STEP,
                                 region=RegionSettings(finest=0))}
    steps = {name: Steps(filter_, measured, numpy_alone if name == ALL else nullcontext)
             for name, filter_ in filters.items()}
    samples = interleave({name: Contestant(one.take, MEASUREMENTS, one.reset)
                          for name, one in steps.items()}, 1, effort.scaled(5, 1),
                         Progress(f'active: sensor {spread:g}'))
    held = int(np.count_nonzero(steps[ALL].belief.density
                                > 1e-6 * steps[ALL].belief.density.max()))
    apart = float(np.abs(steps[ALL].belief.density - steps[ACTIVE].belief.on(
        WORLD, (0, 1, 2)).density).sum() * WORLD.cell_volume)
    share = f'{held / WORLD.size:.2%}'
    rows = [Row.timed(name, f'{share} hold it', samples[name], samples[ALL], ALL,
                      {'cells kept': float(steps[ACTIVE].belief.size if name == ACTIVE
                                           else WORLD.size)})
            for name in filters]
    return rows, (f'{share} of {WORLD.size:,} cells have more than 1e-6 of the densest one where '
                  f'the sensor has a deviation of {spread:g}; the two densities are {apart:.3f} '
                  'apart in L1 in the end.'), Goal(
        f'active cells, {share} hold it, of the time of all', 1 / 20,
        ratio(samples[ACTIVE], samples[ALL]))


class Steps:
    """A filter that goes through a record, measurement by measurement."""

    def __init__(self, filter_: Any, measured: Array,
                 way: Callable[[], AbstractContextManager[Any]]) -> None:
        """Begin at the prior; way: what it is to run in."""
        self.filter, self._measured, self._way = filter_, measured, way
        with way():
            filter_.describe()
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self.belief = self.filter.gaussian(START, SPREAD)

    def take(self, k: int) -> None:
        """Predict to the k-th measurement, and correct by it."""
        period = round(STEP * EVERY * SECOND)
        now, then = k * period, (k + 1) * period
        with self._way():
            predicted = self.filter.predict(self.belief, now, then)
            self.belief, _ = self.filter.correct(predicted, self._measured[k], 'position', then)
