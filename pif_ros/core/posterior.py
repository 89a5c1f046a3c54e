"""The posterior from the prior and a likelihood, on many cells  [Sensors, Eq. 27]."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.core import compiler

Array = NDArray[np.float64]

#: A density below this is none: a subnormal number costs as much as a hundred others.
NEGLIGIBLE = 1e-290
#: An evidence below this share of the largest likelihood may have lost digits to underflow.
UNSAFE = 1e-200
#: The powers of the exponential's series that a double can tell, of an x of log(2) / 2 and less.
SERIES = tuple(1 / math.factorial(n) for n in range(14))
#: 1 / log 2, and log 2 in two parts, the first with so few digits that its multiples are exact.
PER_LOG_2 = 1 / math.log(2)
LOG_2, REST_OF_LOG_2 = math.floor(math.log(2) * 2**32) / 2**32, 1.9082149292705877e-10
#: Added to a small number it leaves the nearest whole one in the last digits.
ROUNDS = 1.5 * 2.0**52
#: What the loops call: a compiler makes it, and they look for it here.
as_bits: Any = None
as_number: Any = None
weighed: Any = None


def posterior(p: Array, log_l: Array, cell_volume: float) -> tuple[Array, float] | None:
    """
    Return the density given a measurement, (size,), and the log evidence of it; None if neither.

    p: the density before; log_l: the log likelihood, NaN where there is none.
    """
    found = _compiled(p, log_l, cell_volume) if compiler.is_available() else None
    if found is None:
        found = _plain(p, log_l, cell_volume)
    return found


def log_likelihood(u: Array, v: Array, square: Array, constant: float) -> Array:
    """Return sum_i u_i v_i + square + constant, for u (m,), v (m, size) and square (size,)."""
    if compiler.is_available():
        log_l = np.empty(len(square))
        _loops()[1](u, np.ascontiguousarray(v, dtype=float), square, constant, log_l)
        return log_l
    log_l = u @ v
    log_l += square
    log_l += constant
    return log_l


def warm_up() -> None:
    """Compile now, so that no measurement waits for it."""
    if compiler.is_available():
        _loops()


def _compiled(p: Array, log_l: Array, cell_volume: float) -> tuple[Array, float] | None:
    result = np.empty(len(p))
    peak, evidence = _loops()[0](np.ascontiguousarray(p, dtype=float),
                                 np.ascontiguousarray(log_l, dtype=float), cell_volume, result)
    if not evidence > UNSAFE:
        return None
    return result, float(peak + np.log(evidence * cell_volume))


@np.errstate(over='ignore', invalid='ignore')
def _plain(p: Array, log_l: Array, cell_volume: float) -> tuple[Array, float] | None:
    peak = log_l.max()
    # p(y | x) p(x) up to the factor exp(peak)
    joint = np.subtract(log_l, peak)
    np.exp(joint, out=joint)
    joint *= p
    evidence = joint.sum()
    if not evidence > UNSAFE:
        # an outlier, or cells without a likelihood: with logs of the prior too
        log_joint, peak = _log_joint(p, log_l)
        if not np.isfinite(peak):
            return None
        joint = np.exp(log_joint - peak)
        evidence = joint.sum()
    joint /= evidence * cell_volume
    joint -= NEGLIGIBLE
    np.maximum(joint, 0.0, out=joint)
    return joint, float(peak + np.log(evidence * cell_volume))


def _log_joint(p: Array, log_l: Array) -> tuple[Array, float]:
    """Return log p(y | x) p(x), -inf where either is not, and its maximum."""
    with np.errstate(divide='ignore'):
        log_joint = np.where(np.isnan(log_l), -np.inf, log_l) + np.log(p)
    return log_joint, float(log_joint.max())


@cache
def _loops() -> tuple[Callable[..., Any], ...]:
    """Return the loops of the posterior and of the log likelihood, compiled."""
    global as_bits, as_number, weighed
    numba = compiler.compiler()
    as_bits, as_number = _reinterpreted('int64'), _reinterpreted('float64')
    weighed = numba.njit(fastmath={'contract'})(_weighed)
    kinds, one = numba.types, numba.types.float64
    vector = one[::1]
    read = kinds.Array(one, 1, 'C', readonly=True)
    table = kinds.Array(one, 2, 'C', readonly=True)
    return (numba.njit([(read, read, one, vector)], cache=True, nogil=True,
                       error_model='numpy')(_posterior),
            numba.njit([(read, table, read, one, vector)], cache=True, nogil=True)(_affine))


def _posterior(p, log_l, cell_volume, result):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the posterior, and return the largest log likelihood where p is, and the evidence."""
    tiles = (p.size + 127) // 128
    holds, best, sums = np.zeros(tiles, np.bool_), np.full(128, -np.inf), np.zeros(128)
    for tile in range(tiles):
        some, logs = p[128 * tile:128 * tile + 128], log_l[128 * tile:128 * tile + 128]
        for i in range(some.size):
            if some[i] > 0:
                holds[tile] = True
                break
        if holds[tile]:
            for i in range(some.size):
                x = logs[i] if some[i] > 0 else -np.inf
                best[i] = x if x > best[i] else best[i]
    peak = best.max()
    if not np.isfinite(peak):
        return peak, 0.0
    for tile in range(tiles):
        some, logs = p[128 * tile:128 * tile + 128], log_l[128 * tile:128 * tile + 128]
        joint = result[128 * tile:128 * tile + 128]
        if holds[tile]:
            for i in range(some.size):
                joint[i] = weighed(some[i], logs[i] - peak)
            for i in range(some.size):
                sums[i] += joint[i]
        else:
            joint[:] = 0.0
    evidence = sums.sum()
    scale = 1 / (evidence * cell_volume)
    for i in range(p.size):
        x = result[i] * scale - NEGLIGIBLE
        result[i] = x if x > 0 else 0.0
    return peak, evidence


