"""From an initial pose to the belief to start from, or to the reason why it is none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from pif_ros import conversions
from pif_ros.config import ConfigError, gaussian_of
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import Tracker
from pif_ros.sources import Refused


def start_of(msg: PoseWithCovarianceStamped, tracker: Tracker[Any], axes: Sequence[int | None],
             frame_id: str, now_ns: int | None, oldest_ns: int) -> tuple[Any, int]:
    """
    Return the belief that a pose asks for, and the stamp at which it holds; Refused where none.

    States that are on none of its axes are as in the prior.  Without a stamp, or with one that is
    still to come, it holds now.
    """
    if now_ns is None:
        raise Refused('no clock', 'expected a /clock before it')
    if msg.header.frame_id not in ('', frame_id):
        raise Refused('other frame', f'frame_id: expected {frame_id!r}, '
                      f'got {msg.header.frame_id!r}')
    stamp_ns = conversions.stamp_to_ns(msg.header.stamp)
    stamp_ns = stamp_ns if 0 < stamp_ns < now_ns else now_ns
    if stamp_ns < oldest_ns:
        raise Refused('too late', 'stamp: expected one at most time.max_gap before the last pose, '
                      f'got {stamp_ns / NANOSECONDS} s')
    q, is_turned = msg.pose.pose.orientation, any(axis is not None for axis in axes[3:])
    if is_turned and not np.all(np.isfinite(conversions.angles(msg.pose.pose))):
        raise Refused('not finite', 'orientation: expected a quaternion of finite length, not 0, '
                      f'got {[q.x, q.y, q.z, q.w]}')
    mean, covariance = conversions.gaussian_from_pose(
        msg.pose, axes, tracker.prior.mean(), tracker.prior.covariance())
    for name, values in (('mean', mean), ('covariance', covariance)):
        if not np.all(np.isfinite(values)):
            raise Refused('not finite', f'{name}: expected finite numbers, got {values.tolist()}')
    try:
        return gaussian_of(tracker.filter, mean, covariance, 'covariance: expected one that '
                           'fits'), stamp_ns
    except ConfigError as error:
        raise Refused('too wide', str(error)) from None
    except ValueError as error:
        reason = 'bad covariance' if str(error).startswith('covariance') else 'off the grid'
        raise Refused(reason, str(error)) from None
