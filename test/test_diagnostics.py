"""What the node says of itself: for a person, and true."""

import dataclasses
import math

import numpy as np
from pif_ros.accounts import Accounts, SourceAccount
from pif_ros.config import DiagnosticsConfig
from pif_ros.core.active import ActiveGridFilter
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.lost import Alarm
from pif_ros.core.systems import position_2d
from pif_ros.core.systems.robots import position_sensor
from pif_ros.core.tracker import Tracker
from pif_ros.diagnostics import ERROR, Facts, OK, statuses, WARN
import pytest

SECOND = 1_000_000_000
GRID = Grid((-5.0, -5.0), (5.0, 5.0), (40, 40))
MODEL, SENSORS = position_2d(0.5).model, {'main': position_sensor(0.3)}


def tracker_of(filter_):
    return Tracker(filter_, filter_.gaussian([0.0, 1.0], np.eye(2)))


def told(tracker, accounts=None, now_ns=0, **given):
    """Return what is said of a tracker, by task."""
    facts = Facts(tracker, Accounts(['main']) if accounts is None else accounts,
                  DiagnosticsConfig(), now_ns, 0, {},
                  **{'log_volume': math.log(100), **given})
    return {status.name: status for status in statuses(facts)}


def all_cells():
    return DiracFeynmanFilter(MODEL, GRID, SENSORS, KernelSettings(0.1))


def test_before_a_measurement_it_says_that_it_waits():
    said = told(tracker_of(all_cells()))
    assert list(said) == ['filter', 'belief', 'main', 'timing']
    assert (said['filter'].level, said['filter'].message) == (OK, 'waits for a measurement')
    assert (said['belief'].level, said['belief'].message) == (
        OK, 'the prior, which waits for a measurement')
    assert (said['main'].level, said['main'].message) == (OK, 'nothing received yet')
    assert told(tracker_of(all_cells()), now_ns=None)['filter'].message == 'waits for a /clock'


@pytest.mark.parametrize('filter_', [all_cells(), ActiveGridFilter(MODEL, GRID, SENSORS, 0.1)],
                         ids=['all cells', 'active cells'])
def test_tells_mass_deviations_and_evidence_of_the_newest_belief(filter_):
    tracker = tracker_of(filter_)
    tracker.observe(Measurement(0, 'main', (0.5, 0.5)))
    estimate = tracker.estimate()
    belief = told(tracker)['belief']
    assert belief.level == OK
    assert float(belief.values['mass']) == pytest.approx(estimate.belief.mass, abs=1e-9)
    for i, name in enumerate('xy'):
        assert float(belief.values[f'standard deviation of {name}']) == pytest.approx(
            np.sqrt(estimate.belief.covariance()[i, i]), rel=1e-5)
    assert float(belief.values['log evidence of the newest measurement']) == pytest.approx(
        estimate.log_evidence, rel=1e-3)


def test_tells_entropy_modes_and_what_lies_at_the_edge():
    tracker = tracker_of(all_cells())
    tracker.reset(all_cells().gaussian([4.5, 0.0], 0.09 * np.eye(2)), 0)
    belief = told(tracker, masses=(0.75, 0.25))['belief']
    # of a Gaussian, less what is cut off: half of it lies beyond 4.75, where the last cell is
    newest = tracker.newest.belief
    assert float(belief.values['entropy'].split()[0]) == pytest.approx(newest.entropy(), rel=1e-3)
    assert belief.values['masses of the modes'] == '0.750, 0.250'
    density = newest.density
    inner = density[1:-1, 1:-1].sum() / density.sum()
    assert float(belief.values['mass at the edge']) == pytest.approx(1 - inner, rel=1e-2)
    assert belief.level == WARN and 'at the edge' in belief.message


@pytest.mark.parametrize(('masses', 'level', 'word'), [
    ((1.0,), OK, 'one place'), ((0.5, 0.5), WARN, '2 places are possible')])
