"""How often what is costly goes out."""

from pif_ros import pace
from pif_ros.pace import Pace, Rest
import pytest

SECOND = 1_000_000_000


class Wall:
    """A clock on the wall that stands still unless it is moved."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(pace.time, 'monotonic', lambda: self.now)


@pytest.fixture
def wall(monkeypatch):
    return Wall(monkeypatch)


def test_it_goes_out_at_its_rate_by_the_stamps_however_fast_they_come(wall):
    every = Pace({'rate': 4.0}, 'rate')
    out = []
    for stamp_ns in range(0, 2 * SECOND, SECOND // 100):
        if every.is_due(stamp_ns):
            with every.making(stamp_ns):
                out.append(stamp_ns)
    assert out == [k * SECOND // 4 for k in range(8)]


def test_a_rate_that_changes_holds_at_once_and_none_is_never(wall):
    live = {'rate': 0.0}
    every = Pace(live, 'rate')
    assert not every.is_due(0)
    live['rate'] = 0.5
    assert every.is_due(0)
    with every.making(0):
        pass
    assert not every.is_due(SECOND) and every.is_due(2 * SECOND)
    live['rate'] = 1.0
    assert every.is_due(SECOND)


def test_what_takes_long_waits_until_it_has_no_more_than_its_share(wall):
    every = Pace({'rate': 1000.0}, 'rate', share=0.1)
    with every.making(0):
        wall.now += 0.5
    wall.now += 4.4
    assert not every.is_due(10 * SECOND)
    wall.now += 0.2
    assert every.is_due(10 * SECOND)


def test_after_a_restart_the_next_goes_out_at_once(wall):
    every = Pace({'rate': 1.0}, 'rate', share=0.1)
    with every.making(10 * SECOND):
        wall.now += 1.0
    assert not every.is_due(SECOND)
    every.restart()
    assert every.is_due(SECOND)


@pytest.mark.parametrize(('took', 'waited', 'is_over'), [
    # what is followed by work after a second anyway needs no rest of less
    (0.2, 0.0, True), (0.3, 0.89, False), (0.3, 0.91, True), (2.0, 5.9, False), (2.0, 6.1, True)])
def test_work_rests_until_it_has_its_share_unless_it_comes_seldom_enough(
        wall, took, waited, is_over):
    rest = Rest(0.25, 1.0)
    assert rest.is_over
    with rest.working():
        wall.now += took
    wall.now += waited
    assert rest.is_over is is_over
    rest.end()
    assert rest.is_over
