"""Systems of several states: the papers' examples, and chaos with noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems.system import Array, finite, positive, room, System, white

#: Where the off-diagonal vielbein of multiplicative_4d has a sine (0) or a cosine (1), and of
#: which state: row, column, which, state  [Sensors, Eq. 33].
_TURNS = (
    (0, 1, 0, 1), (0, 2, 1, 2), (0, 3, 0, 3),
    (1, 0, 0, 3), (1, 2, 1, 2), (1, 3, 0, 0),
    (2, 0, 1, 0), (2, 1, 0, 3), (2, 3, 1, 2),
    (3, 0, 0, 0), (3, 1, 1, 1), (3, 2, 0, 2))


def cubic_bearing(sigma_x1: float = 0.001, sigma_x2: float = 0.03,
                  sigma_y: float = 0.2) -> System:
    """Thin noise, dx1 = (9.16 x2 - 189 x2^3) dt + ..., dx2 = -dt / 3 + ...  [Sensors, Eq. 28]."""
    def drift(x: Array, t: float) -> Array:
        f, x2 = room(x), x[1]
        f[0] = x2 * (9.16 - 189 * x2 * x2)
        f[1] = -1 / 3
        return f

    def jacobian(x: Array, t: float) -> Array:
        slope = np.zeros((2,) + x.shape)
        slope[0, 1] = 9.16 - 567 * x[1] * x[1]
        return slope

    e = np.diag([positive('sigma_x1', sigma_x1), positive('sigma_x2', sigma_x2)])
    # y = arcsin(x2 / sqrt(x1^2 + x2^2)) + sigma_y w, 0 at the origin  [Sensors, Eq. 29]
    return System(StateModel(('x1', 'x2'), drift, e, drift_jacobian=jacobian), {
        'arcsine': _seen(lambda x: np.arctan2(x[1], np.abs(x[0]))[None], sigma_y, 1)})


def coupled_trigonometric(sigma_x: float = 1.0, sigma_y: float = 1.0) -> System:
    """Coupled drifts, both signs unseen, y_i = x_i^2 + sigma_y w_i  [Sensors, Eqs. 31, 32]."""
    def drift(x: Array, t: float) -> Array:
        f = room(x)
        f[0] = np.cos(x[0]) - x[1]
        f[1] = np.sin(x[1]) + x[0]
        return f

    def jacobian(x: Array, t: float) -> Array:
        slope = np.ones((2,) + x.shape)
        slope[0, 0], slope[0, 1], slope[1, 1] = -np.sin(x[0]), -1, np.cos(x[1])
        return slope

    e = positive('sigma_x', sigma_x) * np.eye(2)
    return System(StateModel(('x1', 'x2'), drift, e, drift_jacobian=jacobian),
                  {'squares': _seen(lambda x: x * x, sigma_y, 2)})


def multiplicative_4d(sigma_y: float = 1.0) -> System:
    """Four coupled states whose noise, full and 5 strong, depends on them  [Sensors, Eq. 33]."""
    def drift(x: Array, t: float) -> Array:
        f, (x1, x2, x3, x4) = room(x), x
        f[0] = x2 - x1
        f[1] = x1 * (1 - x3) - x2
        f[2] = x1 * x2 - x3
        f[3] = (1 - x2) * x3 - x4
        return f

    def jacobian(x: Array, t: float) -> Array:
        slope, (x1, x2, x3, _) = np.zeros((4,) + x.shape), x
        slope[0, 0] = slope[1, 1] = slope[2, 2] = slope[3, 3] = -1
        slope[0, 1], slope[1, 0], slope[1, 2] = 1, 1 - x3, -x1
        slope[2, 0], slope[2, 1], slope[3, 1], slope[3, 2] = x2, x1, -x3, 1 - x2
        return slope

    model = StateModel(('x1', 'x2', 'x3', 'x4'), drift, _vielbein_4d, drift_jacobian=jacobian,
                       multiplicative=True, vielbein_jacobian=_vielbein_jacobian_4d)
    return System(model, {
        'trigonometric': _seen(_trigonometric, sigma_y, 4),
        'inverse_trigonometric': lambda c=0.1: _inverse_trigonometric(c, sigma_y)})


def lorenz_63(sigma: float = 10.0, rho: float = 28.0, beta: float = 8 / 3, sigma_x: float = 4.0,
              sigma_y: float = 2.0) -> System:
    """Lorenz's convection with noise sigma_x on each state; y = x1 + sigma_y w, or all three."""
    sigma, rho, beta = finite('sigma', sigma), finite('rho', rho), finite('beta', beta)

    # dx1 = sigma (x2 - x1) dt, dx2 = (x1 (rho - x3) - x2) dt, dx3 = (x1 x2 - beta x3) dt
    # [Lorenz 1963, Eqs. 25-27]
    def drift(x: Array, t: float) -> Array:
        f, (x1, x2, x3) = room(x), x
        f[0] = sigma * (x2 - x1)
        f[1] = x1 * (rho - x3) - x2
        f[2] = x1 * x2 - beta * x3
        return f

    def jacobian(x: Array, t: float) -> Array:
        slope, (x1, x2, x3) = np.zeros((3,) + x.shape), x
        slope[0, 0], slope[0, 1] = -sigma, sigma
        slope[1, 0], slope[1, 1], slope[1, 2] = rho - x3, -1, -x1
        slope[2, 0], slope[2, 1], slope[2, 2] = x2, x1, -beta
        return slope

    e = positive('sigma_x', sigma_x) * np.eye(3)
    return System(StateModel(('x1', 'x2', 'x3'), drift, e, drift_jacobian=jacobian), {
        'first': _seen(lambda x: x[:1], sigma_y, 1, (0,)),
        'position': _seen(lambda x: x, sigma_y, 3)})


