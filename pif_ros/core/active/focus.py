"""
Cells as fine as the belief is narrow  [Sensors, section 4.3, strategy 2].

Fine cells are never more than the world has wide ones: where they would be, the heaviest patches
get theirs first.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.regions import regions
from pif_ros.core.active.resolution import halved, paired, widths
from pif_ros.core.active.settings import RegionSettings
from pif_ros.core.active.window import Window

Array = NDArray[np.float64]

#: Features wider than this many times what is asked for are kept on cells twice as wide: more
#: than 2, so that what was paired is not halved again at once.
LAVISH = 2.5
#: A measurement may leave features narrower than asked for by this factor before it is used anew
#: on finer cells.
TOLERATED = 0.7
#: Noise narrower than this share of its largest variance is along a line.
LINE = 1e-12
#: A patch with less than this share of the mass is not made finer before a measurement.
LIGHT = 1e-6


def fitted(belief: ActiveBelief, settings: RegionSettings) -> ActiveBelief:
    """Return a belief in the patches and on the cells that suit it."""
    belief = regions(belief, settings.negligible)
    room, patches = belief.base.size - belief.size, []
    for patch in sorted(belief.patches, key=lambda patch: -patch.mass):
        wanted = widths(patch)
        for axis, level in enumerate(patch.window.level):
            if wanted[axis] > LAVISH * settings.resolution and level > 0:
                patch = paired(patch, axis)
            elif wanted[axis] < settings.resolution and level < settings.finest:
                if patch.window.size <= room:
                    room -= patch.window.size
                    patch = halved(patch, axis)
        patches.append(patch)
    return replace(belief, patches=tuple(patches))


def loosened(patch: Patch, noise: Array, settings: RegionSettings) -> Patch:
    """
    Return a patch without the fine cells that the noise of a step would blur.

    noise: its covariance, (n, n).  Such cells would be made as far as the noise goes, in vain.
    """
    needed = 2 * LAVISH * settings.resolution * patch.window.spacing
    if not (np.array(patch.window.level) * (np.diag(noise) > needed**2)).any():
        return patch
    # the width given all other states, as features are measured; none along a line
    some = np.eye(len(noise)) * LINE * np.diag(noise).max()
    narrow = 1 / np.sqrt(np.diag(np.linalg.inv(noise + some)))
    for axis, width in enumerate(narrow):
        while patch.window.level[axis] > 0 and width > needed[axis]:
            patch, needed[axis] = paired(patch, axis), 2 * needed[axis]
    return patch


def focused(prior: ActiveBelief, posterior: ActiveBelief,
            settings: RegionSettings) -> ActiveBelief | None:
    """
    Return a prior on the cells that its posterior needs, None where those that it has will do.

    What a measurement leaves may be narrower than a cell: it is then to be made anew, from this.
    """
    room, result, changed = prior.base.size - prior.size, [], False
    for before, after in zip(prior.patches, posterior.patches):
        # what is replaced makes room: a prior may have all of the world's cells
        room += before.window.size
        finer = _finer(before, after, settings, room) if after.mass > LIGHT else None
        changed |= finer is not None
        result += finer or [before]
        room -= sum(patch.window.size for patch in finer or [before])
    return replace(prior, patches=tuple(result)) if changed else None


def _finer(before: Patch, after: Patch, settings: RegionSettings, room: int) -> list[Patch] | None:
    """Return the parts of a patch that its posterior needs, halved; None where none are narrow."""
    parts = regions(ActiveBelief(after.window.base, (after,)), settings.negligible).patches
    left, changed = before.density.copy(), False
    result = [_taken(before.window, left, part.window) for part in parts]
    room -= sum(inner.window.size for inner in result)
    for k, part in enumerate(parts):
        narrow = [axis for axis, width in enumerate(widths(part))
                  if width < TOLERATED * settings.resolution
                  and part.window.level[axis] < settings.finest]
        size = result[k].window.size
        if narrow and (size << len(narrow)) - size <= room:
            for axis in narrow:
                result[k] = halved(result[k], axis)
            room, changed = room - (result[k].window.size - size), True
    return result if changed else None


def _taken(outer: Window, left: Array, window: Window) -> Patch:
    """
    Return what is left of a density in a window of its level, and two cells around it.

    It is taken out, since neighbours are to have each cell once.
    """
    places, first = [], []
    for axis, circle in enumerate(outer.circles):
        start, count = window.offset[axis] - outer.offset[axis], window.shape[axis]
        if window.base.periodic[axis]:
            start %= window.cells[axis]
        cells = np.arange(start - 2, start + count + 2)
        if circle:
            cells = cells[:window.cells[axis]] % window.cells[axis]
        else:
            cells = cells[(cells >= 0) & (cells < outer.shape[axis])]
            start = int(cells[0]) + 2
        places.append(cells)
        first.append(outer.offset[axis] + start - 2)
    density = left[np.ix_(*places)]
    left[np.ix_(*places)] = 0.0
    return Patch.at(window.base, window.level, first, density)
