"""The telling moments of a recording."""

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


def test_the_first_or_the_newest_within_is_chosen() -> None:
    stamps = [10, 20, 30, 40]
    assert Wanted('', 15, 35).choose(stamps) == 20
    assert Wanted('', 15, 35, newest=True).choose(stamps) == 30
    assert Wanted('', 21, 29).choose(stamps) is None
