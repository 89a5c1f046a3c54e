"""Time: what begins anew after a gap, whatever the order of arrival."""

import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core import steering
from pif_ros.core.bank import Bank, Member
from pif_ros.core.continuous import ExtendedKalmanBucyFilter
from pif_ros.core.controls import Controls
from pif_ros.core.estimates import Measurement, Rejection
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.guard import Guard
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.lost import Alarm
from pif_ros.core.models import Sensor
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.saved import arrays_of, forms_of, memory_from
from pif_ros.core.systems import ornstein_uhlenbeck, unicycle_2d
from pif_ros.core.tracker import Tracker
import pytest

SECOND = 1_000_000_000
SYSTEM = unicycle_2d()
FILTER = ExtendedKalmanFilter(SYSTEM.model, {'place': SYSTEM.sensors['position'](0.3)}, 0.05)
PRIOR = FILTER.gaussian([0.0, 0.0, 0.3], 0.2 * np.eye(3))
LINE = DiracFeynmanFilter(ornstein_uhlenbeck().model, Grid((-3,), (3,), (24,)),
                          {'place': Sensor(lambda x, t: x, [[0.3]])}, KernelSettings(0.05))
HOLD = 0.7
STAMPS = st.integers(0, 4 * SECOND)
MEASUREMENTS = st.lists(st.builds(Measurement, STAMPS, st.just('place'), st.tuples(
    st.floats(-2, 2), st.floats(-2, 2))), min_size=1, max_size=6, unique=True)
CONTROLS = st.dictionaries(STAMPS, st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=6)


def give(tracker, item):
    """Give a tracker a measurement, or a control as (stamp, values)."""
    return tracker.observe(item) if isinstance(item, Measurement) else tracker.control(*item)


def stamp_of(item):
    return item.stamp_ns if isinstance(item, Measurement) else item[0]


def place(seconds, x=0.1, y=0.2):
    return Measurement(round(seconds * SECOND), 'place', (x, y))


def verbs(measurements, controls, max_gap):
    """Return belief and total log evidence by the two verbs, with the prior after each gap."""
    known = Controls(*(zip(*sorted(controls.items())) if controls else ((), ())),
                     round(HOLD * SECOND))
    now, belief, total = -math.inf, PRIOR, 0.0
    for m in sorted(measurements):
        if m.stamp_ns - now > max_gap * SECOND:
            belief, total = PRIOR, 0.0
        else:
            belief = FILTER.predict(belief, now, m.stamp_ns, known)
        belief, log_evidence = FILTER.correct(belief, m.values, m.source, m.stamp_ns)
        now, total = m.stamp_ns, total + log_evidence
    return belief, total


def assert_same(estimate, belief, total):
    np.testing.assert_array_equal(estimate.belief.mean(), belief.mean())
    np.testing.assert_array_equal(estimate.belief.covariance(), belief.covariance())
    assert estimate.total_log_evidence == total


@given(MEASUREMENTS, CONTROLS, st.integers(0, SECOND), st.sampled_from([0.2, 0.8, 1.5]),
       st.randoms(use_true_random=False))
@settings(max_examples=40)
def test_after_a_gap_the_prior_holds_in_whatever_order_the_measurements_come(
        measurements, controls, history, max_gap, random):
    items, first = [*measurements, *controls.items()], min(measurements)
    arrival = {item: stamp_of(item) + random.randint(0, history) for item in items}
    tracker = Tracker(FILTER, PRIOR, history / SECOND, hold=HOLD, max_gap=max_gap)
    tracker.observe(first)
    for item in sorted((i for i in items if i is not first), key=arrival.get):
        rejected = give(tracker, item)
        assert rejected is None or stamp_of(item) <= first.stamp_ns - HOLD * SECOND
        if random.random() < 0.5:
            tracker.estimate()
    assert_same(tracker.estimate(), *verbs(measurements, controls, max_gap))


