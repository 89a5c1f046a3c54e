"""The player, heard over DDS."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
import signal
import time

from follower import Follower, until
import numpy as np
from numpy.testing import assert_allclose
from pif_ros.plaza import player_node
from pif_ros.plaza.player_node import Player, Spin
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.settings import Settings
import pytest
from ros import Executable, executable

FAST = {'speed': 0.0, 'follow': '/filter_node/pose', 'timeout': 5.0}


Spinner = Callable[..., Spin]


def play(spinner: Spinner, recording: Recording, follower: Follower,
         **settings: float) -> None:
    """Play to a follower in this process until it has heard everything."""
    player = Player(recording, Settings(**{**FAST, **settings}))
    spin = spinner(player, follower)
    player.play(spin)
    until(spin, lambda: len(follower.ranges) >= player.sent['ranges'])


def test_every_range_is_heard_once_with_its_own_stamp_beacon_and_value(
        spinner: Spinner, plaza: Recording) -> None:
    follower = Follower()
    play(spinner, plaza, follower, duration=20.0)
    sent = np.flatnonzero(plaza.seconds(plaza.arrivals_ns) <= 20.0)
    expected = sorted((int(plaza.range_stamps_ns[i]), f'beacon_{plaza.beacon_ids[i]}')
                      for i in sent)
    assert sorted((stamp, frame) for stamp, frame, _ in follower.ranges) == expected
    heard = {stamp: value for stamp, _, value in follower.ranges}
    assert_allclose([heard[stamp] for stamp in plaza.range_stamps_ns[sent].tolist()],
                    plaza.ranges[sent], rtol=1e-6)


def test_a_late_block_comes_after_the_range_that_it_is_late_for(
        spinner: Spinner, small: Recording) -> None:
    """Oracle: of each beacon, which has a topic of its own, the ranges by their arrivals."""
    follower = Follower()
    play(spinner, small, follower, start=80.0, duration=15.0)
    late = small.range_stamps_ns < small.arrivals_ns
    block = set(small.range_stamps_ns[late].tolist())
    heard = {stamp for stamp, _, _ in follower.ranges}
    assert {int(small.arrivals_ns[late][0]), *block} <= heard
    order = np.argsort(small.arrivals_ns, kind='stable')
    for beacon in small.beacons:
        stamps = small.range_stamps_ns[order[small.beacon_ids[order] == beacon]].tolist()
        assert [stamp for stamp, frame, _ in follower.ranges if frame == f'beacon_{beacon}'] == [
            stamp for stamp in stamps if stamp in heard]
    assert any(np.any(np.diff([stamp for stamp, frame, _ in follower.ranges
                               if frame == f'beacon_{beacon}']) < 0) for beacon in small.beacons)


def test_no_range_is_sent_before_the_one_before_it_is_answered(
        spinner: Spinner, small: Recording) -> None:
    """Oracle: a follower that answers only twelve ranges has heard thirteen at the time-out."""
    follower = Follower(respond=12)
    player = Player(small, Settings(**{**FAST, 'timeout': 0.7}))
    with pytest.raises(TimeoutError, match='no pose on /filter_node/pose .* at 3.500 s'):
        player.play(spinner(player, follower))
    assert len(follower.ranges) == player.sent['ranges'] == 13


def test_the_clock_never_runs_back_and_stops_just_short_of_an_arrival(
        spinner: Spinner, small: Recording) -> None:
    follower = Follower()
    play(spinner, small, follower, duration=60.0)
    assert np.diff(follower.clocks).min() >= 0
    arrivals = {stamp for stamp, _, _ in follower.ranges}
    assert not arrivals & set(follower.clocks)
    assert {stamp - 1 for stamp in arrivals} <= set(follower.clocks)


def test_the_truth_is_played_beside_the_ranges(
        spinner: Spinner, small: Recording) -> None:
    follower = Follower()
    play(spinner, small, follower, duration=10.0)
    stamps = np.array([stamp for stamp, _, _ in follower.truths])
    assert_allclose(np.diff(stamps), 0.2e9, rtol=1e-6)
    assert_allclose([(x, y) for _, x, y in follower.truths], small.truth_at(stamps)[:, :2])


def test_odometry_comes_at_the_end_of_the_interval_whose_start_it_bears(
        spinner: Spinner, small: Recording) -> None:
    follower = Follower()
    player = Player(small, Settings(**{**FAST, 'start': 20.0, 'duration': 10.0}))
    spin = spinner(player, follower)
    player.play(spin)
    first, last = (small.start_ns + k * 10**9 for k in (20, 30))
    ends = small.odometry_ends_ns
    expected = np.flatnonzero((ends >= first) & (ends <= last))
    until(spin, lambda: len(follower.controls) >= len(expected))
    stamps, v, omega, heard = zip(*follower.controls)
    assert list(stamps) == small.odometry_stamps_ns[expected].tolist()
    assert_allclose(np.transpose([v, omega]), small.odometry[expected])
    # each range was answered before anything later was sent
    arrivals = small.arrivals_ns[small.arrivals_ns >= first]
    assert np.all(np.array(heard) >= np.searchsorted(arrivals, ends[expected]))
    assert heard[-1] > 30


def test_the_clock_of_a_follower_waits_for_what_it_answers(
        spinner: Spinner, small: Recording) -> None:
    """Between ranges at 4 Hz comes odometry at 5 Hz, which does not move the clock."""
    follower = Follower()
    play(spinner, small, follower, duration=10.0)
    assert len(follower.controls) > 40
    stamps = {stamp for stamp, _, _ in follower.ranges}
    moved = {clock for clock in follower.clocks if clock > min(stamps)}
    assert moved <= {stamp - 1 for stamp in stamps} | {small.start_ns + 10 * 10**9}


def test_odometry_may_be_left_out(spinner: Spinner, small: Recording) -> None:
    follower = Follower()
    play(spinner, small, follower, duration=5.0, odometry=False)
    assert not follower.controls and follower.ranges


@pytest.mark.parametrize(('foresee', 'heard'), [(1, 9), (3, 4), (0, 1)])
def test_a_follower_that_foresees_something_is_always_waited_for(
        spinner: Spinner, small: Recording, monkeypatch: pytest.MonkeyPatch,
        foresee: int, heard: int) -> None:
    """
    Ten seconds of a silence; the follower foresees one of so many, but never the first.

    heard: of how many stamps it has been heard when the player comes to each of these seconds.
    """
    monkeypatch.setattr(player_node, '_PATIENCE', 0.1)
    follower = Follower(foresee=foresee)
    player = Player(small, Settings(**{
        **FAST, 'start': 38.0, 'duration': 12.0, 'odometry': False}))
    waited: list[int] = []
    await_forecast = player._await_forecast
    monkeypatch.setattr(player, '_await_forecast', lambda step, *rest: (
        waited.append(player._pose_ns), await_forecast(step, *rest)))
    player.play(spinner(player, follower))
    assert (len(waited), len(set(waited))) == (10, heard)


def test_ten_seconds_at_tenfold_speed_take_one_second(
        spinner: Spinner, small: Recording) -> None:
    follower = Follower(respond=0)
    player = Player(small, Settings(speed=10.0, duration=10.0))
    spin = spinner(player, follower)
    until(spin, lambda: not player._missing())
    began = time.monotonic()
    player.play(spin)
    assert 0.9 < time.monotonic() - began - 0.5 < 2.5  # the half second is the clock's lead
    until(spin, lambda: len(follower.ranges) == player.sent['ranges'] == 39)


def test_says_who_is_missing_where_nobody_listens(
        spinner: Spinner, small: Recording) -> None:
    player = Player(small, Settings(speed=1.0, timeout=0.2))
    with pytest.raises(TimeoutError, match='nobody at /clock, /beacon_0/range.* after 0.2 s'):
        player.play(spinner(player))


def test_stops_at_once_when_told_to(
        spinner: Spinner, small: Recording) -> None:
    follower = Follower()
    player = Player(small, Settings(**FAST))
    player.play(spinner(player, follower), stopped=lambda: len(follower.ranges) >= 5)
    assert player.sent['ranges'] <= 6


def process(folder: Path, *parameters: str) -> AbstractContextManager[Executable]:
    """Return the executable, with some parameters."""
    return executable(folder, *(word for parameter in parameters for word in ('-p', parameter)),
                      module='pif_ros.plaza.player')


def test_two_processes_lose_nothing(
        spinner: Spinner, tmp_path: Path, synthetic_file: Path, small: Recording) -> None:
    follower = Follower()
    spin = spinner(follower)
    with process(tmp_path, f'path:={synthetic_file}', 'speed:=0',
                 'follow:=/filter_node/pose', 'duration:=20.0') as player:
        status, *_ = player.end(lambda: spin(0.05))
    assert (status, player.stderr.count('recording')) == (0, 10)
    sent = small.range_stamps_ns[small.seconds(small.arrivals_ns) <= 20.0]
    until(spin, lambda: len(follower.ranges) == len(sent) > 70)
    assert sorted(stamp for stamp, _, _ in follower.ranges) == sorted(sent.tolist())


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_with_status_0_and_not_a_word(
        tmp_path: Path, synthetic_file: Path, number: signal.Signals) -> None:
    with process(tmp_path, f'path:={synthetic_file}') as player:
        player.until(lambda: 'waiting for the other end' in player.stdout, 'it waits')
        player.signal(number)
        player.signal(number)
        status, *_ = player.end()
    assert (status, player.stderr) == (0, '')


@pytest.mark.parametrize(('argument', 'line'), [
    ('speed:=-1.0', "plaza_player: parameter 'speed': expected a number of at least 0, got -1.0"),
    ('sped:=1.0', "plaza_player: parameter 'sped': expected one of recording, path, speed, "
     'follow, start, duration, timeout, odometry'),
    ('odometry:=1', "plaza_player: parameter 'odometry': expected true or false, got 1"),
    ('use_sim_time:=7', 'plaza_player: use_sim_time: expected true or false, got 7'),
    ('start:=1e300', "plaza_player: parameter 'start': expected a number from 0 to 1e9, "
     'got 1e+300'),
    ('duration:=1e300', "plaza_player: parameter 'duration': expected a number from 0 to 1e9, "
     'got 1e+300'),
    ('path:=/absent.mat', 'plaza_player: no such recording: /absent.mat')])
def test_what_cannot_be_played_is_one_line_and_status_2(
        tmp_path: Path, argument: str, line: str) -> None:
    with process(tmp_path, argument) as player:
        status, *_ = player.end()
    assert (status, player.stderr) == (2, line + '\n')


@pytest.mark.parametrize('argument', [
    'start_type_description_service:=false', 'qos_overrides./clock.publisher.depth:=5'])
def test_what_rclpy_itself_is_told_is_no_unknown_parameter(
        tmp_path: Path, synthetic_file: Path, argument: str) -> None:
    with process(tmp_path, f'path:={synthetic_file}', argument) as player:
        player.until(lambda: 'waiting for the other end' in player.stdout, 'it waits')
        player.signal(signal.SIGTERM)
        status, *_ = player.end()
    assert (status, player.stderr) == (0, '')
