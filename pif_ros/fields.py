"""The fields of messages by their paths: what is read of them, and written to them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import functools
import importlib
import importlib.machinery
import math
from pathlib import Path
import re
import sys
from typing import Any

import numpy as np

#: By the name of a message, its field of distances, and those of the least and the most of them.
DISTANCES = {'Range': ('range', 'min_range', 'max_range'),
             'LaserScan': ('ranges', 'range_min', 'range_max')}
#: Kinds of numbers that need not be whole, or finite.
REAL = ('double', 'float')
#: What numbers of a kind lie between, as messages check it.
FLOAT_MAX = 3.402823466e38
LIMITS: dict[str, tuple[float, float]] = {
    'double': (-sys.float_info.max, sys.float_info.max), 'float': (-FLOAT_MAX, FLOAT_MAX),
    **{f'int{bits}': (-2**(bits - 1), 2**(bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **{f'uint{bits}': (0, 2**bits - 1) for bits in (8, 16, 32, 64)}}


def message_class(name: str) -> Any:
    """
    Return the class of an installed message type such as 'sensor_msgs/msg/Range'.

    Nothing is imported but what the ROS message generators made: a package that holds the message
    and its C type support.  Raises ValueError.
    """
    match = re.fullmatch(r'([a-z][a-z0-9_]*)/msg/([A-Z][A-Za-z0-9]*)', name)
    if match is None:
        raise ValueError(f'expected a message type such as sensor_msgs/msg/Range, got {name!r}')
    package, message = match.groups()
    spec = importlib.machinery.PathFinder.find_spec(package)
    folders = [Path(place) for place in (spec and spec.submodule_search_locations) or []]
    if not any((folder / 'msg').is_dir() and any(folder.glob(f'{package}_s__rosidl_typesupport*'))
               for folder in folders):
        raise ValueError(f'expected a type of an installed message package, got {name!r}')
    found = getattr(importlib.import_module(f'{package}.msg'), message, None)
    if not hasattr(found, 'get_fields_and_field_types'):
        raise ValueError(f'expected a message of package {package}, got {name!r}')
    return found


def has_header(message: Any) -> bool:
    """Return whether messages of a class carry a std_msgs/Header."""
    return message.get_fields_and_field_types().get('header') == 'std_msgs/Header'


def ranger(message: Any, paths: Sequence[str]) -> Callable[[Any], str]:
    """
    Return a function that says which distance that is read saw nothing, '' for none.

    Those of a Range or a LaserScan must be within its limits if it has any, and not below 0.  What
    is infinite is beyond any: +inf is how drivers say that nothing came back, -inf that something
    is too close [REP 117]; NaN, an error, is not judged here.
    """
    field, least, most = DISTANCES.get(message.__name__, ('', '', ''))
    own = [path for path in paths if path.split('[')[0] == field]
    if not own or not {field, least, most} <= set(message.get_fields_and_field_types()):
        return lambda msg: ''
    read = field_reader(message, own)

    def beyond(msg: Any) -> str:
        low, high = getattr(msg, least), getattr(msg, most)
        for value in read(msg):
            within = low <= value <= high if high > low else value >= 0
            if math.isinf(value) or not (within or math.isnan(value)):
                return f'expected a range from {low:g} to {high:g}, got {value:g}'
        return ''

    return beyond


def field_reader(message: Any, paths: Sequence[str]) -> Callable[[Any], tuple[float, ...]]:
    """
    Return a function that reads the numbers at some paths of a message of this class.

    A path such as 'pose.pose.position.x' or 'ranges[0]' is a number; a path to an array of
    numbers is all of it.  No paths: 'data'.  Raises ValueError for a path that the class has not;
    the reader raises IndexError, which names the path, for an array that is too short.
    """
    steps = [_path(message, path) for path in paths or ('data',)]

    def read(msg: Any) -> tuple[float, ...]:
        values: list[float] = []
        for path in steps:
            found = msg
            for step in path:
                if not isinstance(step, int):
                    found = getattr(found, step)
                elif step < len(found):
                    found = found[step]
                else:
                    raise IndexError(f'expected {_written(path)}, got an array that is too short: '
                                     f'it has {len(found)}')
            if hasattr(found, '__len__'):
                values.extend(float(v[0] if isinstance(v, bytes) else v) for v in found)
            else:
                values.append(float(found))
        return tuple(values)

    return read


def _written(steps: Sequence[str | int]) -> str:
    """Return a path as it is written in the parameters."""
    return ''.join(f'[{step}]' if isinstance(step, int) else f'.{step}' for step in steps)[1:]


def are_places(paths: Sequence[str]) -> bool:
    """Return whether some of the paths lead into a pose or a point, in the header's frame."""
    return any(path.split('.')[0] in ('pose', 'point') for path in paths)


