"""What an inbox tells and counts, also of gaps and of new starts."""

import itertools
from types import SimpleNamespace

import numpy as np
from pif_ros import inbox
from pif_ros.accounts import Accounts
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import CorrectionFailed, Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.inbox import Inbox
from pif_ros.verdicts import ROOM
import pytest

SECOND = 1_000_000_000
T = 1_000 * SECOND
PLANE = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [12, 10], 'kernel.time_step': 1.0, 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.4, 'filter.type': 'ekf', 'time.max_gap': 10.0}


class Listening:
    """An inbox, and what it said."""

    def __init__(self, **more):
        """Make it, its tracker and its accounts."""
        self.config, self.said = Config.from_parameters({**PLANE, **more}), []
        self.accounts, self.tracker = Accounts(['main']), build_tracker(self.config)
        self.inbox = Inbox(self.tracker, self.accounts, self.config,
                           lambda kind, text: self.said.append((kind, text)))

    def put(self, second, values):
        """Let a measurement wait."""
        account = self.accounts.sources['main']
        account.received += 1
        self.inbox.put(SimpleNamespace(name='main', what='measurement', account=account),
                       Measurement(T + round(second * SECOND), 'main', values))

    def hear(self, *seconds):
        """Let measurements wait, and work each in by itself."""
        for second in seconds:
            self.put(second, (0.1, second))
            self.work()

    def work(self):
        """Work in all that waits."""
        while self.inbox.has_work:
            self.inbox.work()

    @property
    def became(self):
        """Return how many were accepted, how many of these are outliers, and the rejected."""
        account = self.accounts.sources['main']
        return account.accepted, account.outliers, dict(+account.rejected)

    @property
    def gaps(self):
        """Return the lines that tell of a gap."""
        return [text for kind, text in self.said if kind == 'gap']


@pytest.mark.parametrize(('seconds', 'gaps'), [
    # the second one comes to within the longest gap of the first
    ((0, 9.8, 10.5), 0), ((0, 10.2, 11.0), 1), ((0, 20.0, 20.5), 1), ((0, 0.5, 11.0), 1)])
def test_a_gap_is_one_of_the_stamps_and_not_of_the_order_of_arrival(seconds, gaps):
    means = []
    for order in itertools.permutations(range(3)):
        listening = Listening(**{'time.history': 30.0})
        listening.hear(*(seconds[k] for k in order))
        means.append(listening.tracker.newest.belief.mean())
        assert listening.inbox.gaps == gaps
    np.testing.assert_array_equal(means, [means[0]] * len(means))


def test_a_gap_is_told_once_also_where_a_late_measurement_ends_it():
    listening = Listening()
    listening.hear(0, 20.5, 20.0, 20.7)
    assert listening.gaps == ['main: a gap of 20 s, more than time.max_gap: back to the prior']
    assert listening.inbox.last_gap == listening.gaps[0] and listening.inbox.gaps == 1
    listening.hear(60)
    assert len(listening.gaps) == 2 and listening.inbox.gaps == 2
    # of those that no replay can reach nothing is kept
    assert len(listening.inbox._gaps) == 1
    listening.inbox.restart(None, None)
    assert listening.inbox.last_gap == '' and listening.inbox.gaps == 2


def test_a_gap_that_a_late_measurement_bridges_is_none_and_the_next_is_told():
    listening = Listening()
    listening.hear(0, 10.5, 9.8)
    assert listening.inbox.gaps == 0 and listening.inbox.last_gap == ''
    listening.hear(30)
    assert listening.inbox.gaps == 1 and len(listening.gaps) == 2


HERE, THERE = (0.5, -0.5), (2.5, 3.0)
GATED = {'measurements.main.gate.tail_probability': 1e-4, 'model.params.diffusion': 0.01,
         'prior.covariance_diagonal': [0.04, 0.04], 'prior.mean': list(HERE)}


@pytest.mark.parametrize('since', [0.5, 0.8])
@pytest.mark.parametrize('waits', [False, True])
@pytest.mark.parametrize(('where', 'before', 'after'), [
    (THERE, (1, 0, {'gate': 1}), (2, 0, {})), (HERE, (2, 0, {}), (1, 0, {'gate': 1}))])
def test_after_a_new_start_what_was_measured_since_is_judged_by_that(
        since, waits, where, before, after):
    listening = Listening(**GATED)
    for second, values in ((0, HERE), (0.8, where)):
        listening.put(second, values)
    if not waits:
        listening.work()
        assert listening.became == before
    start = listening.tracker.filter.gaussian(THERE, 0.04 * np.eye(2))
    since_ns = T + round(since * SECOND)
    listening.inbox.restart(start, since_ns, since_ns)
    # of one that the new start forgot before it was worked in there is none
    assert len(listening.accounts.sources['main'].traffic.log_evidence) == 2 - waits
    assert listening.became == after and not listening.inbox.wants_a_turn
    assert listening.tracker.newest.stamp_ns == T + round(0.8 * SECOND)


