"""The likelihood of a measurement in every cell of a grid, in the log domain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray

from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor

Array = NDArray[np.float64]

#: Points per axis at most, by dimension, over which a cell's likelihood is averaged.
FINEST = {1: 32, 2: 8, 3: 4, 4: 3}
#: A cell with less than this share of the densest one is not worth averaging over.
SIGNIFICANT = 1e-9


@dataclass(frozen=True, eq=False)
class GridLikelihood:
    """
    A sensor's likelihood on a grid.

    A cell over which the expected measurement changes by more than its standard deviation
    (dx > sigma_y / |h'|) does not resolve the likelihood at its centre; with average_cells, and
    where the belief has mass, the likelihood is averaged over such a cell.
    """

    grid: Grid
    sensor: Sensor
    average_cells: bool = True

    def log(self, y: Array, density: Array, t: float) -> Array:
        """
        Return log p(y | x) for all cells (size,), given the density (size,) before it.

        Where the sensor's function is undefined it is NaN.
        """
        log_l = self._at_centres(y, t)
        if self.average_cells and len(self._coarse):
            there = density[self._coarse]
            cells = self._coarse[there > SIGNIFICANT * density.max()]
            if len(cells):
                log_l[cells] = self._averaged(y, cells, t)
        return log_l

    def remarks(self, name: str) -> list[str]:
        """Return a sentence where some cells are wider than the likelihood."""
        share, widest = len(self._coarse) / self.grid.size, float(self._width.max())
        if not share:
            return []
        cure = ('its likelihood is averaged over such cells where the belief is'
                if self.average_cells else 'filter.average_cells is off, so variances are wrong')
        return [f'grid.shape: {share:.0%} of the cells are wider than sensor {name!r} resolves, '
                f'up to {widest:.1f} of its standard deviations; {cure}']

    def _at_centres(self, y: Array, t: float) -> Array:
        sensor = self.sensor
        if sensor.time_dependent or callable(sensor.covariance) or any(sensor.angular):
            return sensor.log_likelihood(y, sensor.function(self.grid.points, t), t)
        v = self._whitened - (self._whiten @ y)[:, None]
        log_l = np.einsum('ij,ij->j', v, v)
        log_l *= -0.5
        log_l += self._constant
        return log_l

    @cached_property
    def _whiten(self) -> Array:
        return np.linalg.inv(np.linalg.cholesky(self.sensor.noise(0.0)))

    @cached_property
    def _whitened(self) -> Array:
        return np.ascontiguousarray(self._whiten @ self.sensor.function(self.grid.points, 0.0))

    @cached_property
    def _constant(self) -> float:
        return float(np.log(np.diag(self._whiten)).sum()
                     - 0.5 * self.sensor.size * np.log(2 * np.pi))

    @cached_property
    def _width(self) -> Array:
        """Return each cell's width in standard deviations of the measurement, (size,)."""
        sensor, x = self.sensor, self.grid.points
        width = np.zeros(self.grid.size)
        for d, half in enumerate(np.diag(self.grid.spacing / 2)):
            low, high = (sensor.function(x + side * half[:, None], 0.0) for side in (-1, 1))
            change = self._whiten @ sensor.difference(high, low)
            np.maximum(width, np.linalg.norm(change, axis=0), out=width)
        return np.nan_to_num(width, nan=0.0, posinf=0.0)

    @cached_property
    def _coarse(self) -> NDArray[np.intp]:
        return np.flatnonzero(self._width > 1.0)

    def _averaged(self, y: Array, cells: NDArray[np.intp], t: float) -> Array:
        """Return the log of the likelihood's average over some cells."""
        n = self.grid.ndim
        count = min(math.ceil(self._width[cells].max()) + 1, FINEST[n])
        steps = (np.arange(count) + 0.5) / count - 0.5
        inner = np.stack(np.meshgrid(*[steps] * n, indexing='ij')).reshape(n, 1, -1)
        x = self.grid.points[:, cells, None] + inner * self.grid.spacing[:, None, None]
        log_l = self.sensor.log_likelihood(y, self.sensor.function(x, t), t)
        peak = np.nan_to_num(log_l.max(axis=1, keepdims=True), nan=-np.inf)
        peak = np.where(np.isfinite(peak), peak, 0.0)
        with np.errstate(divide='ignore'):
            return np.log(np.exp(log_l - peak).mean(axis=1)) + peak[:, 0]
