"""What may happen to the node: messages right and wrong, at times right and wrong."""

from __future__ import annotations

import array
from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Any, Protocol

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from proofs.inputs import Input
from ros import SECOND, stamp_into

MS = SECOND // 1000
FRAME = 'map'
#: Reasons by which the node is to count what is no measurement.
NO_CLOCK, NOT_FINITE, WRONG_LENGTH = 'no clock', 'not finite', 'wrong length'
BAD_COVARIANCE = 'bad covariance'
NO_STAMP, FUTURE = 'no stamp', 'from the future'
OUT_OF_RANGE, TOO_FAST = 'out of range', 'too fast'

#: The last second that a stamp can hold; the year 2262, of 64 bits of nanoseconds, is beyond it.
LAST_SECOND = 2**31 - 1
WILD = (math.nan, math.inf, -math.inf, 1e308, -1e308, 1e300, 1e160, -1e154, 1e18, 1e-308, 5e-324,
        -5e-324, 0.0, -0.0, 1e-200, 3.4e38, float(2**63), 50.0, -1e6)
FRAMES = ('', FRAME, FRAME, 'odom', '/map', 'mäp', 'a\nb', 'x' * 300)
ADVANCES = (0, 0, MS, 10 * MS, 10 * MS, 50 * MS, 50 * MS, 200 * MS, 1500 * MS)


class Chooser(Protocol):
    """What decides: a seeded generator, or hypothesis."""

    def one_of(self, options: Sequence[Any]) -> Any:
        """Return one of some options."""

    def number(self) -> float:
        """Return a number of the size of what is measured."""

    def rarely(self, times: int) -> bool:
        """Return true once in so many times."""


class Seeded:
    """A chooser that a seed decides."""

    def __init__(self, *seed: int) -> None:
        self._rng = np.random.default_rng(seed)

    def one_of(self, options: Sequence[Any]) -> Any:
        """Return one of some options, each as likely."""
        return options[int(self._rng.integers(len(options)))]

    def number(self) -> float:
        """Return a number with standard deviation 1."""
        return float(self._rng.standard_normal())

    def rarely(self, times: int) -> bool:
        """Return true once in so many times."""
        return bool(self._rng.integers(times) == 0)


@dataclass(frozen=True)
class Sent:
    """
    A message, and what is right to make of it: its stamp, its numbers, what is wrong of it.

    What a message without a stamp counts at is the time of its delivery.
    """

    message: Any
    stamp_ns: int
    values: tuple[float, ...]
    wrong: frozenset[str]


def message_of(chooser: Chooser, kind: Input, now_ns: int, newest_ns: int) -> Sent:
    """Return a message, right three times of four, given the time and the newest stamp."""
    values = numbers(chooser, kind)
    message, wrong = kind.message(), set()
    kind.write(message, values)
    stamp_ns = now_ns
    if kind.stamped:
        stamp_ns = stamp(chooser, now_ns, newest_ns)
        put_stamp(message.header.stamp, stamp_ns, chooser.rarely(50))
        message.header.frame_id = chooser.one_of(FRAMES)
        if stamp_ns <= 0:
            wrong.add(NO_STAMP)
    if isinstance(message, PoseWithCovarianceStamped):
        if chooser.rarely(4):
            message.pose.covariance = [chooser.one_of(WILD) for _ in range(36)]
        if not (all(map(math.isfinite, message.pose.covariance))
                and all(v >= 0 for v in message.pose.covariance[::7])):
            wrong.add(BAD_COVARIANCE)
    if len(values) < kind.size or (len(values) > kind.size and not kind.longer):
        wrong.add(WRONG_LENGTH)
    read = values[:kind.size]
    if not all(map(math.isfinite, read)):
        wrong.add(NOT_FINITE)
    if not all(kind.limits[0] <= value <= kind.limits[1] for value in read):
        wrong.add(OUT_OF_RANGE)
    if any(abs(value) > kind.fastest for value in read):
        wrong.add(TOO_FAST)
    return Sent(message, stamp_ns, read, frozenset(wrong))


def good_message(chooser: Chooser, kind: Input, now_ns: int) -> Sent:
    """Return a message that is right in all."""
    values, message = _right_numbers(chooser, kind, kind.size), kind.message()
    kind.write(message, values)
    if kind.stamped:
        stamp_into(message.header.stamp, now_ns)
    return Sent(message, now_ns, values, frozenset([] if now_ns else [NO_STAMP]))