def test_where_a_sensor_raises_at_a_new_start_the_measurement_is_told_and_left_out(monkeypatch):
    listening = Listening()
    listening.hear(0, 0.7, 0.8)
    monkeypatch.setattr(type(listening.tracker.filter), 'correct', raising_at(
        listening, T + round(0.7 * SECOND)))
    listening.inbox.restart(listening.tracker.prior, T + SECOND // 2, T + SECOND // 2)
    assert listening.became == (2, 0, {'fault': 1})
    [(kind, line)] = listening.said
    assert kind == 'fault' and line.startswith('ArithmeticError: no correction by')
    assert listening.tracker.newest.stamp_ns == T + round(0.8 * SECOND)


@pytest.mark.parametrize('times', [1, 1000])
def test_all_that_waits_is_worked_in_also_where_the_watch_over_some_raises(monkeypatch, times):
    listening, left = Listening(**{'filter.type': 'df'}), iter(range(times))
    predictive = DiracFeynmanFilter.predictive

    def broken(*given):
        if next(left, None) is not None:
            raise ArithmeticError('such a sensor')
        return predictive(*given)

    listening.hear(0)
    monkeypatch.setattr(DiracFeynmanFilter, 'predictive', broken)
    for second in (0.1, 3, 6, 9):
        listening.put(second, HERE)
    failed = listening.inbox.settle()
    assert failed and {(type(each.__cause__), str(each)) for each in failed} == {
        (ArithmeticError, 'no watch over being lost: such a sensor')}
    assert not listening.inbox.has_work and listening.tracker.newest.stamp_ns == T + 9 * SECOND
    assert listening.became == (5, 0, {})


def test_a_gap_in_a_state_that_is_gone_on_from_was_told_before():
    one, other = (Listening(**{'time.history': 30.0}) for _ in range(2))
    one.hear(0, 20)
    other.inbox.recall(one.tracker.memory())
    other.work()
    assert other.gaps == [] and other.inbox.gaps == 0 and other.inbox.last_gap == ''
    other.hear(21, 40)
    assert other.inbox.gaps == 1


def test_a_measurement_that_fails_in_a_replay_ends_no_gap(monkeypatch):
    listening = Listening()
    listening.hear(0, 20.5)
    monkeypatch.setattr(type(listening.tracker.filter), 'correct', raising_at(
        listening, T + round(20.5 * SECOND)))
    listening.put(20.4, HERE)
    with pytest.raises(CorrectionFailed):
        listening.work()
    listening.hear(20.6)
    assert listening.inbox.gaps == 1 and listening.became[2] == {'fault': 1}


def test_what_was_judged_within_the_history_is_judged_anew_however_much_it_is():
    listening = Listening(**GATED, **{'measurements.main.gate.max_consecutive_rejections': 1000})
    for k in range(90):
        listening.put(0.01 * k, THERE)
        listening.work()
    assert listening.became == (0, 0, {'gate': 90})
    start = listening.tracker.filter.gaussian(THERE, 0.04 * np.eye(2))
    listening.inbox.restart(start, T, T)
    assert listening.became == (90, 0, {})


def test_what_comes_too_late_or_twice_is_told_with_how_much_it_is_behind():
    listening = Listening()
    listening.hear(0, 4, 5, 1, 4)
    assert listening.said == [
        ('main: too late', 'main: rejected a measurement: too late, 4.000 s behind the newest, '
         'more than time.history'),
        ('main: duplicate', 'main: rejected a measurement: duplicate, 1.000 s behind the newest')]
    assert listening.became == (3, 0, {'too late': 1, 'duplicate': 1})


def test_verdicts_of_long_ago_are_not_kept():
    listening = Listening(**GATED, **{'measurements.main.gate.max_consecutive_rejections': 1000,
                                      'time.max_gap': 1e6})
    for k in range(300):
        listening.put(2 * k, THERE)
        listening.work()
    assert listening.became == (0, 0, {'gate': 300})
    assert len(listening.inbox._verdicts._found) <= ROOM + 1


def test_a_long_replay_waits_while_more_comes_but_not_longer_than_its_patience(monkeypatch):
    listening, milliseconds, now = Listening(), itertools.count(), [0.0]
    monkeypatch.setattr(inbox, 'time', SimpleNamespace(monotonic=lambda: now[0]))

    def arrive():
        listening.put(0.001 * next(milliseconds), HERE)

    for began in (50.0, 60.0):
        for _ in range(inbox.LONG_REPLAY):
            arrive()
        made = listening.tracker.kept
        for waited in (0.0, 0.5, 0.99):
            now[0] = began + waited * inbox.PATIENCE
            arrive()
            assert listening.inbox.work() is None and listening.tracker.kept == made
        now[0] = began + inbox.PATIENCE
        arrive()
        listening.inbox.work()
        assert listening.tracker.kept > made
        listening.work()


def test_a_long_replay_begins_once_nothing_more_comes():
    listening = Listening()
    for k in range(inbox.LONG_REPLAY + 1):
        listening.put(0.001 * k, HERE)
    assert listening.inbox.work() is None and listening.tracker.kept == 0
    listening.inbox.work()
    assert listening.tracker.kept > 0


def raising_at(listening, stamp_ns):
    """Return a correction that raises at a stamp."""
    correct = type(listening.tracker.filter).correct

    def broken(self, belief, y, sensor, at_ns):
        if at_ns == stamp_ns:
            raise ArithmeticError('such a number')
        return correct(self, belief, y, sensor, at_ns)

    return broken
