"""From a message to a measurement or a control, or to the reason why it is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Any

from pif_ros import conversions, fields
from pif_ros.accounts import SourceAccount
from pif_ros.config import ConfigError, ControlConfig, SourceConfig
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor


class Refused(ValueError):
    """A message that cannot be used: a reason to count by, and a sentence."""

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason


@dataclass(frozen=True)
class Control:
    """What drives the model from a stamp on, one value for each of its inputs."""

    stamp_ns: int
    values: tuple[float, ...]


class Inlet:
    """
    One topic of stamped numbers, so many in each message, and the account of its messages.

    prefix: what the names of its parameters begin with; name, what: what its lines speak of;
    off: why its last message was not listened to, '' where it was; is_placed: whether the frame of
    its messages is still to be looked at; angles: those of its numbers that are, as long as none
    was beyond a turn; covariances: those that come with what is read.
    Raises ConfigError for a type that is not installed or fields that it has not.
    """

    def __init__(self, name: str, what: str, prefix: str, config: SourceConfig | ControlConfig,
                 size: int, max_ahead: float, account: SourceAccount | None) -> None:
        self.name, self.what, self.prefix, self.topic = name, what, prefix, config.topic
        self.account = SourceAccount() if account is None else account
        self._size, self._max_ahead_ns = size, round(max_ahead * NANOSECONDS)
        self.type_name, self.off = config.type, ''
        try:
            self.type = fields.message_class(config.type)
        except ValueError as error:
            raise ConfigError(f'{prefix}.type: {error}') from None
        try:
            self._read = fields.field_reader(self.type, config.fields)
        except ValueError as error:
            raise ConfigError(f'{prefix}.fields: {error}') from None
        self._wrong = fields.doubter(self.type, config.fields)
        self.covariances = fields.covariances(self.type, config.fields)
        self.is_stamped = fields.has_header(self.type)
        self.is_placed = self.is_stamped and fields.are_places(config.fields)
        self._beyond = fields.ranger(self.type, config.fields)
        self.angles: Sequence[int] = ()
        self._newest: int | None = None
        self._is_mixed = False

    def lost(self, number: int | None, publishers: Callable[[], int]) -> int:
        """
        Return how many messages never came since the last one, by their publisher's count.

        None where the middleware does not count.  publishers: tells how many there are, since each
        counts for itself, and which one sent is not told: nothing can be said until one is left,
        and has sent once more.
        """
        newest, self._newest = self._newest, number
        if newest is None or number is None or number == newest + 1 and not self._is_mixed:
            return 0
        was_mixed = self._is_mixed
        # a smaller number is that of another publisher, who may have left before it was heard
        self._is_mixed = number <= newest or publishers() > 1
        return 0 if was_mixed or self._is_mixed else number - newest - 1

    def read(self, msg: Any, now_ns: int | None,
             arrived_ns: int | None = None) -> tuple[int, tuple[float, ...]]:
        """
        Return the stamp and the numbers of a message; Refused where they are none.

        One without a header holds at its arrival, now where that is not known.
        """
        if now_ns is None:
            raise Refused('no clock', f'expected a /clock before the first {self.what}')
        try:
            values = self._read(msg)
        except IndexError as error:
            raise Refused('wrong length', str(error)) from None
        if len(values) != self._size:
            raise Refused('wrong length', f'expected {self._size} numbers, got {len(values)}')
        if beyond := self._beyond(msg):
            raise Refused('out of range', beyond)
        if not all(map(math.isfinite, values)):
            raise Refused('not finite', f'expected finite numbers, got {list(values)}')
        if wrong := self._wrong(msg):
            raise Refused('bad covariance', wrong)
        return self._stamp(msg, now_ns, arrived_ns), values

    def _stamp(self, msg: Any, now_ns: int, arrived_ns: int | None) -> int:
        if not self.is_stamped:
            return now_ns if arrived_ns is None else min(arrived_ns, now_ns)
        stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
        if stamp_ns <= 0:
            raise Refused('no stamp', f'expected a stamp after 0, got {stamp_ns / NANOSECONDS} s')
        if stamp_ns > now_ns + self._max_ahead_ns:
            ahead = (stamp_ns - now_ns) / NANOSECONDS
            raise Refused('from the future', 'expected a stamp at most time.max_ahead after now, '
                          f'got one {ahead:.3f} s after it')
        return stamp_ns


class Source(Inlet):
    """
    One topic of measurements by a sensor.

    Raises ConfigError also for fields that never hold just its numbers.
    """

    def __init__(self, name: str, config: SourceConfig, sensor: Sensor, max_ahead: float,
                 account: SourceAccount | None = None) -> None:
        super().__init__(name, 'measurement', f'measurements.{name}', config, sensor.size,
                         max_ahead, account)
        try:
            fields.check_count(self.type, config.fields, sensor.size)
        except ValueError as error:
            raise ConfigError(f'{self.prefix}.fields: {error}') from None
        self.angles = [i for i, angular in enumerate(sensor.angular) if angular]

    def item(self, msg: Any, now_ns: int | None, arrived_ns: int | None = None) -> Measurement:
        """Return the measurement in a message; Refused where it is none."""
        stamp_ns, values = self.read(msg, now_ns, arrived_ns)
        return Measurement(stamp_ns, self.name, values)


class ControlSource(Inlet):
    """
    The topic of what drives a model with inputs.

    Of those without a header that arrive at one reading of a coarse clock each is stamped a
    nanosecond after the one before, so that the last counts.
    is_too_fast: tells of the numbers of a control, and the time, whether no step could follow it.
    Raises ConfigError also for fields that hold not just one number for each input.
    """

    def __init__(self, config: ControlConfig, inputs: Sequence[str], max_ahead: float,
                 is_too_fast: Callable[[tuple[float, ...], float], bool],
                 account: SourceAccount | None = None) -> None:
        super().__init__('control', 'control', 'control', config, len(inputs), max_ahead, account)
        self._is_too_fast = is_too_fast
        self._arrived_ns, self._in_a_tick = -1, 0
        try:
            fields.field_writer(self.type, config.fields, len(inputs))
        except ValueError as error:
            raise ConfigError(f'control.fields: {error} for {", ".join(inputs)}') from None

    def item(self, msg: Any, now_ns: int | None, arrived_ns: int | None = None) -> Control:
        """Return the control in a message; Refused where it is none."""
        stamp_ns, values = self.read(msg, now_ns, arrived_ns)
        if self._is_too_fast(values, stamp_ns / NANOSECONDS):
            raise Refused('too fast', 'expected one that carries no state across the whole grid '
                          f'in kernel.time_step, got {list(values)}')
        return Control(stamp_ns if self.is_stamped else self._after_others(stamp_ns), values)

    def _after_others(self, arrived_ns: int) -> int:
        """Return when a control arrived, later by one for each that did at the same time."""
        same = arrived_ns == self._arrived_ns
        self._arrived_ns, self._in_a_tick = arrived_ns, self._in_a_tick + 1 if same else 0
        return arrived_ns + self._in_a_tick
