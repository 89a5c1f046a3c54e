"""When a clock was set, and what is another time."""

from types import SimpleNamespace

from pif_ros import timekeeper
from pif_ros.timekeeper import Timekeeper
import pytest
from rclpy.clock import ClockType, ROSClock
from rclpy.time import Time

MS, SECOND = 1_000_000, 1_000_000_000


class Kept:
    """A timekeeper of the system's clock and of a steady one, which is set; what it was told."""

    def __init__(self, monkeypatch):
        self.clock, self.said, self.steady_ns = ROSClock(), [], 0
        self.keeper = Timekeeper(SimpleNamespace(get_clock=lambda: self.clock), 500 * MS,
                                 self.said.append)
        monkeypatch.setattr(timekeeper, 'steady_ns', lambda: self.steady_ns)

    def system(self, monkeypatch, now_ns, steady_ns):
        """Read both clocks at these times."""
        self.steady_ns = steady_ns
        monkeypatch.setattr(ROSClock, 'now', lambda _: Time(
            nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))
        return self.keeper.now()

    def simulate(self, now_ns):
        """Let a /clock tell the time."""
        self.clock._set_ros_time_is_active(True)
        self.clock.set_ros_time_override(Time(nanoseconds=now_ns, clock_type=ClockType.ROS_TIME))
        return self.keeper.now()


@pytest.fixture
def kept(monkeypatch):
    return Kept(monkeypatch)


@pytest.mark.parametrize(('by_ns', 'is_set'), [
    (-251 * MS, True), (-249 * MS, False), (249 * MS, False), (251 * MS, True)])
def test_a_clock_that_moves_by_more_than_a_quarter_of_a_second_was_set(
        kept, monkeypatch, by_ns, is_set):
    kept.system(monkeypatch, 1000 * SECOND, 0)
    assert kept.system(monkeypatch, 1001 * SECOND, SECOND) == 1001 * SECOND and not kept.said
    kept.system(monkeypatch, 1002 * SECOND + by_ns, 2 * SECOND)
    kept.system(monkeypatch, 1003 * SECOND + by_ns, 3 * SECOND)
    assert [(told.by_ns, told.goes_on) for told in kept.said] == is_set * [(by_ns, True)]
    assert all(f'set by {by_ns / 1e9:+.3f} s' in told.text for told in kept.said)


def test_a_clock_that_creeps_was_not_set(kept, monkeypatch):
    for second in range(10):
        kept.system(monkeypatch, second * 1200 * MS, second * SECOND)
    assert not kept.said


@pytest.mark.parametrize(('waits_ns', 'is_set'), [(31 * MS, True), (32 * MS, False)])
def test_who_has_to_wait_between_two_clocks_does_not_compare_them(
        kept, monkeypatch, waits_ns, is_set):
    kept.system(monkeypatch, 1000 * SECOND, 0)
    readings = iter([SECOND, SECOND + waits_ns])
    monkeypatch.setattr(timekeeper, 'steady_ns', lambda: next(readings))
    monkeypatch.setattr(ROSClock, 'now', lambda _: Time(
        nanoseconds=2000 * SECOND, clock_type=ClockType.ROS_TIME))
    assert kept.keeper.now() == 2000 * SECOND
    assert bool(kept.said) is is_set


def test_before_the_first_clock_there_is_no_time_and_the_system_s_does_not_count(
        kept, monkeypatch):
    assert kept.simulate(0) is None
    assert kept.simulate(5 * SECOND) == 5 * SECOND
    kept.steady_ns = 3600 * SECOND
    assert kept.simulate(6 * SECOND) == 6 * SECOND and not kept.said


@pytest.mark.parametrize(('by_ns', 'told'), [
    (3600 * SECOND, []), (1, []), (-1, [(0, True)]), (-500 * MS, [(0, True)]),
    (-500 * MS - 1, [(-500 * MS - 1, False)]), (-50 * SECOND, [(-50 * SECOND, False)])])
def test_a_simulated_clock_that_jumps_back_is_another_time_unless_by_little(kept, by_ns, told):
    kept.simulate(100 * SECOND)
    kept.simulate(100 * SECOND + by_ns)
    assert [(said.by_ns, said.goes_on) for said in kept.said] == told
    assert all(f'jumped by {by_ns / 1e9:.3f} s' in said.text for said in kept.said)
