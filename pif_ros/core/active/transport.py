"""
How a patch of probability moves: along the flow of the drift, and into the width of the noise.

Half of the noise acts before and half after the drift  [Strang 1968], which is second order in the
step.  What a cell holds lands where the flow takes its centre, shared among three nodes on each
axis, and the noise is a Gaussian on the lattice: mass and mean are exact, the variance too
where the noise is at least a quarter of a cell squared on each axis (of correlated noise what is
left there, which is nothing where it is all but along a line), and nothing is ever negative.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active import compiled
from pif_ros.core.active.belief import Patch
from pif_ros.core.active.window import Window
from scipy import ndimage

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Mask = NDArray[np.bool_]
#: How far the drift moves what lies in those cells of a window that are held, given as a mask of
#: its shape, in cells, (n, ...), with one value along an axis on which it is the same everywhere.
Moves = Callable[[Window, Mask], Array]
#: What the noise is in the cells of a window: its variances along the axes (n,), and, where it is
#: correlated, further ones along directions of whole cells; all in cells squared.
Noise = Callable[[Window], tuple[Array, list[tuple[float, tuple[int, ...]]]]]

#: The variance, in cells squared, that three nodes can give to any place between them alike.
SPREAD = 0.25
#: How many standard deviations of the noise are kept: 2e-9 of it lies beyond.
REACH = 6.0
#: A cell with less than this share of the densest one is not worth carrying: all of these together
#: are next to nothing beside what a cut leaves out.
NOTHING = 1e-9
#: Iterations for the width of the noise; they converge in six.
NEWTON = 10
#: Cells that are carried at a time.
CHUNK = 1 << 15


def moved(patch: Patch, moves: Moves, noise: Noise) -> Patch:
    """Return a patch after a step."""
    variance, across = noise(patch.window)
    spread = np.minimum(variance, SPREAD)
    # sharing comes after the flow, as the second half of the noise does, and is a part of it
    after = np.maximum(variance / 2, spread)
    half = [(strength / 2, direction) for strength, direction in across]
    wide = _without_margins(heated(patch, variance - after, half))
    p = wide.density
    there = moves(wide.window, p > NOTHING * p.max())
    return heated(deposited(wide, there, spread), after - spread, half)


def heated(patch: Patch, variance: Array,
           across: Sequence[tuple[float, tuple[int, ...]]] = ()) -> Patch:
    """
    Return a patch that the noise has widened by variances in cells squared, (n,).

    across: further ones, each along a direction of whole cells.
    """
    for strength, direction in across:
        patch = _heated_along(patch, noise_kernel(strength), np.array(direction))
    kernels = [noise_kernel(float(v)) for v in variance]
    window, p, first = patch.window, patch.density, np.zeros(len(kernels), dtype=np.int64)
    for axis, kernel in enumerate(kernels):
        if len(kernel) > 1:
            cells, round_ = window.cells[axis], window.base.periodic[axis]
            if not round_:
                # what goes further than that has left the world
                middle = len(kernel) // 2
                kernel = kernel[max(middle - cells, 0):middle + cells + 1]
            first[axis] = -(len(kernel) // 2)
            p = _convolved(p, _folded(kernel, cells) if round_ else kernel, axis)
            if round_ and p.shape[axis] >= cells:
                # what has come round a circle lies on what was there
                patch = _placed(window, first, p)
                window, p, first = patch.window, patch.density, 0 * first
    return _placed(window, first, p)


def _folded(kernel: Array, cells: int) -> Array:
    """Return the weights of moves, an odd number, to which those a turn further on are added."""
    if len(kernel) <= cells + 1:
        return kernel
    once = np.pad(kernel, (0, -len(kernel) % cells)).reshape(-1, cells).sum(axis=0)
    return np.pad(once, (0, 1 - cells % 2))


def _convolved(p: Array, kernel: Array, axis: int) -> Array:
    """Return p with each cell shared along an axis, which grows by that on either side."""
    if compiled.is_available():
        return compiled.convolved(p, kernel, axis)
    p = np.pad(p, [(len(kernel) // 2 if i == axis else 0,) * 2 for i in range(p.ndim)])
    return np.asarray(ndimage.convolve1d(p, kernel, axis, mode='constant'))


def _without_margins(patch: Patch) -> Patch:
    """Return a patch without the planes at its sides that hold next to nothing."""
    p, window = patch.density, patch.window
    first, last = np.zeros(p.ndim, dtype=np.int64), np.array(p.shape)
    for axis, circle in enumerate(window.circles):
        held = p.max(axis=tuple(i for i in range(p.ndim) if i != axis))
        used = np.flatnonzero(held > NOTHING * held.max())
        if len(used) and not circle:
            first[axis] = min(used[0], p.shape[axis] - 2)
            last[axis] = max(used[-1] + 1, first[axis] + 2)
    inside = p[tuple(slice(a, b) for a, b in zip(first, last))]
    return _placed(window, first, np.ascontiguousarray(inside))


def _heated_along(patch: Patch, kernel: Array, direction: Integers) -> Patch:
    """Return a patch whose cells are shared along a direction."""
    reach = len(kernel) // 2 * np.abs(direction)
    p, axes = np.pad(patch.density, [(k, k) for k in reach]), tuple(range(len(direction)))
    # nothing comes round, since there is room for it
    shared = sum(w * np.roll(p, tuple((k - len(kernel) // 2) * direction), axes)
                 for k, w in enumerate(kernel))
    return _placed(patch.window, -reach, np.asarray(shared))


@lru_cache(maxsize=256)
def noise_kernel(variance: float) -> Array:
    """
    Return the weights of moves by -K to K cells with a variance in cells squared, (2 K + 1,).

    exp(-a k^2) up to a factor, with the a that makes the variance exact: a Gaussian sampled at the
    nodes, where it is wide, and three nodes where it is thin.  Its fourth moment is a Gaussian's
    from half a cell on, while that of the lattice's own heat kernel exp(-v) I_k(v) is always too
    large, by v.
    """
    if variance <= 0:
        return np.ones(1)
    reach = int(np.ceil(REACH * np.sqrt(variance)))
    if reach == 1:
        return np.array([variance / 2, 1 - variance, variance / 2])
    k = np.arange(-reach, reach + 1)
    a = 1 / (2 * variance)
    for _ in range(NEWTON):
        w = np.exp(-a * k * k)
        w /= w.sum()
        found = float(w @ k**2)
        # d variance / d a = variance^2 - fourth moment
        slope = found**2 - float(w @ k**4)
        a = max(a - (found - variance) / slope if slope < 0 else 2 * a, 0.5 * a)
    weights: Array = np.exp(-a * k * k)
    weights /= weights.sum()
    return weights


def deposited(patch: Patch, move: Array, spread: Array) -> Patch:
    """
    Return a patch whose cells have moved; a place off the lattice is shared by its nodes.

    move: in cells, (n, ...); spread: the variance that this is to have, at most 1/4, (n,).  With d
    in [-1/2, 1/2] from the nearest node, and v = spread or |d| (1 - |d|) where that is more:
    w_0 = 1 - (v + d^2), w_(+-1) = (v + d^2 +- d) / 2.
    """
    window, p = patch.window, patch.density
    least = NOTHING * float(p.max())
    move, p = _sound(window, move, p, least)
    if not p.max() > least:
        return Patch(window, np.zeros(p.shape))
    if compiled.is_available():
        return _placed(window, *compiled.share(
            p, list(move), least, spread, window.base.periodic, window.cells, window.offset))
    index = np.nonzero(p > least)
    mass = p[index]
    places = [cell + np.broadcast_to(m, p.shape)[index] for cell, m in zip(index, move)]
    first, shape = _landed(window, places)
    result = np.zeros(int(np.prod(shape)))
    for k in range(0, len(mass), CHUNK):
        result += _shared([place[k:k + CHUNK] for place in places], mass[k:k + CHUNK], spread,
                          window, first, shape)
    return _placed(window, first, result.reshape(shape))


def _sound(window: Window, move: Array, p: Array, least: float) -> tuple[Array, Array]:
    """
    Return moves that are finite and no longer than the world, and what is moved by such.

    least: what is worth carrying, and tells how far.

    What the drift does not tell, or carries further than that, is lost to the world anyway; round
    a circle it is as if all had gone some whole turns less.
    """
    longest, by_axis = np.array(window.cells) + 3.0, move.reshape(len(move), -1)
    if (by_axis.max(axis=1) <= longest).all() and (by_axis.min(axis=1) >= -longest).all():
        return move, p
    longest = longest.reshape(-1, *(1,) * p.ndim)
    move = move.copy()
    alike = tuple(axis for axis in range(p.ndim) if move.shape[axis + 1] == 1)
    held = (p > least).any(axis=alike, keepdims=True)
    for axis in np.flatnonzero(window.base.periodic):
        finite, turn = move[axis][held & np.isfinite(move[axis])], window.cells[axis]
        if len(finite):
            move[axis] -= turn * np.rint(np.median(finite) / turn)
            far = np.isfinite(move[axis]) & (np.abs(move[axis]) > turn)
            move[axis][far] -= turn * np.rint(move[axis][far] / turn)
    defined = np.broadcast_to(np.isfinite(move).all(axis=0), p.shape)
    return np.clip(np.nan_to_num(move), -longest, longest), np.where(defined, p, 0.0)


def _landed(window: Window, places: list[Array]) -> tuple[Integers, Integers]:
    """Return the first cell and the shape of what is landed on; a circle at most once round."""
    first = np.array([np.rint(place.min()) - 1 for place in places]).astype(np.int64)
    last = np.array([np.rint(place.max()) + 1 for place in places]).astype(np.int64)
    shape = last - first + 1
    for i, round_ in enumerate(window.base.periodic):
        if round_ and shape[i] >= window.cells[i]:
            first[i], shape[i] = -window.offset[i], window.cells[i]
    return first, shape


def _shared(places: list[Array], mass: Array, spread: Array, window: Window, first: Integers,
            shape: Integers) -> Array:
    """Return what comes of some cells' mass in each cell that is landed on, flat."""
    node, weight = np.zeros(1, dtype=np.int64), mass
    for i, place in enumerate(places):
        middle = np.rint(place)
        d = place - middle
        v = np.maximum(spread[i], np.abs(d) * (1 - np.abs(d)))
        w = np.stack([(v + d * d - d) / 2, 1 - v - d * d, (v + d * d + d) / 2])
        # where v only just suffices, rounding must not go below 0
        np.maximum(w, 0.0, out=w)
        nodes = middle.astype(np.int64) + np.arange(-1, 2)[:, None] - first[i]
        if window.base.periodic[i] and shape[i] == window.cells[i]:
            nodes %= shape[i]
        node = node[..., None, :] * shape[i] + nodes
        weight = weight[..., None, :] * w
    return np.asarray(np.bincount(node.ravel(), weight.ravel(), int(np.prod(shape))), dtype=float)


def _placed(window: Window, first: Integers, density: Array) -> Patch:
    """Return a density whose first cell is so many cells from the window's."""
    return Patch.at(window.base, window.level, np.array(window.offset) + first, density)
