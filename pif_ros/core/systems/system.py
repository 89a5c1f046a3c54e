"""What a named system is, and how its constants are held to be numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.models import Sensor, StateModel

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class System:
    """
    A state model and what can measure it.

    sensors: functions of a sensor's constants that return a Sensor, by name; the first is the one
    that a source without a sensor's name gets.
    """

    model: StateModel
    sensors: Mapping[str, Callable[..., Sensor]]


def positive(name: str, value: float) -> float:
    """Return a constant that is a positive number; ValueError where it is none."""
    if not _is_number(value) or not 1e-150 < value < 1e150:
        raise ValueError(f'{name}: expected a positive number, got {value}')
    return float(value)


def finite(name: str, value: float) -> float:
    """Return a constant that is a finite number; ValueError where it is none."""
    if not _is_number(value) or not math.isfinite(value):
        raise ValueError(f'{name}: expected a finite number, got {value}')
    return float(value)


def white(name: str, sigma: float, size: int) -> Array:
    """Return the covariance of independent noises of one standard deviation, (size, size)."""
    return positive(name, sigma)**2 * np.eye(size)


def room(x: Array) -> Array:
    """Return an array of the shape of x for what depends on it."""
    return np.empty(np.shape(x), np.result_type(x, 1.0))


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