def covariances(message: Any, paths: Sequence[str]) -> tuple[str, ...]:
    """
    Return the paths of the covariances of what is read.

    Those are, at each message on the paths, its `covariance`, or the one that is named after the
    next field (`angular_velocity_covariance`), or the only one.
    """
    return tuple(dict.fromkeys('.'.join(place) for path in paths
                               for place in _covariances(message, _path(message, path))))


def doubter(message: Any, paths: Sequence[str]) -> Callable[[Any], str]:
    """
    Return a function that says what is wrong with the covariances of what is read, '' for nothing.

    They must be finite, with no variance below 0: -1 in front is how sensor_msgs says that there
    is no such measurement.
    """
    places = [place.split('.') for place in covariances(message, paths)]

    def wrong(msg: Any) -> str:
        for place in places:
            values = np.asarray(functools.reduce(getattr, place, msg), dtype=float)
            variances = values[::math.isqrt(len(values)) + 1]
            if not np.all(np.isfinite(values)) or np.any(variances < 0):
                return (f'{".".join(place)}: expected finite numbers and no variance below 0, '
                        f'got variances {variances.tolist()}')
        return ''

    return wrong


def _covariances(message: Any, steps: Sequence[str | int]) -> Iterator[tuple[str, ...]]:
    """Give the places of the covariances that belong to what lies at the end of some steps."""
    place: tuple[str, ...] = ()
    for step in steps:
        if isinstance(step, int):
            return
        kinds = message.get_fields_and_field_types()
        there = [name for name, kind in kinds.items()
                 if name.endswith('covariance') and re.fullmatch(r'double\[\d+\]', kind)]
        own = [name for name in ('covariance', f'{step}_covariance') if name in there]
        if step not in there:
            yield from ((*place, name) for name in own or (there if len(there) == 1 else []))
        place, kind = (*place, step), kinds[step]
        message = (message_class(kind.replace('/', '/msg/'))
                   if re.fullmatch(r'\w+/\w+', kind) else None)


def _path(message: Any, path: str) -> tuple[str | int, ...]:
    """Return the steps of a path, checked against the fields of a message class."""
    return _found(message, path)[0]


def _found(message: Any, path: str) -> tuple[tuple[str | int, ...], str]:
    """Return the steps of a path, and the kind of what lies at its end."""
    steps: list[str | int] = []
    kind = ''
    for part in path.split('.'):
        match = re.fullmatch(r'(\w+)(?:\[(\d+)\])?', part)
        fields = message.get_fields_and_field_types() if message is not None else {}
        if match is None or match[1] not in fields:
            raise ValueError(f'expected fields out of {", ".join(fields) or "nothing further"}, '
                             f'got {path!r}')
        steps.append(match[1])
        kind = fields[match[1]]
        if match[2] is not None:
            if not (element := _element(kind)):
                raise ValueError(f'expected an index after an array only, got {path!r}')
            if int(match[2]) >= (most := _count(kind)[1]):
                raise ValueError(f'expected an index below {most}, got {path!r}')
            steps.append(int(match[2]))
            kind = element
        message = message_class(kind.replace('/', '/msg/')) if re.fullmatch(
            r'\w+/\w+', kind) else None
    if '/' in kind or 'string' in kind:
        raise ValueError(f'expected the path of a number, got {path!r} ({kind})')
    return tuple(steps), kind


