"""Messages to arrays and back: pure functions, and the only place that knows message classes."""

from __future__ import annotations

import array
from collections.abc import Sequence
import math

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseWithCovariance
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.grid import Grid
from pif_ros.diagnostics import Status
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

Array = NDArray[np.float64]

#: A map has at most so many cells.
MOST_CELLS = 4_000_000
#: The axes of a pose, in the order of its covariance.
POSE_AXES = ('x', 'y', 'z', 'roll', 'pitch', 'yaw')


def stamp_to_ns(stamp: Time) -> int:
    """Return a stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def stamp_from_ns(stamp_ns: int) -> Time:
    """Return a stamp of nanoseconds since the epoch, 0 or more."""
    return Time(sec=int(stamp_ns // NANOSECONDS), nanosec=int(stamp_ns % NANOSECONDS))


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
    """
    Return roll, pitch and yaw of a pose's orientation, a quaternion of any length.

    NaN where it is no rotation: of length 0, or not finite.
    """
    q = pose.orientation
    length = math.hypot(q.x, q.y, q.z, q.w)
    if not 0 < length < math.inf:
        return math.nan, math.nan, math.nan
    x, y, z, w = (component / length for component in (q.x, q.y, q.z, q.w))
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
    """
    Return a density over x and y as a map: 100 in the densest cell, 0 in an empty one.

    Cells are squares as wide as the finer spacing, those of the other are shown more than once;
    where there would be more than MOST_CELLS of them they are wider, with the mean density.
    """
    message, grid = OccupancyGrid(), belief.grid
    message.header.stamp, message.header.frame_id = stamp_from_ns(stamp_ns), frame
    resolution, density = _resolution(grid), belief.density
    counts, stretch = _cells(grid, resolution), grid.spacing / resolution
    for axis in np.argsort(stretch).tolist():
        density = _stretched(density, axis, counts[axis], float(stretch[axis]))
    share = density.T / density.max()
    info = message.info
    info.map_load_time = stamp_from_ns(stamp_ns)
    info.resolution = resolution
    info.height, info.width = share.shape
    info.origin.position.x, info.origin.position.y = float(grid.lower[0]), float(grid.lower[1])
    info.origin.orientation.w = 1.0
    message.data = array.array('b', np.rint(100 * share).astype(np.int8).tobytes())
    return message


def _resolution(grid: Grid) -> float:
    """Return how wide the cells of a map are: as the narrowest of the grid, if they may be."""
    extent = np.array(grid.upper) - np.array(grid.lower)
    resolution = max(float(grid.spacing.min()), float(extent.max()) / MOST_CELLS)
    while math.prod(_cells(grid, resolution)) > MOST_CELLS:
        resolution *= 2
    return resolution


def _cells(grid: Grid, resolution: float) -> list[int]:
    """Return how many cells of a map there are along each axis."""
    return [max(1, round(cells * float(width) / resolution))
            for cells, width in zip(grid.shape, grid.spacing)]


def _stretched(density: Array, axis: int, count: int, stretch: float) -> Array:
    """Return a density on so many cells of an axis, of which a cell of its own takes some."""
    cells = density.shape[axis]
    if stretch >= 1:
        nearest = np.minimum((np.arange(count) + 0.5) / stretch, cells - 1).astype(int)
        return np.take(density, nearest, axis)
    # the mean of a wider cell is what was summed up to its end, less what was up to its beginning
    ends = np.minimum(np.arange(count + 1) / stretch, cells)
    whole = np.minimum(ends, cells - 1).astype(int)
    summed = np.moveaxis(np.cumsum(density, axis) - density, axis, -1)
    summed = summed[..., whole] + (ends - whole) * np.moveaxis(density, axis, -1)[..., whole]
    return np.moveaxis(np.maximum(np.diff(summed), 0.0), -1, axis) * stretch
