"""How fine the cells of a patch are, and how they are made finer and coarser."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.belief import Patch

Array = NDArray[np.float64]


def widths(patch: Patch) -> Array:
    """
    Return how wide the features of a density are along each axis, in cells, (n,).

    1 / sqrt(I), I = 4 int (d sqrt(p) / dx)^2 dx the Fisher information of its place: for a
    Gaussian the standard deviation given all other states, and no larger for many humps or a ring.
    """
    root, window = np.sqrt(patch.density), patch.window
    total, found = float((root * root).sum()), []
    for axis, circle in enumerate(window.circles):
        first, last = root.take([0], axis), root.take([-1], axis)
        square = np.diff(root, axis=axis)**2
        # beyond a patch nothing is, but beyond the edge of the world that is no feature
        information = float(square.sum())
        if circle:
            information += float(((first - last)**2).sum())
        else:
            edges = (window.offset[axis] == 0,
                     window.offset[axis] + window.shape[axis] == window.cells[axis])
            information += sum(float((side * side).sum()) for side, edge in
                               zip((first, last), edges) if window.base.periodic[axis] or not edge)
        found.append(1 / np.sqrt(max(4 * information / total, 1e-30)))
    return np.array(found)


def halved(patch: Patch, axis: int) -> Patch:
    """
    Return a patch with the cells of an axis cut in two.

    A cell's mass goes to its halves as the slope there has it, at most all of it to one; then
    each half gives an eighth to its neighbours, which makes the variance what it was.  Mass is
    kept by every cell, the mean where no slope is cut off; nothing goes beyond the world.
    """
    p, window = np.moveaxis(patch.density, axis, 0), patch.window
    circle = window.circles[axis]
    p = p if circle else np.pad(p, [(1, 1)] + [(0, 0)] * (p.ndim - 1))
    slope = (np.roll(p, -1, 0) - np.roll(p, 1, 0)) / 8
    if not circle:
        slope[0] = slope[-1] = 0
    np.clip(slope, -p, p, out=slope)
    fine = np.stack([p - slope, p + slope], axis=1).reshape((2 * len(p),) + p.shape[1:])
    fine = 0.75 * fine + 0.125 * (np.roll(fine, 1, 0) + np.roll(fine, -1, 0))
    grown = 0 if circle else 2
    return _changed(patch, axis, 1, 2 * window.offset[axis] - grown, fine)


def paired(patch: Patch, axis: int) -> Patch:
    """
    Return a patch with the cells of an axis joined two by two.

    What that moves the mean by, next to nothing, is moved back, so that mass and mean are kept.
    """
    p, window = np.moveaxis(patch.density, axis, 0), patch.window
    circle, first = window.circles[axis], window.offset[axis]
    if not circle:
        before, after = first % 2 + 2, (first + len(p)) % 2 + 2
        p = np.pad(p, [(before, after)] + [(0, 0)] * (p.ndim - 1))
        first -= before
    joined = 0.5 * (p[::2] + p[1::2])
    drift = 0.25 * float((p[::2] - p[1::2]).sum()) / max(float(p.sum()), 1e-300)
    # halves to the left of their pair's centre have been moved right by a quarter of a new cell
    joined = (1 - abs(drift)) * joined + abs(drift) * np.roll(joined, -int(np.sign(drift)), 0)
    return _changed(patch, axis, -1, first // 2, joined)


def at_level(patch: Patch, level: tuple[int, ...]) -> Patch:
    """Return a patch with each axis halved so often."""
    for axis, wanted in enumerate(level):
        while patch.window.level[axis] < wanted:
            patch = halved(patch, axis)
        while patch.window.level[axis] > wanted:
            patch = paired(patch, axis)
    return patch


def _changed(patch: Patch, axis: int, by: int, first: int, density: Array) -> Patch:
    """
    Return a patch with the level of an axis, its first cell and its density changed.

    What has come to lie beyond the world stays at its edge.
    """
    window = patch.window
    level, offset = list(window.level), list(window.offset)
    level[axis] += by
    if not window.base.periodic[axis]:
        cells = window.base.shape[axis] << level[axis]
        before, after = max(-first, 0), max(first + len(density) - cells, 0)
        density[before] += density[:before].sum(axis=0)
        density[len(density) - after - 1] += density[len(density) - after:].sum(axis=0)
        first, density = first + before, density[before:len(density) - after]
    offset[axis] = first
    density = np.ascontiguousarray(np.moveaxis(density, 0, axis))
    return Patch.at(window.base, level, offset, density)