def _vielbein_4d(x: Array, t: float) -> Array:
    """Return e of multiplicative_4d at states (4, ...), shape (4, 4, ...)  [Sensors, Eq. 33]."""
    e = np.empty((4,) + x.shape, np.result_type(x, 1.0))
    turns = np.sin(x), np.cos(x)
    for row, column, which, state in _TURNS:
        e[row, column] = turns[which][state]
    for i, inner in enumerate(_diagonal(x)):
        e[i, i] = 5 + 0.1 * np.tanh(inner)
    return e


def _vielbein_jacobian_4d(x: Array, t: float) -> Array:
    """Return de_ia/dx_j of multiplicative_4d at states (4, ...), shape (4, 4, 4, ...)."""
    slope = np.zeros((4, 4) + x.shape)
    turned = np.cos(x), -np.sin(x)
    for row, column, which, state in _TURNS:
        slope[row, column, state] = turned[which][state]
    tangents = [0.1 * (1 - np.tanh(inner)**2) for inner in _diagonal(x)]
    for i, (up, down) in enumerate(((0, None), (1, 2), (2, 3), (0, 3))):
        slope[i, i, up] = tangents[i]
        if down is not None:
            slope[i, i, down] = -tangents[i]
    slope[0, 0, 1] = tangents[0]
    slope[1, 1, 2] *= 2 * x[2]
    return slope


def _diagonal(x: Array) -> tuple[Array, Array, Array, Array]:
    """Return what the hyperbolic tangents of d_1 to d_4 are taken of  [Sensors, Eq. 33]."""
    return x[0] + x[1], x[1] - x[2] * x[2], x[2] - x[3], x[0] - x[3]


def _trigonometric(x: Array) -> Array:
    """Return h at states (4, ...), shape (4, ...)  [Sensors, Eq. 34]."""
    h, (x1, x2, x3, x4) = room(x), x
    h[0], h[1] = np.sin(x1 + x2), np.cos(x2 - x3)
    h[2], h[3] = np.sin(x3 + x4), np.sin(x4 - x1)
    return h


def _inverse_trigonometric(c: float, sigma_y: float) -> Sensor:
    """Return the sensor of the inverse functions, c strong  [Sensors, Eq. 35]."""
    c = finite('c', c)

    def function(x: Array) -> Array:
        h, (x1, _, x3, x4) = room(x), x
        h[0] = np.arctan(np.hypot(x1, x3))
        # arccos(x1 / sqrt(1 + x1^2 + x4^2)) and arcsin(x4 / sqrt(1 + x3^2 + x4^2)), as angles of
        # triangles, which lose no digits near 0 and pi
        h[1] = np.arctan2(np.hypot(1.0, x4), x1)
        h[2] = np.arctan2(x4, np.hypot(1.0, x3))
        h[3] = np.arctan(1 + x4 * x4 + np.sin(x1)**2)
        h *= c
        return h

    return _seen(function, sigma_y, 4, (0, 2, 3))()


def _seen(h: Callable[[Array], Array], sigma_y: float, size: int,
          states: tuple[int, ...] | None = None) -> Callable[[], Sensor]:
    """Return what makes the sensor of h(x), of some states or all, with noises sigma_y."""
    R = white('sigma_y', sigma_y, size)
    return lambda: Sensor(lambda x, t: h(x), R, states=states)
