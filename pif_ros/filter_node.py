"""The node: callbacks of a few lines around one Tracker."""

from __future__ import annotations

import math
import time
from typing import Any

from pif_ros import parameters
from pif_ros.accounts import Accounts, Throttle
from pif_ros.config import (build_tracker, ConfigError, describe, find_grid, find_system,
                            remarks)
from pif_ros.core.active import ActiveGridFilter
from pif_ros.core.continuous import PathBelief
from pif_ros.core.estimates import Estimate, Memory
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import Tracker
from pif_ros.diagnostics import Facts
from pif_ros.health import Health
from pif_ros.inbox import Inbox
from pif_ros.keeper import Keeper
from pif_ros.listener import Listener
from pif_ros.managed_node import ManagedNode
from pif_ros.outputs import Outputs
from pif_ros.pace import Rest
from pif_ros.poses import Poses
from pif_ros.process import guarded
from pif_ros.resuming import Resuming
from pif_ros.start import Starting
from pif_ros.stopwatch import shortest, Stopwatch, TimedFilter
from pif_ros.timekeeper import ClockSet, Timekeeper
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, ParameterUninitializedException
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter

#: Predicting the pose to now has this share of the time at most, the rest is for measurements.
FORECASTS_TAKE = 0.25
#: Work that takes less than this, in seconds, is done where a message arrives: to wait for its
#: turn would take as long.
AT_ONCE = 1e-3


