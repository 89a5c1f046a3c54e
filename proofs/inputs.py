"""What the node takes, type by type: how it is configured for it, and how a message is made."""

from __future__ import annotations

import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import Odometry
from pif_ros.fields import FLOAT_MAX
from ros import PLANE
from sensor_msgs.msg import JointState, LaserScan, Range
from std_msgs.msg import Float64MultiArray

Write = Callable[[Any, Sequence[float]], None]

#: What carries it across its yard in a step is between this and a quarter more.
FASTEST = 60.0
#: A robot that is driven; what it measures is where it is.
YARD = {
    **PLANE, 'model.name': 'unicycle_2d', 'model.params.sigma_position': 0.5,
    'grid.lower': [-3.0, -4.0, -math.pi], 'grid.upper': [3.0, 4.0, math.pi],
    'grid.shape': [8, 10, 6], 'grid.periodic': [False, False, True],
    'prior.mean': [0.5, -0.5, 0.3], 'prior.covariance_diagonal': [1.0, 2.0, 0.5],
    'control.hold': 0.5}
del YARD['model.params.diffusion']


@dataclass(frozen=True)
class Input:
    """
    One topic of the node: how it is configured, and how numbers get into its messages.

    size: how many numbers make a message right; single: they travel in single precision; loose: a
    message holds any number of them, and longer: more than size are right too; limits: what the
    message itself says they lie between; fastest: what they may be at most where they drive the
    model, control.
    """

    topic: str
    message: Any
    size: int
    write: Write
    parameters: Mapping[str, Any]
    single: bool = False
    loose: bool = False
    longer: bool = False
    stamped: bool = True
    control: bool = False
    fastest: float = math.inf
    limits: tuple[float, float] = (-math.inf, math.inf)


def _source(type_name: str, fields: Sequence[str], **more: Any) -> dict[str, Any]:
    return {**PLANE, 'measurements.main.type': type_name, 'measurements.main.fields': fields,
            **{f'measurements.main.{name}': value for name, value in more.items()}}


def _point(msg: Any, values: Sequence[float]) -> None:
    msg.point.x, msg.point.y = values


def _pose(msg: Any, values: Sequence[float]) -> None:
    msg.pose.pose.position.x, msg.pose.pose.position.y = values


def _array(msg: Any, values: Sequence[float]) -> None:
    msg.data = array.array('d', values)


def _joints(msg: Any, values: Sequence[float]) -> None:
    msg.position = array.array('d', values)


def _scan(msg: Any, values: Sequence[float]) -> None:
    # read are the first and the fourth
    msg.ranges = array.array('f', [value for pair in values for value in (pair, 7.0, 7.0)])
    # positions, which may be below 0: whatever is finite is within these limits
    msg.range_min, msg.range_max = -FLOAT_MAX, FLOAT_MAX


def _range(msg: Any, values: Sequence[float]) -> None:
    msg.range, = values
    msg.min_range, msg.max_range = _LIMITS


def _twist(msg: Any, values: Sequence[float]) -> None:
    msg.linear.x, msg.angular.z = values


def _stamped_twist(msg: Any, values: Sequence[float]) -> None:
    _twist(msg.twist, values)


_LIMITS = (0.25, 40.0)
_PAIR = ('pose.pose.position.x', 'pose.pose.position.y')
_DRIVEN = {'control.topic': 'drive'}

INPUTS = {
    'Float64MultiArray': Input(
        'fix', Float64MultiArray, 2, _array, _source('std_msgs/msg/Float64MultiArray', []),
        loose=True, stamped=False),
    'PointStamped': Input('fix', PointStamped, 2, _point, PLANE),
    'Range': Input(
        'fix', Range, 1, _range, {
            **_source('sensor_msgs/msg/Range', ['range'], sensor='range'),
            'measurements.main.params.landmark': [3.0, 4.0]}, single=True, limits=_LIMITS),
    'PoseWithCovarianceStamped': Input(
        'fix', PoseWithCovarianceStamped, 2, _pose,
        _source('geometry_msgs/msg/PoseWithCovarianceStamped', _PAIR)),
    'JointState': Input('fix', JointState, 2, _joints,
                        _source('sensor_msgs/msg/JointState', ['position']), loose=True),
    'LaserScan': Input('fix', LaserScan, 2, _scan, _source(
        'sensor_msgs/msg/LaserScan', ['ranges[0]', 'ranges[3]']),
        single=True, loose=True, longer=True, limits=(-FLOAT_MAX, FLOAT_MAX)),
    'Odometry': Input('fix', Odometry, 2, _pose, _source('nav_msgs/msg/Odometry', _PAIR)),
    'TwistStamped': Input('drive', TwistStamped, 2, _stamped_twist, {**YARD, **_DRIVEN},
                          control=True, fastest=FASTEST),
    'Twist': Input('drive', Twist, 2, _twist, {
        **YARD, **_DRIVEN, 'control.type': 'geometry_msgs/msg/Twist',
        'control.fields': ['linear.x', 'angular.z']},
        stamped=False, control=True, fastest=FASTEST),
}
#: The pose to start from comes beside measurements of this type.
INITIAL_POSE = 'initialpose'
BESIDE = 'PointStamped'
