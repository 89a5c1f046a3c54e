"""The density of a whole path: the action of its steps, and what was measured along it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.belief import check_covariance
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.kernels.formula import action, drift_terms
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import central_differences, scale_of, Sensor, StateModel
from pif_ros.core.smoothing import in_order

Array = NDArray[np.float64]
Index = slice | NDArray[np.intp]
Places = slice | list[int]


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of a path that are computed at once: which, how long, from when, and e Q e^T."""

    index: Index
    settings: KernelSettings
    t: float
    diffusion: Array


@dataclass(frozen=True, eq=False)
class Seen:
    """Measurements y (m, K) of a sensor at K different stamps, and where in the path they are."""

    index: NDArray[np.intp]
    sensor: Sensor
    y: Array
    t: float


@dataclass(frozen=True, eq=False)
class PathPosterior:
    """
    The density of a path x(t_0), ..., x(t_N) given the measurements along it  [TM, Eq. 130].

    kernel: of its settings time_step, r and jacobian are what counts here; mean (n,), covariance
    (n, n): of the Gaussian prior; measurements: as such or (stamp_ns, source, values); start_ns:
    the prior's stamp, the first measurement's where none is given.  The path has a state at each
    whole step from a measurement on, and one at the next measurement: no stamp is rounded.  An
    array of paths has its components first, (n, N + 1, ...).  Noise must be additive, and e Q e^T
    regular.  Raises ValueError for what does not fit.
    """

    model: StateModel
    sensors: Mapping[str, Sensor]
    kernel: KernelSettings
    mean: ArrayLike
    covariance: ArrayLike
    measurements: Sequence[Measurement | tuple[int, str, ArrayLike]]
    start_ns: int | None = None

    def __post_init__(self) -> None:
        """Bring prior and measurements to plain form, and refuse what does not fit."""
        n, put = self.model.ndim, object.__setattr__
        if self.model.multiplicative:
            raise ValueError('model: expected additive noise, got multiplicative')
        if self.model.inputs:
            raise ValueError('model: expected one without inputs, '
                             f'got {", ".join(self.model.inputs)}')
        put(self, 'mean', np.array(self.mean, dtype=float))
        put(self, 'covariance', np.array(self.covariance, dtype=float))
        if np.shape(self.mean) != (n,) or not np.all(np.isfinite(self.mean)):
            raise ValueError(f'mean: expected {n} finite numbers, '
                             f'got {np.asarray(self.mean).tolist()}')
        check_covariance('covariance', np.asarray(self.covariance), n)
        put(self, 'model', self.model.at_scale(self._deviations))
        put(self, 'measurements', tuple(in_order(self.measurements, self.start_ns)))
        for m in self.ordered:
            self._check(m)
        if self.start_ns is None:
            put(self, 'start_ns', self.ordered[0].stamp_ns)
        for steps in self.steps:
            check_covariance('model: e Q e^T', steps.diffusion, n)

    def _check(self, m: Measurement) -> None:
        if m.source not in self.sensors:
            raise ValueError(f'measurements: expected sources {", ".join(self.sensors)}, '
                             f'got {m.source}')
        size = self.sensors[m.source].size
        if len(m.values) != size or not np.all(np.isfinite(m.values)):
            raise ValueError(f'measurements: expected {size} finite values of {m.source}, '
                             f'got {list(m.values)}')

    @property
    def ordered(self) -> tuple[Measurement, ...]:
        """Return the measurements in order."""
        return self.measurements  # type: ignore[return-value]

    @property
    def ndim(self) -> int:
        """Return the number of states."""
        return self.model.ndim

    @cached_property
    def stamps_ns(self) -> tuple[int, ...]:
        """Return the N + 1 stamps of the path."""
        h = max(round(self.kernel.time_step * NANOSECONDS), 1)
        now = int(self.start_ns or 0)
        stamps = [now]
        for stamp in sorted({m.stamp_ns for m in self.ordered} - {now}):
            stamps += [*range(now + h, stamp, h), stamp]
            now = stamp
        return tuple(stamps)

    @cached_property
    def steps(self) -> tuple[Steps, ...]:
        """Return the steps in groups: of one length, and of one time where the model changes."""
        at, lengths = np.array(self.stamps_ns[:-1]), np.diff(self.stamps_ns)
        if self.model.changes_with_time:
            groups = [np.array([k]) for k in range(len(at))]
        else:
            groups = [np.flatnonzero(lengths == h) for h in np.unique(lengths)]
        return tuple(self._group(index, int(lengths[index[0]]), at[index[0]] / NANOSECONDS)
                     for index in groups)

    def _group(self, index: NDArray[np.intp], length_ns: int, t: float) -> Steps:
        settings = replace(self.kernel, time_step=length_ns / NANOSECONDS)
        whole = len(index) == len(self.stamps_ns) - 1
        return Steps(slice(None) if whole else index, settings, t,
                     self.model.diffusion(t + settings.r * settings.time_step))

    @cached_property
    def seen(self) -> tuple[Seen, ...]:
        """Return the measurements in groups of one sensor, and of one time where it changes."""
        place = {stamp: k for k, stamp in enumerate(self.stamps_ns)}
        groups: dict[tuple[object, ...], list[Measurement]] = {}
        times: dict[tuple[str, int], int] = {}
        for m in self.ordered:
            times[m.source, m.stamp_ns] = turn = times.get((m.source, m.stamp_ns), 0) + 1
            sensor = self.sensors[m.source]
            changes = sensor.time_dependent or callable(sensor.covariance)
            groups.setdefault((m.source, turn, m.stamp_ns if changes else None), []).append(m)
        return tuple(Seen(np.array([place[m.stamp_ns] for m in group]),
                          self.sensors[group[0].source],
                          np.array([m.values for m in group]).T, group[0].stamp_ns / NANOSECONDS)
                     for group in groups.values())

    @property
    def first_seen(self) -> int:
        """Return at which state of the path the first measurement is."""
        return min(int(seen.index.min()) for seen in self.seen)

    @cached_property
    def step(self) -> Mapping[int, Steps]:
        """Return the group that each step belongs to."""
        every = np.arange(len(self.stamps_ns) - 1)
        return {int(k): steps for steps in self.steps for k in every[steps.index]}

    def log_density(self, paths: Array, share: Array | float = 1.0) -> Array:
        """
        Return -U of paths (n, N + 1, ...): log p(path, measurements), shape (...).

        share: of the measurements' log likelihood that counts, one for all paths or for each.  It
        is -inf where a model or sensor is undefined.
        """
        d = self._from_mean(paths)
        total = -0.5 * (np.einsum('i...,ij,j...->...', d, self._precision, d)
                        + np.linalg.slogdet(2 * np.pi * np.asarray(self.covariance))[1])
        for steps, x_from, x_to in self._moves(paths):
            total = total + log_transition(self.model, x_to, x_from, steps).sum(axis=0)
        total = total + share * self.log_likelihood(paths)
        return np.where(np.isnan(total), -np.inf, total)

    def log_likelihood(self, paths: Array) -> Array:
        """Return the log likelihood of all measurements along paths (n, N + 1, ...), (...)."""
        return np.asarray(sum(_log_likelihood(seen, paths[:, seen.index]).sum(axis=0)
                              for seen in self.seen))

    def log_likelihood_at(self, k: int, x: Array) -> Array:
        """Return the log likelihood of what was measured at the k-th stamp, of states (n, ...)."""
        total = np.zeros(x.shape[1:])
        for seen, place in self._seen_at.get(k, []):
            total += _log_likelihood(seen, x[:, None], [place])[0]
        return total

    def gradient(self, paths: Array, share: Array | float = 1.0) -> Array:
        """Return the derivatives of log_density by the states of paths, (n, N + 1, ...)."""
        slope = np.zeros(paths.shape)
        slope[:, 0] = -np.tensordot(self._precision, self._from_mean(paths), axes=1)
        for steps, x_from, x_to in self._moves(paths):
            at_from, at_to = _transition_gradient(self.model, x_to, x_from, steps)
            slope[:, :-1][:, steps.index] += at_from
            slope[:, 1:][:, steps.index] += at_to
        for seen in self.seen:
            x = paths[:, seen.index]
            v, H = _residual(seen, x, slice(None)), self._slopes(seen, x)
            u = np.tensordot(np.linalg.inv(seen.sensor.noise(seen.t)), v, axes=1)
            slope[:, seen.index] += share * np.einsum('ij...,i...->j...', H, u)
        return slope

    def curvature(self, paths: Array, share: float = 1.0) -> tuple[Array, Array]:
        """
        Return the Gauss-Newton precision of a path, averaged over paths (n, N + 1, B).

        That is of the blocks on the diagonal (N + 1, n, n) and of those below it (N, n, n).
        """
        n, length, _ = paths.shape
        diagonal, below = np.zeros((length, n, n)), np.zeros((length - 1, n, n))
        diagonal[0] = self._precision
        for steps, x_from, x_to in self._moves(paths):
            r, eps = steps.settings.r, steps.settings.time_step
            D = eps * self.model.jacobian(x_from + r * (x_to - x_from), steps.t + r * eps)
            # dJ/dx'' = 1 - r eps df/dx, -dJ/dx' = 1 + (1 - r) eps df/dx
            A, B = _plus_one(-r * D), _plus_one((1 - r) * D)
            P = np.linalg.inv(eps * steps.diffusion)
            diagonal[1:][steps.index] += _average(A, P, A)
            diagonal[:-1][steps.index] += _average(B, P, B)
            below[steps.index] -= _average(A, P, B)
        for seen in self.seen:
            H = self._slopes(seen, paths[:, seen.index])
            P = share * np.linalg.inv(seen.sensor.noise(seen.t))
            diagonal[seen.index] += _average(H, P, H)
        return diagonal, below

    @cached_property
    def _seen_at(self) -> Mapping[int, list[tuple[Seen, int]]]:
        found: dict[int, list[tuple[Seen, int]]] = {}
        for seen in self.seen:
            for place, k in enumerate(seen.index):
                found.setdefault(int(k), []).append((seen, place))
        return found

    @cached_property
    def _deviations(self) -> Array:
        return np.sqrt(np.diag(np.asarray(self.covariance)))

    def _slopes(self, seen: Seen, x: Array) -> Array:
        """Return dh_i/dx_j of a sensor at states (n, ...), shape (m, n, ...)."""
        return seen.sensor.jacobian(x, seen.t, scale_of(self._deviations))

    @cached_property
    def _precision(self) -> Array:
        return np.linalg.inv(np.asarray(self.covariance))

    def _from_mean(self, paths: Array) -> Array:
        return paths[:, 0] - np.reshape(self.mean, (-1,) + (1,) * (paths.ndim - 2))

    def _moves(self, paths: Array) -> Iterator[tuple[Steps, Array, Array]]:
        for steps in self.steps:
            yield steps, paths[:, :-1][:, steps.index], paths[:, 1:][:, steps.index]