def test_a_late_measurement_that_bridges_a_gap_brings_back_what_was_known_before_it():
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD, max_gap=10.0)
    seen = [place(0), place(10.5), place(9.8)]
    found = []
    for measurement in seen:
        tracker.observe(measurement)
        tracker.estimate()
        found.append([made.gap_ns for made in tracker.corrections])
    assert found == [[0], [10 * SECOND + SECOND // 2], [0, 0]]
    assert_same(tracker.estimate(), *verbs(seen, {}, 10.0))


@pytest.mark.parametrize('at_once', [False, True])
def test_who_drove_before_a_gap_ended_is_known_to_a_late_measurement_there(at_once):
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=1.0, max_gap=10.0)
    driven = {round(19.1 * SECOND): (3.0, 0.0)}
    seen = [place(0), place(20.5), place(20.0)]
    for item in (seen[0], *driven.items(), *seen[1:]):
        assert give(tracker, item) is None
        if at_once:
            tracker.estimate()
    # from the prior at 20 s it is driven on for a tenth of a second
    moved = FILTER.predict(FILTER.correct(PRIOR, (0.1, 0.2), 'place', 0)[0], seen[2].stamp_ns,
                           seen[1].stamp_ns, Controls(*zip(*driven.items()), SECOND))
    wanted, _ = FILTER.correct(moved, (0.1, 0.2), 'place', 0)
    np.testing.assert_array_equal(tracker.estimate().belief.mean(), wanted.mean())
    # and as after any start, what came before the history, and held then, is late and not too late
    assert tracker.control(round(18.6 * SECOND), (1.0, 0.0)) is None
    assert tracker.control(round(18.4 * SECOND), (1.0, 0.0)) is Rejection.TOO_LATE


def test_after_a_gap_the_controls_before_it_are_forgotten():
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=1.0, max_gap=10.0)
    tracker.observe(place(0))
    for k in range(200):
        tracker.control(k * SECOND // 10, (0.1, 0.0))
    tracker.observe(place(20))
    tracker.estimate()
    assert [stamp for stamp, _ in tracker.memory().controls] == [
        k * SECOND // 10 for k in range(190, 200)]


def test_the_watch_over_being_lost_begins_anew_after_a_gap_also_where_it_comes_later():
    prior = LINE.gaussian([0.5], [[0.4]])
    trackers = [Tracker(LINE, prior, 100.0, guard=Guard(alarm=Alarm()), max_gap=10.0)
                for _ in range(2)]
    for measurement in [Measurement(t * SECOND, 'place', (2.9,)) for t in (0, 1, 30)]:
        for tracker, look in zip(trackers, (True, False)):
            tracker.observe(measurement)
            tracker.estimate(look=look)
    trackers[1].look()
    alone = Tracker(LINE, prior, guard=Guard(alarm=Alarm()))
    alone.observe(Measurement(30 * SECOND, 'place', (2.9,)))
    assert alone.estimate().watch.score > 0
    for tracker in trackers:
        assert tracker.newest.watch == alone.newest.watch


def test_a_bank_does_not_predict_through_a_gap(products):
    priors = {'alpha': LINE.gaussian([0.5], [[0.4]]), 'bravo': LINE.gaussian([-0.5], [[0.4]])}
    bank = Bank({name: Member(LINE, prior, max_gap=10.0) for name, prior in priors.items()})
    for stamp_ns in (0, 20 * SECOND):
        for name in priors:
            bank.observe(name, Measurement(stamp_ns, 'place', (0.1,)))
    found = bank.estimates()
    assert products == []
    for name, prior in priors.items():
        np.testing.assert_array_equal(found[name].belief.density,
                                      LINE.correct(prior, (0.1,), 'place', 0)[0].density)


@pytest.mark.parametrize('max_gap', [-1.0, float('nan')])
def test_refuses_a_gap_that_is_no_time(max_gap):
    with pytest.raises(ValueError, match='^max_gap: expected seconds, 0 or more, got'):
        Tracker(FILTER, PRIOR, max_gap=max_gap)


@pytest.mark.parametrize('pose_comes', range(4, -1, -1))
@pytest.mark.parametrize('at_once', [False, True])
def test_a_new_start_keeps_what_was_measured_since_whichever_comes_first(pose_comes, at_once):
    pose_ns, known = SECOND // 2, {0: (1.0, 0.4), 6 * SECOND // 10: (0.5, -0.4)}
    pose = FILTER.gaussian([1.0, 1.0, 0.3], 0.1 * np.eye(3))
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD)
    items = [place(0), *known.items(), place(0.4), place(0.5, 1.1, 0.9), place(0.8, 1.3, 1.1)]
    for k, item in enumerate(items):
        give(tracker, item)
        if at_once:
            tracker.estimate()
        if k == pose_comes + 1:
            tracker.reset(pose, pose_ns, pose_ns)
    controls = Controls(*zip(*sorted(known.items())), round(HOLD * SECOND))
    wanted, first = FILTER.correct(pose, (1.1, 0.9), 'place', 0)
    wanted = FILTER.predict(wanted, pose_ns, 8 * SECOND // 10, controls)
    wanted, second = FILTER.correct(wanted, (1.3, 1.1), 'place', 0)
    assert_same(tracker.estimate(), wanted, first + second)


def test_a_new_start_from_before_the_history_or_of_which_nothing_is_known_keeps_nothing():
    for stamp_ns, steered_ns in ((SECOND, SECOND), (None, 5 * SECOND), (5 * SECOND, None)):
        tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD)
        for second in range(6):
            tracker.observe(place(second))
        tracker.reset(PRIOR, stamp_ns, steered_ns)
        assert tracker.backlog == 0


def test_a_new_start_just_at_the_end_of_the_history_keeps_what_was_measured_since():
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD)
    for second in range(6):
        tracker.observe(place(second))
    tracker.reset(PRIOR, 4 * SECOND, 4 * SECOND)
    assert tracker.backlog == 2


