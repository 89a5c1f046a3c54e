"""What a node tells of itself on /diagnostics: once in a while, and at once when it gets worse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import time
from typing import Any

from pif_ros import conversions, interface
from pif_ros.accounts import Throttle
from pif_ros.diagnostics import Facts, OK, Status, statuses
from pif_ros.pace import Rest
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

#: Whether it got worse is looked at no more often than this, in seconds.
SELDOM = 0.2
#: What stays wrong is a line of the log no more often than this, in seconds.
REMIND = 60.0
#: Finding the modes has this share of the time at most.
TAKE = 0.002


class Health:
    """
    The publisher of a node's diagnostics.

    facts: what tells how it is; tick: called on every beat of its timer, which is steady.
    """

    def __init__(self, node: Node, rate: float, facts: Callable[[], Facts],
                 tick: Callable[[], None]) -> None:
        self._node, self._facts, self._level, self._looked = node, facts, OK, 0.0
        self._is_wanted, self._throttle = bool(rate), Throttle(REMIND)
        self._rest = Rest(TAKE)
        self._masses: tuple[float, ...] = ()
        told = interface.DIAGNOSTICS
        self._publisher = node.create_publisher(told.type, told.name, told.qos)
        if rate:
            node.create_timer(1 / rate, tick, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def masses(self, belief: Any, share: float) -> Sequence[float]:
        """Return the masses of a belief's modes; those of before where it is too soon."""
        if self._rest.is_over and belief.mass > 0:
            with self._rest.working():
                self._masses = tuple(mode.mass for mode in belief.modes(share))
        return self._masses

    def restart(self) -> None:
        """Forget the modes of another belief."""
        self._rest.end()
        self._masses = ()

    def tell(self) -> None:
        """Publish how it is, and log what is worth it."""
        for status in self._publish(only_worse=False):
            if status.line and (line := self._throttle.line(status.name, status.line)):
                self._node.get_logger().warning(line)

    def look(self) -> None:
        """Publish how it is where that is worse than what was told last."""
        now = time.monotonic()
        if self._is_wanted and now - self._looked > SELDOM:
            self._looked = now
            self._publish(only_worse=True)

    def _publish(self, only_worse: bool) -> list[Status]:
        found = statuses(self._facts())
        level = max(status.level for status in found)
        if level > self._level or not only_worse:
            self._level = level
            self._publisher.publish(conversions.diagnostics_message(
                found, self._node.get_clock().now().nanoseconds,
                self._node.get_fully_qualified_name()))
        return found