def _weighed(p, x):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return p exp(x) for an x up to 0, a digit in the last place off; 0 for less than 1e-298."""
    x = x if x > -700.0 else -700.0
    # exp(x) = 2^k exp(r), |r| <= log(2) / 2
    rounded = x * PER_LOG_2 + ROUNDS
    k = rounded - ROUNDS
    r = (x - k * LOG_2) - k * REST_OF_LOG_2
    r2 = r * r
    r4 = r2 * r2
    e = SERIES[12] + SERIES[13] * r
    e = e * r4 + (SERIES[10] + SERIES[11] * r) * r2 + (SERIES[8] + SERIES[9] * r)
    e = e * r4 + (SERIES[6] + SERIES[7] * r) * r2 + (SERIES[4] + SERIES[5] * r)
    e = e * r4 + (SERIES[2] + SERIES[3] * r) * r2 + (SERIES[0] + SERIES[1] * r)
    # 34 - 1023 is the power of 2 of 1e-298
    power = (as_bits(p) >> 52) + as_bits(rounded) - as_bits(ROUNDS)
    whole = as_number((as_bits(rounded) << 52) + (1023 << 52))
    return p * (e * whole if power > 34 else 0.0)


def _affine(u, v, square, constant, result):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write sum_i u_i v_i + square + constant."""
    for k in range(result.size):
        result[k] = square[k] + constant + u[0] * v[0, k]
    for i in range(1, u.size):
        for k in range(result.size):
            result[k] += u[i] * v[i, k]


def _reinterpreted(kind: str) -> Any:
    """Return what takes the 64 bits of a number for one of another kind."""
    from numba import types
    from numba.extending import intrinsic

    @intrinsic
    def reinterpreted(typing, value):  # type: ignore[no-untyped-def]
        def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
            return builder.bitcast(arguments[0], context.get_data_type(signature.return_type))
        return getattr(types, kind)(value), generate
    return reinterpreted