def log_transition(model: StateModel, x_to: Array, x_from: Array, steps: Steps) -> Array:
    """Return log P(x'' | x') of steps between states (n, ...)  [Sensors, Eqs. 18, 19]."""
    dx, eps, g = x_to - x_from, steps.settings.time_step, steps.diffusion
    f, log_jacobian = drift_terms(model, x_from + steps.settings.r * dx, steps.settings, steps.t)
    constant = -0.5 * float(np.linalg.slogdet(2 * np.pi * eps * g)[1])
    return constant + log_jacobian - action(dx, f, g, eps)


def _residual(seen: Seen, x: Array, places: Places) -> Array:
    """Return y_k - h(x_k) of some of the measurements, for states x (n, K, ...), (m, K, ...)."""
    y = seen.y[:, places]
    return seen.sensor.difference(y.reshape(y.shape + (1,) * (x.ndim - 2)),
                                  np.asarray(seen.sensor.function(x, seen.t), dtype=float))


def _log_likelihood(seen: Seen, x: Array, places: Places = slice(None)) -> Array:
    """Return log p(y_k | x_k) of some of the measurements, for states (n, K, ...), (K, ...)."""
    whiten = np.linalg.inv(np.linalg.cholesky(seen.sensor.noise(seen.t)))
    v = np.tensordot(whiten, _residual(seen, x, places), axes=1)
    return np.asarray(seen.sensor.log_peak(seen.t) - 0.5 * np.einsum('i...,i...->...', v, v))


