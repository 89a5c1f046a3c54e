"""How the world moves, and how it is seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import check_covariance

Array = NDArray[np.float64]
Field = Callable[[Array, float], Array]
#: A field of (x, t), or of (x, u, t) where there are inputs.
Driven = Callable[..., Array]
Matrix = Array | Callable[[float], Array]

#: A function is taken to change over so many cells, or standard deviations, but a unit at most.
WIDTHS = 100.0
#: Standard deviations of an angle's noise beyond which more than 0.2 % lie past half a turn.
WIDEST_ANGLE = 1.0


@dataclass(frozen=True, eq=False)
class StateModel:
    """
    The stochastic differential equation dx = f(x, t) dt + e(x, t) dv  [Sensors, Eq. 1].

    names: one per state; drift: f(x, t) maps states (n, ...) to (n, ...) per second; vielbein: e,
    an (n, p) matrix or a function of t in seconds, or, where multiplicative, a function of (x, t)
    that maps states (n, ...) to (n, p, ...); noise_covariance: Q of dv per second, (p, p) or a
    function of t, the unit matrix where none is given; drift_jacobian: df_i/dx_j, (n, n, ...), and
    vielbein_jacobian: de_ia/dx_j, (n, p, n, ...), both taken by central differences where none is
    given; time_dependent: whether f, or a multiplicative e, depends on t (other functions do);
    period: seconds after which all that depends on time comes again, 0 for never, so that kernels
    of the same phase are made once; s: the sense of multiplicative noise, for which e is taken at
    x' + s (x'' - x') of a step from x' to x'': 0 is Ito's, 1/2 Stratonovich's; units: one per
    state, for the reader; inputs: the names of the components of a control u, and where there are
    any, the drift is f(x, u, t) with u (m,), its Jacobian likewise, and under(u) is the model that
    can be asked for them; homogeneous: the states that the drift does not depend on; scale: the
    lengths, one per state, over which f and e change where their derivatives are taken by central
    differences, 1 for each where none is given; angles: the states that are angles in radians, the
    same after a full turn.
    """

    names: tuple[str, ...]
    drift: Driven
    vielbein: Matrix | Field
    noise_covariance: Matrix | None = None
    drift_jacobian: Driven | None = None
    time_dependent: bool = False
    units: tuple[str, ...] = ()
    multiplicative: bool = False
    vielbein_jacobian: Field | None = None
    s: float = 0.0
    period: float = 0.0
    inputs: tuple[str, ...] = ()
    homogeneous: tuple[int, ...] = ()
    scale: tuple[float, ...] = ()
    angles: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        """Refuse a constant e or Q that does not fit the states, or is none."""
        columns = None
        for name in ('homogeneous', 'angles'):
            given = getattr(self, name)
            if any(not 0 <= i < self.ndim for i in given):
                raise ValueError(f'{name}: expected numbers of states, 0 to {self.ndim - 1}, '
                                 f'got {list(given)}')
        if self.scale and (len(self.scale) != self.ndim or not all(v > 0 for v in self.scale)):
            raise ValueError(f'scale: expected {self.ndim} positive lengths, one for each state, '
                             f'got {list(self.scale)}')
        if not 0 <= self.period < np.inf:
            raise ValueError(f'period: expected seconds, 0 or more, got {self.period!r}')
        if not 0 <= self.s <= 1:
            raise ValueError(f's: expected a number from 0 to 1, got {self.s!r}')
        if self.multiplicative and not callable(self.vielbein):
            raise ValueError('vielbein: expected a function of (x, t) where the noise is '
                             f'multiplicative, got {np.asarray(self.vielbein).tolist()}')
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

    def under(self, u: Sequence[float]) -> StateModel:
        """
        Return the plain model under a constant control u (m,); an empty u stands for zeros.

        A model without inputs is that itself.  Raises ValueError for another number of components.
        """
        return self if not self.inputs else self._under(tuple(map(float, u)))

    @cached_property
    def _under(self) -> Callable[[tuple[float, ...]], StateModel]:
        # steps of one interval ask for the same again and again
        return lru_cache(maxsize=16)(self._made_under)

    def _made_under(self, u: tuple[float, ...]) -> StateModel:
        if u and len(u) != len(self.inputs):
            raise ValueError(f'u: expected {len(self.inputs)} components ('
                             f'{", ".join(self.inputs)}), got {len(u)}')
        value, f, slope = np.array(u or (0.0,) * len(self.inputs)), self.drift, self.drift_jacobian
        return replace(self, drift=lambda x, t: f(x, value, t), inputs=(),
                       drift_jacobian=slope and (lambda x, t: slope(x, value, t)))

    def at_scale(self, widths: ArrayLike) -> StateModel:
        """Return the model whose derivatives hold on cells, or deviations, of widths (n,)."""
        if self.drift_jacobian is not None and not self.noise_bends:
            return self
        given = self.scale or (1.0,) * self.ndim
        scale = tuple(np.fmin(given, WIDTHS * np.asarray(widths, dtype=float)).tolist())
        return self if scale == given else replace(self, scale=scale)

    @property
    def changes_with_time(self) -> bool:
        """Return whether a kernel of this model holds at one time only."""
        return (self.time_dependent or callable(self.noise_covariance)
                or callable(self.vielbein) and not self.multiplicative)

    @property
    def noise_bends(self) -> bool:
        """Return whether the sense of the noise matters: e depends on x, and s is not 0."""
        return self.multiplicative and self.s > 0

    def noise(self, t: float) -> Array:
        """Return Q at time t, shape (p, p)."""
        if self.noise_covariance is not None:
            return np.atleast_2d(_at(self.noise_covariance, t))
        origin = np.zeros((self.ndim, 1))
        return np.eye(self.vielbein_at(origin, t).shape[1])

    def vielbein_at(self, x: Array, t: float) -> Array:
        """Return e at states (n, ...), shape (n, p, ...)."""
        if self.multiplicative:
            return np.asarray(self.vielbein(x, t), dtype=float)  # type: ignore
        e = np.atleast_2d(_at(self.vielbein, t))  # type: ignore[arg-type]
        rest = np.shape(x)[1:]
        return np.broadcast_to(e.reshape(e.shape + (1,) * len(rest)), e.shape + rest)

    def diffusion(self, t: float) -> Array:
        """Return g = e Q e^T of additive noise at time t, shape (n, n)  [TM, Eq. 93]."""
        e = np.atleast_2d(_at(self.vielbein, t))  # type: ignore[arg-type]
        return e @ self.noise(t) @ e.T

    def diffusion_at(self, x: Array, t: float) -> Array:
        """Return g = e Q e^T at states (n, ...), shape (n, n, ...)  [Sensors, Eq. 17]."""
        rest = np.shape(x)[1:]
        if not self.multiplicative:
            g = self.diffusion(t)
            return np.broadcast_to(g.reshape(g.shape + (1,) * len(rest)), g.shape + rest)
        e = self.vielbein_at(x, t)
        return np.einsum('ia...,ab,jb...->ij...', e, self.noise(t), e)

    def jacobian(self, x: Array, t: float) -> Array:
        """Return df_i/dx_j at states (n, ...), shape (n, n, ...)."""
        if self.drift_jacobian is not None:
            return np.asarray(self.drift_jacobian(x, t), dtype=float)
        return central_differences(lambda y: self.drift(y, t), x, self.scale)

    def vielbein_jacobian_at(self, x: Array, t: float) -> Array:
        """Return de_ia/dx_j at states (n, ...), shape (n, p, n, ...)."""
        if self.vielbein_jacobian is not None:
            return np.asarray(self.vielbein_jacobian(x, t), dtype=float)
        shape = self.vielbein_at(x, t).shape
        flat = central_differences(
            lambda y: self.vielbein_at(y, t).reshape((-1,) + shape[2:]), x, self.scale)
        return flat.reshape(shape[:2] + (self.ndim,) + shape[2:])

    def ito_drift(self, x: Array, t: float) -> Array:
        """
        Return the drift of the same process in Ito's sense at states (n, ...), same shape.

        f_i + s (d_k e_ia) Q_ab e_kb: what is left of noise times its own gradient.
        """
        f = np.asarray(self.drift(x, t), dtype=float)
        if not self.noise_bends:
            return f
        return f + self.s * np.einsum('iak...,ab,kb...->i...', self.vielbein_jacobian_at(x, t),
                                      self.noise(t), self.vielbein_at(x, t))

    def ito_jacobian(self, x: Array, t: float) -> Array:
        """Return the derivatives of ito_drift at states (n, ...), shape (n, n, ...)."""
        if not self.noise_bends:
            return self.jacobian(x, t)
        return central_differences(lambda y: self.ito_drift(y, t), x, self.scale)


@dataclass(frozen=True, eq=False)
class Sensor:
    """
    A measurement y = h(x, t) + w, w ~ N(0, R)  [Sensors, Eq. 7].

    function: h(x, t) maps states (n, ...) to measurements (m, ...); covariance: R, (m, m) or a
    function of t; angular: which components are angles in radians, compared on the circle, where
    the noise is cut at half a turn, so that its standard deviation is 1 at most (0.2 % are cut);
    time_dependent: whether h depends on t; states: those that h depends on, where that is known.
    """

    function: Field
    covariance: Matrix
    angular: tuple[bool, ...] = ()
    time_dependent: bool = False
    states: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse a constant R that is no covariance."""
        if not callable(self.covariance):
            R = np.atleast_2d(np.asarray(self.covariance, dtype=float))
            check_covariance('covariance', R, len(R))
            object.__setattr__(self, 'covariance', R)
            if self.angular and len(self.angular) != len(R):
                raise ValueError(f'angular: expected {len(R)} values, one for each component, '
                                 f'got {len(self.angular)}')
            widest = max((R[i, i]**0.5 for i in np.flatnonzero(self.angular)), default=0.0)
            if widest > WIDEST_ANGLE:
                raise ValueError('covariance: expected a standard deviation of at most '
                                 f'{WIDEST_ANGLE:g} rad of an angle, which is cut at half a '
                                 f'turn, got {widest:g}')

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
        if not callable(self.covariance):
            return self._constant_log_peak
        return -0.5 * float(np.linalg.slogdet(2 * np.pi * self.noise(t))[1])

    @cached_property
    def _constant_log_peak(self) -> float:
        return -0.5 * float(np.linalg.slogdet(2 * np.pi * self.noise(0.0))[1])

    def jacobian(self, x: Array, t: float, scale: Sequence[float] | Array = ()) -> Array:
        """
        Return dh_i/dx_j at states (n, ...) by central differences, shape (m, n, ...).

        scale: the lengths over which h changes, (n,), 1 for each where none is given.
        """
        return central_differences(lambda z: self.function(z, t), x, scale, self.difference)


