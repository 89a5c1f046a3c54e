"""Filter nodes of many targets on one kernel, whose predictions are made together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import functools
from pathlib import Path
import re
from typing import Any

from pif_ros import parameters
from pif_ros.accounts import Throttle
from pif_ros.config import ConfigError, FilterOfMany
from pif_ros.core.bank import Bank, Member
from pif_ros.core.estimates import Estimate
from pif_ros.core.filters import NANOSECONDS
from pif_ros.filter_node import FilterNode, FORECASTS_TAKE
from pif_ros.inbox import SLICE
from pif_ros.pace import Rest
from pif_ros.process import guarded
from pif_ros.stopwatch import shortest, Stopwatch
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException, ParameterUninitializedException
from rclpy.guard_condition import GuardCondition
from rclpy.node import Node

TARGETS = 'targets'
#: What ROS takes as a namespace, unless it is hidden.
NAME = '[A-Za-z](_?[A-Za-z0-9])*_?'


class Target(FilterNode):
    """
    The filter node of a target, in the namespace of its name, whose work a bank does.

    many: what makes the trackers of all; wake: what tells the bank that there is work; watch: the
    times of the work for all targets.
    """

    tracker: Member

    def __init__(self, namespace: str, many: FilterOfMany, wake: GuardCondition,
                 watch: Stopwatch, cli_args: Sequence[str] | None = None, **kwargs: Any) -> None:
        self._many, self._bank_wake = many, wake
        # before the process' own arguments, which would put all targets into one namespace
        place = ['--ros-args', '-r', f'__ns:={namespace}', '-r', '__node:=filter_node', '--']
        # whose services would be five more for each target: the bank starts them all
        super().__init__(managed=False, cli_args=[*place, *(cli_args or ())], watch=watch,
                         **kwargs)

    @property
    def state_file(self) -> Path | None:
        """Return where its state is kept, None for nowhere."""
        return self._keeper.file

    def lags(self, estimate: Estimate[Any]) -> int | None:
        """Return the stamp that an estimate is predicted to before it is published, or None."""
        epoch, stamp_ns = self._poses.epoch, estimate.stamp_ns
        if stamp_ns is None or stamp_ns >= epoch.newest_ns or epoch.is_over(stamp_ns):
            return None
        # to ask for the time may show that the clock was set
        told_ns = epoch.stamp_for(stamp_ns, self.now())
        return None if told_ns == stamp_ns else told_ns

    @guarded
    def correct(self) -> Estimate[Any] | None:
        """Work in one measurement, and return what is then to be told."""
        with self.watch.timing('correct'):
            return self.inbox.work()

    @guarded
    def forecast(self, now_ns: int) -> None:
        """Publish what is believed of now."""
        self.tell(self.tracker.forecast(now_ns))

    def due_ns(self, first_ns: int | None) -> int | None:
        """Return the time to predict to, that of the first target if it is the same, or None."""
        now_ns = self.now()
        if now_ns is None or first_ns is None:
            return None
        # one of both may have heard of the next tick, or that a simulated clock jumped back
        if abs(first_ns - now_ns) <= self.config.time.max_ahead * NANOSECONDS:
            now_ns = first_ns
        return now_ns if self._poses.is_due(now_ns) else None

    def _given(self) -> dict[str, Any]:
        return {name: value for name, value in super()._given().items() if name != TARGETS}

    def _make_tracker(self) -> Member:
        known = len(self._many)
        tracker = self._many.tracker(self.get_fully_qualified_name(), self.config)
        self._is_warm = len(self._many) == known
        return tracker

    def _warm_up(self) -> None:
        """Leave that until all targets are known to be right: it may take seconds."""

    def warm_up(self) -> None:
        """Do before the first measurement what need not be done at it, unless another did."""
        if not self._is_warm:
            super()._warm_up()

    def _let_work(self) -> None:
        self._wake, self.inbox.slice = self._bank_wake, 1


class FilterBank(Node):
    """
    The filter nodes of all targets, and what makes their work one.

    Raises ConfigError for parameters that make no filter, or not one for all targets.
    """

    def __init__(self, **kwargs: Any) -> None:
        try:
            super().__init__('filter_bank', **kwargs)
        except (InvalidParameterTypeException, ParameterUninitializedException):
            raise ConfigError(parameters.mistyped(self)) from None
        self.faults = 0
        self._watch = Stopwatch()
        self._throttle = Throttle()
        given, many = parameters.told(self), FilterOfMany()
        names = _targets(given.get(TARGETS))
        self.declare_parameter(TARGETS, names, ParameterDescriptor(
            read_only=True, description='who is tracked'), ignore_override=True)
        self._wake = self.create_guard_condition(self._work)
        self.targets: dict[str, Target] = {}
        for name in names:
            place = f'{self.get_namespace().rstrip("/")}/{name}'
            try:
                self.targets[name] = Target(place, many, self._wake, self._watch, **kwargs)
            except ConfigError as error:
                raise ConfigError(f'{place}/filter_node: {error}') from None
        self._check_own(given)
        for target in self.targets.values():
            target.warm_up()
        _check_files(self.targets)
        self._bank = Bank({name: node.tracker for name, node in self.targets.items()})
        self._start_timers()
        self.get_logger().info(f'targets on one kernel: {", ".join(names)}')
        for remark in self._speed():
            self.get_logger().warning(remark)

    @property
    def nodes(self) -> list[Node]:
        """Return all nodes, to be spun together."""
        return [self, *self.targets.values()]

    @property
    def accounts(self) -> str:
        """Return what became of all targets' measurements, in a line."""
        return '; '.join(f'{name}: {node.accounts}' for name, node in self.targets.items())

    def finish(self) -> None:
        """Account for what still waits, and save what is to outlast the process."""
        for target in self.targets.values():
            try:
                target.finish()
            except Exception as error:  # noqa: B902  the others are to be saved all the same
                target.report('fault', f'finish: {type(error).__name__}: {error}')

    def report(self, kind: str, text: str) -> None:
        """Warn of something, at most one line of a kind every few seconds."""
        line = self._throttle.line(kind, text)
        if line is not None:
            self.get_logger().warning(line)

    # The work of all

    @guarded
    def _work(self) -> None:
        """Correct by what waits, all targets by one measurement each, then by the next."""
        try:
            with self._watch.timing('work'):
                busy = [target for target in self.targets.values() if target.inbox.wants_a_turn]
                for _ in range(SLICE):
                    busy = self._correct(busy)
        finally:
            if any(target.inbox.wants_a_turn for target in self.targets.values()):
                self._wake.trigger()

    def _correct(self, busy: Sequence[Target]) -> list[Target]:
        """Correct some targets by a measurement each, and return who goes on with more."""
        for target in busy:
            target.drain()
        left = [target.tracker.backlog for target in busy]
        self._foresee((target.tracker, target.tracker.next_ns) for target in busy)
        estimates = [(target, estimate, target.restarts) for target in busy
                     if (estimate := target.correct()) is not None]
        self._foresee((target.tracker, target.lags(estimate)) for target, estimate, _ in estimates)
        for target, estimate, restarts in estimates:
            # to ask for the time may have shown that the clock was set
            if target.restarts == restarts:
                target.tell(estimate)
        for target, *_ in estimates:
            target.see_whether_lost()
        return [target for target, before in zip(busy, left)
                if target.inbox.has_work and target.tracker.backlog < before]

    @guarded
    def _on_timer(self, rest: Rest, targets: Sequence[Target]) -> None:
        # each is to see for itself that the clock was set
        first_ns = targets[0].now()
        due = [(target, now_ns) for target in targets
               if (now_ns := target.due_ns(first_ns)) is not None]
        if not rest.is_over:
            for target, _ in due:
                target.skipped += 1
            return
        with rest.working(), self._watch.timing('forecast'):
            self._foresee((target.tracker, now_ns) for target, now_ns in due)
            for target, now_ns in due:
                target.forecast(now_ns)

    def _foresee(self, asked: Iterable[tuple[Member, int | None]]) -> None:
        try:
            with self._watch.timing('predict'):
                self._bank.foresee((tracker, stamp_ns) for tracker, stamp_ns in asked
                                   if stamp_ns is not None)
        except Exception as error:  # noqa: B902  models are others' code
            # each target meets it again by itself, and accounts for it
            self.report('together', f'not predicted together: {type(error).__name__}: {error}')

    # How it is set up

    def _check_own(self, given: dict[str, Any]) -> None:
        """Refuse what was told to the bank, and is meant for its targets."""
        target, *_ = self.targets.values()
        known = {TARGETS}.union(*map(parameters.told, self.targets.values()))
        for name in given:
            if name not in known:
                raise ConfigError(f'{name}: expected among the parameters of /** or of a target '
                                  f'such as {target.get_fully_qualified_name()}, got it '
                                  f'among those of {self.get_fully_qualified_name()}')

    def _start_timers(self) -> None:
        groups: dict[tuple[float, bool], list[Target]] = {}
        for target in self.targets.values():
            simulated = target.get_parameter('use_sim_time').value
            groups.setdefault((target.config.publish.rate, simulated), []).append(target)
        for (rate, _), targets in groups.items():
            if rate:
                rest = Rest(FORECASTS_TAKE, 1 / rate)
                targets[0].create_timer(1 / rate,
                                        functools.partial(self._on_timer, rest, targets),
                                        clock=targets[0].forecast_clock())

    def _speed(self) -> list[str]:
        """Return a sentence where prediction of all targets is slower than time."""
        target, *_ = self.targets.values()
        step = target.tracker.filter.time_step_ns / NANOSECONDS
        needed = shortest(lambda _: self._bank.rehearse())
        return [] if needed < step / 2 else [
            f'targets: a step of {step:g} s of all takes {needed:.2g} s to compute: the filters '
            'cannot keep up; share the targets among processes']


def _check_files(targets: Mapping[str, Target]) -> None:
    """Refuse a file in which the states of two targets would be kept."""
    first: dict[Path | None, str] = {}
    for target in targets.values():
        name, file = target.get_fully_qualified_name(), target.state_file
        if file is not None and first.setdefault(file, name) != name:
            raise ConfigError(f'{name}: state_file: expected a file for each target, got '
                              f"{str(file)!r}, which is {first[file]}'s")


def _targets(given: Any) -> list[str]:
    """Return the names of the targets; ConfigError where they are none."""
    wanted = f'{TARGETS}: expected names of namespaces, at least one and each once'
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, (list, tuple)) or not names:
        raise ConfigError(f'{wanted}, got {given!r}' if given else f'{wanted}, got none')
    for name in names:
        if not isinstance(name, str) or not re.fullmatch(NAME, name):
            raise ConfigError(f'{wanted}, got {name!r}')
    if len(set(names)) < len(names):
        raise ConfigError(f'{wanted}, got {list(names)}')
    return list(names)
