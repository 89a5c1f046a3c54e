"""What a parameter may hold, and how a wrong one is refused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, Field, field
import math
from typing import Any

Value = bool | int | float | str | Sequence[Any] | None


class ConfigError(ValueError):
    """A parameter that cannot be: its full name, what was wanted and what was given."""


@dataclass(frozen=True)
class Kind:
    """What a parameter may hold."""

    wanted: str
    take: Callable[[Value], Any]


def _number(value: Value) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError
    if not math.isfinite(value):
        raise ValueError
    return float(value)


def _integer(value: Value) -> int:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(value):
        raise ValueError
    return int(value)


def _positive(value: Value) -> float:
    number = _number(value)
    if number <= 0:
        raise ValueError
    return number


def _not_negative(value: Value) -> float:
    number = _number(value)
    if number < 0:
        raise ValueError
    return number


def _count(value: Value) -> int:
    number = _integer(value)
    if not 1 <= number <= 1_000_000:
        raise ValueError
    return number


def _share(value: Value) -> float:
    number = _number(value)
    if not 0 <= number <= 1:
        raise ValueError
    return number


def _part(value: Value) -> float:
    number = _share(value)
    if number == 1:
        raise ValueError
    return number


def _between(value: Value) -> float:
    number = _part(value)
    if number == 0:
        raise ValueError
    return number


def _little(value: Value) -> float:
    number = _between(value)
    if number > 0.01:
        raise ValueError
    return number


def _seed(value: Value) -> int:
    number = _integer(value)
    if not 0 <= number < 2**63:
        raise ValueError
    return number


def _steps(value: Value) -> int:
    number = _count(value)
    if number > 1000:
        raise ValueError
    return number


def _frequency(value: Value) -> float:
    number = _number(value)
    if number and not 0.001 <= number <= 1000:
        raise ValueError
    return number


def _duration(value: Value) -> float:
    number = _number(value)
    if not 0 <= number <= 1e9:
        raise ValueError
    return number


def _span(value: Value) -> float:
    number = _duration(value)
    if not number:
        raise ValueError
    return number


def _period(value: Value) -> float:
    number = _duration(value)
    if number and number < 0.1:
        raise ValueError
    return number


def _bool(value: Value) -> bool:
    if not isinstance(value, bool):
        raise ValueError
    return value


def _text(value: Value) -> str:
    if not isinstance(value, str):
        raise ValueError
    return value


def _name(value: Value) -> str:
    if not _text(value):
        raise ValueError
    return str(value)


def _many(one: Callable[[Value], Any]) -> Callable[[Value], tuple[Any, ...]]:
    def take(value: Value) -> tuple[Any, ...]:
        if value is None:
            return ()
        if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
            raise ValueError
        return tuple(one(item) for item in value)
    return take


def _limits(value: Value) -> tuple[float, ...]:
    numbers = _many(_not_negative)(value)
    if len(numbers) != 2 or numbers[0] > numbers[1]:
        raise ValueError
    return numbers


def one_of(*options: str) -> Kind:
    def take(value: Value) -> str:
        if value not in options:
            raise ValueError
        return str(value)
    return Kind(' | '.join(options), take)


NUMBER, INTEGER = Kind('a finite number', _number), Kind('a whole number', _integer)
POSITIVE = Kind('a positive number', _positive)
NOT_NEGATIVE = Kind('a number, 0 or more', _not_negative)
COUNT = Kind('a whole number, 1 to 1000000', _count)
SHARE, PART = Kind('a number from 0 to 1', _share), Kind('a number from 0 to below 1', _part)
BETWEEN = Kind('a number between 0 and 1', _between)
LITTLE = Kind('a number above 0 and up to 0.01', _little)
SEED, STEPS = Kind('a whole number, 0 or more', _seed), Kind('a whole number, 1 to 1000', _steps)
DURATION = Kind('a number from 0 to 1e9', _duration)
FREQUENCY = Kind('0, or a number from 0.001 to 1000', _frequency)
SPAN = Kind('a positive number up to 1e9', _span)
PERIOD = Kind('0, or a number from 0.1 to 1e9', _period)
BOOL, TEXT, NAME = Kind('true or false', _bool), Kind('text', _text), Kind('a name', _name)
NUMBERS = Kind('a list of finite numbers', _many(_number))
LIMITS = Kind('two numbers, 0 or more, the second no less than the first', _limits)
INTEGERS = Kind('a list of whole numbers', _many(_integer))
BOOLS = Kind('a list of true or false', _many(_bool))
NAMES = Kind('a list of names', _many(_text))


def parameter(default: Any, kind: Kind, says: str, unit: str = '', live: bool = False) -> Any:
    """Return a field that is a parameter; live ones may be set while the node runs."""
    return field(default=default, metadata={
        'kind': kind, 'says': says, 'unit': unit, 'live': live})


def taken(name: str, value: Value, spec: Field[Any]) -> Any:
    """Return a value as its parameter holds it; ConfigError where it is none of its kind."""
    kind: Kind = spec.metadata['kind']
    try:
        return kind.take(value)
    except (ValueError, TypeError, OverflowError):
        listed = isinstance(value, Iterable) and not isinstance(value, str)
        shown = list(value) if listed else value  # type: ignore[arg-type]
        hint = (" (y, n, on and off are true and false unless in quotes: 'y')"
                if kind is NAMES and isinstance(shown, list)
                and any(isinstance(item, bool) for item in shown) else '')
        raise ConfigError(f'{name}: expected {kind.wanted}{hint}, got {shown!r}') from None


@contextmanager
def named(prefix: str) -> Iterator[None]:
    """Put a section's name before what the core says of a value in it."""
    try:
        yield
    except ConfigError:
        raise
    except (ValueError, TypeError) as error:
        raise ConfigError(f'{prefix}.{error}' if ':' in str(error) else
                          f'{prefix}: {error}') from None
