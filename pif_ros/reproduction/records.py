"""Records: a sample path, and what was measured of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.simulation import measure, measure_path, refined, simulate

Array = NDArray[np.float64]
#: Seconds, (T,).
Times = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Record:
    """
    A sample path, and what was measured of it.

    stamps_ns (K,): when; truth (K, n); measured (K, m), by a sensor of this name; start (n,): the
    truth at stamp 0, when the prior holds; origin (m,): the value at stamp 0 of what is measured,
    where that is a path.
    """

    stamps_ns: NDArray[np.int64]
    truth: Array
    measured: Array
    sensor: str
    start: Array
    origin: Array | None = None


def recorded(model: StateModel, sensor: Sensor, name: str, start: Array, times: Times,
             rng: Generator, substeps: int) -> Record:
    """Return the record of a path from a start at times[0], measured at all later times."""
    return observed(sensor, name, simulate(model, start, times, rng, substeps), times, rng)


def observed(sensor: Sensor, name: str, path: Array, times: Times, rng: Generator) -> Record:
    """Return the record of a path (T, n), measured at all times but the first."""
    y = np.array([measure(sensor, x, t, rng) for x, t in zip(path[1:], times[1:])])
    return Record(stamps(times[1:]), path[1:], y, name, path[0])


def path_recorded(model: StateModel, sensor: Sensor, name: str, start: Array, times: Times,
                  rng: Generator, substeps: int) -> Record:
    """Return the record of a path from a start at times[0], and of the path that is measured."""
    fine = refined(times, substeps)
    path = simulate(model, start, fine, rng)
    y = measure_path(sensor, path, fine, rng)[::substeps]
    return Record(stamps(times[1:]), path[substeps::substeps], y[1:], name, path[0], y[0])


def stamps(times: Times) -> NDArray[np.int64]:
    """Return times in seconds as stamps in nanoseconds."""
    return np.rint(times * NANOSECONDS).astype(np.int64)