class FilterNode(ManagedNode):
    """
    Measurements in; pose, covariance and density out, on the topics of interface.py.

    It configures and activates itself, unless autostart is false: then a lifecycle manager does.
    managed: whether one can; where not, it starts in any case; watch: times its work.  Raises
    ConfigError for parameters that make no filter, as far as these are looked at here.
    """

    def __init__(self, managed: bool = True, watch: Stopwatch | None = None,
                 **kwargs: Any) -> None:
        try:
            super().__init__('filter_node', managed, **kwargs)
        except (InvalidParameterTypeException, ParameterUninitializedException):
            raise ConfigError(parameters.mistyped(self)) from None
        given = self._given()
        self.told = bool(given)
        self.config = parameters.declare(self, given)
        self.faults = self.skipped = self.restarts = 0
        self.accounts = Accounts(())
        self.watch = watch or Stopwatch()
        self._why, self._lost = '', False
        self._throttle = Throttle()
        self._took = math.inf
        self._since_ns = 0
        self._health: Health
        self._live = parameters.live_at_start(self.config)
        self._time = Timekeeper(self, round(self.config.time.max_ahead * NANOSECONDS),
                                self._on_clock_set)
        self.add_on_set_parameters_callback(self._on_parameters)
        if self.config.autostart or not managed:
            self.start()

    def finish(self) -> None:
        """Account for what still waits, and save what is to outlast the process."""
        if self.is_made:
            self.inbox.account()
            self._resuming.finish()

    def _release(self) -> None:
        try:
            super()._release()
        finally:
            if told := str(self.accounts):
                self.get_logger().info(f'cleaned up; {told}')
            self.accounts = Accounts(())

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and publish; what was believed is believed still."""
        self._outputs.restart()
        if self._poses.is_untold:
            self._poses.is_untold = False
            self._remind()
        return super().on_activate(state)

    # What comes in

    def _on_arrival(self, alone: bool) -> None:
        """Work in what has arrived, now where nothing else waited and the work is short."""
        if alone and self._took < AT_ONCE:
            self._work()
        else:
            self._wake.trigger()

    def _refuses(self, prefix: str) -> str:
        """Return in a word why a source is not listened to now, '' where it is."""
        if not self.is_active:
            return 'inactive'
        return '' if self._live.get(f'{prefix}.enabled', True) else 'disabled'

    @guarded
    def _on_clock_set(self, clock: ClockSet) -> None:
        self.get_logger().info(clock.text)
        if not self.is_made or clock.goes_on and not clock.by_ns:
            return
        self._poses.epoch.restart()
        self._since_ns = 0
        if clock.goes_on:
            for failed in self.inbox.settle():
                self.faults += 1
                self.report('fault', f'{type(failed.__cause__).__name__}: {failed}')
            belief = self.tracker.newest.belief
            if isinstance(belief, PathBelief):
                belief = belief.moved(clock.by_ns)
            self.accounts.restart()
            self._begin_anew(clock.text)
            # by the new clock nothing was told yet
            self._remind()
            self.inbox.set_clock(clock.by_ns, belief)
        else:
            self._restart(None, None, clock.text)
            self.accounts.restart()

    def _on_parameters(self, changes: list[Parameter]) -> SetParametersResult:
        try:
            self._live.update(parameters.live_values(changes, self.config.measurements.names))
        except ConfigError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    # What is done with it

    @guarded
    def _work(self) -> None:
        began = time.monotonic()
        with self.watch.timing('work'):
            try:
                estimate = self.inbox.work()
            finally:
                if self.inbox.wants_a_turn:
                    self._wake.trigger()
            if estimate is not None:
                self.tell(estimate)
        self._took = time.monotonic() - began
        self.see_whether_lost()

    @guarded
    def see_whether_lost(self) -> None:
        """Bring the watch over being lost up to the newest measurement, and tell what it sees."""
        with self.watch.timing('watch'):
            self.tracker.look()
        was_lost, self._lost = self._lost, self.tracker.newest.watch.lost
        if self._lost and not was_lost:
            self.report('lost', 'lost: the measurements contradict what was believed')

    @guarded
    def _on_timer(self) -> None:
        now_ns = self.now()
        if now_ns is None or not self.is_active or not self._poses.is_due(now_ns):
            return
        if not self._rest.is_over:
            self.skipped += 1
            return
        with self._rest.working(), self.watch.timing('forecast'):
            self.tell(self.tracker.forecast(now_ns))

    @guarded
    def _on_diagnostics(self) -> None:
        self.now()
        self._health.tell()

    def facts(self) -> Facts:
        """Return what is known of the node now."""
        masses = self._health.masses(self.tracker.newest.belief, self.config.modes.share)
        since, now_ns = self.inbox.behind_since, self.get_clock().now().nanoseconds or None
        self._since_ns = self._since_ns or now_ns or 0
        return Facts(self.tracker, self.accounts, self.config.diagnostics, now_ns, self._since_ns,
                     self.watch.summary(), self.watch.busy(), self.skipped,
                     time.monotonic() - since if since else 0.0, self.faults,
                     self.restarts + self.inbox.gaps, self.inbox.last_gap or self._why,
                     self._log_volume, masses, self.is_active, self._keeper.told())

    def drain(self) -> None:
        """Put what waits where it belongs, as far as the work can take it."""
        self.inbox.drain()

    def _recall(self, memory: Memory[Any], published_ns: int) -> None:
        self._begin_anew('state_file')
        epoch = self._poses.epoch
        epoch.newest_ns = max(epoch.newest_ns, published_ns)
        self.inbox.recall(memory)
        self._remind()

    def _restart(self, belief: Any, stamp_ns: int | None, why: str,
                 steered_ns: int | None = None) -> None:
        self._resuming.forgo()
        self._begin_anew(why)
        if steered_ns is None:
            self._poses.epoch.expect_another()
        self.inbox.restart(belief, stamp_ns, steered_ns)

    def _remind(self) -> None:
        """Let what is believed be told anew."""
        self.inbox.remind()
        self._wake.trigger()

    def _begin_anew(self, why: str) -> None:
        """Let go of what was told of another belief."""
        self.restarts += 1
        self._why = why
        self._outputs.restart()
        self._health.restart()

    # What goes out

    @guarded
    def tell(self, estimate: Estimate[Any]) -> None:
        """Publish an estimate, with no older stamp than the last unless it is of another time."""
        self._poses.tell(estimate)

    def give_up(self, why: str) -> None:
        """Begin anew from the prior, since nothing is believed any more."""
        self.report('off the grid', why)
        self.inbox.account()
        self._restart(None, None, why, self.tracker.stamp_ns)

    def now(self) -> int | None:
        """Return the time in nanoseconds, None before there is a /clock."""
        return self._time.now()

    def report(self, kind: str, text: str) -> None:
        """Warn of something, at most one line of a kind every few seconds."""
        line = self._throttle.line(kind, text)
        if line is not None:
            self.get_logger().warning(line)
            self._look()

    @guarded
    def _look(self) -> None:
        if self.is_made:
            self._health.look()

    # How it is set up

    def _given(self) -> dict[str, Any]:
        return parameters.told(self)

    def make(self) -> None:
        """Make the filter, and what goes in and out; ConfigError where there is none."""
        config = self.config
        self.tracker = self._make_tracker()
        filter_ = self.tracker.filter
        self.accounts = Accounts(config.measurements.names, filter_.model.inputs)
        self.inbox = Inbox(self.tracker, self.accounts, config, self.report)
        self._since_ns = 0
        self._health = Health(self, config.diagnostics.rate, self.facts, self._on_diagnostics)
        model = find_system(config).model
        grid = find_grid(config, model)
        self._log_volume = math.log(grid.cell_volume) + math.log(grid.size)
        self._outputs = Outputs(self, config, model, grid, self._live)
        self._poses = Poses(self, config, self.tracker, self._outputs, self.watch)
        self._keeper = Keeper(config, self.tracker, self.report)
        listener = Listener(self, config, filter_, self.accounts, self.inbox, self._time,
                            self._refuses, self._on_arrival)
        self._warm_up()
        listener.listen()
        max_gap_ns = round(config.time.max_gap * NANOSECONDS)
        self._starting = Starting(self, self.tracker, self.accounts.initial_pose, self._restart,
                                  self._outputs.pose_axes, config.frame_id, self.now,
                                  lambda: self._poses.epoch.newest_ns - max_gap_ns)
        self._let_work()
        self._resuming = Resuming(self, self._keeper, self._recall,
                                  lambda: self._poses.epoch.newest_ns, self.now,
                                  config.checkpoint_period)

    def _make_tracker(self) -> Tracker[Any]:
        return build_tracker(self.config)

    def _warm_up(self) -> None:
        """Do before the first measurement what need not be done at it."""
        began = time.perf_counter()
        what = describe(self.config, self.tracker.filter)
        self.get_logger().info(f'{self.config.model.name}: {what}, made in '
                               f'{time.perf_counter() - began:.2f} s')
        for remark in [*remarks(self.config, self.tracker.filter), *self._speed()]:
            self.get_logger().warning(remark)

    def _speed(self) -> list[str]:
        """Return a sentence where prediction is slower than time."""
        filter_ = self.tracker.filter
        if isinstance(filter_, ActiveGridFilter):
            # its cost is that of a belief that is not known yet
            return []
        step_ns = filter_.time_step_ns
        step, needed = step_ns / NANOSECONDS, shortest(
            lambda k: filter_.predict(self.tracker.prior, k * step_ns, (k + 1) * step_ns))
        return [] if needed < step / 2 else [
            f'kernel.time_step: a step of {step:g} s takes {needed:.2g} s to compute: the '
            'filter cannot keep up; take a longer step or a coarser grid']

    def _let_work(self) -> None:
        """Let the work be done when there is some."""
        self._wake = self.create_guard_condition(self._work)
        self.tracker.filter = TimedFilter(self.tracker.filter, self.watch)
        if rate := self.config.publish.rate:
            self._rest = Rest(FORECASTS_TAKE, 1 / rate)
            self.create_timer(1 / rate, self._on_timer, clock=self.forecast_clock())

    def forecast_clock(self) -> Clock:
        """Return the clock by which poses are predicted to now."""
        # a timer on the system's clock stands still when that clock is set back
        return (self.get_clock() if self._time.is_simulated
                else Clock(clock_type=ClockType.STEADY_TIME))