def _transition_gradient(model: StateModel, x_to: Array, x_from: Array,
                         steps: Steps) -> tuple[Array, Array]:
    """Return the derivatives of log P(x'' | x') by x' and by x'', both (n, ...)."""
    r, eps = steps.settings.r, steps.settings.time_step
    x, tau = x_from + r * (x_to - x_from), steps.t + r * eps
    D, f = model.jacobian(x, tau), np.asarray(model.drift(x, tau), dtype=float)
    # u = g^-1 J / eps, J = x'' - x' - eps f(x^(r)), of which f has its share in x' and in x''
    u = np.tensordot(np.linalg.inv(eps * steps.diffusion), x_to - x_from - eps * f, axes=1)
    shared = eps * np.einsum('ij...,i...->j...', D, u)
    if r > 0:
        shared = shared + _log_jacobian_gradient(model, x, D, steps.settings, tau)
    return u + (1 - r) * shared, r * shared - u


def _log_jacobian_gradient(model: StateModel, x: Array, D: Array, settings: KernelSettings,
                           tau: float) -> Array:
    """Return the derivatives by x (n, ...) of log |det(1 - r eps D)|, or of -r eps div f."""
    r_eps = settings.r * settings.time_step
    # d D_ij / dx_k stands at [i, k, j]
    change = central_differences(lambda y: model.jacobian(y, tau), x, model.scale)
    if settings.jacobian == 'exponential':
        return np.asarray(-r_eps * np.einsum('iki...->k...', change))
    # d log |det A| = tr(A^-1 dA)
    A = np.moveaxis(_plus_one(-r_eps * D), (0, 1), (-2, -1))
    inverse = np.moveaxis(np.linalg.inv(A), (-2, -1), (0, 1))
    return np.asarray(-r_eps * np.einsum('ji...,ikj...->k...', inverse, change))


def _plus_one(D: Array) -> Array:
    """Return 1 + D of matrices (n, n, ...)."""
    return D + np.eye(len(D)).reshape(D.shape[:2] + (1,) * (D.ndim - 2))


def _average(A: Array, P: NDArray, B: Array) -> Array:
    """Return A^T P B of matrices (m, n, K, B), averaged over the last axis, (K, n, n)."""
    return np.asarray(np.einsum('aikb,ac,cjkb->kij', A, P, B, optimize=True) / A.shape[-1])
