"""What lets a node begin anew when it is asked to: a pose, a reset, a search everywhere."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from pif_ros import conversions, interface
from pif_ros.accounts import SourceAccount
from pif_ros.config import ConfigError, gaussian_of, uniform_of
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import Tracker
from pif_ros.process import guarded
from pif_ros.sources import Refused
from std_srvs.srv import Empty, Trigger


class Starting:
    """
    The topic and the services by which others set a node's belief.

    node: one that reports and counts its faults; account: counts the poses; restart: takes a
    belief (None: the prior), its stamp, why, and a stamp at which the robot is still driven as it
    was; axes, frame_id: of poses; now: gives the time, None before there is a /clock; oldest_ns:
    gives the stamp before which a pose comes too late.
    """

    def __init__(self, node: Any, tracker: Tracker[Any], account: SourceAccount,
                 restart: Callable[[Any, int | None, str, int | None], None],
                 axes: Sequence[int | None], frame_id: str, now: Callable[[], int | None],
                 oldest_ns: Callable[[], int]) -> None:
        self._node, self._tracker, self._account = node, tracker, account
        self._restart, self._axes, self._frame_id = restart, axes, frame_id
        self._now, self._oldest_ns = now, oldest_ns
        start = interface.INITIAL_POSE
        node.create_subscription(start.type, start.name, self._on_initial_pose, start.qos)
        for service, callback in ((interface.RESET, self._on_reset),
                                  (interface.GLOBAL, self._on_global)):
            node.create_service(service.type, service.name, callback)

    @guarded
    def _on_initial_pose(self, msg: PoseWithCovarianceStamped) -> None:
        now_ns = self._now()
        self._account.received += 1
        try:
            if not self._node.is_active:
                raise Refused('inactive', 'it is inactive')
            belief, stamp_ns = start_of(msg, self._tracker, self._axes, self._frame_id, now_ns,
                                        self._oldest_ns())
        except Refused as refused:
            self._account.reject(refused.reason)
            self._node.report(f'initialpose: {refused.reason}', f'initialpose: {refused}')
            return
        self._account.accept(stamp_ns)
        self._restart(belief, stamp_ns, 'initialpose', stamp_ns)
        self._node.tell(self._tracker.estimate())

    @guarded
    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._restart(None, None, '~/reset', None)
        response.success, response.message = True, 'the prior holds at the next measurement'
        return response

    @guarded
    def _on_global(self, _: Empty.Request, response: Empty.Response) -> Empty.Response:
        name = interface.GLOBAL.name
        try:
            belief = uniform_of(self._tracker.filter, f'{name}: expected a grid whose uniform '
                                'belief fits')
        except ConfigError as error:
            self._node.report(name, str(error))
        else:
            self._restart(belief, None, name, None)
        return response


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
