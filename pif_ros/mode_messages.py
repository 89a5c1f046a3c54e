"""The humps of a belief as messages: numbers for programs, ellipses for RViz."""

from __future__ import annotations

import array
from collections.abc import Sequence
import math

from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
import numpy as np
from numpy.typing import NDArray
from pif_ros import conversions
from pif_ros.core.modes import Mode
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header, MultiArrayDimension
from visualization_msgs.msg import Marker, MarkerArray

Array = NDArray[np.float64]

#: An ellipse holds this share of a Gaussian over x and y: it reaches so many standard deviations.
HOLDS = 0.95
SIGMAS = math.sqrt(-2 * math.log(1 - HOLDS))
#: No axis of an ellipse is shorter than this, in the units of x and y: nothing would be seen.
THINNEST = 1e-3
#: Where only one of x and y is estimated, the other has this share of its standard deviation.
BAR = 0.1
#: Letters are this share of the ellipse's mean radius tall, and at least so tall, in these units.
LETTERS, SMALLEST = 0.5, 0.2
#: Blue and vermilion are seen on RViz's dark ground and on a white map.
BLUE, VERMILION = (0.0, 0.45, 0.7), (0.84, 0.37, 0.0)
ELLIPSES, MASSES = 'modes', 'masses'


def modes_message(modes: Sequence[Mode], names: Sequence[str]) -> Float64MultiArray:
    """Return a row for each mode: its mass, its mean (n,), its covariance (n, n) row by row."""
    n, states = len(names), ', '.join(names)
    rows = np.array([[mode.mass, *mode.mean, *mode.covariance.ravel()] for mode in modes])
    message = Float64MultiArray(data=array.array('d', rows.tobytes()))
    width = 1 + n + n * n
    message.layout.dim = [
        MultiArrayDimension(label='mode, heaviest first', size=len(modes),
                            stride=len(modes) * width),
        MultiArrayDimension(label=f'mass; mean of {states}; covariance of {states}, row by row',
                            size=width, stride=width)]
    return message


def markers_message(modes: Sequence[Mode], axes: Sequence[int | None], shown: int, stamp_ns: int,
                    frame: str) -> MarkerArray:
    """
    Return an ellipse and a text with its mass for each mode, and what deletes older ones.

    axes: the states that are x, y and z, None for none; shown: how many modes there were before.
    A mode's markers have its rank as their id.
    """
    header = Header(stamp=conversions.stamp_from_ns(stamp_ns), frame_id=frame)
    markers = []
    for rank, mode in enumerate(modes):
        markers += _drawn(header, rank, mode, axes)
    for rank in range(len(modes), shown):
        markers += [Marker(header=header, ns=space, id=rank, action=Marker.DELETE)
                    for space in (ELLIPSES, MASSES)]
    return MarkerArray(markers=markers)


def _drawn(header: Header, rank: int, mode: Mode, axes: Sequence[int | None]) -> list[Marker]:
    """Return the ellipse and the text of a mode."""
    x, y, z = (0.0 if axis is None else float(mode.mean[axis]) for axis in axes)
    half, turn = ellipse(_in_plane(mode.covariance, axes[:2]))
    letters = max(SMALLEST, LETTERS * math.sqrt(half[0] * half[1]))
    opacity = 0.2 + 0.4 * min(mode.mass, 1.0)
    qx, qy, qz, qw = conversions.quaternion(0.0, 0.0, turn)
    return [
        Marker(header=header, ns=ELLIPSES, id=rank, type=Marker.CYLINDER, action=Marker.ADD,
               pose=Pose(position=Point(x=x, y=y, z=z),
                         orientation=Quaternion(x=qx, y=qy, z=qz, w=qw)),
               scale=Vector3(x=2 * half[0], y=2 * half[1], z=THINNEST),
               color=_colour(BLUE, opacity)),
        Marker(header=header, ns=MASSES, id=rank, type=Marker.TEXT_VIEW_FACING, action=Marker.ADD,
               pose=Pose(position=Point(x=x, y=y, z=z + letters),
                         orientation=Quaternion(w=1.0)),
               scale=Vector3(z=letters), color=_colour(VERMILION, 1.0),
               text=f'{100 * mode.mass:.3g} %')]


def ellipse(covariance: Array) -> tuple[tuple[float, float], float]:
    """Return the half axes of a covariance's (2, 2) ellipse, the longer first, and its angle."""
    variances, directions = np.linalg.eigh(covariance)
    short, long = (max(SIGMAS * math.sqrt(max(float(v), 0.0)), THINNEST / 2) for v in variances)
    return (long, short), math.atan2(float(directions[1, 1]), float(directions[0, 1]))


def _in_plane(covariance: Array, axes: Sequence[int | None]) -> Array:
    """Return the covariance of x and y, narrow along the one that is not estimated."""
    known = [axis for axis in axes if axis is not None]
    if len(known) == 2:
        return covariance[np.ix_(known, known)]
    variance = covariance[known[0], known[0]]
    return np.diag([variance * (BAR**2 if axis is None else 1.0) for axis in axes])


def _colour(rgb: tuple[float, float, float], opacity: float) -> ColorRGBA:
    r, g, b = rgb
    return ColorRGBA(r=r, g=g, b=b, a=opacity)