def central_differences(function: Callable[[Array], Array], x: Array,
                        scale: Sequence[float] | Array = (),
                        minus: Callable[[Array, Array], Array] = np.subtract) -> Array:
    """
    Return d function_i / dx_j, shape (m, n, ...).

    scale: lengths L (n,), 1 for each where none is given.  The step, cbrt(1e-16 L^2 max(|x|, L)),
    is long against the rounding of x and short against whatever a function does over L, also far
    from the origin.
    """
    x = np.asarray(x, dtype=float)
    columns = []
    for j, length in enumerate(scale if len(scale) else np.ones(len(x))):
        step = np.cbrt(np.finfo(float).eps * length**2 * np.maximum(np.abs(x[j]), length))
        up, down = x.copy(), x.copy()
        up[j] += step
        down[j] -= step
        columns.append(minus(function(up), function(down)) / (up[j] - down[j]))
    return np.stack(columns, axis=1)


def scale_of(widths: ArrayLike) -> Array:
    """Return the lengths over which functions change that matter on cells of widths (n,)."""
    return np.fmin(WIDTHS * np.asarray(widths, dtype=float), 1.0)


def _at(matrix: Matrix, t: float) -> Array:
    return np.asarray(matrix(t) if callable(matrix) else matrix, dtype=float)
