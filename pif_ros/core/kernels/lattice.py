"""Whole cells: moves, boxes of them, and how wide a step is in them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel
from scipy.special import gammainccinv

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: No move is longer than this, in cells; it has left any grid.
FAR = 1e9


def reach(tolerance: float, n: int) -> float:
    """Return the radius, in standard deviations, beyond which a Gaussian has this share."""
    return math.sqrt(2 * gammainccinv(n / 2, tolerance))


def variance_in_cells(model: StateModel, grid: Grid, settings: KernelSettings,
                      t: float) -> Array:
    """Return eps g in cells for each state of the grid, (n, n, size), or for all, (n, n, 1)."""
    x = grid.points if model.multiplicative else np.zeros((grid.ndim, 1))
    variance = settings.time_step * model.diffusion_at(x, t + settings.r * settings.time_step)
    return variance / np.outer(grid.spacing, grid.spacing)[..., None]


def whole_cells(move: Array) -> Integers:
    """Return moves in cells as whole numbers."""
    return np.rint(np.clip(np.nan_to_num(move), -FAR, FAR)).astype(int)


def box(half: Integers) -> Integers:
    """Return all offsets up to half cells on each axis, shape (n, K), in C order."""
    axes = [np.arange(-h, h + 1) for h in half]
    return np.stack(np.meshgrid(*axes, indexing='ij')).reshape(len(axes), -1)


def strides_of(shape: Integers) -> Integers:
    """Return how far apart in the flat order the neighbours along each axis are."""
    return np.concatenate([np.cumprod(shape[:0:-1])[::-1], [1]]).astype(int)
