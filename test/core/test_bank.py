"""Trackers of many targets on one kernel: each is what it would be alone, to the bit."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.bank import Bank, Member
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.systems import ornstein_uhlenbeck
from pif_ros.core.tracker import Tracker
import pytest

SECOND = 1_000_000_000
SEEDS = st.integers(0, 2**32 - 1)


def assert_same_bits(found, wanted):
    np.testing.assert_array_equal(found.density.view(np.int64), wanted.density.view(np.int64))


LINE = Grid((-3,), (3,), (24,))
SENSORS = {'place': Sensor(lambda x, t: x, [[0.3]]), 'square': Sensor(lambda x, t: x**2, [[0.5]])}
FILTER = DiracFeynmanFilter(ornstein_uhlenbeck().model, LINE, SENSORS, KernelSettings(0.05))
NAMES = ('alpha', 'bravo', 'charlie')
PRIORS = {name: GridBelief.gaussian(LINE, [mean], [[0.4]])
          for name, mean in zip(NAMES, (0.5, -1.0, 0.0))}
#: What arrives, in order: who is measured, and what; a stamp that all may share, or any.
ARRIVALS = st.lists(st.tuples(
    st.sampled_from(NAMES),
    st.builds(Measurement, st.integers(0, 2 * SECOND) | st.sampled_from(
        range(0, 2 * SECOND, SECOND // 5)), st.sampled_from(['place', 'square']),
        st.tuples(st.floats(-3, 3)))), min_size=1, max_size=20)


def bank(filter_=FILTER, history=0.7):
    return Bank({name: Member(filter_, prior, history) for name, prior in PRIORS.items()})


@given(ARRIVALS, SEEDS)
def test_each_target_is_what_it_is_alone_whoever_else_is_in_the_bank(arrivals, seed):
    rng, together = np.random.default_rng(seed), bank()
    alone = {name: Tracker(FILTER, prior, 0.7) for name, prior in PRIORS.items()}
    for name, measurement in arrivals:
        assert together.observe(name, measurement) == alone[name].observe(measurement)
        if rng.random() < 0.4:
            later = int(rng.choice([2_000_000_000, 2_123_456_789, measurement.stamp_ns]))
            for target, forecast in together.forecasts(later).items():
                exact = alone[target].forecast(later)
                assert forecast.stamp_ns == exact.stamp_ns
                assert_same_bits(forecast.belief, exact.belief)
    for target, estimate in together.estimates().items():
        exact = alone[target].estimate()
        assert_same_bits(estimate.belief, exact.belief)
        assert (estimate.stamp_ns, estimate.log_evidence, estimate.total_log_evidence) == (
            exact.stamp_ns, exact.log_evidence, exact.total_log_evidence)


def refuse(*args):
    raise AssertionError('predicted alone')


def test_one_frame_of_a_camera_is_one_prediction_for_all(products, monkeypatch):
    together = bank()
    for name in NAMES:
        together.observe(name, Measurement(0, 'place', (0.1,)))
    together.estimates()
    monkeypatch.setattr(DiracFeynmanFilter, 'predict', lambda self, belief, from_ns, to_ns, _: (
        belief if from_ns == to_ns else refuse()))
    for name in NAMES:
        together.observe(name, Measurement(170_000_000, 'place', (0.2,)))
    together.estimates()
    assert products == [3] * 4
    products.clear()
    together.forecasts(270_000_000)
    # three whole steps are more by one than the 0.1 s of them that were taken, and the rest
    together.forecasts(335_000_000)
    assert products == [3] * 2 + [3] + [3]


def test_a_backlog_of_many_frames_is_worked_off_frame_by_frame(products):
    together = bank()
    for frame in range(5):
        for name in NAMES:
            together.observe(name, Measurement(frame * SECOND // 10, 'place', (0.1 * frame,)))
    together.estimates()
    assert products == [3] * 8


def test_what_was_foreseen_is_not_believed_when_a_late_measurement_comes_between():
    together, alone = bank(), Tracker(FILTER, PRIORS['bravo'], 0.7)
    for tracker in (together.trackers['bravo'], alone):
        tracker.observe(Measurement(0, 'place', (0.0,)))
        tracker.observe(Measurement(SECOND // 2, 'place', (0.4,)))
        tracker.estimate()
    together.observe('alpha', Measurement(0, 'place', (0.3,)))
    together.forecasts(SECOND)
    late = Measurement(SECOND // 4, 'square', (2.0,))
    assert together.observe('bravo', late) is alone.observe(late) is None
    assert_same_bits(together.forecasts(SECOND)['bravo'].belief, alone.forecast(SECOND).belief)
    together.trackers['bravo'].reset()
    assert together.forecasts(SECOND)['bravo'].belief is PRIORS['bravo']


def test_targets_with_sensors_of_their_own_share_the_kernel(products):
    noisy = FILTER.with_sensors({'place': Sensor(lambda x, t: x, [[3.0]])})
    own = DiracFeynmanFilter(FILTER.model, LINE, noisy.sensors, FILTER.kernel)
    assert noisy.kernel_at(0) is FILTER.kernel_at(0) is not own.kernel_at(0)
    together = Bank({'alpha': Member(FILTER, PRIORS['alpha']),
                     'bravo': Member(noisy, PRIORS['alpha'])})
    exact = {'alpha': Tracker(FILTER, PRIORS['alpha']), 'bravo': Tracker(own, PRIORS['alpha'])}
    for stamp_ns in (0, 300_000_000):
        for name in exact:
            together.observe(name, Measurement(stamp_ns, 'place', (0.9,)))
            exact[name].observe(Measurement(stamp_ns, 'place', (0.9,)))
    found = together.estimates()
    for name, tracker in exact.items():
        assert_same_bits(found[name].belief, tracker.estimate().belief)
    assert products == [2] * 6
    assert found['alpha'].belief.covariance() < found['bravo'].belief.covariance()


def test_filters_with_kernels_of_their_own_are_no_bank():
    own = DiracFeynmanFilter(FILTER.model, LINE, SENSORS, FILTER.kernel)
    with pytest.raises(ValueError, match='^trackers: expected filters with one kernel'):
        Bank({'alpha': Member(FILTER, PRIORS['alpha']), 'bravo': Member(own, PRIORS['alpha'])})


def test_filters_without_a_kernel_are_a_bank_in_which_each_predicts_for_itself():
    filter_ = ExtendedKalmanFilter(FILTER.model, SENSORS, 0.05, LINE)
    prior = filter_.gaussian([0.5], [[0.4]])
    together, alone = Bank({'alpha': Member(filter_, prior)}), Tracker(filter_, prior)
    for stamp_ns in (0, 300_000_000):
        together.observe('alpha', Measurement(stamp_ns, 'place', (0.9,)))
        alone.observe(Measurement(stamp_ns, 'place', (0.9,)))
    found, exact = together.forecasts(SECOND)['alpha'].belief, alone.forecast(SECOND).belief
    assert (found.mean(), found.covariance()) == (exact.mean(), exact.covariance())
