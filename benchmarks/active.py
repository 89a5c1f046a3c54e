"""Tracking with one per cent of the cells holding the mass: those cells, against all of them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
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
START, SPREAD, MEASUREMENTS, EVERY = np.array([1.5, -1.5, 25.0]), 4 * np.eye(3), 12, 1
ALL, SKIPPING, ACTIVE = 'all cells', 'all cells, empty ones skipped', 'active cells'


def run(effort: Effort) -> Table:
    """Return the time of predict and correct on a thousand thousand cells."""
    progress = Progress('active')
    system = lorenz_63(sigma_x=NOISE, sigma_y=1.0)
    sensors = {'position': system.sensors['position']()}
    times = STEP * EVERY * np.arange(MEASUREMENTS + 1)
    rng = np.random.default_rng(5)
    path = simulate(system.model, START, times, rng, substeps=10)
    measured = np.array([measure(sensors['position'], x, t, rng)
                         for x, t in zip(path[1:], times[1:])])
    filters: dict[str, Any] = {
        name: DiracFeynmanFilter(system.model, WORLD, sensors, KernelSettings(STEP, form='split'))
        for name in (ALL, SKIPPING)}
    filters[ACTIVE] = ActiveGridFilter(system.model, WORLD, sensors, STEP,
                                       region=RegionSettings(finest=0))
    steps = {name: Steps(filter_, measured, numpy_alone if name == ALL else nullcontext)
             for name, filter_ in filters.items()}
    samples = interleave({name: Contestant(one.take, MEASUREMENTS, one.reset)
                          for name, one in steps.items()}, 1, effort.scaled(5, 1), progress)
    held = int(np.count_nonzero(steps[ALL].belief.density
                                > 1e-6 * steps[ALL].belief.density.max()))
    apart = float(np.abs(steps[ALL].belief.density - steps[ACTIVE].belief.on(
        WORLD, (0, 1, 2)).density).sum() * WORLD.cell_volume)
    rows = [Row.timed(name, f'{WORLD.size:,} cells', samples[name], samples[ALL], ALL,
                      {'cells held': float(steps[ACTIVE].belief.size if name == ACTIVE
                                           else WORLD.size)})
            for name in filters]
    return Table('Tracking where the belief is', rows, (
        f'lorenz_63 with noise {NOISE:g}, all states measured every {STEP:g} s; '
        f'{held / WORLD.size:.2%} of the cells have more than 1e-6 of the densest one; the two '
        f'densities are {apart:.3f} apart in L1 in the end.',), (
        Goal('active cells, of the time of all', 1 / 20, ratio(samples[ACTIVE], samples[ALL])),))


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
