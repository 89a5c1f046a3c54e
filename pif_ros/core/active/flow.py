"""Where the drift carries a state."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.window import Window
from pif_ros.core.controls import Controls, NANOSECONDS
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]

#: A Runge-Kutta step times the rate at which neighbours part: its error is about this, to the
#: fifth power, over 120.
SMOOTH = 0.25
#: States at which that rate is looked at, at most, and where: at irregular places, since a drift
#: may be the same at regular ones.
LOOKS, GOLDEN = 1000, (5**0.5 - 1) / 2
#: States that are carried at a time, which stay in the cache.
CHUNK = 1 << 13


def flow(model: StateModel, x: Array, from_ns: int, to_ns: int, controls: Controls,
         rate: float) -> Array:
    """
    Return where states x (n, ...) are carried by dx/dt = f(x, u, t), same shape.

    rate: of parting, per second; classical Runge-Kutta, in steps that suit it, and that end where
    the control changes.
    """
    parts = [(model.under(u), start_ns / NANOSECONDS, (end_ns - start_ns) / NANOSECONDS)
             for start_ns, end_ns, u in controls.between(from_ns, to_ns)]
    flat = x.reshape(len(x), -1)
    ends = np.empty_like(flat)
    for k in range(0, flat.shape[1], CHUNK):
        some = flat[:, k:k + CHUNK]
        for driven, start, lasts in parts:
            count = max(1, int(np.ceil(lasts * rate / SMOOTH)))
            h = lasts / count
            for step in range(count):
                some = _runge_kutta(driven, some, start + step * h, h)
        ends[:, k:k + CHUNK] = some
    return ends.reshape(x.shape)


@np.errstate(invalid='ignore')
def parting_rate(model: StateModel, window: Window, from_ns: int, to_ns: int,
                 controls: Controls) -> float:
    """
    Return how fast neighbouring cells part or meet, per second, seen at some states.

    The largest sum over j of |df_i/dx_j| dx_j / dx_i, with dx the widths of a cell.
    """
    size = window.size
    places = (np.arange(size) if size <= LOOKS
              else (size * (GOLDEN * np.arange(LOOKS) % 1)).astype(np.int64))
    cells = np.unravel_index(places, window.shape)
    x = np.stack([axis[place] for axis, place in zip(window.grid.axes, cells)])
    scale, rate = window.spacing, 0.0
    for start_ns, end_ns, u in controls.between(from_ns, to_ns):
        driven = model.under(u).at_scale(window.base.spacing)
        for t_ns in (start_ns, (start_ns + end_ns) / 2, end_ns)[:3 if model.time_dependent else 1]:
            J = driven.jacobian(x, t_ns / NANOSECONDS)
            sums = np.einsum('ijk,j->ik', np.abs(J), scale) / scale[:, None]
            rate = max(rate, float(np.nan_to_num(sums, posinf=0.0).max()))
    return rate


def _runge_kutta(model: StateModel, x: Array, t: float, h: float) -> Array:
    """Return the states after one classical step of fourth order."""
    k1 = model.drift(x, t)
    k2 = model.drift(_further(x, h / 2, k1), t + h / 2)
    k3 = model.drift(_further(x, h / 2, k2), t + h / 2)
    k4 = model.drift(_further(x, h, k3), t + h)
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
