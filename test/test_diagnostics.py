"""What the node says of itself: for a person, and true."""

from collections import Counter
import dataclasses

import numpy as np
from pif_ros.accounts import Accounts
from pif_ros.core.active import ActiveGridFilter
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.systems import position_2d
from pif_ros.core.systems.robots import position_sensor
from pif_ros.core.tracker import Measurement, Tracker
from pif_ros.diagnostics import OK, statuses, WARN
import pytest

GRID = Grid((-5.0, -5.0), (5.0, 5.0), (40, 40))
MODEL, SENSORS = position_2d(0.5).model, {'main': position_sensor(0.3)}


def tracker_of(filter_):
    return Tracker(filter_, filter_.gaussian([0.0, 1.0], np.eye(2)))


def all_cells():
    return DiracFeynmanFilter(MODEL, GRID, SENSORS, KernelSettings(0.1))


def test_before_a_measurement_it_says_that_it_waits():
    belief, source = statuses(tracker_of(all_cells()), Accounts(['main']))
    assert (belief.level, belief.message) == (OK, 'the prior, which waits for a measurement')
    assert (source.name, source.level, source.message) == ('main', OK, 'nothing received yet')


@pytest.mark.parametrize('filter_', [all_cells(), ActiveGridFilter(MODEL, GRID, SENSORS, 0.1)],
                         ids=['all cells', 'active cells'])
def test_tells_mass_deviations_and_evidence_of_the_newest_belief(filter_):
    tracker = tracker_of(filter_)
    tracker.observe(Measurement(0, 'main', (0.5, 0.5)))
    estimate = tracker.estimate()
    belief = statuses(tracker, Accounts(['main']))[0]
    assert belief.level == OK
    assert float(belief.values['mass']) == pytest.approx(estimate.belief.mass, abs=1e-9)
    for i, name in enumerate('xy'):
        assert float(belief.values[f'standard deviation of {name}']) == pytest.approx(
            np.sqrt(estimate.belief.covariance()[i, i]), rel=1e-5)
    assert float(belief.values['log evidence of the newest measurement']) == pytest.approx(
        estimate.log_evidence, rel=1e-3)


def test_tells_what_active_cells_there_are_and_what_was_dropped():
    tracker = tracker_of(ActiveGridFilter(MODEL, GRID, SENSORS, 0.1))
    for k in range(3):
        tracker.observe(Measurement(k * 100_000_000, 'main', (0.5, 0.5)))
    values = statuses(tracker, Accounts(['main']))[0].values
    newest = tracker.estimate().belief
    values = statuses(tracker, Accounts(['main']))[0].values
    assert float(values['cells']) == pytest.approx(newest.size, rel=1e-2)
    assert values['patches'] == '1'
    assert 0 < float(values['dropped']) <= 1e-5


def test_warns_when_most_of_the_belief_has_left_the_grid():
    filter_ = all_cells()
    tracker = tracker_of(filter_)
    tracker.reset(filter_.gaussian([4.9, 0.0], 0.01 * np.eye(2)), 0)
    tracker.reset(filter_.predict(tracker.newest.belief, 0, 3_000_000_000), 0)
    belief = statuses(tracker, Accounts(['main']))[0]
    assert belief.level == WARN
    assert belief.message.endswith('% of it has left the grid')


@pytest.mark.parametrize('filter_', [all_cells(), ActiveGridFilter(MODEL, GRID, SENSORS, 0.1)],
                         ids=['all cells', 'active cells'])
def test_a_belief_that_has_left_the_grid_altogether_is_told_of_too(filter_):
    tracker = tracker_of(filter_)
    nothing = (dataclasses.replace(filter_.uniform(), patches=())
               if isinstance(filter_, ActiveGridFilter)
               else GridBelief(GRID, np.zeros(GRID.shape)))
    tracker.reset(nothing, 0)
    belief = statuses(tracker, Accounts(['main']))[0]
    assert (belief.level, belief.message) == (WARN, '100% of it has left the grid')
    assert float(belief.values['mass']) == 0


def test_tells_every_account_and_warns_of_what_was_dropped():
    accounts = Accounts(['main'], ['v'])
    account = accounts.sources['main']
    account.received, account.accepted, account.dropped = 10, 6, 1
    account.rejected = Counter({'too late': 3})
    accounts.initial_pose.received = 1
    _, source, control, start = statuses(tracker_of(all_cells()), accounts)
    assert source.level == WARN
    assert source.values == {'received': '10', 'accepted': '6', 'outliers': '0', 'dropped': '1',
                             'rejected, too late': '3'}
    assert (control.name, start.name) == ('control', 'initialpose')
