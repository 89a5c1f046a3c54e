"""What a source says of anything but the state: the density of measurements that are clutter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor

Array = NDArray[np.float64]

#: Cells at most, out of all of the grid's, at which a sensor's span is looked for.
LOOKED_AT = 1 << 20


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
    def spanning(cls, sensor: Sensor, grid: Grid, t: float = 0.0) -> Clutter:
        """Return that of a sensor on a grid; ValueError where it says nothing there."""
        h = np.asarray(sensor.function(_coarsened(grid, sensor.states), t), dtype=float)
        h = np.where(np.isfinite(h), h, np.nan)
        if np.isnan(h).all(axis=1).any():
            raise ValueError('sensor: expected one that says something on the grid, got one that '
                             'is undefined on all of it')
        low, high = np.nanmin(h, axis=1), np.nanmax(h, axis=1)
        width = high - low + 6 * np.sqrt(sensor.noise(t).diagonal())
        width[np.flatnonzero(sensor.angular)] = np.inf
        return cls(tuple(((low + high) / 2).tolist()), tuple(width.tolist()))

    @np.errstate(over='ignore')
    def log_density(self, y: ArrayLike) -> float:
        """Return the log density of a measurement (m,)."""
        y, width = np.asarray(y, dtype=float), np.array(self.width)
        line = np.isfinite(width)
        z = (y - self.centre)[line] / width[line]
        return float(-0.5 * z @ z - np.log(width[line] * np.sqrt(2 * np.pi)).sum()
                     - np.log(2 * np.pi) * (~line).sum())


def _coarsened(grid: Grid, seen: Sequence[int] | None) -> Array:
    """Return points (n, N) all over a grid, its edges among them: one of what is not seen."""
    axes = range(grid.ndim) if seen is None else seen
    most = max(int(LOOKED_AT**(1 / max(len(axes), 1))), 2)
    lines = [np.linspace(low, high, min(count + 1, most)) if i in axes else [(low + high) / 2]
             for i, (low, high, count) in enumerate(zip(grid.lower, grid.upper, grid.shape))]
    return np.stack(np.meshgrid(*lines, indexing='ij')).reshape(grid.ndim, -1)
