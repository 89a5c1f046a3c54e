"""How messages come in, from what is noted of them."""

import numpy as np
from pif_ros.traffic import LAST, Traffic
import pytest

SECOND = 1_000_000_000


def test_rate_and_delay_are_those_of_the_last_messages_alone():
    traffic, rng = Traffic(), np.random.default_rng(2)
    for k in range(40):
        traffic.arrive(k * SECOND, k * SECOND)
    gaps = rng.uniform(0.01, 0.03, LAST)
    arrivals = 100 + np.cumsum(gaps)
    delays = rng.uniform(0.0, 0.2, LAST)
    for arrival, delay in zip(arrivals, delays):
        traffic.arrive(round(arrival * SECOND), round((arrival - delay) * SECOND))
    assert traffic.rate == pytest.approx(1 / gaps[1:].mean(), rel=1e-6)
    assert traffic.delay == pytest.approx(np.median(delays), abs=1e-8)
    assert traffic.skew == 0.0


def test_there_is_no_rate_of_one_message_nor_of_many_at_one_time():
    traffic = Traffic()
    assert traffic.rate is None
    for _ in range(5):
        traffic.arrive(SECOND)
        assert traffic.rate is None
    assert traffic.delay is None and traffic.skew is None


def test_what_was_lost_counts_as_refused_and_is_forgotten_in_time():
    traffic = Traffic()
    for _ in range(LAST):
        traffic.accept(1)
    traffic.refuse(10**9)
    assert traffic.refused == 1.0
    for _ in range(LAST // 2):
        traffic.accept(1)
    assert traffic.refused == 0.5


def test_a_verdict_that_changes_moves_one_message_and_counts_none_twice():
    traffic = Traffic()
    for _ in range(10):
        traffic.accept(1)
    traffic.judge_anew(refused=True)
    traffic.judge_anew(refused=True)
    assert traffic.refused == pytest.approx(0.2)
    traffic.judge_anew(refused=False)
    assert traffic.refused == pytest.approx(0.1)
    for _ in range(3):
        traffic.judge_anew(refused=False)
    assert traffic.refused == 0.0


def test_the_age_is_that_of_the_newest_stamp_however_they_came():
    traffic = Traffic()
    assert traffic.age(SECOND) is None
    for stamp_ns in (3, 9, 5):
        traffic.accept(stamp_ns * SECOND)
    assert traffic.age(10 * SECOND) == 1.0


def test_another_clock_begins_anew_but_remembers_what_was_taken():
    traffic = Traffic()
    traffic.arrive(50 * SECOND, 49 * SECOND)
    traffic.accept(49 * SECOND)
    traffic.refuse()
    traffic.restart()
    assert (traffic.skew, traffic.rate, traffic.delay, traffic.age(0)) == (None,) * 4
    assert traffic.silence(7 * SECOND, 4 * SECOND) == 3.0
    assert traffic.refused == 0.5
