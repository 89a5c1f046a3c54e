"""Which cells are kept: where the mass is, and no others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.window import Window

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Box = tuple[slice, ...]

#: A patch with less than this share of the mass dies: no measurement short of seven standard
#: deviations would bring it back.
DEAD = 1e-12
#: By how many cells a step widens a patch on each side, about: what a cut costs.
HALO = 4
#: Bits of a number behind the power of two that it begins with, and all of that.
DIGITS, POWERS = 52, (1 << 11) - 1
#: A box with fewer cells is not cut, nor one of which more than this share is kept and no plane
#: is empty.
SMALL, FILLED = 512, 0.2
#: Another one is, if that leaves less than this share of its cells, with their halos.
WORTH = 0.7
#: A patch with less than this share of another's mass would lose much by the other's measure.
SLIGHT = 1e-3
#: Patches that meet are put together, and cut anew, in a box of so many times their size at most.
WASTE = 16


def regions(belief: ActiveBelief, negligible: float) -> ActiveBelief:
    """
    Return a belief in patches that fit it, without what is negligible.

    Each patch leaves out its emptiest cells, which together hold at most this share of its own
    mass: so a light hump is trimmed as a heavy one is, and lives on.  A patch dies when less than
    DEAD of all the mass is left in it.  What is left out is added to dropped.
    """
    mass = belief.mass
    if not mass > 0:
        return ActiveBelief(belief.base, (), belief.dropped)
    alive = [patch for patch in belief.patches if patch.mass > DEAD * mass]
    kept = [part for patch in _put_together(alive) for part in _cut(patch, negligible)]
    left_out = max(1 - sum(patch.mass for patch in kept) / mass, 0.0)
    return ActiveBelief(belief.base, tuple(kept), belief.dropped + left_out)


def _put_together(patches: Sequence[Patch]) -> list[Patch]:
    """Return patches with those of a level that overlap made one, but for light humps."""
    left, result = list(patches), []
    while left:
        group = [left.pop()]
        hull = group[0].window
        while True:
            found = next(((k, both) for k, patch in enumerate(left)
                          if (both := _hull(hull, patch.window)) is not None
                          and not any(_is_hump_beside(patch, other) for other in group)
                          and both.size <= WASTE * (patch.window.size + sum(
                              p.window.size for p in group))), None)
            if found is None:
                break
            group.append(left.pop(found[0]))
            hull = found[1]
        result.append(group[0] if len(group) == 1 else _sum(hull, group))
    return result


def _is_hump_beside(a: Patch, b: Patch) -> bool:
    """Return whether the lighter of two is no tail of the other, but would be trimmed as one."""
    light, heavy = (a, b) if a.mass < b.mass else (b, a)
    if light.mass > SLIGHT * heavy.mass:
        return False
    densest = np.unravel_index(np.argmax(light.density), light.density.shape)
    place = []
    for i, round_ in enumerate(heavy.window.base.periodic):
        cell = light.window.offset[i] + int(densest[i]) - heavy.window.offset[i]
        place.append(cell % heavy.window.cells[i] if round_ else cell)
    inside = all(0 <= cell < count for cell, count in zip(place, heavy.window.shape))
    return not inside or bool(heavy.density[tuple(place)] < light.density[densest])


def _hull(a: Window, b: Window) -> Window | None:
    """Return the smallest window around two of one level that overlap, None where they do not."""
    if a.level != b.level:
        return None
    first, last = [], []
    for i, round_ in enumerate(a.base.periodic):
        low, high, other = a.offset[i], a.offset[i] + a.shape[i], b.offset[i]
        if round_:
            # the turn on which b comes nearest to a
            turns = np.rint((low + high - 2 * other - b.shape[i]) / (2 * a.cells[i]))
            other += int(turns) * a.cells[i]
        if other > high or other + b.shape[i] < low:
            return None
        first.append(min(low, other))
        last.append(max(high, other + b.shape[i]))
    return Window.of(a.base, a.level, first, np.subtract(last, first))


def _sum(hull: Window, patches: Sequence[Patch]) -> Patch:
    """Return the sum of some patches in a window that holds them all."""
    density = np.zeros(hull.shape)
    for patch in patches:
        places = []
        for i, round_ in enumerate(hull.base.periodic):
            cells = patch.window.offset[i] - hull.offset[i] + np.arange(patch.window.shape[i])
            places.append(cells % hull.cells[i] if round_ else cells)
        density[np.ix_(*places)] += patch.density
    return Patch(hull, density)


def _cut(patch: Patch, negligible: float) -> Iterator[Patch]:
    """Give the parts of a patch that hold all but a negligible share of its mass."""
    kept = _kept(patch.density, negligible)
    if any(patch.window.circles):
        patch = _unrolled(patch, kept)
        kept = _kept(patch.density, negligible)
    for box in _boxes(kept):
        window = patch.window
        first = [start + part.start for start, part in zip(window.offset, box)]
        yield thick(window, first, patch.density[box])


def thick(window: Window, first: list[int], density: Array) -> Patch:
    """Return a patch of two cells each way at least, the second of which may be empty."""
    for axis, count in enumerate(density.shape):
        if count == 1:
            at_the_edge = first[axis] + 1 >= window.cells[axis] and not window.base.periodic[axis]
            more = (1, 0) if at_the_edge else (0, 1)
            density = np.pad(density, [more if i == axis else (0, 0)
                                       for i in range(density.ndim)])
            first[axis] -= more[0]
    density = np.ascontiguousarray(density)
    return Patch.at(window.base, window.level, first, density)


def _kept(p: Array, negligible: float) -> Mask:
    """Return the cells without the emptiest, which hold a share of the mass at most."""
    # what stands in front of the digits: all cells between two powers of two have the same
    power = (np.ascontiguousarray(p).view(np.int64) >> DIGITS) & POWERS
    mass = np.bincount(power.ravel(), p.ravel())
    lightest = int(np.searchsorted(np.cumsum(mass), negligible * mass.sum(), side='right'))
    kept: Mask = (power >= lightest) & (p > 0)
    return kept


def _unrolled(patch: Patch, kept: Mask) -> Patch:
    """Return a patch cut open at the widest gap of each circle that is not full."""
    window, density = patch.window, patch.density
    for axis in (i for i, circle in enumerate(window.circles) if circle):
        used = np.flatnonzero(_along(kept, axis))
        gaps = np.diff(used, append=used[0] + window.cells[axis])
        widest = int(np.argmax(gaps))
        if gaps[widest] <= HALO:
            continue
        start = int(used[(widest + 1) % len(used)])
        count = window.cells[axis] - int(gaps[widest]) + 1
        density = np.take(density, (start + np.arange(max(count, 2))) % window.cells[axis], axis)
        kept = np.take(kept, (start + np.arange(max(count, 2))) % window.cells[axis], axis)
        offset = list(window.offset)
        offset[axis] += start
        window = Window.of(window.base, window.level, offset, density.shape)
    return Patch(window, density)


def _boxes(kept: Mask) -> list[Box]:
    """Return boxes around all that is kept, cut where that saves cells  [Berger, Rigoutsos]."""
    box = _trimmed(kept)
    inside = kept[box]
    axis, place, gap = _gap(inside)
    # what is far apart is never one patch: each part is to be trimmed by its own measure
    apart = gap > 2 * HALO
    if not apart and inside.size <= SMALL:
        return [box]
    if not place:
        if np.count_nonzero(inside) > FILLED * inside.size:
            return [box]
        axis = int(np.argmax(inside.shape))
        place = inside.shape[axis] // 2
    parts = [tuple(slice(a.start + b.start + c.start, a.start + b.start + c.stop)
                   for a, b, c in zip(box, half, inner))
             for half in _halves(inside, axis, place) for inner in _boxes(inside[half])]
    return parts if apart or sum(map(_cost, parts)) < WORTH * _cost(box) else [box]


def _gap(kept: Mask) -> tuple[int, int, int]:
    """Return the axis with the widest gap, where that begins and its width; 0 for none."""
    axis, place, widest = 0, 0, 1
    for i in range(kept.ndim):
        used = np.flatnonzero(_along(kept, i))
        gaps = np.diff(used)
        if gaps.max(initial=1) > widest:
            axis, place, widest = i, int(used[np.argmax(gaps)]) + 1, int(gaps.max())
    return axis, place, widest - 1


def _halves(kept: Mask, axis: int, place: int) -> list[Box]:
    """Return a box in two, cut across an axis."""
    whole = [slice(0, count) for count in kept.shape]
    return [(*whole[:axis], part, *whole[axis + 1:])
            for part in (slice(0, place), slice(place, kept.shape[axis]))]


def _trimmed(kept: Mask) -> Box:
    """Return the smallest box around what is kept."""
    used = [np.flatnonzero(_along(kept, axis)) for axis in range(kept.ndim)]
    return tuple(slice(int(cells[0]), int(cells[-1]) + 1) for cells in used)


def _along(kept: Mask, axis: int) -> Mask:
    """Return which cells of an axis hold anything."""
    return np.asarray(kept.any(axis=tuple(i for i in range(kept.ndim) if i != axis)))


def _cost(box: Box) -> int:
    """Return the cells of a box with what a step adds around it."""
    return int(np.prod([part.stop - part.start + 2 * HALO for part in box]))
