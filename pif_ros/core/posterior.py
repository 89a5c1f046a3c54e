"""The posterior from the prior and a likelihood, on many cells  [Sensors, Eq. 27]."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
import math
from typing import Any, NamedTuple

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
held_tiles: Any = None
corrected: Any = None


class Terms(NamedTuple):
    """
    A log likelihood by its terms: sum_i u_i v_i + square + constant, but in some places their own.

    u: (m,); v: (m, size); square: (size,); places, own: (some,).
    """

    u: Array
    v: Array
    square: Array
    constant: float
    places: NDArray[np.intp]
    own: Array

    @np.errstate(over='ignore', invalid='ignore')
    def total(self) -> Array:
        """Return the log likelihood, (size,)."""
        log_l: Array = self.u @ self.v
        log_l += self.square
        log_l += self.constant
        log_l[self.places] = self.own
        return log_l


def posterior(p: Array, log_l: Array | Terms, cell_volume: float) -> tuple[Array, float] | None:
    """
    Return the density given a measurement, (size,), and the log evidence of it; None if neither.

    p: the density before; log_l: the log likelihood, NaN where there is none.
    """
    found = _compiled(p, log_l, cell_volume) if compiler.is_available() else None
    if found is None:
        found = _plain(p, log_l.total() if isinstance(log_l, Terms) else log_l, cell_volume)
    return found


def warm_up() -> None:
    """Compile now, so that no measurement waits for it."""
    if compiler.is_available():
        _loops()


def _compiled(p: Array, log_l: Array | Terms,
              cell_volume: float) -> tuple[Array, float] | None:
    # of what is nowhere written, memory has none to clear
    p, result = np.ascontiguousarray(p, dtype=float), np.zeros(len(p))
    if isinstance(log_l, Terms):
        peak, evidence = _loops()[1](p, log_l.u, log_l.v, log_l.square, log_l.constant,
                                     log_l.places, log_l.own, cell_volume, result)
    else:
        peak, evidence = _loops()[0](p, np.ascontiguousarray(log_l, dtype=float), cell_volume,
                                     result)
    if not evidence > UNSAFE:
        return None
    return result, float(peak + math.log(evidence * cell_volume))


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
    """Return the loops of the posterior from a log likelihood and from its terms, compiled."""
    global as_bits, as_number, weighed, held_tiles, corrected
    numba = compiler.compiler()
    as_bits, as_number = _reinterpreted('int64'), _reinterpreted('float64')
    weighed = numba.njit(fastmath={'contract'})(_weighed)
    held_tiles, corrected = (numba.njit(nogil=True, error_model='numpy')(loop)
                             for loop in (_held_tiles, _corrected))
    kinds, one = numba.types, numba.types.float64
    read, table, places = (kinds.Array(kind, ndim, 'C', readonly=True)
                           for kind, ndim in ((one, 1), (one, 2), (kinds.intp, 1)))
    make = partial(numba.njit, cache=True, nogil=True, error_model='numpy')
    return (make([(read, read, one, one[::1])])(_from_logs),
            make([(read, read, table, read, one, places, read, one, one[::1])])(_from_terms))


def _from_logs(p, log_l, cell_volume, result):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the posterior, and return the largest log likelihood where p is, and the evidence."""
    holds = held_tiles(p)
    for tile in range(holds.size):
        if holds[tile]:
            result[128 * tile:128 * tile + 128] = log_l[128 * tile:128 * tile + 128]
    return corrected(p, holds, cell_volume, result)


def _from_terms(p, u, v, square, constant,  # type: ignore[no-untyped-def]
                places, own, cell_volume, result):  # pragma: no cover
    """Do the same for a log likelihood by its terms."""
    holds = held_tiles(p)
    for tile in range(holds.size):
        if holds[tile]:
            logs = result[128 * tile:128 * tile + 128]
            some = square[128 * tile:128 * tile + 128]
            for i in range(logs.size):
                logs[i] = some[i] + constant
            for j in range(u.size):
                factor = v[j, 128 * tile:128 * tile + 128]
                for i in range(logs.size):
                    logs[i] += u[j] * factor[i]
    for k in range(places.size):
        if holds[places[k] >> 7]:
            result[places[k]] = own[k]
    return corrected(p, holds, cell_volume, result)


def _held_tiles(p):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return which 128 cells hold anything."""
    holds = np.zeros((p.size + 127) // 128, np.bool_)
    for tile in range(holds.size):
        some = p[128 * tile:128 * tile + 128]
        for i in range(some.size):
            if some[i] > 0:
                holds[tile] = True
                break
    return holds


def _corrected(p, holds, cell_volume, result):  # type: ignore[no-untyped-def]
    # pragma: no cover
    """Write the posterior over the log likelihood, which is 0 where a tile holds nothing."""
    best, sums = np.full(128, -np.inf), np.zeros(128)
    for tile in range(holds.size):
        if holds[tile]:
            some, logs = p[128 * tile:128 * tile + 128], result[128 * tile:128 * tile + 128]
            for i in range(some.size):
                x = logs[i] if some[i] > 0 else -np.inf
                best[i] = x if x > best[i] else best[i]
    peak = best.max()
    if not np.isfinite(peak):
        return peak, 0.0
    for tile in range(holds.size):
        joint = result[128 * tile:128 * tile + 128]
        if holds[tile]:
            some = p[128 * tile:128 * tile + 128]
            for i in range(some.size):
                joint[i] = weighed(some[i], joint[i] - peak)
            for i in range(some.size):
                sums[i] += joint[i]
    evidence = sums.sum()
    scale = 1 / (evidence * cell_volume)
    for tile in range(holds.size):
        if holds[tile]:
            joint = result[128 * tile:128 * tile + 128]
            for i in range(joint.size):
                x = joint[i] * scale - NEGLIGIBLE
                joint[i] = x if x > 0 else 0.0
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
