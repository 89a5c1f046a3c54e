"""Time: which measurement comes when."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import CorrectionFailed, Measurement, Rejection
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.guard import Guard
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.lost import Alarm
from pif_ros.core.models import Sensor
from pif_ros.core.rivals import ExtendedKalmanFilter, GaussianBelief
from pif_ros.core.systems import ornstein_uhlenbeck
from pif_ros.core.tracker import Tracker
import pytest

SECOND = 1_000_000_000
SENSORS = {'place': Sensor(lambda x, t: x, [[0.3]]), 'square': Sensor(lambda x, t: x**2, [[0.5]])}
FILTER = DiracFeynmanFilter(ornstein_uhlenbeck().model, Grid((-3,), (3,), (24,)), SENSORS,
                            KernelSettings(0.05))
PRIOR = GridBelief.gaussian(FILTER.grid, [0.5], [[0.4]])

STAMPS = st.integers(0, 2 * SECOND)
#: A few stamps only, so that many are equal.
TIES = st.sampled_from([0, 40_000_000, 70_000_000, 500_000_000])
MEASUREMENTS = st.lists(
    st.builds(Measurement, STAMPS | TIES, st.sampled_from(['place', 'square']),
              st.tuples(st.floats(-3, 3))), min_size=1, max_size=12, unique=True)


def tracker_of(history=10.0, beliefs=1000, **more):
    """Return a tracker with memory for so many beliefs."""
    return Tracker(FILTER, PRIOR, history, beliefs * PRIOR.nbytes, **more)


def verbs(measurements, filter_=FILTER, belief=PRIOR):
    """Return belief and log evidences by predict and correct alone, in the order of stamps."""
    ordered = sorted(measurements, key=lambda m: (m.stamp_ns, m.source, m.values))
    now, evidences = ordered[0].stamp_ns, []
    for m in ordered:
        belief = filter_.predict(belief, now, m.stamp_ns)
        belief, log_evidence = filter_.correct(belief, m.values, m.source, m.stamp_ns)
        now = m.stamp_ns
        evidences.append(log_evidence)
    return belief, evidences


def assert_same_bits(estimate, belief):
    np.testing.assert_array_equal(estimate.belief.density, belief.density)


@given(MEASUREMENTS, st.randoms(use_true_random=False))
def test_any_order_of_arrival_gives_the_bits_of_the_two_verbs_in_order_of_stamps(
        measurements, random):
    exact, evidences = verbs(measurements)
    random.shuffle(measurements)
    tracker = tracker_of()
    for measurement in measurements:
        assert tracker.observe(measurement) is None
        if random.random() < 0.5:
            tracker.estimate()
    found = tracker.estimate()
    assert_same_bits(found, exact)
    assert found.stamp_ns == max(m.stamp_ns for m in measurements)
    assert found.log_evidence == evidences[-1]
    assert found.total_log_evidence == pytest.approx(sum(evidences), rel=1e-12)


@given(MEASUREMENTS, st.integers(0, SECOND), st.randoms(use_true_random=False))
def test_arrival_late_by_no_more_than_the_history_gives_the_same_bits_while_it_forgets(
        measurements, history, random):
    # who arrives stamp + delay with a delay within the history is never older than the newest
    # stamp less the history
    arrival = {m: m.stamp_ns + random.randint(0, history) for m in measurements}
    tracker = tracker_of(history / SECOND)
    for measurement in sorted(measurements, key=arrival.get):
        assert tracker.observe(measurement) is None
        tracker.estimate()
    assert_same_bits(tracker.estimate(), verbs(measurements)[0])


@given(st.lists(st.tuples(st.sampled_from(['place', 'square']), st.floats(-3, 3)),
                min_size=2, max_size=6, unique=True), st.randoms(use_true_random=False))
def test_equal_stamps_may_come_in_any_order(seen, random):
    first = Measurement(0, 'place', (0.1,))
    found = []
    for _ in range(2):
        tracker = tracker_of()
        tracker.observe(first)
        random.shuffle(seen)
        for source, y in seen:
            tracker.observe(Measurement(123_456_789, source, (y,)))
            tracker.estimate()
        found.append(tracker.estimate())
    assert_same_bits(found[0], found[1].belief)
    assert found[0].total_log_evidence == found[1].total_log_evidence


@given(MEASUREMENTS, st.lists(STAMPS, max_size=10), st.randoms(use_true_random=False))
def test_no_pattern_of_forecasts_changes_a_posterior(measurements, asked, random):
    quiet, watched = tracker_of(), tracker_of()
    for measurement in measurements:
        quiet.observe(measurement)
        watched.observe(measurement)
        for stamp in random.sample(asked, random.randint(0, len(asked))):
            watched.forecast(stamp)
    assert_same_bits(watched.estimate(), quiet.estimate().belief)
    assert watched.estimate().total_log_evidence == quiet.estimate().total_log_evidence


@given(st.lists(st.integers(0, SECOND), min_size=1, max_size=8))
def test_a_forecast_has_the_same_bits_asked_for_in_one_go_or_after_others(asked):
    tracker = tracker_of()
    tracker.observe(Measurement(SECOND, 'place', (0.4,)))
    posterior = tracker.estimate()
    for ahead in asked:
        found = tracker.forecast(SECOND + ahead)
        assert_same_bits(found, FILTER.predict(posterior.belief, SECOND, SECOND + ahead))
        assert found.stamp_ns == SECOND + ahead
        assert found.log_evidence == (0.0 if ahead else posterior.log_evidence)
        assert found.total_log_evidence == posterior.total_log_evidence


def test_a_forecast_takes_no_step_twice():
    class Counting:
        model = FILTER.model
        time_step_ns = FILTER.time_step_ns
        steps = 0

        def predict(self, belief, from_ns, to_ns, controls):
            self.steps += (to_ns - from_ns) // self.time_step_ns
            return FILTER.predict(belief, from_ns, to_ns)

        correct, log_peak = FILTER.correct, FILTER.log_peak

    counting = Counting()
    tracker = Tracker(counting, PRIOR)
    tracker.observe(Measurement(0, 'place', (0.4,)))
    for tick in range(1, 201):
        tracker.forecast(tick * SECOND // 20)
    assert counting.steps == 200


@given(MEASUREMENTS, st.integers(-2**62, 2**62))
def test_only_differences_of_stamps_count_however_large_or_negative_they_are(
        measurements, shift):
    here, there = tracker_of(), tracker_of()
    for m in measurements:
        here.observe(m)
        there.observe(Measurement(m.stamp_ns + shift, m.source, m.values))
    assert_same_bits(there.estimate(), here.estimate().belief)
    assert there.stamp_ns == here.stamp_ns + shift


def bits(tracker):
    estimate = tracker.estimate()
    return estimate.stamp_ns, estimate.belief.density.tobytes(), estimate.total_log_evidence


def test_a_measurement_older_than_the_history_is_refused_and_one_just_within_it_taken():
    tracker = tracker_of(history=0.5)
    for stamp in (0, SECOND, 2 * SECOND):
        tracker.observe(Measurement(stamp, 'place', (0.4,)))
        tracker.estimate()
    before = bits(tracker)
    late = Measurement(2 * SECOND - SECOND // 2 - 1, 'place', (1.0,))
    assert tracker.observe(late) is Rejection.TOO_LATE
    assert bits(tracker) == before
    just = Measurement(2 * SECOND - SECOND // 2, 'place', (1.0,))
    assert tracker.observe(just) is None
    assert tracker.backlog == 2
    exact = verbs([Measurement(t, 'place', (0.4,)) for t in (0, SECOND, 2 * SECOND)] + [just])[0]
    assert_same_bits(tracker.estimate(), exact)


@given(MEASUREMENTS, st.integers(0, 11))
def test_what_was_taken_once_is_refused_when_it_comes_again(measurements, which):
    tracker = tracker_of()
    for measurement in measurements:
        tracker.observe(measurement)
    before = bits(tracker)
    again = measurements[which % len(measurements)]
    copy = Measurement(again.stamp_ns, again.source, tuple(again.values))
    assert tracker.observe(copy) is Rejection.DUPLICATE
    assert bits(tracker) == before


@pytest.mark.parametrize('stamps', [(0, 10, 20, 30), (0, 10, 10, 10), (10, 10, 10, 10)])
@pytest.mark.parametrize('beliefs', [0, 1, 2, 3])
def test_what_was_taken_once_is_refused_when_it_comes_again_beyond_the_memory(stamps, beliefs):
    tracker = tracker_of(beliefs=beliefs)
    measurements = [Measurement(stamp, 'place', (0.1 * k,)) for k, stamp in enumerate(stamps)]
    for measurement in measurements:
        tracker.observe(measurement)
        tracker.estimate()
    before = bits(tracker)
    for measurement in measurements:
        assert tracker.observe(measurement) in (Rejection.DUPLICATE, Rejection.TOO_LATE)
    assert bits(tracker) == before


def test_memory_bounds_what_is_kept_and_changes_no_bit_of_what_comes_in_order():
    rng = np.random.default_rng(4)
    measurements = [Measurement(k * 30_000_000, 'place', (y,))
                    for k, y in enumerate(rng.normal(size=60))]
    tracker = tracker_of(history=100.0, beliefs=5)
    for measurement in measurements:
        tracker.observe(measurement)
        tracker.estimate()
    assert_same_bits(tracker.estimate(), verbs(measurements)[0])
    assert tracker.observe(Measurement(53 * 30_000_000, 'place', (0.0,))) is Rejection.TOO_LATE
    assert tracker.observe(Measurement(58 * 30_000_000, 'place', (0.0,))) is None


def test_the_prior_without_a_stamp_holds_at_the_first_measurement_and_until_then():
    tracker = tracker_of()
    waiting = tracker.forecast(5 * SECOND)
    assert tracker.stamp_ns is None and waiting.stamp_ns is None
    assert_same_bits(waiting, PRIOR)
    tracker.observe(Measurement(7 * SECOND, 'place', (0.4,)))
    exact, log_evidence = FILTER.correct(PRIOR, (0.4,), 'place', 7 * SECOND)
    assert_same_bits(tracker.estimate(), exact)
    assert tracker.estimate().total_log_evidence == log_evidence


def test_a_reset_forgets_all_and_takes_nothing_from_before_its_stamp():
    tracker = tracker_of()
    tracker.observe(Measurement(SECOND, 'place', (0.4,)))
    tracker.forecast(2 * SECOND)
    other = GridBelief.gaussian(FILTER.grid, [-1.0], [[0.1]])
    tracker.reset(other, 5 * SECOND)
    assert_same_bits(tracker.estimate(), other)
    assert tracker.estimate().total_log_evidence == 0
    assert tracker.observe(Measurement(5 * SECOND - 1, 'place', (0.4,))) is Rejection.TOO_LATE
    assert tracker.observe(Measurement(5 * SECOND, 'place', (0.4,))) is None
    assert_same_bits(tracker.estimate(), FILTER.correct(other, (0.4,), 'place', 0)[0])
    assert_same_bits(tracker.forecast(6 * SECOND), FILTER.predict(
        FILTER.correct(other, (0.4,), 'place', 0)[0], 0, SECOND))
    tracker.reset()
    assert tracker.stamp_ns is None
    assert_same_bits(tracker.estimate(), PRIOR)


def test_backlog_counts_the_corrections_that_are_due():
    tracker = tracker_of()
    for stamp in (10, 30, 20):
        tracker.observe(Measurement(stamp, 'place', (0.4,)))
    assert tracker.backlog == 3
    tracker.estimate()
    assert tracker.backlog == 0
    tracker.observe(Measurement(15, 'place', (0.4,)))
    assert tracker.backlog == 3


@given(MEASUREMENTS, st.lists(STAMPS, max_size=5), st.randoms(use_true_random=False))
@settings(max_examples=20)
def test_another_filter_behind_the_same_verbs_is_tracked_to_the_bit_as_well(
        measurements, asked, random):
    ekf = ExtendedKalmanFilter(ornstein_uhlenbeck().model, SENSORS, time_step=0.05)
    prior = GaussianBelief(np.array([0.5]), np.array([[0.4]]))
    exact, _ = verbs(measurements, ekf, prior)
    random.shuffle(measurements)
    tracker = Tracker(ekf, prior, 10.0)
    for measurement in measurements:
        tracker.observe(measurement)
        for stamp in asked:
            tracker.forecast(stamp)
    found = tracker.estimate().belief
    np.testing.assert_array_equal(found.mean(), exact.mean())
    np.testing.assert_array_equal(found.covariance(), exact.covariance())


@pytest.mark.parametrize('fields, name', [
    ({'history': -1.0}, 'history'), ({'history': float('nan')}, 'history'),
    ({'history': float('inf')}, 'history'), ({'memory': -1}, 'memory')])
def test_refuses_a_memory_that_is_none(fields, name):
    with pytest.raises(ValueError, match=f'^{name}: expected .*, got .*$'):
        Tracker(FILTER, PRIOR, **fields)


def test_a_measurement_at_which_a_sensor_raises_is_named_and_forgotten():
    def h(x, t):
        if t > 0.025:
            raise ArithmeticError('no such time')
        return x

    sensor = Sensor(h, [[1.0]], time_dependent=True)
    filter_ = DiracFeynmanFilter(FILTER.model, FILTER.grid, {'place': FILTER.sensors['place'],
                                                             'moody': sensor}, FILTER.kernel)
    tracker = Tracker(filter_, PRIOR, 10.0)
    good = [Measurement(10_000_000 * k, 'place', (0.1 * k,)) for k in range(1, 6)]
    for measurement in [*good, Measurement(30_000_000, 'moody', (0.5,))]:
        tracker.observe(measurement)
    with pytest.raises(CorrectionFailed, match='moody') as error:
        tracker.estimate()
    assert error.value.measurement.source == 'moody'
    assert isinstance(error.value.__cause__, ArithmeticError)
    # all the others are as if it had never come
    assert_same_bits(tracker.estimate(), verbs(good, filter_)[0])


def test_memory_bounds_what_is_kept_while_there_is_a_backlog_too():
    tracker = tracker_of(history=100.0, beliefs=5)
    measurements = [Measurement(k * 10_000_000, 'place', (0.1,)) for k in range(40)]
    for measurement in measurements:
        tracker.observe(measurement)
    found = tracker.estimate(at_most=30)
    assert tracker.backlog == 10
    assert_same_bits(found, verbs(measurements[:30])[0])
    assert [made.measurement for made in tracker.corrections] == measurements[:30]
    # what is beyond the memory was let go of as soon as it was worked in
    assert tracker.observe(Measurement(200_000_001, 'place', (0.0,))) is Rejection.TOO_LATE
    assert_same_bits(tracker.estimate(), verbs(measurements)[0])


def test_a_clock_is_set_also_where_the_watch_over_the_newest_raises(monkeypatch):
    guard = Guard(alarm=Alarm(1e-5))
    tracker = tracker_of(guard=guard)
    for k in range(3):
        tracker.observe(Measurement(100 * SECOND + k, 'place', (0.1 * k,)))
    belief = tracker.estimate(look=False).belief
    watched = Guard.watched

    def broken(self, filter_, predicted, y, *more):
        if y == (0.1,):
            raise ArithmeticError('such a sensor')
        return watched(self, filter_, predicted, y, *more)

    monkeypatch.setattr(Guard, 'watched', broken)
    with pytest.raises(ArithmeticError, match='such a sensor'):
        tracker.set_clock(-50 * SECOND, belief)
    assert tracker.stamp_ns == 50 * SECOND + 2 and tracker.newest.belief is belief
    assert tracker.observe(Measurement(51 * SECOND, 'place', (0.1,))) is None
