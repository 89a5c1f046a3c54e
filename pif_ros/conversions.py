"""Messages to arrays and back: pure functions, and the only place that knows message classes."""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence
import importlib
import importlib.machinery
import math
from pathlib import Path
import re
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseWithCovariance
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import NANOSECONDS
from pif_ros.diagnostics import Status
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

Array = NDArray[np.float64]

#: The axes of a pose, in the order of its covariance.
POSE_AXES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')


def stamp_to_ns(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a stamp of nanoseconds since the epoch, 0 or more."""
    return Time(sec=int(stamp_ns // NANOSECONDS), nanosec=int(stamp_ns % NANOSECONDS))


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
    if found is None or not hasattr(found, 'get_fields_and_field_types'):
        raise ValueError(f'expected a message of package {package}, got {name!r}')
    return found


def has_header(message: Any) -> bool:
    """Return whether messages of a class carry a std_msgs/Header."""
    return message.get_fields_and_field_types().get('header') == 'std_msgs/Header'


def is_range(message: Any, fields: Sequence[str]) -> bool:
    """Return whether what is read of a message of this class is a sensor_msgs/Range's range."""
    return (message.__name__ == 'Range' and 'range' in fields
            and {'min_range', 'max_range'} <= set(message.get_fields_and_field_types()))


def in_range(msg: Any) -> bool:
    """Return whether a Range saw something: within its limits if it has any, and not below 0."""
    limited = msg.max_range > msg.min_range
    return bool(msg.min_range <= msg.range <= msg.max_range if limited else msg.range >= 0)


def field_reader(message: Any, paths: Sequence[str]) -> Callable[[Any], tuple[float, ...]]:
    """
    Return a function that reads the numbers at some paths of a message of this class.

    A path such as 'pose.pose.position.x' or 'ranges[0]' is a number; a path to an array of
    numbers is all of it.  No paths: 'data'.  Raises ValueError for a path that the class has not;
    the reader raises IndexError for an array that is too short.
    """
    steps = [_path(message, path) for path in paths or ('data',)]

    def read(msg: Any) -> tuple[float, ...]:
        values: list[float] = []
        for path in steps:
            found = msg
            for step in path:
                found = found[step] if isinstance(step, int) else getattr(found, step)
            if hasattr(found, '__len__'):
                values.extend(float(v[0] if isinstance(v, bytes) else v) for v in found)
            else:
                values.append(float(found))
        return tuple(values)

    return read


def _path(message: Any, path: str) -> tuple[str | int, ...]:
    """Return the steps of a path, checked against the fields of a message class."""
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
            element = re.fullmatch(r'sequence<([^,>]+).*>|(.+)\[\d+\]', kind)
            if element is None:
                raise ValueError(f'expected an index after an array only, got {path!r}')
            steps.append(int(match[2]))
            kind = element[1] or element[2]
        message = message_class(kind.replace('/', '/msg/')) if re.fullmatch(
            r'\w+/\w+', kind) else None
    if '/' in kind or 'string' in kind:
        raise ValueError(f'expected the path of a number, got {path!r} ({kind})')
    return tuple(steps)


def fill_pose(message: PoseWithCovariance, mean: Array, covariance: Array,
              axes: Sequence[int | None], unestimated_variance: float) -> None:
    """Write mean and covariance to a pose: x, y, z, roll, pitch, yaw are states of these axes."""
    values = np.zeros(6)
    full = np.diag(np.full(6, unestimated_variance))
    estimated = [(axis, state) for axis, state in enumerate(axes) if state is not None]
    for axis, state in estimated:
        values[axis] = mean[state]
        for other, other_state in estimated:
            full[axis, other] = covariance[state, other_state]
    message.covariance = full.ravel()
    position, orientation = message.pose.position, message.pose.orientation
    x, y, z, roll, pitch, yaw = values.tolist()
    position.x, position.y, position.z = x, y, z
    (orientation.x, orientation.y, orientation.z,
     orientation.w) = quaternion(roll, pitch, yaw)


def gaussian_from_pose(message: PoseWithCovariance, axes: Sequence[int | None], mean: Array,
                       covariance: Array) -> tuple[Array, Array]:
    """Return mean and covariance with the states of these axes replaced by those of a pose."""
    position = message.pose.position
    values = (position.x, position.y, position.z, *angles(message.pose))
    full = np.asarray(message.covariance, dtype=float).reshape(6, 6)
    estimated = [(axis, state) for axis, state in enumerate(axes) if state is not None]
    mean, covariance = mean.copy(), covariance.copy()
    for axis, state in estimated:
        mean[state] = values[axis]
        covariance[state, :] = covariance[:, state] = 0.0
    for axis, state in estimated:
        for other, other_state in estimated:
            covariance[state, other_state] = full[axis, other]
    return mean, covariance


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return x, y, z and w of a rotation by roll, then pitch, then yaw."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy)


def angles(pose: Pose) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a pose's orientation."""
    q = pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    return (math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
            math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x)))),
            math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def diagnostics_message(statuses: Sequence[Status], stamp_ns: int, node: str) -> DiagnosticArray:
    """Return what a node of this name has to say of itself."""
    msg = DiagnosticArray()
    msg.header.stamp = stamp_from_ns(stamp_ns)
    msg.status = [
        DiagnosticStatus(level=bytes([status.level]), name=f'{node}: {status.name}',
                         message=status.message, hardware_id=node,
                         values=[KeyValue(key=key, value=value)
                                 for key, value in status.values.items()])
        for status in statuses]
    return msg


