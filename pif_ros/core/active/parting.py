"""
What thin noise does not smooth: cells that the drift takes apart.

Without noise a long step costs nothing but the room between what neighbouring cells land on, and
the fewer steps there are the less is spread: so a step is made as long as cells that are halved
for it keep together.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.belief import Patch
from pif_ros.core.active.resolution import halved, paired
from pif_ros.core.active.transport import moved, Moves, Noise

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: By how many cells neighbours may part: a place is shared by nodes up to one and a half from it.
NEAR = 1.5
#: How often cells are halved for a step.
MOST = 2
#: Cells with less than this share of the densest one may part as they like.
LIGHT = 1e-3


@np.errstate(invalid='ignore')
def parting(patch: Patch, moves: Moves) -> Integers:
    """Return how often each axis is to be halved so that neighbours keep together, (n,)."""
    p = patch.density
    move, heavy = moves(patch.window, np.ones(p.shape, dtype=bool)), p > LIGHT * p.max()
    often = []
    for axis in range(p.ndim):
        if move.shape[axis + 1] == 1 < p.shape[axis]:
            often.append(0)
            continue
        apart = np.abs(np.diff(move, axis=axis + 1))
        # what the drift does not tell is lost, wherever its neighbour goes
        apart = np.where(np.isfinite(apart), apart, 0.0).max(axis=0)
        both = np.delete(heavy, 0, axis) & np.delete(heavy, -1, axis)
        furthest = float(np.where(both, apart, 0.0).max(initial=0.0))
        often.append(max(0, int(np.ceil(np.log2(max(furthest, 1e-9) / NEAR)))))
    return np.array(often)


def moved_on_finer(patch: Patch, moves: Moves, noise: Noise, often: Integers | None) -> Patch:
    """Return a patch after a step that is made on halved cells, on cells as wide as before."""
    if often is None or not often.any():
        return moved(patch, moves, noise)
    for axis, count in enumerate(often):
        for _ in range(count):
            patch = halved(patch, axis)
    patch = moved(patch, moves, noise)
    for axis, count in enumerate(often):
        for _ in range(count):
            patch = paired(patch, axis)
    return patch
