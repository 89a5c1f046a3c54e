"""What time it is for a node, and what is to be done where its clock was set."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import time

from pif_ros.core.filters import NANOSECONDS
from rclpy.clock import JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node

#: A system clock that moves by more than this against a steady one was set; one that is kept in
#: step by the network's time moves by half a millisecond in a second at most.
SET_NS = NANOSECONDS // 4


@dataclass(frozen=True)
class ClockSet:
    """
    A clock that was set instead of going on.

    by_ns: how far forward; text: a line on it; goes_on: whether it is the same time by another
    clock, and not another time.
    """

    by_ns: int
    text: str
    goes_on: bool


class Timekeeper:
    """
    The clock of a node, simulated or the system's.

    A simulated one that jumps back begins another time, unless by no more than small_ns; forward
    it may go as it likes.  The system's is held against a steady one: where it was set, forward or
    back, the same time goes on by another clock.  on_set is called before the time is told.
    """

    def __init__(self, node: Node, small_ns: int, on_set: Callable[[ClockSet], None]) -> None:
        clock = node.get_clock()
        assert isinstance(clock, ROSClock)
        self._clock, self._small_ns, self._on_set = clock, small_ns, on_set
        self._ahead_ns: int | None = None
        self._jumps = self._clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            post_callback=self._on_jump)

    @property
    def is_simulated(self) -> bool:
        """Return whether the time is that of /clock."""
        return bool(self._clock.ros_time_is_active)

    def now(self) -> int | None:
        """Return the time in nanoseconds, None before there is a /clock."""
        before, now_ns, after = steady_ns(), int(self._clock.now().nanoseconds), steady_ns()
        if self.is_simulated:
            return now_ns or None
        if after - before > SET_NS // 8:
            # this process had to wait between the two clocks
            return now_ns
        ahead_ns = now_ns - after
        # once and again, so that what creeps is never taken for a step
        before_ns, self._ahead_ns = self._ahead_ns, ahead_ns
        if before_ns is not None and abs(ahead_ns - before_ns) > SET_NS:
            by_ns = ahead_ns - before_ns
            self._on_set(ClockSet(by_ns, f'the system clock was set by {by_ns / NANOSECONDS:+.3f} '
                                  's: the belief goes on, its stamp moves with the clock', True))
        return now_ns

    def _on_jump(self, jump: TimeJump) -> None:
        by_ns = int(jump.delta.nanoseconds)
        if -self._small_ns <= by_ns < 0:
            self._on_set(ClockSet(0, f'the clock jumped by {by_ns / NANOSECONDS:.3f} s, no '
                                  'further back than time.max_ahead: the belief goes on', True))
        elif by_ns < 0:
            self._on_set(ClockSet(by_ns, f'the clock jumped by {by_ns / NANOSECONDS:.3f} s: back '
                                  'to the prior', False))


def steady_ns() -> int:
    """Return the time of a clock that nobody sets, and that goes on while the machine sleeps."""
    kind = getattr(time, 'CLOCK_BOOTTIME', time.CLOCK_MONOTONIC)
    return time.clock_gettime_ns(kind)
