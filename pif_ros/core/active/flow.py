"""Where the drift carries a state."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.window import Window, wrapped
from pif_ros.core.controls import Controls, NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import Field, StateModel

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

#: A Runge-Kutta step times the rate at which neighbours part: its error is about this, to the
#: fifth power, over 120.
SMOOTH = 0.25
#: States at which that rate is looked at, at most, and where: at irregular places, since a drift
#: may be the same at regular ones.
LOOKS, GOLDEN = 1000, (5**0.5 - 1) / 2
#: How far, in cells, a Runge-Kutta step may be from what the drift says on its way: a drift that
#: bends is off by far more, and the step's end by some hundredths of it.
BENT = 0.05
#: States at which that is looked at, at most, and how often a step is halved for it.
FOLLOWED, HALVINGS = 64, 7
#: After what shares of a step: irregular ones too, since a wave may come again.
ON_THE_WAY = GOLDEN, GOLDEN**2, GOLDEN**3
#: States that are carried at a time, which stay in the cache.
CHUNK = 1 << 13


def flow(model: StateModel, window: Window, x: Array, from_ns: int, to_ns: int,
         controls: Controls, rate: float) -> Array:
    """
    Return where states x (n, ...) are carried by dx/dt = f(x, u, t), same shape.

    window: what the states are in; rate: of parting, per second; classical Runge-Kutta, in steps
    that suit it, shorter where the drift bends, and that end where the control changes.
    """
    parts = [(_drift(model.under(u), window.base), start_ns / NANOSECONDS,
              (end_ns - start_ns) / NANOSECONDS)
             for start_ns, end_ns, u in controls.between(from_ns, to_ns)]
    # who stays in his cell stays where the slope was looked at
    near = -1.0 if model.time_dependent else 1.0
    flat, widths = x.reshape(len(x), -1), window.spacing[:, None]
    ends = np.empty_like(flat)
    for k in range(0, flat.shape[1], CHUNK):
        some = flat[:, k:k + CHUNK]
        for drift, start, lasts in parts:
            count = max(1, int(np.ceil(lasts * rate / SMOOTH)))
            h = lasts / count
            for step in range(count):
                some = _stepped(drift, some, start + step * h, h, widths, near)
        ends[:, k:k + CHUNK] = some
    return ends.reshape(x.shape)


@np.errstate(invalid='ignore')
def parting_rate(model: StateModel, window: Window, from_ns: int, to_ns: int,
                 controls: Controls) -> float:
    """
    Return how fast neighbouring cells part or meet, per second, seen at some states.

    The largest sum over j of |df_i/dx_j| dx_j / dx_i, with dx the widths of a cell.
    """
    cells = np.unravel_index(_some(window.size, LOOKS), window.shape)
    x = np.stack([axis[place] for axis, place in zip(window.grid.axes, cells)])
    x = wrapped(window.base, x)
    scale, rate = window.spacing, 0.0
    for start_ns, end_ns, u in controls.between(from_ns, to_ns):
        driven = model.under(u).at_scale(window.base.spacing)
        for t_ns in (start_ns, (start_ns + end_ns) / 2, end_ns)[:3 if model.time_dependent else 1]:
            J = driven.jacobian(x, t_ns / NANOSECONDS)
            sums = np.einsum('ijk,j->ik', np.abs(J), scale) / scale[:, None]
            rate = max(rate, float(np.nan_to_num(sums, posinf=0.0).max()))
    return rate


def _drift(model: StateModel, base: Grid) -> Field:
    """Return the drift, not asked for what lies beyond a circle's edges."""
    if not any(base.periodic):
        return model.drift
    return lambda x, t: model.drift(wrapped(base, x), t)


def _stepped(drift: Field, x: Array, t: float, h: float, widths: Array, near: float,
             halvings: int = HALVINGS) -> Array:
    """
    Return the states after a step, or after two of half its length where the drift bends.

    near: how many cells, of widths (n, 1), states may go without being followed.
    """
    end, some = _runge_kutta(drift, x, t, h), _some(x.shape[1], FOLLOWED)
    start, gone = np.take(x, some, axis=1), np.take(end, some, axis=1)
    gone -= start
    if (np.abs(gone) <= near * widths).all() or not halvings \
            or _smooth(drift, start, gone, t, h, widths):
        return end
    middle = _stepped(drift, x, t, h / 2, widths, near, halvings - 1)
    return _stepped(drift, middle, t + h / 2, h / 2, widths, near, halvings - 1)


@np.errstate(invalid='ignore', over='ignore')
def _smooth(drift: Field, x: Array, gone: Array, t: float, h: float, widths: Array) -> bool:
    """Return whether the drift on the way is that of the cubic which has it at both ends."""
    first, last = h * drift(x, t), h * drift(x + gone, t + h)
    for s in ON_THE_WAY:
        there = x + s * s * (3 - 2 * s) * gone + s * (1 - s) * ((1 - s) * first - s * last)
        slope = 6 * s * (1 - s) * gone + (1 - s) * (1 - 3 * s) * first - s * (2 - 3 * s) * last
        off = np.abs(h * drift(there, t + s * h) - slope)
        if (np.isfinite(off) & (off > BENT * widths)).any():
            return False
    return True


def _runge_kutta(drift: Field, x: Array, t: float, h: float) -> Array:
    """Return the states after one classical step of fourth order."""
    k1 = drift(x, t)
    k2 = drift(_further(x, h / 2, k1), t + h / 2)
    k3 = drift(_further(x, h / 2, k2), t + h / 2)
    k4 = drift(_further(x, h, k3), t + h)
    total = k2 + k3
    total *= 2
    total += k1
    total += k4
    return _further(x, h / 6, total)


def _further(x: Array, h: float, slope: Array) -> Array:
    """Return x + h slope."""
    moved: Array = h * slope
    moved += x
    return moved


@lru_cache(maxsize=64)
def _some(count: int, most: int) -> Integers:
    """Return up to so many of the numbers below count, at irregular places."""
    return (np.arange(count) if count <= most
            else (count * (GOLDEN * np.arange(most) % 1)).astype(np.int64))
