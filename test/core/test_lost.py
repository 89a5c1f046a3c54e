"""Lost or not: the test, and the verdict."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.lost import Alarm, FEWEST, verdict, Watch
import pytest

ALARM = Alarm(1e-5)
TAILS = st.lists(st.floats(0, 1), max_size=60)


def watched(tails, alarm=ALARM, watch=Watch()):
    for tail in tails:
        watch = alarm.after(watch, tail)
    return watch


def test_false_alarms_are_no_more_frequent_than_the_rate_that_is_asked_for():
    # a rate that a test can see; increments that are held down make it much less still
    alarm, rng, watch, raised = Alarm(0.2), np.random.default_rng(1), Watch(), 0
    for tail in rng.random(200_000):
        watch = alarm.after(watch, tail)
        if alarm.is_raised(watch):
            raised, watch = raised + 1, Watch()
    assert 0 < raised <= 0.2 * 200_000


def test_a_lost_filter_is_found_out_by_the_fourth_measurement_and_by_no_fewer():
    assert not watched([0.0] * (FEWEST - 1)).lost
    assert watched([0.0] * FEWEST).lost
    assert watched([0.5] * 100 + [1e-9] * FEWEST).lost


def test_three_outliers_alone_are_no_alarm():
    assert not watched([0.5] * 20 + [0.0] * 3 + [0.5] * 20).lost


@given(TAILS)
def test_the_score_stays_between_nothing_and_the_threshold(tails):
    assert 0 <= watched(tails).score <= ALARM.threshold


def test_once_lost_it_is_lost_until_the_measurements_fit_again():
    lost = watched([0.0] * 5)
    assert lost.lost and watched([0.5] * 3, watch=lost).lost
    assert watched([0.5] * 30, watch=lost) == Watch()


def test_a_recovery_is_halfway_to_the_next():
    lost = watched([0.0] * 5).recovered()
    assert lost.lost and not ALARM.is_raised(lost) and lost.recoveries == 1
    assert ALARM.is_raised(watched([0.0] * (FEWEST // 2), watch=lost))


def test_what_nobody_has_asked_for_changes_nothing():
    lost = watched([0.0] * 3)
    assert ALARM.after(lost, math.nan) is lost


def test_rejections_are_counted_by_source():
    watch = Watch().counted('b', 2).counted('a', 1)
    assert (watch.rejections('a'), watch.rejections('b'), watch.rejections('c')) == (1, 2, 0)
    assert watch.counted('b', 0) == Watch().counted('a', 1)
    assert Watch().counted('a', 1).counted('b', 2) == watch


@pytest.mark.parametrize('rate', [0, 1, -0.1, float('nan')])
def test_refuses_what_is_no_rate(rate):
    with pytest.raises(ValueError, match='^rate: expected .*, got .*$'):
        Alarm(rate)


@pytest.mark.parametrize('watch, filled, masses, level, words', [
    (Watch(), 0.001, [0.97], 'found', 'in one place'),
    (Watch(), 0.001, [0.8, 0.15], 'found', '80%'),
    (Watch(), 0.001, [0.5, 0.45], 'unsure', '2 places'),
    (Watch(), 0.9, [0.95], 'unsure', '90% of the grid'),
    (Watch(11.5, True), 0.001, [0.97], 'lost', 'contradict'),
    (Watch(3.0, True), 0.9, [0.95], 'lost', '90% of the grid')])
def test_evidence_entropy_and_modes_make_one_verdict(watch, filled, masses, level, words):
    found = verdict(watch, ALARM, filled, masses)
    assert found.level == level and words in found.sentence
    assert found.numbers['surprise'] == pytest.approx(watch.score / ALARM.threshold)
    assert found.numbers['share of the grid filled'] == filled


def test_without_a_watch_entropy_and_modes_still_have_a_word():
    assert verdict(Watch(), None, 0.9, [0.9]).level == 'unsure'
    found = verdict(Watch(), None, 0.01, [0.9])
    assert (found.level, found.sentence) == (
        'found', 'found: the belief is in one place; it is not watched whether the measurements '
        'fit')
    assert 'surprise' not in found.numbers


def test_where_nobody_has_looked_for_modes_nothing_is_said_of_them():
    found = verdict(Watch(), ALARM, 0.012, [])
    assert (found.level, found.sentence) == (
        'found', 'found: the belief fills 1.2% of the grid, and the measurements fit')
