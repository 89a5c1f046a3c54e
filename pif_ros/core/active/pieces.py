"""What overlapping patches hold, on one lattice: how dense it is where they meet."""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.window import Window
from pif_ros.core.grid import Grid
from pif_ros.core.modes import Pieces

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: A lattice is as fine as the finest patch, unless there were more pieces than this then.
FEW = 2**19


def pieces(base: Grid, windows: Sequence[Window], densities: Sequence[Array]) -> Pieces:
    """
    Return the density that is the sum of some on windows of a base grid, scaled to mass 1.

    A cell wider than the lattice's is one piece for each of these, all at its own centre, so that
    the moments are those of the cells.
    """
    level = _level(windows)
    lattice = Grid(base.lower, base.upper,
                   tuple(count << up for count, up in zip(base.shape, level)), base.periodic)
    found = [_split(window, p, lattice, level) for window, p in zip(windows, densities)]
    cell, points, mass = (np.concatenate(parts, axis=-1) for parts in zip(*found))
    mass /= mass.sum()
    if np.all(np.diff(cell) > 0):
        held = mass
    else:
        _, places = np.unique(cell, return_inverse=True)
        held = np.bincount(places.reshape(-1), mass)[places.reshape(-1)]
    return Pieces(lattice, cell, points, mass, held / lattice.cell_volume)


def _level(windows: Sequence[Window]) -> Integers:
    """Return how often the base's cells are halved for the lattice, (n,)."""
    levels, sizes = np.array([w.level for w in windows]), np.array([w.size for w in windows])
    level, base = levels.max(axis=0), windows[0].base
    while level.any() and (sizes @ np.exp2(np.maximum(level - levels, 0).sum(axis=1)) > FEW
                           or math.log2(base.size) + level.sum() > 62):
        level[np.argmax(level)] -= 1
    return level


def _split(window: Window, p: Array, lattice: Grid,
           level: Integers) -> tuple[Integers, Array, Array]:
    """Return the lattice's cells (N,), the points (n, N) and the masses (N,) of a window."""
    where = np.nonzero(p > 0)
    index = np.array(where) + np.array(window.offset)[:, None]
    points = np.array(lattice.lower)[:, None] + (index + 0.5) * window.spacing[:, None]
    finer = level - window.level
    index = index << np.maximum(finer, 0)[:, None] >> np.maximum(-finer, 0)[:, None]
    # the lattice's cells in one of the window's, from the first
    inner = np.indices([1 << max(int(up), 0) for up in finer]).reshape(lattice.ndim, 1, -1)
    index = index[:, :, None] + inner
    many = inner.shape[-1]
    for i, (count, round_) in enumerate(zip(lattice.shape, lattice.periodic)):
        index[i] = index[i] % count if round_ else np.clip(index[i], 0, count - 1)
    cell = np.ravel_multi_index(tuple(index.reshape(lattice.ndim, -1)), lattice.shape)
    mass = p[where] * (window.spacing.prod() / many)
    return cell, np.repeat(points, many, axis=1), np.repeat(mass, many)