def test_what_drove_while_the_first_measurement_was_on_its_way_counts():
    driven = {k * SECOND // 10: (1.0, 0.01 * k) for k in range(31)}
    seen = [place(0), place(1)]
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD)
    for item in (*driven.items(), *seen):
        assert give(tracker, item) is None
    assert_same(tracker.estimate(), *verbs(seen, driven, 10.0))


def test_of_more_controls_than_are_kept_before_the_first_measurement_the_oldest_go(monkeypatch):
    monkeypatch.setattr(steering, 'MOST_CONTROLS', 3)
    tracker = Tracker(FILTER, PRIOR, 1.0, hold=HOLD)
    for k in range(9):
        assert tracker.control(k * SECOND, (1.0, 0.0)) is None
    assert [stamp // SECOND for stamp, _ in tracker.memory().controls] == [7, 8]


@pytest.mark.parametrize(('tenths', 'driven'), [(3, False), (7, False), (9, True)])
def test_of_a_start_before_all_that_is_kept_no_control_is_known_however_long_the_history(
        tenths, driven):
    # memory for the newest belief alone: the one at 0.8 s is what all else starts from
    tracker = Tracker(FILTER, PRIOR, 10.0, memory=0, hold=0.1)
    controls = {k * SECOND // 10: (1.0, 0.2) for k in range(10)}
    for stamp_ns, u in controls.items():
        tracker.control(stamp_ns, u)
        tracker.observe(place(stamp_ns / SECOND))
        tracker.estimate()
    start_ns = tenths * SECOND // 10
    tracker.reset(PRIOR, start_ns + 1, start_ns + 1)
    known = Controls(*zip(*sorted(controls.items())), SECOND // 10) if driven else Controls()
    wanted = FILTER.predict(PRIOR, start_ns + 1, SECOND, known)
    np.testing.assert_array_equal(tracker.forecast(SECOND).belief.mean(), wanted.mean())


def test_a_path_that_began_before_rejected_points_knows_what_drove_it_since():
    path = ExtendedKalmanBucyFilter(SYSTEM.model, FILTER.sensors, 0.05)
    prior = path.gaussian([0.0, 0.0, 0.3], 0.2 * np.eye(3))
    controls = {-SECOND // 10: (1.0, 0.0), 3 * SECOND // 10: (0.0, 0.0)}
    # no state allows these: the increment to the last point begins at the first
    points = [place(0), place(1, 1e200), place(2, 1e200), place(3, 0.4)]
    tracker = Tracker(path, prior, 0.5, hold=10.0)
    for item in (*controls.items(), *points):
        give(tracker, item)
        tracker.estimate()
    known, belief, now = Controls(*zip(*controls.items()), 10 * SECOND), prior, 0
    for point in (points[0], points[3]):
        belief = path.predict(belief, now, point.stamp_ns, known)
        belief, log_evidence = path.correct(belief, point.values, 'place', point.stamp_ns)
        now = point.stamp_ns
    np.testing.assert_allclose(tracker.estimate().belief.mean(), belief.mean(), rtol=1e-9)
    assert tracker.estimate().log_evidence == pytest.approx(log_evidence, rel=1e-9)


def test_what_a_watch_raises_keeps_nobody_from_remembering_and_is_raised_by_the_next_look(
        monkeypatch):
    tracker = Tracker(LINE, LINE.gaussian([0.5], [[0.4]]), guard=Guard(alarm=Alarm()))
    tracker.observe(Measurement(0, 'place', (0.1,)))
    known = tracker.estimate().watch
    tracker.observe(Measurement(SECOND, 'place', (0.2,)))
    believed = tracker.estimate(look=False)
    monkeypatch.setattr(DiracFeynmanFilter, 'predictive', raising)
    memory = tracker.memory()
    assert memory.stamp_ns == SECOND and tracker.newest.belief is believed.belief
    assert tracker.newest.watch == known
    monkeypatch.undo()
    with pytest.raises(ArithmeticError, match='such a sensor'):
        tracker.look()
    tracker.look()
    assert tracker.memory() == memory


def raising(*_):
    raise ArithmeticError('such a sensor')


def test_a_measurement_of_many_numbers_is_remembered_as_any_other():
    wide = LINE.with_sensors({'place': Sensor(lambda x, t: np.repeat(x[:1], 72, 0), np.eye(72))})
    first, other = (Tracker(wide, wide.gaussian([0.5], [[0.4]]), 1.0) for _ in range(2))
    for second in (0, 5, 10):
        first.observe(Measurement(second * SECOND, 'place', (0.5 + second,) * 72))
        first.estimate()
    arrays = arrays_of(first)
    forms, _ = forms_of(other)
    assert all(forms[name].allows(array.dtype, array.shape) for name, array in arrays.items())
    other.recall(memory_from(other, arrays))
    np.testing.assert_array_equal(other.estimate().belief.density, first.newest.belief.density)


@pytest.mark.parametrize(('room', 'kept'), [(0, 1), (1, 1), (2.5, 2), (3, 3), (5, 5), (9, 6)])
def test_as_many_beliefs_are_kept_as_there_is_memory_for_and_the_newest(room, kept):
    tracker = Tracker(FILTER, PRIOR, 10.0, memory=room * PRIOR.nbytes)
    for second in range(6):
        tracker.observe(place(second))
        tracker.estimate()
    assert tracker.kept == kept
    # who is kept is corrected anew by what comes late, and nobody else is
    for late in range(5):
        rejected = tracker.observe(place(late + 0.5))
        assert (rejected is None) is (late + 0.5 > 5 - kept)


def test_a_measurement_that_nothing_allows_counts_for_no_evidence():
    total = []
    for seconds in ((0, 1, 2), (0, 2)):
        tracker = Tracker(LINE, LINE.gaussian([0.5], [[0.4]]), 10.0)
        for second in seconds:
            # of which the square is infinite
            y = 1e200 if second == 1 else 0.3
            tracker.observe(Measurement(second * SECOND, 'place', (y,)))
        total.append(tracker.estimate().total_log_evidence)
    assert total[0] == pytest.approx(total[1]) and math.isfinite(total[0])


@pytest.mark.parametrize('nothing', ['history', 'memory', 'hold', 'max_gap'])
def test_of_all_that_a_tracker_is_given_there_may_be_none(nothing):
    tracker = Tracker(FILTER, PRIOR, **{nothing: 0})
    tracker.observe(place(1))
    assert tracker.estimate().stamp_ns == SECOND


def test_there_is_one_zero_of_controls_whichever_comes_first():
    for first, second in ((0.0, -0.0), (-0.0, 0.0)):
        tracker = Tracker(FILTER, PRIOR)
        assert tracker.control(SECOND, (first, 1.0)) is None
        assert tracker.control(SECOND, (second, 1.0)) is Rejection.DUPLICATE
        [(_, (value, _))] = tracker.memory().controls
        assert math.copysign(1.0, value) == 1.0
