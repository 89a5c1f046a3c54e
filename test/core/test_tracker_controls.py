"""Time: which control comes when, and what it does to what was measured."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core import steering
from pif_ros.core.controls import Controls
from pif_ros.core.estimates import Measurement, Rejection
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.systems import ornstein_uhlenbeck, unicycle_2d
from pif_ros.core.tracker import Tracker
import pytest

SECOND = 1_000_000_000
SYSTEM = unicycle_2d()
SENSORS = {'place': SYSTEM.sensors['position'](0.3), 'far': SYSTEM.sensors['range']((4, 1), 0.2)}
FILTER = ExtendedKalmanFilter(SYSTEM.model, SENSORS, 0.05)
PRIOR = FILTER.gaussian([0.0, 0.0, 0.3], 0.2 * np.eye(3))

STAMPS = st.integers(0, 2 * SECOND) | st.sampled_from([0, 70_000_000, 500_000_000])
PLACES = st.builds(Measurement, STAMPS, st.just('place'),
                   st.tuples(st.floats(-2, 2), st.floats(-2, 2)))
RANGES = st.builds(Measurement, STAMPS, st.just('far'), st.tuples(st.floats(0, 5)))
MEASUREMENTS = st.lists(PLACES | RANGES, min_size=1, max_size=8, unique=True)
#: By stamp, which makes each appear once.
CONTROLS = st.dictionaries(STAMPS, st.tuples(st.floats(-1, 1), st.floats(-1, 1)), max_size=8)
HOLD = 0.7


def tracker_of(history=10.0, filter_=FILTER, **more):
    return Tracker(filter_, PRIOR, history, hold=HOLD, **more)


def verbs(measurements, controls, belief=PRIOR):
    """Return the belief by predict and correct alone, with all controls known beforehand."""
    known = Controls(*(zip(*sorted(controls.items())) if controls else ((), ())),
                     round(HOLD * SECOND))
    ordered = sorted(measurements)
    now = ordered[0].stamp_ns
    for m in ordered:
        belief = FILTER.predict(belief, now, m.stamp_ns, known)
        belief, _ = FILTER.correct(belief, m.values, m.source, m.stamp_ns)
        now = m.stamp_ns
    return belief


def give(tracker, item):
    """Give a tracker a measurement, or a control as (stamp, values)."""
    return tracker.observe(item) if isinstance(item, Measurement) else tracker.control(*item)


def stamp_of(item):
    return item.stamp_ns if isinstance(item, Measurement) else item[0]


def assert_same_bits(estimate, belief):
    np.testing.assert_array_equal(estimate.belief.mean(), belief.mean())
    np.testing.assert_array_equal(estimate.belief.covariance(), belief.covariance())


@given(MEASUREMENTS, CONTROLS, st.randoms(use_true_random=False))
def test_any_order_of_arrival_gives_the_bits_of_the_two_verbs(measurements, controls, random):
    items = [*measurements, *controls.items()]
    random.shuffle(items)
    tracker = tracker_of()
    for item in items:
        assert give(tracker, item) is None
        if random.random() < 0.5:
            tracker.estimate()
        if random.random() < 0.5:
            tracker.forecast(random.randint(0, 3 * SECOND))
    assert_same_bits(tracker.estimate(), verbs(measurements, controls))


@given(MEASUREMENTS, CONTROLS, st.integers(0, SECOND), st.randoms(use_true_random=False))
@settings(max_examples=200)
def test_arrival_late_by_no_more_than_the_history_gives_the_same_bits_while_it_forgets(
        measurements, controls, history, random):
    items = [*measurements, *controls.items()]

    # the prior holds at the first measurement, which the others are late against
    first = min(measurements)
    arrival = {item: stamp_of(item) + random.randint(0, history) for item in items}
    tracker = tracker_of(history / SECOND)
    tracker.observe(first)
    for item in sorted((i for i in items if i is not first), key=arrival.get):
        rejected = give(tracker, item)
        # what is from before the prior, and holds no more at it, does not count either way
        assert rejected is None or stamp_of(item) <= first.stamp_ns - HOLD * SECOND
        tracker.estimate()
    assert_same_bits(tracker.estimate(), verbs(measurements, controls))


@given(CONTROLS, st.lists(st.integers(0, 3 * SECOND), min_size=1, max_size=5),
       st.randoms(use_true_random=False))
def test_a_forecast_sees_every_control_that_came_whatever_was_asked_before(
        controls, asked, random):
    tracker, come = tracker_of(), {}
    tracker.observe(Measurement(0, 'place', (0.1, 0.2)))
    posterior = tracker.estimate().belief
    for stamp, value in random.sample(sorted(controls.items()), len(controls)):
        come[stamp] = value
        tracker.control(stamp, value)
        for ahead in asked:
            known = Controls(*zip(*sorted(come.items())), round(HOLD * SECOND))
            assert_same_bits(tracker.forecast(ahead), FILTER.predict(posterior, 0, ahead, known))


def test_a_control_after_the_steps_of_a_forecast_lets_them_be():
    class Counting(ExtendedKalmanFilter):
        steps = 0

        def predict(self, belief, from_ns, to_ns, controls):
            Counting.steps += (to_ns - from_ns) // self.time_step_ns
            return super().predict(belief, from_ns, to_ns, controls)

    tracker = tracker_of(filter_=Counting(SYSTEM.model, SENSORS, 0.05))
    tracker.observe(Measurement(0, 'place', (0.1, 0.2)))
    for tick in range(1, 101):
        tracker.control((tick - 1) * SECOND // 20, (0.01 * tick, 0.1))
        tracker.forecast(tick * SECOND // 20)
    assert Counting.steps == 100


def test_a_control_takes_back_what_was_believed_after_it_and_nothing_else():
    tracker = tracker_of()
    for k in range(5):
        tracker.observe(Measurement(k * SECOND, 'place', (0.1, 0.2)))
    tracker.estimate()
    tracker.control(2 * SECOND, (1.0, 0.0))
    assert tracker.backlog == 2
    tracker.estimate()
    assert tracker.backlog == 0 and len(tracker.corrections) == 2


@pytest.mark.parametrize('order', [1, -1])
def test_of_two_controls_of_a_stamp_the_larger_counts_whichever_comes_first(order):
    small, large = (0.5, 0.9), (0.6, -0.9)
    tracker = tracker_of()
    for stamp in (0, SECOND):
        tracker.observe(Measurement(stamp, 'place', (0.1, 0.2)))
    answers = [tracker.control(0, u) for u in [small, large][::order]]
    assert answers == [None, None if order == 1 else Rejection.DUPLICATE]
    assert_same_bits(tracker.estimate(), verbs(
        [Measurement(stamp, 'place', (0.1, 0.2)) for stamp in (0, SECOND)], {0: large}))


def test_a_control_that_comes_again_is_refused_and_takes_nothing_back():
    tracker = tracker_of()
    for stamp in (0, SECOND):
        tracker.observe(Measurement(stamp, 'place', (0.1, 0.2)))
    tracker.control(0, (0.5, -0.0))
    tracker.estimate()
    assert tracker.control(0, (0.5, 0.0)) is Rejection.DUPLICATE
    assert tracker.backlog == 0


def test_a_control_older_than_the_history_is_refused_and_one_just_within_it_taken():
    tracker = tracker_of(history=0.5)
    for stamp in (0, SECOND, 2 * SECOND):
        tracker.observe(Measurement(stamp, 'place', (0.1, 0.2)))
        tracker.estimate()
    before = tracker.estimate()
    late, just = 2 * SECOND - SECOND // 2 - 1, 2 * SECOND - SECOND // 2
    assert tracker.control(late, (1.0, 0.0)) is Rejection.TOO_LATE
    assert tracker.estimate() is before
    assert tracker.control(just, (1.0, 0.0)) is None
    assert_same_bits(tracker.estimate(), verbs(
        [Measurement(t, 'place', (0.1, 0.2)) for t in (0, SECOND, 2 * SECOND)],
        {just: (1.0, 0.0)}))


@pytest.mark.parametrize('at_once', [False, True])
def test_what_counts_does_not_depend_on_when_the_work_is_done(at_once):
    tracker, first = tracker_of(history=0.5), {SECOND // 5: (1.0, 0.4), SECOND: (0.3, 0.2)}
    seen = [Measurement(t, 'place', (0.1, 0.2)) for t in (0, SECOND, 2 * SECOND)]
    for item in sorted([*seen, *first.items()], key=stamp_of):
        give(tracker, item)
        if at_once:
            tracker.estimate()
    assert tracker.control(3 * SECOND // 2 - 1, (9.0, 9.0)) is Rejection.TOO_LATE
    assert tracker.control(3 * SECOND // 2, (0.5, 0.5)) is None
    assert_same_bits(tracker.estimate(), verbs(seen, {**first, 3 * SECOND // 2: (0.5, 0.5)}))


def test_a_control_from_before_the_start_counts_as_long_as_it_holds_then():
    starts = []
    for stamp in (5 * SECOND - SECOND // 2, 4 * SECOND):
        tracker = tracker_of()
        tracker.reset(PRIOR, 5 * SECOND)
        assert (tracker.control(stamp, (1.0, 0.0)) is None) == (stamp > 4 * SECOND)
        starts.append(tracker.forecast(6 * SECOND).belief.mean()[0])
    # 0.2 s of 1 m/s are left of the first
    assert starts[0] - starts[1] == pytest.approx(0.2 * np.cos(0.3), abs=1e-9)


def test_a_reset_forgets_the_controls():
    tracker = tracker_of()
    tracker.observe(Measurement(0, 'place', (0.1, 0.2)))
    tracker.control(0, (1.0, 1.0))
    tracker.forecast(SECOND)
    tracker.reset(PRIOR, 0)
    assert_same_bits(tracker.forecast(SECOND), FILTER.predict(PRIOR, 0, SECOND))


def test_what_is_kept_is_what_the_history_still_needs():
    tracker = tracker_of(history=0.5)
    for k in range(1000):
        tracker.control(k * SECOND // 10, (1.0, 0.0))
    # before the first measurement, which may come late by more than that: all
    assert len(tracker.memory().controls) == 1000
    for k in range(1000, 2000):
        tracker.control(k * SECOND // 10, (1.0, 0.0))
        tracker.observe(Measurement(k * SECOND // 10, 'place', (0.1, 0.2)))
        tracker.estimate()
    # the anchor is the measurement before the last half second
    assert len(tracker.memory().controls) == 7


def test_there_is_a_most_that_is_kept(monkeypatch):
    monkeypatch.setattr(steering, 'MOST_CONTROLS', 3)
    tracker = tracker_of()
    tracker.observe(Measurement(0, 'place', (0.1, 0.2)))
    answers = [tracker.control(k, (1.0, 0.0)) for k in range(4)]
    assert answers == [None, None, None, Rejection.TOO_MANY]
    assert tracker.control(2, (2.0, 0.0)) is None


@pytest.mark.parametrize('values', [(1.0,), (1.0, float('nan')), (1.0, 2.0, 3.0)])
def test_refuses_what_is_no_control_of_the_model(values):
    with pytest.raises(ValueError, match=r'^values: expected 2 finite numbers \(v, omega\), got'):
        tracker_of().control(0, values)


def test_refuses_a_control_where_the_model_has_no_inputs():
    filter_ = ExtendedKalmanFilter(ornstein_uhlenbeck().model, {}, 0.05)
    with pytest.raises(ValueError, match='^values: expected 0 finite numbers'):
        Tracker(filter_, filter_.gaussian([0.0], [[1.0]])).control(0, ())


@pytest.mark.parametrize('hold', [-1.0, float('inf')])
def test_refuses_a_hold_that_is_no_time(hold):
    with pytest.raises(ValueError, match='^hold: expected seconds, 0 or more, got'):
        Tracker(FILTER, PRIOR, hold=hold)


@pytest.mark.parametrize('back', [0, SECOND // 10, SECOND // 2, 2 * SECOND])
def test_what_drives_on_from_a_new_start_does_not_depend_on_when_the_work_was_done(back):
    at_once, later = (Tracker(FILTER, PRIOR, 0.2, hold=3.0) for _ in range(2))
    for k in range(30):
        stamp_ns = k * SECOND // 10
        for tracker in (at_once, later):
            assert tracker.control(stamp_ns, (1.0, 0.1 * k)) is None
            assert tracker.observe(Measurement(stamp_ns, 'place', (0.1 * k, 0.2))) is None
        at_once.estimate()
    start_ns = 29 * SECOND // 10 - back
    for tracker in (at_once, later):
        tracker.reset(PRIOR, start_ns, start_ns)
    assert_same_bits(at_once.forecast(start_ns + SECOND),
                     later.forecast(start_ns + SECOND).belief)


@pytest.mark.parametrize('asked', [False, True])
@pytest.mark.parametrize('second_ns', [200_000_000, SECOND, 1_300_000_000])
def test_a_start_before_the_last_one_finds_the_controls_in_between(asked, second_ns):
    """Oracle: predict and correct, with all controls known beforehand."""
    tracker = tracker_of(history=2.0)
    controls = {k * SECOND // 4: (0.4 + 0.1 * k, 0.5 - 0.2 * k) for k in range(8)}
    for control in controls.items():
        assert tracker.control(*control) is None
    fixes = [Measurement(stamp_ns, 'place', (0.5, 0.2)) for stamp_ns in (
        1_700_000_000, 2 * SECOND)]
    for start_ns, fix in zip((1_600_000_000, second_ns), fixes):
        tracker.reset(PRIOR, start_ns, start_ns)
        assert tracker.observe(fix) is None
        if asked:
            tracker.estimate()
    known = Controls(*zip(*controls.items()), round(HOLD * SECOND))
    belief, now = PRIOR, second_ns
    for fix in fixes:
        belief = FILTER.predict(belief, now, fix.stamp_ns, known)
        belief, _ = FILTER.correct(belief, fix.values, fix.source, fix.stamp_ns)
        now = fix.stamp_ns
    assert_same_bits(tracker.estimate(), belief)
