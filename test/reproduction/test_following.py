"""Filters follow records through the tracker, and are scored by what they believed."""

import dataclasses

import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.rivals import GaussianBelief
from pif_ros.core.systems import ornstein_uhlenbeck
from pif_ros.reproduction.contenders import gaussian, Problem
from pif_ros.reproduction.filtering import error_scores, FilteringCase
from pif_ros.reproduction.records import recorded
from pif_ros.reproduction.tracks import follow, moments, Reading, sizes
import pytest

SYSTEM = ornstein_uhlenbeck()
SENSORS = {'position': SYSTEM.sensors['position']()}
PROBLEM = Problem(SYSTEM.model, SENSORS, gaussian([0.0], [[1.0]]))
GRID = Grid((-5.0,), (5.0,), (200,))
KERNEL = KernelSettings(0.05)
GRID_FILTER = PROBLEM.grid('grid', 'best', GRID, KERNEL)
KALMAN = PROBLEM.extended(0.05)


def record(steps: int = 40):
    return recorded(SYSTEM.model, SENSORS['position'], 'position', np.array([1.0]),
                    0.1 * np.arange(steps + 1), np.random.default_rng(5), 4)


def track(contender, **more):
    filter_, prior = contender.start(0)
    return follow(filter_, prior, record(), moments, {}, **more)


def test_grid_and_kalman_agree_where_both_are_exact():
    grid, kalman = track(GRID_FILTER), track(KALMAN)
    # two steps of second order per measurement: a tenth of what the first order would leave
    assert np.abs(grid.means - kalman.means).max() < 1e-3
    assert np.abs(grid.variances - kalman.variances).max() < 1e-3
    assert grid.log_evidence == pytest.approx(kalman.log_evidence, abs=1e-2)
    assert np.all(grid.masses > 0.999) and np.all(grid.seconds > 0)


def test_only_some_are_read_where_only_some_are_wanted():
    whole, some = track(GRID_FILTER), track(GRID_FILTER, every=10)
    assert some.chosen.tolist() == [9, 19, 29, 39]
    assert np.array_equal(some.means, whole.means[some.chosen])
    filter_, prior = GRID_FILTER.start(0)
    read = follow(filter_, prior, record(), moments, {
        'mass': Reading(lambda belief: belief.mass, 20)}).read['mass']
    assert read.shape == (2,)


@dataclasses.dataclass(frozen=True, eq=False)
class Breaking:
    """A filter that raises at its third correction."""

    error: Exception
    time_step_ns = 100_000_000
    sensors = SENSORS
    model = SYSTEM.model

    def predict(self, belief, from_ns, to_ns, controls):
        return belief

    def correct(self, belief, y, sensor, at_ns):
        if at_ns == 300_000_000:
            raise self.error
        return belief, 0.0

    def log_peak(self, belief, sensor, at_ns):
        return 0.0


PRIOR = GaussianBelief(np.zeros(1), np.eye(1))


def test_a_filter_that_breaks_down_is_lost_and_a_mistake_is_raised():
    lost = follow(Breaking(np.linalg.LinAlgError('singular')), PRIOR, record(), moments, {})
    assert lost.fault == 'singular'
    assert np.isfinite(lost.means[:, 0]).sum() == 2
    assert np.isnan(error_scores(record().truth, lost.means, lost.variances)['coverage_1'])
    with pytest.raises(Exception, match='no correction by') as raised:
        follow(Breaking(KeyError('typo')), PRIOR, record(), moments, {})
    assert isinstance(raised.value.__cause__, KeyError)


def test_scores_are_what_they_are_called():
    truth = np.array([[0.0, 0.0], [1.0, 1.0]])
    means = np.array([[0.0, 2.0], [1.5, 1.0]])
    scores = error_scores(truth, means, np.ones((2, 2)))
    assert scores['rmse'] == pytest.approx(np.sqrt((4.0 + 0.25) / 4))
    # errors of 0, 2, 0.5 and 0 in deviations; 2 itself is outside
    assert (scores['coverage_1'], scores['coverage_2']) == (0.75, 0.75)


def test_sizes_are_those_of_the_states():
    filter_, _ = KALMAN.start(0)
    belief = filter_.gaussian([0.3], [[0.49]])
    mean, variance = sizes(Grid((-6.0,), (6.0,), (2400,))).moments(belief)
    drawn = np.abs(np.random.default_rng(0).normal(0.3, 0.7, 400_000))
    # three standard errors of 400,000 draws
    assert mean[0] == pytest.approx(drawn.mean(), abs=3e-3)
    assert variance[0] == pytest.approx(drawn.var(), abs=3e-3)


def test_a_case_scores_all_on_the_same_record_and_against_the_best():
    case = FilteringCase('ou', '', '', lambda rng: record(), (GRID_FILTER, dataclasses.replace(
        KALMAN, entry=dataclasses.replace(KALMAN.entry, role='optimum'))))
    scores = case.run(0, False).scores
    assert scores['grid']['to_best'] == 0.0 == scores['EKF']['to_optimum']
    assert scores['grid']['to_optimum'] == scores['EKF']['to_best'] < 1e-3
    assert scores['grid']['rmse'] == pytest.approx(scores['EKF']['rmse'], abs=1e-3)