def test_a_belief_in_several_places_is_unsure(masses, level, word):
    tracker = tracker_of(all_cells())
    tracker.reset(all_cells().gaussian([0.0, 0.0], 0.09 * np.eye(2)), 0)
    belief = told(tracker, masses=masses)['belief']
    assert belief.level == level and word in belief.message


def test_a_filter_that_is_lost_is_an_error_and_one_that_knows_nothing_a_warning():
    tracker = tracker_of(all_cells())
    tracker.guard = dataclasses.replace(tracker.guard, alarm=Alarm())
    for k in range(6):
        tracker.observe(Measurement(k, 'main', (3.0 * (-1)**k, 3.0)))
    tracker.estimate()
    belief = told(tracker, masses=(1.0,))['belief']
    assert belief.level == ERROR and belief.message.startswith('lost: ')
    tracker.reset(all_cells().uniform(), 0)
    belief = told(tracker, masses=(1.0,))['belief']
    assert belief.level == WARN and 'fills 100% of the grid' in belief.message


def test_tells_what_active_cells_there_are_and_what_was_dropped():
    tracker = tracker_of(ActiveGridFilter(MODEL, GRID, SENSORS, 0.1))
    for k in range(3):
        tracker.observe(Measurement(k * 100_000_000, 'main', (0.5, 0.5)))
    values = told(tracker)['belief'].values
    newest = tracker.estimate().belief
    values = told(tracker)['belief'].values
    assert float(values['cells']) == pytest.approx(newest.size, rel=1e-2)
    assert values['patches'] == '1'
    assert 0 < float(values['dropped']) <= 1e-5


def test_warns_when_most_of_the_belief_has_left_the_grid():
    filter_ = all_cells()
    tracker = tracker_of(filter_)
    tracker.reset(filter_.gaussian([4.9, 0.0], 0.01 * np.eye(2)), 0)
    tracker.reset(filter_.predict(tracker.newest.belief, 0, 3_000_000_000), 0)
    belief = told(tracker)['belief']
    assert belief.level == ERROR
    assert belief.message.endswith('% of it has left the grid')


@pytest.mark.parametrize('filter_', [all_cells(), ActiveGridFilter(MODEL, GRID, SENSORS, 0.1)],
                         ids=['all cells', 'active cells'])
def test_a_belief_that_has_left_the_grid_altogether_is_told_of_too(filter_):
    tracker = tracker_of(filter_)
    nothing = (dataclasses.replace(filter_.uniform(), patches=())
               if isinstance(filter_, ActiveGridFilter)
               else GridBelief(GRID, np.zeros(GRID.shape)))
    tracker.reset(nothing, 0)
    belief = told(tracker)['belief']
    assert (belief.level, belief.message) == (ERROR, 'all of it has left the grid')
    assert float(belief.values['mass']) == 0


