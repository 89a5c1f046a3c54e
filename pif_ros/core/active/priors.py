"""The cells on which a belief begins where a mean and a covariance are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.window import Window
from pif_ros.core.grid import Grid

Array = NDArray[np.float64]

#: Within how many standard deviations a Gaussian prior is kept.
AROUND = 6.0


def is_gaussian(grid: Grid, mean: Array, covariance: Array) -> bool:
    """Return whether a mean on the grid and a covariance make a Gaussian."""
    return bool(mean.shape == (grid.ndim,) and covariance.shape == (grid.ndim, grid.ndim)
                and np.all(np.isfinite(mean)) and np.all(grid.contains(mean))
                and np.all(np.isfinite(covariance))
                and np.all(np.linalg.eigvalsh(covariance) > 0))


def around(grid: Grid, mean: Array, covariance: Array, region: RegionSettings) -> Window:
    """Return cells that hold a Gaussian, and are as fine as it needs; all where it is none."""
    if not is_gaussian(grid, mean, covariance):
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