def check_count(message: Any, paths: Sequence[str], size: int) -> None:
    """Raise ValueError where no message of this class has so many numbers at these paths."""
    counts = [_count(_found(message, path)[1]) for path in paths or ('data',)]
    least, most = (sum(each) for each in zip(*counts))
    if not least <= size <= most:
        raise ValueError(f'expected fields that hold {size} numbers, got {list(paths)}')


def _element(kind: str) -> str:
    """Return what an array of a kind is made of, '' where it is none."""
    found = re.fullmatch(r'sequence<([^,>]+).*>|(.+)\[\d+\]', kind)
    return '' if found is None else found[1] or found[2]


def _count(kind: str) -> tuple[int, float]:
    """Return how many numbers a field of a kind holds, at least and at most."""
    if fixed := re.fullmatch(r'.+\[(\d+)\]', kind):
        return int(fixed[1]), int(fixed[1])
    if sequence := re.fullmatch(r'sequence<[^,]+(?:, (\d+))?>', kind):
        return 0, int(sequence[1]) if sequence[1] else math.inf
    return 1, 1


def field_writer(message: Any, paths: Sequence[str],
                 size: int) -> Callable[[Any, Sequence[float]], None]:
    """
    Return a function that puts so many numbers into a message of this class.

    What a field_reader with the same paths reads of it then.  An array of any length holds what
    the other paths leave.  Raises ValueError for paths that cannot hold just so many numbers; the
    writer raises it for a number that its field cannot hold.
    """
    places = [(path, *_found(message, path)) for path in paths or ('data',)]
    counts = [_room(message(), steps) for _, steps, _ in places]
    for path, _, kind in places:
        if (_element(kind) or kind) not in LIMITS:
            raise ValueError(f'expected fields of real or whole numbers, got {path!r} ({kind})')
    known = sum(count or 0 for count in counts)
    if counts.count(None) > 1 or known > size or (None not in counts and known < size):
        raise ValueError(f'expected fields that hold {size} numbers, got {list(paths)}')
    ends = np.cumsum([size - known if count is None else count for count in counts]).tolist()

    def write(msg: Any, values: Sequence[float]) -> None:
        for (path, steps, kind), begin, end in zip(places, [0, *ends], ends):
            _check_limits(path, _element(kind) or kind, values[begin:end])
            _put(msg, steps, values[begin:end])

    return write


def _room(msg: Any, steps: Sequence[str | int]) -> int | None:
    """Return how many numbers the place at the end of a path takes, None for any number."""
    if any(isinstance(step, int) for step in steps[:-1]):
        raise ValueError(f'expected an index at the end of a path only, got {list(steps)}')
    found = msg
    for step in steps:
        if isinstance(step, int):
            return 1
        found = getattr(found, step)
    return 1 if isinstance(found, (int, float)) else len(found) or None


def _check_limits(path: str, kind: str, values: Sequence[float]) -> None:
    """Refuse numbers that a field of a kind cannot hold, whole ones once they are rounded."""
    (low, high), is_real = LIMITS[kind], kind in REAL
    for value in values:
        if not (is_real if not math.isfinite(value) else
                low <= (value if is_real else round(value)) <= high):
            raise ValueError(f'expected numbers from {low:.12g} to {high:.12g} for {path!r} '
                             f'({kind}), got {float(value)!r}')


def _put(msg: Any, steps: Sequence[str | int], values: Sequence[float]) -> None:
    """Write numbers to the end of a path, rounded where it takes whole ones only."""
    names = [step for step in steps if isinstance(step, str)]
    for name in names[:-1]:
        msg = getattr(msg, name)
    found = getattr(msg, names[-1])
    if isinstance(found, (int, float)):
        setattr(msg, names[-1], type(found)(round(values[0]) if isinstance(found, int)
                                            else values[0]))
        return
    kind = found.dtype.char if hasattr(found, 'dtype') else found.typecode
    numbers = [float(v) if kind in 'fd' else round(v) for v in values]
    if isinstance(steps[-1], int):
        kept = found.tolist()
        kept += [type(numbers[0])(0)] * (steps[-1] + 1 - len(kept))
        kept[steps[-1]] = numbers[0]
        numbers = kept
    setattr(msg, names[-1], numbers)
