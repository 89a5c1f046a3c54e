"""The telling moments of a recording."""

import numpy as np
from pif_ros.plaza.moments import telling_moments, Wanted
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.schedule import Span


def test_there_are_six_of_them_in_a_recording_with_a_silence(plaza: Recording) -> None:
    assert len(telling_moments(plaza)) == 6


def test_the_first_three_are_when_a_beacon_is_heard_for_the_first_time(plaza: Recording) -> None:
    """Oracle: the beacons before and at those stamps."""
    for count, wanted in enumerate(telling_moments(plaza)[:3], start=1):
        until = plaza.range_stamps_ns <= wanted.first_ns
        before = plaza.range_stamps_ns < wanted.first_ns
        assert set(wanted.heard) == set(plaza.beacon_ids[until].tolist())
        assert len(wanted.heard) == count > len(set(plaza.beacon_ids[before].tolist()))
        assert wanted.first_ns == wanted.last_ns


def test_the_last_two_are_before_and_after_the_longest_silence(small: Recording) -> None:
    silence, again = telling_moments(small)[-2:]
    assert (silence.title, again.title) == ('In a silence of 40 s', 'Heard again')
    assert small.seconds(silence.first_ns) > 39.75
    assert small.seconds(again.first_ns) == 80.0
    assert silence.last_ns == again.first_ns - 1


def test_without_a_silence_there_are_four(small: Recording) -> None:
    assert len(telling_moments(small, Span(duration=30.0))) == 4


def test_with_odometry_two_are_when_it_has_driven_so_far(small: Recording) -> None:
    """Oracle: 12 m in radius, once in two minutes: 0.628 m/s from the start, ranges at 4 Hz."""
    found = telling_moments(small, Span(duration=30.0), odometry=True)
    assert [len(w.heard) for w in found] == [1, 2, 3, 1, 1]
    first = small.seconds(small.range_stamps_ns[0])
    for wanted, metres in zip(found[3:], (1.0, 10.0)):
        reached = first + metres / (2.0 * np.pi * 12.0 / 120.0)
        # a sample of the odometry lasts 0.2 s, and the one during the first range does not count
        assert 0.0 <= small.seconds(wanted.first_ns) - reached <= 0.4 + 1e-6
        assert 0.0 <= small.seconds(wanted.last_ns) - small.seconds(wanted.first_ns) <= 0.25


def test_what_is_not_reached_is_no_moment(small: Recording) -> None:
    span = Span(duration=10.0)  # 6 m
    assert len(telling_moments(small, span, odometry=True)) == 4
    assert telling_moments(small, odometry=True)[-1].title == 'In a silence of 40 s'


def test_the_first_or_the_newest_within_is_chosen() -> None:
    stamps = [10, 20, 30, 40]
    assert Wanted('', 15, 35).choose(stamps) == 20
    assert Wanted('', 15, 35, newest=True).choose(stamps) == 30
    assert Wanted('', 21, 29).choose(stamps) is None
