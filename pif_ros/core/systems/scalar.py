"""Systems of one state: the papers' examples, and those with an exact answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems.system import Array, finite, positive, System, white


def wiener(sigma: float = 1.0, sigma_y: float = 1.0) -> System:
    """Brownian motion, dx = sigma dv  [TM, Eq. 122]; y = x + sigma_y w."""
    return _scalar(np.zeros_like, np.zeros_like, 'sigma', sigma, {'position': _direct(sigma_y)})


def ornstein_uhlenbeck(a: float = 1.0, sigma: float = 1.0, sigma_y: float = 0.5) -> System:
    """Return to the origin, dx = -a x dt + sigma dv; y = x + sigma_y w."""
    return _scalar(lambda x: -a * x, lambda x: np.full_like(x, -a), 'sigma', sigma,
                   {'position': _direct(sigma_y)})


def benes(sigma_y: float = 1.0) -> System:
    """Nonlinear drift with an exact filter, dx = tanh(x) dt + dv; y = x + sigma_y w."""
    return _scalar(np.tanh, lambda x: 1 - np.tanh(x)**2, 'sigma', 1.0,
                   {'position': _direct(sigma_y)})


def double_well(sigma: float = 0.1, sigma_y: float = 0.1) -> System:
    """Two wells, dx = -4 x (x^2 - 1) dt + sigma dv  [TM, Eq. 124]; y = x + sigma_y w."""
    return _scalar(lambda x: -4 * x * (x * x - 1), lambda x: 4 - 12 * x * x, 'sigma', sigma,
                   {'position': _direct(sigma_y)})


def cosine_drift(sigma: float = 0.3, sigma_y: float = 0.1) -> System:
    """Periodic drift, dx = 1.2 cos(3 x) dt + sigma dv  [TM, Eq. 125]; y = x + sigma_y w."""
    return _scalar(lambda x: 1.2 * np.cos(3 * x), lambda x: -3.6 * np.sin(3 * x), 'sigma', sigma,
                   {'position': _direct(sigma_y)})


def sine_cubic_drift(sigma: float = 3.0, sigma_y: float = 1.0) -> System:
    """Sign unseen, dx = -sin(x (x^2 - 1)) dt + sigma dv; y = x^2 + sigma_y w  [TM, Eq. 126]."""
    return _scalar(lambda x: -np.sin(x * (x * x - 1)),
                   lambda x: -np.cos(x * (x * x - 1)) * (3 * x * x - 1), 'sigma', sigma,
                   {'square': _seen(lambda x: x * x, sigma_y)})


def arctangent_sensor(a: float = 1.2, b: float = 3.0, sigma_x: float = 0.3,
                      sigma_y: float = 0.05) -> System:
    """See a path: dx = a cos(b x) dt + sigma_x dv, dy = arctan(x) dt + sigma_y dw  [PMC, 40]."""
    a, b = finite('a', a), finite('b', b)
    return _scalar(lambda x: a * np.cos(b * x), lambda x: -a * b * np.sin(b * x), 'sigma_x',
                   sigma_x, {'arctangent': _seen(np.arctan, sigma_y)})


def cubic_sensor(sigma_x: float = 1.0, sigma_y: float = 1.0) -> System:
    """Measure a path, flat at 0: dx = sigma_x dv, dy = x^3 dt + sigma_y dw  [PMC, 42]."""
    return _scalar(np.zeros_like, np.zeros_like, 'sigma_x', sigma_x,
                   {'cube': _seen(lambda x: x * x * x, sigma_y)})


def geometric_brownian_motion(mu: float = 0.1, sigma: float = 0.3,
                              sigma_y: float = 0.1) -> System:
    """Noise in proportion to x > 0, dx = mu x dt + sigma x dv; y = log(x) + sigma_y w."""
    mu, sigma = finite('mu', mu), positive('sigma', sigma)
    model = StateModel(('x',), lambda x, t: mu * x, lambda x, t: sigma * x[None],
                       drift_jacobian=lambda x, t: np.full_like(x, mu)[None], multiplicative=True,
                       vielbein_jacobian=lambda x, t: np.full_like(x, sigma)[None, None])
    return System(model, {'logarithm': _seen(_logarithm, sigma_y), 'position': _direct(sigma_y)})


def _scalar(f: Callable[[Array], Array], slope: Callable[[Array], Array], name: str, sigma: float,
            sensors: Mapping[str, Callable[..., Sensor]]) -> System:
    """Return dx = f(x) dt + sigma dv with its sensors; name: what sigma is called."""
    model = StateModel(('x',), lambda x, t: f(x), positive(name, sigma) * np.eye(1),
                       drift_jacobian=lambda x, t: slope(x)[None])
    return System(model, sensors)


def _direct(sigma_y: float) -> Callable[[], Sensor]:
    return _seen(lambda x: x, sigma_y)


def _seen(h: Callable[[Array], Array], sigma_y: float) -> Callable[[], Sensor]:
    """Return what makes the sensor of h(x), with sigma_y^2 as R, or per second of a path."""
    R = white('sigma_y', sigma_y, 1)
    return lambda: Sensor(lambda x, t: h(x), R)


def _logarithm(x: Array) -> Array:
    # what no path reaches has no likelihood
    with np.errstate(divide='ignore', invalid='ignore'):
        return np.asarray(np.log(x))