def numbers(chooser: Chooser, kind: Input) -> tuple[float, ...]:
    """Return what a message says: mostly numbers as they should be, and as many."""
    size = kind.size
    if kind.loose and chooser.rarely(10):
        size = chooser.one_of((0, 1, 3, 7, 1000))
    if not chooser.rarely(6):
        return _right_numbers(chooser, kind, size)
    return _as_sent(kind, [chooser.one_of(WILD) for _ in range(size)])


def _right_numbers(chooser: Chooser, kind: Input, size: int) -> tuple[float, ...]:
    values = [chooser.number() for _ in range(size)]
    if kind.limits[0] > 0:
        values = [kind.limits[0] + 3 * abs(value) for value in values]
    return _as_sent(kind, values)


def _as_sent(kind: Input, values: Sequence[float]) -> tuple[float, ...]:
    """Return numbers as they come out of a message."""
    with np.errstate(over='ignore', under='ignore'):
        return tuple(float(np.float32(value)) if kind.single else value for value in values)


def stamp(chooser: Chooser, now_ns: int, newest_ns: int) -> int:
    """Return the stamp of a message: mostly of a moment ago."""
    if not chooser.rarely(4):
        return max(now_ns - chooser.one_of((0, MS, 3 * MS, 20 * MS)), 0)
    back = chooser.one_of((100, 400, 900, 1000, 1100, 3000, 100_000)) * MS
    return chooser.one_of((
        newest_ns, newest_ns, newest_ns + 1, newest_ns - 1, now_ns - back, now_ns - back,
        now_ns + SECOND // 2, now_ns + SECOND, now_ns + SECOND + 1, 0, -1, -7 * SECOND,
        LAST_SECOND * SECOND, -LAST_SECOND * SECOND))


def put_stamp(field: Any, stamp_ns: int, carried: bool) -> None:
    """Write a stamp, perhaps with more nanoseconds than a second has."""
    field.sec, field.nanosec = divmod(stamp_ns, SECOND)
    if carried and field.sec > -LAST_SECOND and field.nanosec < 2**32 - 3 * SECOND:
        field.sec, field.nanosec = field.sec - 3, field.nanosec + 3 * SECOND


def wrong_at(sent: Sent, stamped: bool, now_ns: int) -> frozenset[str]:
    """Return all that is wrong of a message when it is delivered."""
    late = {NO_CLOCK} if not now_ns else set()
    if stamped and sent.stamp_ns > now_ns + SECOND:
        late.add(FUTURE)
    return sent.wrong | late


@dataclass(frozen=True)
class Start:
    """A pose to start from, and what is right to make of it: None where it is none."""

    message: PoseWithCovarianceStamped
    stamp_ns: int
    mean: tuple[float, float]
    covariance: tuple[float, float, float, float]
    right: bool


SQUARES = ((0.25, 0.1, 0.1, 0.5), (1.0, 0.0, 0.0, 2.0), (1e-12, 0.0, 0.0, 1e-12),
           (1e6, 0.0, 0.0, 1e6))
NO_SQUARES = ((0.0, 0.0, 0.0, 0.0), (1.0, 0.9, 0.1, 1.0), (-1.0, 0.0, 0.0, 1.0),
              (1.0, 2.0, 2.0, 1.0), (math.nan, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, math.inf),
              (1.0, math.nan, math.nan, 1.0))


def start_of(chooser: Chooser, now_ns: int, newest_ns: int) -> Start:
    """Return a pose to start from, right half of the time."""
    covariance = chooser.one_of(SQUARES if not chooser.rarely(4) else NO_SQUARES)
    x, y = (chooser.number() / 4 if not chooser.rarely(6)
            else chooser.one_of((math.nan, math.inf, 1e300, 50.0)) for _ in range(2))
    frame = FRAME if not chooser.rarely(6) else chooser.one_of(FRAMES)
    stamp_ns = chooser.one_of((now_ns, 0, stamp(chooser, now_ns, newest_ns)))
    message = PoseWithCovarianceStamped()
    message.header.frame_id = frame
    put_stamp(message.header.stamp, stamp_ns, False)
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    rest = [chooser.one_of(WILD) for _ in range(36)]
    for place, value in zip((0, 1, 6, 7), covariance):
        rest[place] = value
    message.pose.covariance = array.array('d', rest)
    for part in ('x', 'y', 'z', 'w'):
        setattr(message.pose.pose.orientation, part, chooser.one_of(WILD))
    on_grid = abs(x) <= 3 and abs(y) <= 4
    right = covariance in SQUARES and on_grid and frame in ('', FRAME) and now_ns > 0
    holds_ns = stamp_ns if 0 < stamp_ns < now_ns else now_ns
    return Start(message, holds_ns, (x, y), covariance, right)
