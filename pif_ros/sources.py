"""From the message of a source to a measurement, or to the reason why it is none."""

from __future__ import annotations

import math
from typing import Any

from pif_ros import conversions
from pif_ros.config import ConfigError, SourceConfig
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.models import Sensor
from pif_ros.core.tracker import Measurement


class Refused(ValueError):
    """A message that is no measurement: a reason to count by, and a sentence."""

    def __init__(self, reason: str, sentence: str) -> None:
        super().__init__(sentence)
        self.reason = reason


class Source:
    """
    One topic of measurements.

    Raises ConfigError for a type that is not installed or fields that it has not.
    """

    def __init__(self, name: str, config: SourceConfig, sensor: Sensor,
                 max_ahead: float) -> None:
        self.name, self.topic, self._size = name, config.topic, sensor.size
        self._max_ahead_ns = round(max_ahead * NANOSECONDS)
        try:
            self.type = conversions.message_class(config.type)
        except ValueError as error:
            raise ConfigError(f'measurements.{name}.type: {error}') from None
        try:
            self._read = conversions.field_reader(self.type, config.fields)
        except ValueError as error:
            raise ConfigError(f'measurements.{name}.fields: {error}') from None
        self._stamped = conversions.has_header(self.type)
        self._is_range = conversions.is_range(self.type, config.fields)
        self._newest: int | None = None

    def lost(self, number: int | None) -> int:
        """
        Return how many messages never came since the last one, by their publisher's count.

        None where the middleware does not count; a smaller number is that of a new publisher.
        """
        newest, self._newest = self._newest, number
        return 0 if newest is None or number is None else max(number - newest - 1, 0)

    def measurement(self, msg: Any, now_ns: int | None,
                    arrived_ns: int | None = None) -> Measurement:
        """
        Return the measurement in a message; Refused where it is none.

        One without a header holds at its arrival, now where that is not known.
        """
        if now_ns is None:
            raise Refused('no clock', 'expected a /clock before the first measurement')
        try:
            values = self._read(msg)
        except IndexError:
            raise Refused('wrong length', f'expected {self._size} numbers, got a message whose '
                          'arrays are too short') from None
        if len(values) != self._size:
            raise Refused('wrong length', f'expected {self._size} numbers, got {len(values)}')
        if not all(map(math.isfinite, values)):
            raise Refused('not finite', f'expected finite numbers, got {list(values)}')
        if self._is_range and not conversions.in_range(msg):
            raise Refused('out of range', f'expected a range from {msg.min_range:g} to '
                          f'{msg.max_range:g}, got {msg.range:g}')
        return Measurement(self._stamp(msg, now_ns, arrived_ns), self.name, values)

    def _stamp(self, msg: Any, now_ns: int, arrived_ns: int | None) -> int:
        if not self._stamped:
            return now_ns if arrived_ns is None else min(arrived_ns, now_ns)
        stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
        if stamp_ns <= 0:
            raise Refused('no stamp', f'expected a stamp after 0, got {stamp_ns / NANOSECONDS} s')
        if stamp_ns > now_ns + self._max_ahead_ns:
            ahead = (stamp_ns - now_ns) / NANOSECONDS
            raise Refused('from the future', 'expected a stamp at most time.max_ahead after now, '
                          f'got one {ahead:.3f} s after it')
        return stamp_ns
