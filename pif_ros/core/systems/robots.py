"""Systems of robots, and the sensors that they carry; metres and radians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems.system import positive, System, white


def position_2d(diffusion: float = 1.0) -> System:
    """Random walk in the plane, diffusion in m / sqrt(s), seen by range, bearing or position."""
    e = positive('diffusion', diffusion) * np.eye(2)
    model = StateModel(('x', 'y'), lambda x, t: np.zeros_like(x), e,
                       drift_jacobian=lambda x, t: np.zeros((2,) + x.shape), units=('m', 'm'))
    return System(model, {'position': position_sensor, 'range': range_sensor,
                          'bearing': bearing_sensor})


def range_sensor(landmark: Sequence[float], sigma: float, scale: float = 1.0,
                 bias: float = 0.0) -> Sensor:
    """Distance to a landmark (x, y) in metres: y = scale * distance + bias + sigma w."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (scale * np.hypot(x[0] - x0, x[1] - y0) + bias)[None],
                  white('sigma', sigma, 1))


def bearing_sensor(landmark: Sequence[float], sigma: float, bias: float = 0.0) -> Sensor:
    """Direction in which a landmark (x, y) is seen, in radians from the x axis of the map."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (np.arctan2(y0 - x[1], x0 - x[0]) + bias)[None],
                  white('sigma', sigma, 1), angular=(True,))


def position_sensor(sigma: float) -> Sensor:
    """Both coordinates in metres, as a satellite receiver gives them."""
    return Sensor(lambda x, t: x[:2], white('sigma', sigma, 2))


def _point(landmark: Sequence[float]) -> tuple[float, float]:
    point = np.asarray(landmark)
    if point.shape != (2,) or point.dtype.kind not in 'iuf' or not np.all(np.isfinite(point)):
        raise ValueError(f'landmark: expected 2 finite numbers, got {landmark}')
    return float(landmark[0]), float(landmark[1])
