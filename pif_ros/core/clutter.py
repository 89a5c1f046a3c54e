"""What a source says of anything but the state: the density of measurements that are clutter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor

Array = NDArray[np.float64]

#: Cells at most, out of all of the grid's, at which a sensor's span is looked for; and those
#: where that is to be done at every measurement.
LOOKED_AT, LOOKED_AT_AGAIN = 1 << 20, 1 << 12


@dataclass(frozen=True)
class Clutter:
    """
    Independent Gaussians, so wide that they are all but flat over all that a sensor can say.

    centre, width: middle and length of what it says from all over the grid, its noise included,
    (m,) each: the mean and the standard deviation.  Unlike a uniform density it ends nowhere, so
    that what no state explains is clutter, however far out; over the span it falls by an eighth in
    the logarithm.  A width of inf is an angle's: 1 / (2 pi).
    """

    centre: tuple[float, ...]
    width: tuple[float, ...]

    @classmethod
    @np.errstate(all='ignore')
    def spanning(cls, sensor: Sensor, grid: Grid, t: float = 0.0,
                 most: int = LOOKED_AT) -> Clutter:
        """Return that of a sensor on a grid; ValueError where it says nothing there."""
        h = np.asarray(sensor.function(_coarsened(grid, sensor.states, most), t), dtype=float)
        h = np.where(np.isfinite(h), h, np.nan)
        if np.isnan(h).all(axis=1).any():
            raise ValueError('sensor: expected one that says something on the grid, got one that '
                             'is undefined on all of it')
        low, high = np.nanmin(h, axis=1), np.nanmax(h, axis=1)
        width = high - low + 6 * np.sqrt(sensor.noise(t).diagonal())
        width[np.flatnonzero(sensor.angular)] = np.inf
        return cls(tuple(((low + high) / 2).tolist()), tuple(width.tolist()))

    def at(self, t: float) -> Clutter:
        """Return that at a time: the same."""
        return self

    @np.errstate(over='ignore')
    def log_density(self, y: ArrayLike) -> float:
        """Return the log density of a measurement (m,)."""
        y, width = np.asarray(y, dtype=float), np.array(self.width)
        line = np.isfinite(width)
        z = (y - self.centre)[line] / width[line]
        return float(-0.5 * z @ z - np.log(width[line] * np.sqrt(2 * np.pi)).sum()
                     - np.log(2 * np.pi) * (~line).sum())


@dataclass(frozen=True, eq=False)
class MovingClutter:
    """That of a sensor which changes with time."""

    sensor: Sensor
    grid: Grid

    def at(self, t: float) -> Clutter:
        """Return that at a time; ValueError where the sensor says nothing then."""
        return Clutter.spanning(self.sensor, self.grid, t, LOOKED_AT_AGAIN)


def clutter_of(sensor: Sensor, grid: Grid) -> Clutter | MovingClutter:
    """Return the clutter of a sensor on a grid; ValueError where it says nothing there."""
    if sensor.time_dependent or callable(sensor.covariance):
        return MovingClutter(sensor, grid)
    return Clutter.spanning(sensor, grid)


def _coarsened(grid: Grid, seen: Sequence[int] | None, looked_at: int) -> Array:
    """Return points (n, N) all over a grid, its edges among them: one of what is not seen."""
    axes = range(grid.ndim) if seen is None else seen
    most = max(int(looked_at**(1 / max(len(axes), 1))), 2)
    lines = [np.linspace(low, high, min(count + 1, most)) if i in axes else [(low + high) / 2]
             for i, (low, high, count) in enumerate(zip(grid.lower, grid.upper, grid.shape))]
    return np.stack(np.meshgrid(*lines, indexing='ij')).reshape(grid.ndim, -1)
