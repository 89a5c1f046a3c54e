"""What lets a node go on across restarts: its two services, its checkpoints, its start."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pif_ros import interface
from pif_ros.core.estimates import Memory
from pif_ros.keeper import FAILURES, Keeper
from pif_ros.process import guarded
from pif_ros.state_file import StateRefused
from rclpy.clock import Clock, ClockType, JumpHandle, JumpThreshold, TimeJump
from rclpy.duration import Duration
from std_srvs.srv import Trigger


class Resuming:
    """
    Saves a node's state when asked to, every period and at the end; goes on from it at the start.

    node: one that reports and counts its faults; recall: takes what a tracker remembered, and the
    newest stamp that was published; published_ns: gives that stamp; now: gives the time, None
    before there is a /clock; period: seconds between checkpoints, 0 for none.
    """

    def __init__(self, node: Any, keeper: Keeper, recall: Callable[[Memory[Any], int], None],
                 published_ns: Callable[[], int], now: Callable[[], int | None],
                 period: float) -> None:
        self._node, self._keeper, self._is_due = node, keeper, keeper.is_there()
        self._recall, self._published_ns, self._now = recall, published_ns, now
        for service, callback in ((interface.SAVE, self._on_save),
                                  (interface.LOAD, self._on_load)):
            node.create_service(service.type, service.name, callback)
        if keeper.file is not None and period:
            node.create_timer(period, self._on_checkpoint,
                              clock=Clock(clock_type=ClockType.STEADY_TIME))
        # rclpy's clock does not keep the handle that it calls: to be freed it must be unregistered
        self._first_clock: JumpHandle | None = None
        if self._is_due and now() is None:
            self._first_clock = node.get_clock().create_jump_callback(
                JumpThreshold(min_forward=Duration(nanoseconds=1), min_backward=None,
                              on_clock_change=False), post_callback=self._on_clock)
        self._start()

    def finish(self) -> None:
        """Save what is to outlast the node, but not over a state that was never gone on from."""
        if self._first_clock is not None:
            self._first_clock.unregister()
        was_due, self._is_due = self._is_due, False
        self._keeper.close(None if was_due else self._published_ns())

    def forgo(self) -> None:
        """Leave the state file alone at the first /clock: another beginning was asked for."""
        self._is_due = False

    def _start(self) -> None:
        """Go on from the state file where there is one, once the time is known."""
        if not self._is_due or self._now() is None:
            return
        self._is_due = False
        told = self._told(self._load, Trigger.Response())
        if told.success:
            self._node.get_logger().info(told.message)
        else:
            self._node.report('state', f'{told.message}: from the prior')

    @guarded
    def _on_clock(self, _: TimeJump) -> None:
        self._start()

    @guarded
    def _on_checkpoint(self) -> None:
        if not self._is_due:
            self._keeper.checkpoint(self._published_ns())

    @guarded
    def _on_save(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._told(self._save, response)

    @guarded
    def _on_load(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._told(self._load, response)

    def _save(self) -> str:
        """Save, and return a line that says so."""
        if self._is_due:
            raise StateRefused('expected a /clock first, to go on from the file that is there')
        return self._keeper.save(self._published_ns())

    def _load(self) -> str:
        """Go on from the state file, and return a line that says so."""
        self._recall(*self._keeper.load(self._now()))
        return f'goes on from {self._keeper.file}'

    def _told(self, action: Callable[[], str], response: Trigger.Response) -> Trigger.Response:
        """Answer with the line of an action, or why there was none."""
        try:
            response.message, response.success = action(), True
        except FAILURES as error:
            response.message, response.success = self._keeper.refusal(error), False
        return response