def density_message(belief: GridBelief, names: Sequence[str],
                    units: Sequence[str]) -> Float64MultiArray:
    """
    Return a density in C order; values times the cell volume sum to 1.

    layout.dim has one entry for each axis, labelled 'x first=-59.75 spacing=0.5 unit=m'.
    """
    message = Float64MultiArray()
    grid = belief.grid
    for axis, name in enumerate(names):
        unit = units[axis] if units else '1'
        label = (f'{name} first={float(grid.axes[axis][0])!r} '
                 f'spacing={float(grid.spacing[axis])!r} unit={unit}')
        stride = math.prod(grid.shape[axis:])
        message.layout.dim.append(MultiArrayDimension(
            label=label, size=int(grid.shape[axis]), stride=int(stride)))
    values = np.ascontiguousarray(belief.density / belief.mass)
    data = array.array('d')
    data.frombytes(values.data.cast('B'))
    message.data = data
    return message


def map_message(belief: GridBelief, stamp_ns: int, frame: str) -> OccupancyGrid:
    """Return a density over x and y as a map: 100 in the densest cell, 0 in an empty one."""
    message, grid = OccupancyGrid(), belief.grid
    message.header.stamp, message.header.frame_id = stamp_from_ns(stamp_ns), frame
    # a map has square cells: the finer spacing, other cells are shown more than once
    resolution = float(grid.spacing.min())
    columns, rows = (_nearest(grid.shape[axis], float(grid.spacing[axis]) / resolution)
                     for axis in (0, 1))
    share = belief.density[np.ix_(columns, rows)].T / belief.density.max()
    info = message.info
    info.map_load_time = stamp_from_ns(stamp_ns)
    info.resolution = resolution
    info.width, info.height = len(columns), len(rows)
    info.origin.position.x, info.origin.position.y = float(grid.lower[0]), float(grid.lower[1])
    info.origin.orientation.w = 1.0
    message.data = array.array('b', np.rint(100 * share).astype(np.int8).tobytes())
    return message


def _nearest(cells: int, stretch: float) -> NDArray[np.int64]:
    """Return which of some cells is shown in each cell of a finer axis."""
    return np.minimum((np.arange(round(cells * stretch)) + 0.5) / stretch, cells - 1).astype(int)


def field_writer(message: Any, paths: Sequence[str],
                 size: int) -> Callable[[Any, Sequence[float]], None]:
    """
    Return a function that puts so many numbers into a message of this class.

    What a field_reader with the same paths reads of it then.  An array of any length holds what
    the other paths leave.  Raises ValueError for paths that cannot hold just so many numbers.
    """
    places = [_path(message, path) for path in paths or ('data',)]
    counts = [_room(message(), steps) for steps in places]
    known = sum(count or 0 for count in counts)
    if counts.count(None) > 1 or known > size or (None not in counts and known < size):
        raise ValueError(f'expected fields that hold {size} numbers, got {list(paths)}')
    ends = np.cumsum([size - known if count is None else count for count in counts]).tolist()

    def write(msg: Any, values: Sequence[float]) -> None:
        for steps, begin, end in zip(places, [0, *ends], ends):
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
    if isinstance(found, (bool, bytes)):
        raise ValueError(f'expected fields of real or whole numbers, got {list(steps)}')
    return 1 if isinstance(found, (int, float)) else len(found) or None


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
