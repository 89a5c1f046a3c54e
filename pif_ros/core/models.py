"""How the world moves, and how it is seen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import check_covariance

Array = NDArray[np.float64]
Field = Callable[[Array, float], Array]
Matrix = Array | Callable[[float], Array]


@dataclass(frozen=True, eq=False)
class StateModel:
    """
    The stochastic differential equation dx = f(x, t) dt + e(t) dv  [TM, Eq. 65].

    names: one per state; drift: f(x, t) maps states (n, ...) to (n, ...) per second; vielbein: e,
    an (n, p) matrix or a function of t in seconds; noise_covariance: Q of dv per second, (p, p) or
    a function of t, the unit matrix where none is given; drift_jacobian: df_i/dx_j, (n, n, ...),
    taken by central differences where none is given; time_dependent: whether f depends on t (e
    and Q do where they are functions); units: one per state, for the reader.
    """

    names: tuple[str, ...]
    drift: Field
    vielbein: Matrix
    noise_covariance: Matrix | None = None
    drift_jacobian: Field | None = None
    time_dependent: bool = False
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a constant e or Q that does not fit the states, or is none."""
        columns = None
        if not callable(self.vielbein):
            e = np.asarray(self.vielbein, dtype=float)
            if e.ndim != 2 or len(e) != self.ndim or not np.all(np.isfinite(e)):
                raise ValueError(f'vielbein: expected {self.ndim} rows of finite numbers, one for '
                                 f'each state, got {e.tolist()}')
            columns = e.shape[1]
        if self.noise_covariance is not None and not callable(self.noise_covariance):
            Q = np.asarray(self.noise_covariance, dtype=float)
            check_covariance('noise_covariance', Q, len(Q) if columns is None else columns)

    @property
    def ndim(self) -> int:
        """Return the number of states."""
        return len(self.names)

    @property
    def changes_with_time(self) -> bool:
        """Return whether a kernel of this model holds at one time only."""
        return self.time_dependent or callable(self.vielbein) or callable(self.noise_covariance)

    def diffusion(self, t: float) -> Array:
        """Return the diffusion matrix g = e Q e^T at time t, shape (n, n)  [TM, Eq. 93]."""
        e = np.atleast_2d(_at(self.vielbein, t))
        Q = np.eye(e.shape[1]) if self.noise_covariance is None else np.atleast_2d(
            _at(self.noise_covariance, t))
        return e @ Q @ e.T

    def jacobian(self, x: Array, t: float) -> Array:
        """Return df_i/dx_j at states (n, ...), shape (n, n, ...)."""
        if self.drift_jacobian is not None:
            return np.asarray(self.drift_jacobian(x, t), dtype=float)
        return central_differences(lambda y: self.drift(y, t), x)


@dataclass(frozen=True, eq=False)
class Sensor:
    """
    A measurement y = h(x, t) + w, w ~ N(0, R)  [Sensors, Eq. 7].

    function: h(x, t) maps states (n, ...) to measurements (m, ...); covariance: R, (m, m) or a
    function of t; angular: which components are angles in radians, compared on the circle;
    time_dependent: whether h depends on t.
    """

    function: Field
    covariance: Matrix
    angular: tuple[bool, ...] = ()
    time_dependent: bool = False

    def __post_init__(self) -> None:
        """Refuse a constant R that is no covariance."""
        if not callable(self.covariance):
            R = np.atleast_2d(np.asarray(self.covariance, dtype=float))
            check_covariance('covariance', R, len(R))
            object.__setattr__(self, 'covariance', R)
            if self.angular and len(self.angular) != len(R):
                raise ValueError(f'angular: expected {len(R)} values, one for each component, '
                                 f'got {len(self.angular)}')

    @cached_property
    def size(self) -> int:
        """Return m, the number of components of a measurement."""
        return len(self.noise(0.0))

    def noise(self, t: float) -> Array:
        """Return R at time t, shape (m, m)."""
        return np.atleast_2d(_at(self.covariance, t))

    def residual(self, y: ArrayLike, expected: Array) -> Array:
        """Return y - h for expected measurements h (m, ...), angles the short way round."""
        shape = (-1,) + (1,) * (expected.ndim - 1)
        return self.difference(np.asarray(y, dtype=float).reshape(shape), expected)

    def difference(self, a: Array, b: Array) -> Array:
        """Return a - b of measurements (m, ...), angles the short way round."""
        v = a - b
        for i in np.flatnonzero(self.angular):
            v[i] = (v[i] + np.pi) % (2 * np.pi) - np.pi
        return v

    def log_likelihood(self, y: ArrayLike, expected: Array, t: float = 0.0) -> Array:
        """Return log p(y | h) for expected measurements h (m, ...)  [Sensors, Eq. 8]."""
        v, R = self.residual(y, expected), self.noise(t)
        if len(R) == 1:
            square = v[0] * v[0]
            square *= -0.5 / R[0, 0]
        else:
            whitened = np.tensordot(np.linalg.inv(np.linalg.cholesky(R)), v, axes=1)
            square = -0.5 * np.einsum('i...,i...->...', whitened, whitened)
        square += self.log_peak(t)
        return square

    def log_peak(self, t: float) -> float:
        """Return the log likelihood of a measurement that is just as expected."""
        return -0.5 * float(np.linalg.slogdet(2 * np.pi * self.noise(t))[1])

    def jacobian(self, x: Array, t: float) -> Array:
        """Return dh_i/dx_j at states (n, ...) by central differences, shape (m, n, ...)."""
        return central_differences(lambda z: self.function(z, t), x, self.difference)


def central_differences(function: Callable[[Array], Array], x: Array,
                        minus: Callable[[Array, Array], Array] = np.subtract) -> Array:
    """
    Return d function_i / dx_j, shape (m, n, ...).

    The step, cbrt(1e-16 max(|x|, 1)), is long against the rounding of x and short against
    whatever a function does over a unit, also far from the origin.
    """
    x = np.asarray(x, dtype=float)
    columns = []
    for j in range(len(x)):
        step = np.cbrt(np.finfo(float).eps * np.maximum(np.abs(x[j]), 1.0))
        up, down = x.copy(), x.copy()
        up[j] += step
        down[j] -= step
        columns.append(minus(function(up), function(down)) / (up[j] - down[j]))
    return np.stack(columns, axis=1)


def _at(matrix: Matrix, t: float) -> Array:
    return np.asarray(matrix(t) if callable(matrix) else matrix, dtype=float)
