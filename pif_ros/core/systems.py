"""
Named systems: state models with the sensors that see them.

A system is a function of its constants, by the papers' own names, that returns a System.  An
installed package adds its own through entry points of group ``pif_ros.systems``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

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


def wiener(sigma: float = 1.0, sigma_y: float = 1.0) -> System:
    """Brownian motion, dx = sigma dv  [TM, Eq. 122]; y = x + sigma_y w."""
    return _scalar(np.zeros_like, np.zeros_like, sigma, {'position': _direct(sigma_y)})


def ornstein_uhlenbeck(a: float = 1.0, sigma: float = 1.0, sigma_y: float = 0.5) -> System:
    """Return to the origin, dx = -a x dt + sigma dv; y = x + sigma_y w."""
    return _scalar(lambda x: -a * x, lambda x: np.full_like(x, -a), sigma,
                   {'position': _direct(sigma_y)})


def benes(sigma_y: float = 1.0) -> System:
    """Nonlinear drift with an exact filter, dx = tanh(x) dt + dv; y = x + sigma_y w."""
    return _scalar(np.tanh, lambda x: 1 - np.tanh(x)**2, 1.0, {'position': _direct(sigma_y)})


def double_well(sigma: float = 0.1, sigma_y: float = 0.1) -> System:
    """Two wells, dx = -4 x (x^2 - 1) dt + sigma dv  [TM, Eq. 124]; y = x + sigma_y w."""
    return _scalar(lambda x: -4 * x * (x**2 - 1), lambda x: 4 - 12 * x**2, sigma,
                   {'position': _direct(sigma_y)})


def cosine_drift(sigma: float = 0.3, sigma_y: float = 0.1) -> System:
    """Periodic drift, dx = 1.2 cos(3 x) dt + sigma dv  [TM, Eq. 125]; y = x + sigma_y w."""
    return _scalar(lambda x: 1.2 * np.cos(3 * x), lambda x: -3.6 * np.sin(3 * x), sigma,
                   {'position': _direct(sigma_y)})


def sine_cubic_drift(sigma: float = 3.0, sigma_y: float = 1.0) -> System:
    """Sign unseen, dx = -sin(x (x^2 - 1)) dt + sigma dv; y = x^2 + sigma_y w  [TM, Eq. 126]."""
    return _scalar(lambda x: -np.sin(x * (x**2 - 1)),
                   lambda x: -np.cos(x * (x**2 - 1)) * (3 * x**2 - 1), sigma,
                   {'square': _squares(sigma_y, 1)})


def coupled_trigonometric(sigma_x: float = 1.0, sigma_y: float = 1.0) -> System:
    """Coupled drifts, both signs unseen, y_i = x_i^2 + sigma_y w_i  [Sensors, Eqs. 31, 32]."""
    def drift(x: Array, t: float) -> Array:
        return np.stack([-x[1] + np.cos(x[0]), x[0] + np.sin(x[1])])

    def jacobian(x: Array, t: float) -> Array:
        one = np.ones_like(x[0])
        return np.stack([np.stack([-np.sin(x[0]), -one]), np.stack([one, np.cos(x[1])])])

    e = _positive('sigma_x', sigma_x) * np.eye(2)
    return System(StateModel(('x1', 'x2'), drift, e, drift_jacobian=jacobian),
                  {'squares': _squares(sigma_y, 2)})


def position_2d(diffusion: float = 1.0) -> System:
    """Random walk in the plane, diffusion in m / sqrt(s), seen by range, bearing or position."""
    e = _positive('diffusion', diffusion) * np.eye(2)
    model = StateModel(('x', 'y'), lambda x, t: np.zeros_like(x), e,
                       drift_jacobian=lambda x, t: np.zeros((2,) + x.shape), units=('m', 'm'))
    return System(model, {'position': position_sensor, 'range': range_sensor,
                          'bearing': bearing_sensor})


def range_sensor(landmark: Sequence[float], sigma: float, scale: float = 1.0,
                 bias: float = 0.0) -> Sensor:
    """Distance to a landmark (x, y) in metres: y = scale * distance + bias + sigma w."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (scale * np.hypot(x[0] - x0, x[1] - y0) + bias)[None],
                  _positive('sigma', sigma)**2 * np.eye(1))


def bearing_sensor(landmark: Sequence[float], sigma: float, bias: float = 0.0) -> Sensor:
    """Direction in which a landmark (x, y) is seen, in radians from the x axis of the map."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (np.arctan2(y0 - x[1], x0 - x[0]) + bias)[None],
                  _positive('sigma', sigma)**2 * np.eye(1), angular=(True,))


def position_sensor(sigma: float) -> Sensor:
    """Both coordinates in metres, as a satellite receiver gives them."""
    return Sensor(lambda x, t: x[:2], _positive('sigma', sigma)**2 * np.eye(2))


SYSTEMS: Mapping[str, Callable[..., System]] = {
    system.__name__: system for system in (
        wiener, ornstein_uhlenbeck, benes, double_well, cosine_drift, sine_cubic_drift,
        coupled_trigonometric, position_2d)}


def _scalar(f: Callable[[Array], Array], slope: Callable[[Array], Array], sigma: float,
            sensors: Mapping[str, Callable[..., Sensor]]) -> System:
    model = StateModel(('x',), lambda x, t: f(x), _positive('sigma', sigma) * np.eye(1),
                       drift_jacobian=lambda x, t: slope(x)[None])
    return System(model, sensors)


def _direct(sigma_y: float) -> Callable[[], Sensor]:
    R = _positive('sigma_y', sigma_y)**2 * np.eye(1)
    return lambda: Sensor(lambda x, t: x, R)


def _squares(sigma_y: float, size: int) -> Callable[[], Sensor]:
    R = _positive('sigma_y', sigma_y)**2 * np.eye(size)
    return lambda: Sensor(lambda x, t: x**2, R)


def _positive(name: str, value: float) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
            1e-150 < value < 1e150):
        raise ValueError(f'{name}: expected a positive number, got {value}')
    return float(value)


def _point(landmark: Sequence[float]) -> tuple[float, float]:
    point = np.asarray(landmark)
    if point.shape != (2,) or point.dtype.kind not in 'iuf' or not np.all(np.isfinite(point)):
        raise ValueError(f'landmark: expected 2 finite numbers, got {landmark}')
    return float(landmark[0]), float(landmark[1])
