"""Systems of robots, and the sensors that they carry; metres and radians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems.system import positive, room, System, white

Array = NDArray[np.float64]


def position_2d(diffusion: float = 1.0) -> System:
    """Random walk in the plane, diffusion in m / sqrt(s), seen by range, bearing or position."""
    e = positive('diffusion', diffusion) * np.eye(2)
    model = StateModel(('x', 'y'), lambda x, t: np.zeros_like(x), e,
                       drift_jacobian=lambda x, t: np.zeros((2,) + x.shape), units=('m', 'm'))
    return System(model, {'position': position_sensor, 'range': range_sensor,
                          'bearing': bearing_sensor})


def unicycle_2d(sigma_position: float = 0.1, sigma_heading: float = 0.1) -> System:
    """
    Robot in the plane that drives where it heads: control v in m/s and omega in rad/s.

    theta: heading in radians from the x axis of the map, to be a periodic axis of the grid from
    -pi to pi; sigma_position in m / sqrt(s) on x and on y, sigma_heading in rad / sqrt(s): what
    the motion is not sure of.
    """
    p, h = positive('sigma_position', sigma_position), positive('sigma_heading', sigma_heading)

    def drift(x: Array, u: Array, t: float) -> Array:
        f = room(x)
        f[0], f[1], f[2] = u[0] * np.cos(x[2]), u[0] * np.sin(x[2]), u[1]
        return f

    def jacobian(x: Array, u: Array, t: float) -> Array:
        D = np.zeros((3,) + np.shape(x))
        D[0, 2], D[1, 2] = -u[0] * np.sin(x[2]), u[0] * np.cos(x[2])
        return D

    model = StateModel(('x', 'y', 'theta'), drift, np.diag([p, p, h]), drift_jacobian=jacobian,
                       units=('m', 'm', 'rad'), inputs=('v', 'omega'), homogeneous=(0, 1),
                       angles=(2,))
    return System(model, {'position': position_sensor, 'range': range_sensor,
                          'bearing': bearing_sensor, 'heading': heading_sensor,
                          'relative_bearing': relative_bearing_sensor})


def range_sensor(landmark: Sequence[float], sigma: float, scale: float = 1.0,
                 bias: float = 0.0) -> Sensor:
    """Distance to a landmark (x, y) in metres: y = scale * distance + bias + sigma w."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (scale * np.hypot(x[0] - x0, x[1] - y0) + bias)[None],
                  white('sigma', sigma, 1), states=(0, 1))


def bearing_sensor(landmark: Sequence[float], sigma: float, bias: float = 0.0) -> Sensor:
    """Direction in which a landmark (x, y) is seen, in radians from the x axis of the map."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (np.arctan2(y0 - x[1], x0 - x[0]) + bias)[None],
                  white('sigma', sigma, 1), angular=(True,), states=(0, 1))


def position_sensor(sigma: float) -> Sensor:
    """Both coordinates in metres, as a satellite receiver gives them."""
    return Sensor(lambda x, t: x[:2], white('sigma', sigma, 2), states=(0, 1))


def heading_sensor(sigma: float, bias: float = 0.0) -> Sensor:
    """Heading in radians from the x axis of the map, as a compass gives it."""
    return Sensor(lambda x, t: x[2:3] + bias, white('sigma', sigma, 1), angular=(True,),
                  states=(2,))


def relative_bearing_sensor(landmark: Sequence[float], sigma: float, bias: float = 0.0) -> Sensor:
    """Direction in which a landmark (x, y) is seen, in radians from where the robot heads."""
    x0, y0 = _point(landmark)
    return Sensor(lambda x, t: (np.arctan2(y0 - x[1], x0 - x[0]) - x[2] + bias)[None],
                  white('sigma', sigma, 1), angular=(True,), states=(0, 1, 2))


def _point(landmark: Sequence[float]) -> tuple[float, float]:
    point = np.asarray(landmark)
    if point.shape != (2,) or point.dtype.kind not in 'iuf' or not np.all(np.isfinite(point)):
        given = list(landmark) if isinstance(landmark, tuple) else landmark
        raise ValueError(f'landmark: expected 2 finite numbers, got {given}')
    return float(landmark[0]), float(landmark[1])
