"""Steps through time, and round a circle."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.controls import Controls, driven
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]

#: A state beyond this has blown up: further out, squares and their sums are no numbers any more.
LARGEST = 1e100


def step_ns(time_step: float) -> int:
    """Return a step in whole nanoseconds, at least one; ValueError where it is no time."""
    if not 0 < time_step < math.inf:
        raise ValueError(f'time_step: expected a positive number of seconds, got {time_step}')
    return max(round(time_step * NANOSECONDS), 1)


def time_steps(from_ns: int, to_ns: int, step: int) -> Iterator[tuple[int, int]]:
    """
    Yield the start and the length of each whole step from a stamp, and of the rest, if any.

    Raises ValueError where to_ns lies before from_ns.
    """
    if to_ns < from_ns:
        raise ValueError(f'to_ns: expected a stamp from {from_ns} on, got {to_ns}')
    for start in range(from_ns, to_ns, step):
        yield start, min(step, to_ns - start)


def driven_steps(model: StateModel, controls: Controls, from_ns: int, to_ns: int,
                 step: int) -> Iterator[tuple[int, int, StateModel]]:
    """
    Yield the same with the plain model of each step, which is cut where the control changes.

    Steps go on from where they would without the cut, so that whole ones may be taken in any
    number of calls.
    """
    for start, length in time_steps(from_ns, to_ns, step):
        for begin, end, plain in driven(model, controls, start, start + length):
            yield begin, end - begin, plain


def wrapped(x: Array, box: Grid | None) -> Array:
    """Return states (n, ...) with those on a periodic axis of the box brought into it."""
    if box is None or not any(box.periodic):
        return x
    x = np.array(x)
    for i, low, period in circles(box):
        x[i] -= period * np.floor((x[i] - low) / period)
    return x


def short_way(difference: Array, box: Grid | None) -> Array:
    """Return differences of states (n, ...) taken the short way round on periodic axes."""
    return difference if box is None else box.wrap(difference)


def circles(box: Grid | None) -> list[tuple[int, float, float]]:
    """Return number, lower edge and period of each periodic axis."""
    return [] if box is None else [
        (i, low, high - low)
        for i, (low, high, round_) in enumerate(zip(box.lower, box.upper, box.periodic)) if round_]


def check_box(box: Grid | None, ndim: int) -> None:
    """Raise ValueError where a box has not one axis for each state."""
    if box is not None and box.ndim != ndim:
        raise ValueError(f'box: expected {ndim} axes, one for each state, got {box.ndim}')


def known(box: Grid | None) -> Grid:
    """Return the box that a uniform belief fills; ValueError where there is none."""
    if box is None:
        raise ValueError('box: expected a box to begin in, got none')
    return box
