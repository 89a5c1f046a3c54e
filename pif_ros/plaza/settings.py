"""The parameters of the player: names, defaults, limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from math import isfinite
from typing import Any

from pif_ros.plaza.recording import NAMES
from pif_ros.plaza.schedule import Span


@dataclass(frozen=True)
class Settings:
    """
    What is played, and how fast.

    recording: Plaza1 or Plaza2; path: its file, '' for the one that comes with gtsam; speed: 1 is
    real time, 0 as fast as the follower keeps up; follow: the topic of the follower's poses, used
    at speed 0; start, duration: the part that is played, in seconds, a duration of 0 meaning to
    the end; timeout: how long to wait for subscribers, and for a pose at speed 0, in seconds;
    odometry: whether it is played too.
    """

    recording: str = 'Plaza1'
    path: str = ''
    speed: float = 1.0
    follow: str = '/filter_node/pose'
    start: float = 0.0
    duration: float = 0.0
    timeout: float = 30.0
    odometry: bool = True

    @property
    def span(self) -> Span:
        """Return the part of the recording that is played."""
        return Span(self.start, self.duration)

    @classmethod
    def from_values(cls, values: Mapping[str, object]) -> Settings:
        """Return settings from parameter values; ValueError names the first wrong parameter."""
        known = {field.name: type(field.default) for field in fields(cls)}
        for name in values:
            if name not in known:
                raise ValueError(f"parameter '{name}': expected one of {', '.join(known)}")
        checked: dict[str, Any] = {
            name: _checked(name, known[name], value) for name, value in values.items()}
        return cls(**checked)


def _checked(name: str, kind: type, value: object) -> str | float | bool:
    """Return a value as its kind; ValueError says what was wanted and what was given."""
    if kind is str:
        wanted, good = _text(name, value)
    elif kind is bool:
        wanted, good = 'true or false', isinstance(value, bool)
    else:
        wanted, good = _number(name, value)
    if not good:
        raise ValueError(f"parameter '{name}': expected {wanted}, got {value!r}")
    return float(value) if kind is float else kind(value)  # type: ignore[arg-type]


def _text(name: str, value: object) -> tuple[str, bool]:
    if name == 'recording':
        return ' or '.join(NAMES), value in NAMES
    if name == 'follow':
        return 'the name of a topic', isinstance(value, str) and value != ''
    return 'a string', isinstance(value, str)


def _number(name: str, value: object) -> tuple[str, bool]:
    number = isinstance(value, (int, float)) and not isinstance(value, bool) and isfinite(value)
    if name == 'timeout':
        return 'a number above 0', number and value > 0  # type: ignore[operator]
    if name in ('start', 'duration'):
        return 'a number from 0 to 1e9', number and 0 <= value <= 1e9  # type: ignore[operator]
    return 'a number of at least 0', number and value >= 0  # type: ignore[operator]
