"""How long work took, with a clock that is set by hand."""

import numpy as np
from pif_ros import stopwatch
from pif_ros.stopwatch import resident_bytes, Stopwatch, TimedFilter
import pytest


class Time:
    """A clock that is set by hand."""

    now = 100.0

    def monotonic(self):
        return self.now

    perf_counter = monotonic


@pytest.fixture
def time(monkeypatch):
    """Return the clock that the stopwatch looks at."""
    time = Time()
    monkeypatch.setattr(stopwatch, 'time', time)
    return time


def work(watch, time, kind, seconds):
    with watch.timing(kind):
        time.now += seconds


def test_tells_median_and_longest_of_each_kind(time):
    watch = Stopwatch()
    for seconds in (0.5, 0.25, 4.0):
        work(watch, time, 'predict', seconds)
    work(watch, time, 'publish', 0.125)
    assert watch.summary() == {'predict': (0.5, 4.0), 'publish': (0.125, 0.125)}


def test_is_as_busy_as_the_work_took_of_the_time_and_counts_nothing_twice(time):
    watch = Stopwatch()
    with watch.timing('work'):
        work(watch, time, 'predict', 1.0)
        time.now += 1.0
    time.now += 6.0
    assert watch.busy() == 0.25
    time.now += 1.0
    assert watch.busy() == 0.0


def test_work_that_fails_is_timed_too(time):
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch.timing('correct'):
        time.now += 2.0
        1 / 0
    assert watch.summary() == {'correct': (2.0, 2.0)}
    time.now += 2.0
    assert watch.busy() == 0.5


def test_a_timed_filter_gives_what_the_filter_gives(time):
    class Slow:
        name = 'slow'

        def predict(self, a, b):
            time.now += 1.0
            return a + b

        def correct(self, a):
            time.now += 3.0
            return -a

    watch = Stopwatch()
    timed = TimedFilter(Slow(), watch)
    assert (timed.predict(2, 3), timed.correct(4), timed.name) == (5, -4, 'slow')
    assert watch.summary() == {'predict': (1.0, 1.0), 'correct': (3.0, 3.0)}


def test_memory_grows_with_what_is_held():
    before = resident_bytes()
    if before is None:
        pytest.skip('the system does not tell')
    held = np.ones(25_000_000)
    assert resident_bytes() - before > 0.5 * held.nbytes
