"""What a model does and a sensor says: sample paths and measurements from a seeded generator."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import math

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.controls import Controls, driven, NANOSECONDS, NO_CONTROLS
from pif_ros.core.models import Sensor, StateModel

Array = NDArray[np.float64]


def simulate(model: StateModel, x0: ArrayLike, times: ArrayLike, rng: Generator,
             substeps: int = 1, controls: Controls = NO_CONTROLS) -> Array:
    """
    Return sample paths at some times in seconds, shape (len(times), n, ...).

    x0: the states (n, ...) at the first time.  Every interval is cut into substeps of the
    Euler-Maruyama scheme, whose moments are right to first order in their length; one in which the
    controls of a model with inputs change is cut there.
    """
    x, times = np.array(x0, dtype=float), np.asarray(times, dtype=float)
    kick, path = _noise(model), np.empty((len(times),) + x.shape)
    path[0] = x
    for k, interval in enumerate(np.diff(times)):
        dt = interval / substeps
        for begin in times[k] + dt * np.arange(substeps):
            for t, h, plain in _driven(model, controls, begin, dt):
                # x'' = x' + f(x', t') h + e(x', t') dv, f in the sense of Ito
                x = x + plain.ito_drift(x, t) * h + np.sqrt(h) * kick(x, t, rng)
        path[k + 1] = x
    return path


def simulate_inside(model: StateModel, draw: Callable[[Generator], ArrayLike], times: ArrayLike,
                    rng: Generator, lower: ArrayLike, upper: ArrayLike, substeps: int = 1,
                    attempts: int = 1000, controls: Controls = NO_CONTROLS) -> Array:
    """
    Return the first sample path that stays within a box, shape (len(times), n).

    draw: returns a start (n,) from a generator; lower, upper: edges (n,) of the box.  RuntimeError
    where no path of so many attempts stays.
    """
    lower, upper = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
    for _ in range(attempts):
        path = simulate(model, draw(rng), times, rng, substeps, controls)
        if np.all((path >= lower) & (path <= upper)):
            return path
    raise RuntimeError(f'attempts: expected a path that stays between {lower.tolist()} and '
                       f'{upper.tolist()}, got none in {attempts}')


def measure(sensor: Sensor, x: ArrayLike, t: float, rng: Generator) -> Array:
    """Return a measurement of each of the states (n, ...) at time t in seconds, (m, ...)."""
    # y = h(x, t) + w, w ~ N(0, R)  [Sensors, Eq. 7]
    h = np.asarray(sensor.function(np.asarray(x, dtype=float), t), dtype=float)
    # -w is drawn as often as w
    return sensor.difference(h, _drawn(_root(sensor.noise(t)), h.shape[1:], rng))


def measure_path(sensor: Sensor, path: Array, times: ArrayLike, rng: Generator) -> Array:
    """
    Return the measured path of some sample paths (T, n, ...) at the same times, (T, m, ...).

    dy = h(x, t) dt + n dw, y = 0 at the first time, where n n^T is the sensor's covariance, here
    per second  [PMC, Eq. 1].  Over an interval h is the mean of both ends; for a path that is
    asked for less often than that is good for, take every so many of finer times.
    """
    times, shape = np.asarray(times, dtype=float), (-1,) + (1,) * (path.ndim - 1)
    if sensor.time_dependent:
        h = np.array([sensor.function(x, t) for x, t in zip(path, times)])
    else:
        h = np.moveaxis(sensor.function(np.moveaxis(path, 1, 0), times[0]), 0, 1)
    dt = np.diff(times).reshape(shape)
    dy = (h[:-1] + h[1:]) / 2 * dt
    dy += np.sqrt(dt) * np.einsum('kij,kj...->ki...', _roots(sensor, times[:-1]),
                                  rng.standard_normal(dy.shape))
    return np.concatenate([np.zeros((1,) + dy.shape[1:]), np.cumsum(dy, axis=0)])


def refined(times: ArrayLike, substeps: int) -> Array:
    """Return the same times with every interval cut into so many; [::substeps] are they again."""
    times = np.asarray(times, dtype=float)
    inner = np.arange(substeps) / substeps
    fine = times[:-1, None] + np.diff(times)[:, None] * inner
    return np.append(fine.ravel(), times[-1])


def spectral_root(covariance: Array) -> Array:
    """Return a root of a covariance by its eigenvalues, which a singular one has too."""
    size, axes = np.linalg.eigh(covariance)
    return np.asarray(axes * np.sqrt(np.maximum(size, 0.0)), dtype=float)


def _driven(model: StateModel, controls: Controls, t: float,
            dt: float) -> Iterator[tuple[float, float, StateModel]]:
    """Yield the starts, the lengths and the plain models of a step that changes of u cut."""
    if not model.inputs:
        yield t, dt, model
        return
    stamps = round(t * NANOSECONDS), round((t + dt) * NANOSECONDS)
    for start, end, plain in driven(model, controls, *stamps):
        yield start / NANOSECONDS, (end - start) / NANOSECONDS, plain


def _noise(model: StateModel) -> Callable[[Array, float, Generator], Array]:
    """Return what draws e dv of a second at states (n, ...) and a time, dv ~ N(0, Q)."""
    if model.multiplicative or model.changes_with_time:
        def kick(x: Array, t: float, rng: Generator) -> Array:
            dv = _drawn(_root(model.noise(t)), x.shape[1:], rng)
            e = model.vielbein_at(x, t)
            return np.asarray(np.einsum('ia...,a...->i...', e, dv))
        return kick
    root = model.vielbein_at(np.zeros(model.ndim), 0.0) @ _root(model.noise(0.0))
    return lambda x, t, rng: _drawn(root, x.shape[1:], rng)


def _drawn(root: Array, shape: tuple[int, ...], rng: Generator) -> Array:
    """Return draws of N(0, root root^T), shape (len(root), *shape)."""
    drawn = root @ rng.standard_normal((root.shape[1], math.prod(shape)))
    return drawn.reshape((len(root),) + shape)


def _roots(sensor: Sensor, times: Array) -> Array:
    """Return the root of a sensor's covariance at each of some times, (len(times), m, m)."""
    if callable(sensor.covariance):
        return np.array([_root(sensor.noise(t)) for t in times])
    root = _root(sensor.noise(0.0))
    return np.broadcast_to(root, (len(times),) + root.shape)


def _root(covariance: Array) -> Array:
    """Return what makes draws of a covariance out of independent ones."""
    try:
        return np.asarray(np.linalg.cholesky(covariance), dtype=float)
    except np.linalg.LinAlgError:
        return spectral_root(covariance)