def account_of(*fates):
    """Return an account of messages a tenth of a second apart, and what became of each."""
    account = SourceAccount()
    for k, fate in enumerate(fates):
        account.received += 1
        account.traffic.arrive(k * SECOND // 10, k * SECOND // 10 - SECOND // 50)
        if fate == 'accepted':
            account.accept(k * SECOND // 10 - SECOND // 50)
        elif fate == 'dropped':
            account.drop()
        else:
            account.reject(fate)
    return account


def said_of(account, now_ns):
    accounts = Accounts(['main'])
    accounts.sources['main'] = account
    return told(tracker_of(all_cells()), accounts, now_ns)['main']


def test_tells_every_count_and_how_the_messages_come_in():
    account = account_of(*['accepted'] * 30, 'too late')
    account.lose(2)
    account.traffic.log_evidence.extend([-1.0, -3.0])
    source = said_of(account, 3 * SECOND + SECOND // 4)
    assert source.level == OK
    assert source.message == ('31 received, 30 accepted, 1 rejected (1 too late), 0 dropped, '
                              '2 lost before')
    assert source.values == {
        'received': '31', 'accepted': '30', 'outliers': '0', 'dropped': '0',
        'rejected, too late': '1', 'lost before us': '2', 'rate': '10 Hz',
        'age of the newest': '0.370 s', 'delay': '0.020 s',
        'clock less stamp at the first message': '0.020 s',
        'log evidence of the last 2 (mean, least)': '-2, -3'}


@pytest.mark.parametrize(('bad', 'level'), [(1, OK), (2, WARN), (10, ERROR)])
def test_a_source_is_as_bad_as_the_share_of_its_last_messages_that_were_not_taken(bad, level):
    account = account_of(*['accepted'] * (20 - bad), *['dropped'] * bad)
    source = said_of(account, 2 * SECOND)
    assert source.level == level
    assert (f'{bad / 20:.0%} of the last' in source.message) == (level > OK)


@pytest.mark.parametrize(('seconds', 'level'), [(1.9, OK), (2.1, WARN), (10.1, ERROR)])
def test_a_source_that_is_silent_is_told_of_whether_it_was_ever_heard_or_not(seconds, level):
    account = account_of('accepted')
    assert said_of(account, round(seconds * SECOND)).level == level
    never = said_of(SourceAccount(), round(seconds * SECOND))
    assert never.level == level
    assert ('silent for' in never.message) == (level > OK)


@pytest.mark.parametrize(('delay', 'level'), [(0.4, OK), (0.6, WARN), (6.0, ERROR)])
def test_stamps_that_are_old_when_they_come_are_told_of(delay, level):
    account = SourceAccount(received=1)
    account.traffic.arrive(10 * SECOND, round((10 - delay) * SECOND))
    assert said_of(account, 10 * SECOND).level == level


@pytest.mark.parametrize(('given', 'level', 'words'), [
    ({'behind': 3.0}, WARN, 'behind for 3.0 s'), ({'behind': 11.0}, ERROR, 'behind for 11.0 s'),
    ({'now_ns': 5 * SECOND}, WARN, 'predicts only'), ({'now_ns': SECOND}, OK, 'tracks'),
    ({'now_ns': SECOND, 'faults': 2}, WARN, '2 faults')])
def test_the_filter_is_told_to_track_unless_it_does_not(given, level, words):
    tracker = tracker_of(all_cells())
    tracker.observe(Measurement(0, 'main', (0.5, 0.5)))
    tracker.estimate()
    status = told(tracker, **{'now_ns': SECOND, **given})['filter']
    assert status.level == level and words in status.message


def test_the_reason_of_the_last_restart_is_told():
    status = told(tracker_of(all_cells()), restarts=3, why='~/reset')['filter']
    assert (status.values['restarts'], status.values['last restart']) == ('3', '~/reset')


@pytest.mark.parametrize(('busy', 'level'), [(0.5, OK), (0.7, WARN), (0.99, ERROR)])
def test_timing_tells_how_busy_it_is_and_what_takes_how_long(busy, level):
    facts = Facts(tracker_of(all_cells()), Accounts(['main']), DiagnosticsConfig(), 0, 0,
                  {'predict': (0.001, 0.25)}, busy, 4)
    timing = statuses(facts)[-1]
    assert timing.level == level
    assert timing.values['predict, ms (median, longest)'] == '1.00, 250.00'
    assert (timing.values['busy'], timing.values['poses skipped']) == (f'{busy:.0%}', '4')


def test_control_and_initial_pose_are_told_of_where_there_are_some():
    accounts = Accounts(['main'], ['v'])
    accounts.initial_pose.received = 1
    assert list(told(tracker_of(all_cells()), accounts)) == [
        'filter', 'belief', 'main', 'control', 'initialpose', 'timing']


@pytest.mark.parametrize(('saved', 'level', 'words'), [
    (None, OK, 'tracks'), (('3.0 s ago', True), OK, 'tracks'),
    (('state_file: no room', False), WARN, 'not saved: state_file: no room')])
def test_a_state_that_is_not_saved_is_a_concern(saved, level, words):
    tracker = tracker_of(all_cells())
    tracker.observe(Measurement(SECOND, 'main', (0.0, 1.0)))
    tracker.estimate()
    said = told(tracker, now_ns=SECOND, saved=saved)['filter']
    assert said.level == level and words in said.message
    assert said.values.get('state saved') == (saved and saved[0])
