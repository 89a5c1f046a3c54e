"""One run from the recording to the pictures, through the real node in a process of its own."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
import sys
import time

from pif_ros.plaza.evaluation import Run
from pif_ros.plaza.filter_process import accounts, FilterFailed, FilterProcess
from pif_ros.plaza.moments import telling_moments
from pif_ros.plaza.player_node import Player, Spin
from pif_ros.plaza.recorder import Recorder
from pif_ros.plaza.recording import load, Recording
from pif_ros.plaza.results import write
from pif_ros.plaza.settings import Settings
from pif_ros.plaza.yard import parameters_for
from pif_ros.process import take_down
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

_FILTER = '/filter_node'
_SETTLE = 0.5
#: By whether there is odometry.
_PARAMETERS = {False: 'plaza_range_only', True: 'plaza_unicycle'}


def demonstrate(wanted: Namespace, stopped: Callable[[], bool]) -> None:
    """
    Play, compare, draw, and write all of it into wanted.out, until done or stopped.

    ValueError or OSError where there is nothing to play, FilterFailed or TimeoutError where the
    filter does not do its part; each in one line, after what the filter node wrote.
    """
    recording = load(wanted.recording, wanted.path)
    settings = Settings.from_values({
        'speed': wanted.speed, 'start': wanted.start, 'duration': wanted.duration,
        'follow': f'{_FILTER}/pose', 'odometry': wanted.odometry})
    settings.span.limits_ns(recording)
    if wanted.odometry and not len(recording.odometry):
        raise ValueError(f'{recording.name}: expected a table DR, the odometry')
    wanted.out.mkdir(parents=True, exist_ok=True)
    params_file, log = parameters_for(
        recording, wanted.out, _PARAMETERS[wanted.odometry]), wanted.out / 'filter_node.log'
    began = time.monotonic()
    node = FilterProcess(params_file, log)
    try:
        run = _play(recording, settings, node, stopped)
    except (FilterFailed, TimeoutError):
        if not stopped():
            _say(node.output())
        raise
    if not stopped():
        _say('the filter node ended by SIGINT with status 0')
        _say(f'played {settings.span.seconds(recording):.0f} s in '
             f'{time.monotonic() - began:.0f} s; comparing and drawing')
        print('\n' + write(run, settings.span, params_file, wanted.out))
        _say(f'all of it in {time.monotonic() - began:.0f} s; pictures, table and numbers: '
             f'{wanted.out.resolve()}')


def _play(recording: Recording, settings: Settings, node: FilterProcess,
          stopped: Callable[[], bool]) -> Run:
    """Play the recording to the filter node, end the node, and return what it said."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    try:
        windows = [(w.first_ns, w.last_ns)
                   for w in telling_moments(recording, settings.span, settings.odometry)]
        player = Player(recording, settings)
        recorder = Recorder(_FILTER, windows, settings.odometry)
        executor.add_node(player)
        executor.add_node(recorder)

        def spin(timeout: float) -> None:
            node.check()
            executor.spin_once(timeout_sec=timeout)

        player.play(spin, stopped)
        _await_last_pose(recording, settings, recorder, spin, stopped)
        if settings.odometry:
            _settle(spin)
        node.end()
        return Run(recording, player.sent, accounts(node.output()), recorder.track(),
                   recorder.densities())
    finally:
        node.kill()
        take_down(executor)
        rclpy.try_shutdown()


def _await_last_pose(recording: Recording, settings: Settings, recorder: Recorder, spin: Spin,
                     stopped: Callable[[], bool]) -> None:
    """Let the filter finish; it is still at work where the player did not wait for it."""
    _, last = settings.span.limits_ns(recording)
    arrivals = recording.arrivals_ns
    newest = int(arrivals[arrivals <= last].max())
    deadline = time.monotonic() + settings.timeout
    while recorder.stamp_ns < newest and not stopped():
        if time.monotonic() > deadline:
            raise TimeoutError(f'no pose for the last range within {settings.timeout:g} s')
        spin(0.1)


def _settle(spin: Spin) -> None:
    """Let the filter take the odometry after the last range, to which there is no answer."""
    until = time.monotonic() + _SETTLE
    while time.monotonic() < until:
        spin(0.05)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
