"""Which stamps poses go out with."""

from pif_ros.config import Config
from pif_ros.epoch import Epoch
import pytest

MS, SECOND = 1_000_000, 1_000_000_000
T = 1_000 * SECOND


def epoch(**times):
    """Return one whose newest stamp is T, with a rate of 10 Hz unless another one is given."""
    made = Epoch(Config.from_parameters({
        'model.name': 'position_2d', 'publish.rate': times.pop('rate', 10.0),
        **{f'time.{name}': value for name, value in times.items()}}))
    made.advance(T)
    return made


@pytest.mark.parametrize(('stamp_ns', 'now_ns', 'told_ns'), [
    (T + MS, T + 900 * MS, T + MS),
    # a little behind: predicted to the newest
    (T - MS, T + 900 * MS, T), (T - 100 * MS, T + 900 * MS, T),
    # by more than a period: the next forecast tells it, if there is one to come
    (T - 101 * MS, T + 900 * MS, None), (T - 101 * MS, T, T), (T - 101 * MS, None, T)])
def test_no_stamp_is_older_than_the_last(stamp_ns, now_ns, told_ns):
    assert epoch().stamp_for(stamp_ns, now_ns) == told_ns


def test_where_nothing_goes_out_by_itself_all_are_predicted_to_the_newest():
    assert epoch(rate=0.0).stamp_for(T - 5 * SECOND, T + SECOND) == T


@pytest.mark.parametrize(('times', 'furthest'), [
    ({'max_gap': 8.0, 'max_forecast': 3.0}, 8), ({'max_gap': 2.0, 'max_forecast': 3.0}, 3)])
def test_what_no_forecast_reaches_is_of_another_time(times, furthest):
    one = epoch(**times)
    assert not one.is_over(T - furthest * SECOND) and one.is_over(T - furthest * SECOND - 1)
    one.restart()
    assert not one.is_over(0) and one.stamp_for(MS, T) == MS


def test_where_another_time_is_expected_it_begins_where_a_clock_would_have_jumped():
    one = epoch(max_ahead=0.5, max_gap=8.0)
    one.expect_another()
    assert not one.is_over(T - 500 * MS) and one.is_over(T - 500 * MS - 1)
    # as soon as something of it went out, it is this one
    one.advance(T)
    assert not one.is_over(T - 8 * SECOND)


def test_any_stamp_is_the_first_of_an_epoch():
    first = Epoch(Config.from_parameters({'model.name': 'position_2d'}))
    assert first.newest_ns == -1 and not first.is_over(0) and first.stamp_for(0, None) == 0
