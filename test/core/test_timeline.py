"""What has its place in time, and what is too late for one."""

import math

from pif_ros.core.estimates import Estimate, Measurement, Rejection
from pif_ros.core.timeline import Timeline
import pytest

SECOND = 1_000_000_000


def at(seconds, value=0.0):
    return Measurement(round(seconds * SECOND), 'place', (value,))


def line(*seconds, history=1.0, max_gap=10.0, start=None):
    """Return a timeline of measurements at some times."""
    made = Timeline(round(history * SECOND), round(max_gap * SECOND),
                    Estimate(None if start is None else round(start * SECOND), None))
    for each in seconds:
        made.put(at(each))
    return made


@pytest.mark.parametrize(('second', 'place'), [
    (0.5, 0), (1.0, Rejection.DUPLICATE), (1.25, 1), (2.0, 2), (0.49, Rejection.TOO_LATE)])
def test_a_measurement_has_its_place_by_its_stamp_within_the_history(second, place):
    made = line(1.0, 1.5)
    assert made.put(at(second)) == place
    assert made.measurements == sorted(made.measurements)


def test_nothing_comes_before_the_anchor_and_what_led_there():
    made = line(0.0, 0.25, 0.5)
    made.advance(2, Estimate(SECOND // 4, None))
    assert (made.anchored, made.measurements, made.stamp_ns) == (
        at(0.25), [at(0.5)], SECOND // 2)
    assert made.put(at(0.2)) is Rejection.TOO_LATE
    # of equal stamps the smaller value came first
    assert made.put(at(0.25, -1.0)) is made.put(at(0.25)) is Rejection.TOO_LATE
    assert made.put(at(0.25, 1.0)) == 0


@pytest.mark.parametrize(('since', 'count'), [(0.9, 2), (1.0, 2), (1.1, 1), (2.0, 1), (2.1, 0)])
def test_since_a_stamp_is_what_is_no_older(since, count):
    assert len(line(1.0, 2.0, history=9.0).since(round(since * SECOND))) == count


@pytest.mark.parametrize(('history', 'count'), [(0.5, 2), (1.0, 1), (1.5, 1), (2.0, 0)])
def test_beyond_the_history_is_what_is_older_than_it_reaches(history, count):
    made = line(1.0, 2.0, 3.0, history=9.0)
    made._history_ns = round(history * SECOND)
    assert made.beyond_history() == count


@pytest.mark.parametrize(('start', 'seconds', 'gap'), [
    (None, (5.0,), 0), (0.0, (10.0,), 0), (0.0, (10.5,), 10.5), (0.0, (3.0, 13.0), 0),
    (0.0, (3.0, 13.25), 10.25)])
def test_a_gap_is_longer_than_the_longest(start, seconds, gap):
    made = line(*seconds, start=start)
    assert made.gap_ns(len(seconds) - 1) == gap * SECOND


def test_where_all_gaps_are_too_long_a_prior_without_a_stamp_has_none():
    assert line(5.0, max_gap=0.0).gap_ns(0) == 0


@pytest.mark.parametrize(('start', 'seconds', 'is_cut'), [
    (None, (), False), (0.0, (), False), (None, (20.0,), False),
    # the history begins a second before the newest
    (0.0, (11.0,), False), (0.0, (11.5,), True), (0.0, (9.0, 20.0), False),
    (0.0, (8.5, 20.0), True), (0.0, (4.0, 9.0, 20.0), False), (0.0, (8.5, 20.0, 19.5), True)])
def test_a_gap_that_reaches_into_the_history_is_not_bridged_any_more(start, seconds, is_cut):
    made = line(*seconds, start=start)
    assert made.is_cut_off(made.oldest_ns(None)) is is_cut


@pytest.mark.parametrize(('seconds', 'other', 'oldest'), [
    ((), None, -math.inf), ((), 5.0, 4.0), ((3.0,), 5.0, 2.0), ((3.0, 4.0), None, 3.0)])
def test_the_history_reaches_back_from_the_newest_measurement_or_else_from_another_stamp(
        seconds, other, oldest):
    made = line(*seconds)
    assert made.oldest_ns(None if other is None else round(other * SECOND)) == oldest * SECOND


def test_the_history_does_not_reach_behind_what_is_kept_of_it():
    made = line(3.0, 3.5)
    made.advance(1, Estimate(3 * SECOND, None))
    assert made.oldest_ns(None) == 3 * SECOND
