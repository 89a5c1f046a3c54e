"""What is not trusted: gate, outliers, recovery, and the watch over all, through the tracker."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.active import ActiveGridFilter
from pif_ros.core.bank import Bank, Member
from pif_ros.core.belief import GridBelief
from pif_ros.core.clutter import Clutter, clutter_of
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.guard import Gate, Guard, Recovery
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.lost import Alarm, Watch
from pif_ros.core.models import Sensor
from pif_ros.core.rivals import ExtendedKalmanFilter, ParticleFilter, UnscentedKalmanFilter
from pif_ros.core.systems import ornstein_uhlenbeck
from pif_ros.core.tracker import Tracker
import pytest
from scipy import stats

SECOND = 1_000_000_000
SENSORS = {'place': Sensor(lambda x, t: x, [[0.3]]), 'square': Sensor(lambda x, t: x**2, [[0.5]])}
GRID = Grid((-6,), (6,), (60,))
MODEL = ornstein_uhlenbeck().model
DF = DiracFeynmanFilter(MODEL, GRID, SENSORS, KernelSettings(0.05))
FILTERS = {
    'grid': DF, 'active': ActiveGridFilter(MODEL, GRID, SENSORS, 0.05),
    'particle': ParticleFilter(MODEL, SENSORS, 0.05, GRID, 300),
    'ekf': ExtendedKalmanFilter(MODEL, SENSORS, 0.05, GRID),
    'ukf': UnscentedKalmanFilter(MODEL, SENSORS, 0.05, GRID)}
CLUTTER = Clutter.spanning(SENSORS['place'], GRID)
EVERY = pytest.mark.parametrize('kind', FILTERS)


def guard_of(filter_, tail=1e-3, most=3, share=0.2, when_lost=False, **more):
    gates = {name: Gate(tail, most, **more) for name in SENSORS}
    return Guard(gates, Recovery(filter_.uniform(), share, when_lost), Alarm(1e-5))


def tracker_of(filter_, guard, kind=Tracker):
    return kind(filter_, filter_.gaussian([0.5], [[0.4]]), 10.0, guard=guard)


def fed(tracker, measurements):
    for stamp, y in enumerate(measurements):
        tracker.observe(Measurement(stamp * SECOND // 20, 'place', (y,)))
    estimate = tracker.estimate()
    return estimate, tracker.corrections


def told(tracker):
    """Return all that an estimate says, to the bit."""
    estimate = tracker.estimate()
    belief = estimate.belief
    return (belief.mean().tobytes(), belief.covariance().tobytes(), estimate.watch,
            estimate.log_evidence, estimate.total_log_evidence)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_whoever_looks_later_comes_to_the_same_watch_whatever_is_late(seed):
    rng, guard = np.random.default_rng(seed), Guard(alarm=Alarm(1e-3))
    at_once, later = (Tracker(DF, DF.gaussian([0.5], [[0.4]]), 0.3, guard=guard) for _ in range(2))
    for k in range(25):
        stamp = (k - int(rng.integers(0, 5)) * int(rng.integers(0, 2))) * SECOND // 20 + k
        y = float(rng.choice([0.2, -0.1, 3.0]))
        for tracker in (at_once, later):
            tracker.observe(Measurement(stamp, 'place', (y,)))
        at_once.estimate()
        if rng.random() < 0.7:
            later.estimate(at_most=int(rng.integers(1, 4)), look=False)
        if rng.random() < 0.4:
            later.look()
    assert later.estimate(look=False).belief.density.tobytes() == (
        at_once.estimate().belief.density.tobytes())
    later.look()
    assert told(later) == told(at_once)
    assert later.memory().anchor.watch == at_once.memory().anchor.watch


def test_what_a_gate_or_a_recovery_needs_is_looked_at_at_once():
    guard = guard_of(DF, when_lost=True)
    at_once, later = tracker_of(DF, guard), tracker_of(DF, guard)
    for k, y in enumerate([0.2, 9.0, 9.0, 9.0, 9.0, 0.1]):
        for tracker in (at_once, later):
            tracker.observe(Measurement(k * SECOND // 20, 'place', (y,)))
        at_once.estimate()
        later.estimate(look=False)
    assert told(later) == told(at_once)


def test_without_a_guard_it_is_the_filters_own_correct():
    y, prior = (0.7,), DF.gaussian([0.5], [[0.4]])
    made = Guard().correct(DF, prior, y, 'place', 0, None)
    exact, log_evidence = DF.correct(prior, y, 'place', 0)
    assert made.belief.density.tobytes() == exact.density.tobytes()
    assert (made.log_evidence, made.gated, made.recovered) == (log_evidence, False, False)


@EVERY
@pytest.mark.parametrize('z', [2.0, 2.9, 3.7, 8.0])
def test_a_measurement_is_rejected_where_the_tail_that_it_is_in_is_below_the_gates(kind, z):
    filter_ = FILTERS[kind]
    prior = filter_.gaussian([0.5], [[0.4]])
    # the prediction of a Gaussian is one: 0.4 + 0.3 is its variance, or what is left of it here
    mean, variance = prior.mean()[0], prior.covariance()[0, 0] + 0.3
    y = (mean + z * np.sqrt(variance),)
    made = guard_of(filter_).correct(filter_, prior, y, 'place', 0, tracker_watch())
    # 1e-3 is 3.29 standard deviations; 300 particles know it to a tenth or so
    assert made.gated == (z > 3.29)
    if made.gated:
        assert made.belief is prior
    else:
        assert made.tail == pytest.approx(stats.chi2.sf(z * z, 1), rel=0.3)


def tracker_watch():
    return tracker_of(DF, Guard()).newest.watch


@EVERY
def test_what_is_gated_changes_no_belief_and_counts_for_no_evidence(kind):
    filter_ = FILTERS[kind]
    seen = [0.4, 0.6, 5.9, 0.5]
    guarded, corrections = fed(tracker_of(filter_, guard_of(filter_)), seen)
    assert [made.gated for made in corrections] == [False, False, True, False]
    tracker = tracker_of(filter_, guard_of(filter_))
    for stamp, y in enumerate(seen):
        if y != 5.9:
            tracker.observe(Measurement(stamp * SECOND // 20, 'place', (y,)))
    without = tracker.estimate()
    # predicted in one go or in two: the same steps
    np.testing.assert_array_equal(guarded.belief.mean(), without.belief.mean())
    assert guarded.total_log_evidence == without.total_log_evidence
    assert corrections[2].log_evidence < -20


STAMPS = st.integers(0, SECOND) | st.sampled_from([0, 50_000_000, 500_000_000])
MEASUREMENTS = st.lists(
    st.builds(Measurement, STAMPS, st.sampled_from(['place', 'square']),
              st.tuples(st.sampled_from([0.3, 0.5, 1.0, 5.5, -5.0]) | st.floats(-6, 6))),
    min_size=1, max_size=14, unique=True)


@EVERY
@given(seen=MEASUREMENTS, random=st.randoms(use_true_random=False), when_lost=st.booleans())
@settings(max_examples=8, deadline=None)
def test_replays_come_to_the_same_verdicts_and_the_same_bits(kind, seen, random, when_lost):
    filter_ = FILTERS[kind]
    guard = guard_of(filter_, when_lost=when_lost, outlier_probability=1e-4, clutter=CLUTTER)
    found = []
    for _ in range(2):
        tracker, verdicts = tracker_of(filter_, guard), {}
        for measurement in seen:
            tracker.observe(measurement)
            if random.random() < 0.6:
                tracker.estimate()
                verdicts.update({c.measurement: c.gated for c in tracker.corrections})
        tracker.estimate()
        verdicts.update({c.measurement: c.gated for c in tracker.corrections})
        found.append((told(tracker), verdicts))
        random.shuffle(seen)
    assert found[0] == found[1]


def test_a_target_of_a_bank_is_guarded_to_the_same_bits():
    seen = [0.4, 5.9, 5.8, 5.9, 5.7, 5.8]
    alone, together = (tracker_of(DF, guard_of(DF), kind) for kind in (Tracker, Member))
    fed(alone, seen)
    bank = Bank({'one': together})
    for stamp, y in enumerate(seen):
        bank.observe('one', Measurement(stamp * SECOND // 20, 'place', (y,)))
    bank.estimates()
    assert told(together) == told(alone)


@EVERY
def test_a_gate_never_locks_a_filter_out(kind):
    filter_ = FILTERS[kind]
    shut = Guard({'place': Gate(1e-3, 10**9)}, Recovery(filter_.uniform()))
    # something so far away that no gate lets it in, and it stays there
    seen = [0.4, 0.5] + [5.0] * 14
    locked, corrections = fed(tracker_of(filter_, shut), seen)
    assert all(made.gated for made in corrections[2:]) and locked.belief.mean()[0] < 1
    found, corrections = fed(tracker_of(filter_, guard_of(filter_)), seen)
    assert [made.recovered for made in corrections[:5]] == [False] * 4 + [True]
    # the drift pulls it home in between
    assert found.belief.mean()[0] == pytest.approx(5.0, abs=1.0)
    assert found.watch.recoveries == 1 and found.watch.rejections('place') == 0


def test_where_there_is_no_gate_it_recovers_when_it_is_lost():
    # a model that is all too sure of itself: the far belief has no mass where the state is
    model = ornstein_uhlenbeck(sigma=0.05).model
    filter_ = DiracFeynmanFilter(model, GRID, {'place': Sensor(lambda x, t: x, [[0.01]])},
                                 KernelSettings(0.05))
    found = []
    for when_lost in (False, True):
        guard = Guard({}, Recovery(filter_.uniform(), 0.1, when_lost), Alarm(1e-5))
        estimate, _ = fed(tracker_of(filter_, guard), [0.4] * 30 + [5.0, 4.9, 4.8, 4.7, 4.6])
        found.append(estimate)
    assert [each.watch.recoveries for each in found] == [0, 1]
    assert [each.watch.lost for each in found] == [True, True]
    assert found[1].belief.mean()[0] == pytest.approx(4.6, abs=0.2)


def test_after_a_recovery_rejections_are_counted_from_none():
    guard = Guard({'place': Gate(1e-3, 2)}, Recovery(DF.gaussian([-5.0], [[0.01]])))
    belief, watch, recovered = DF.gaussian([5.0], [[0.01]]), tracker_watch(), []
    for k in range(7):
        # far from what is believed, and from what is mixed in
        made = guard.correct(DF, belief, (0.0,), 'place', k, watch)
        belief, watch = made.belief, made.watch
        assert made.gated
        recovered.append(made.recovered)
    assert recovered == [False, True, False, True, False, True, False]


def test_one_rejection_may_be_enough_for_a_recovery():
    guard = Guard({'place': Gate(1e-3, 1)}, Recovery(DF.uniform()))
    assert guard.correct(DF, DF.gaussian([-3.0], [[0.1]]), (5.0,), 'place', 0,
                         tracker_watch()).recovered


def test_every_source_has_its_own_count_of_rejections():
    tracker = tracker_of(DF, guard_of(DF))
    for k, (name, y) in enumerate([('place', 5.9), ('square', 0.1), ('place', 5.9),
                                   ('square', 0.2), ('place', 5.9)]):
        tracker.observe(Measurement(k * 10_000_000, name, (y,)))
    tracker.estimate()
    assert [made.recovered for made in tracker.corrections] == [False] * 4 + [True]


@EVERY
@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('y', [1e308, -1e308, 1e200, 1e-320])
@pytest.mark.parametrize('o', [0.0, 1e-4])
def test_no_number_is_too_large_or_too_small_to_be_judged(kind, y, o):
    filter_ = FILTERS[kind]
    prior = filter_.gaussian([0.5], [[0.4]])
    guard = guard_of(filter_, outlier_probability=o, clutter=CLUTTER)
    alone = Guard({'place': Gate(outlier_probability=o, clutter=CLUTTER)}, None, Alarm(1e-5))
    for one in (guard, alone):
        made = one.correct(filter_, prior, (y,), 'place', 0, tracker_watch())
        assert o <= made.tail <= 1 and not np.isnan(made.log_evidence)
        np.testing.assert_allclose(made.belief.mean(), prior.mean() if abs(y) > 1 else 0.4,
                                   atol=0.3)


# Outliers

@pytest.mark.parametrize('y', [0.6, 2.5, 5.9, 40.0])
def test_the_belief_given_what_may_be_clutter_is_that_of_the_mixed_likelihood(y):
    o, prior = 0.05, DF.gaussian([0.5], [[0.4]])
    guard = Guard({'place': Gate(outlier_probability=o, clutter=CLUTTER)})
    made = guard.correct(DF, prior, (y,), 'place', 0, tracker_watch())
    # 120 deviations of clutter: from -6 to 6 and three deviations of noise to both sides
    x, width = GRID.points[0], 12 + 6 * np.sqrt(0.3)
    likelihood = ((1 - o) * stats.norm.pdf(y, x, np.sqrt(0.3))
                  + o * stats.norm.pdf(y, 0, width))
    joint = likelihood * prior.density
    evidence = joint.sum() * GRID.cell_volume
    np.testing.assert_allclose(made.belief.density, joint / evidence, rtol=1e-6, atol=1e-12)
    # the clutter's span is that of the grid's edges
    assert made.log_evidence == pytest.approx(np.log(evidence), abs=1e-6)


@pytest.mark.parametrize('at', [0.0, 60.0, 1.7e9])
def test_the_clutter_of_a_sensor_that_moves_is_where_that_is(at):
    grid, y = Grid((-5.0,), (5.0,), (100,)), 2 * at + 4.0
    moving = Sensor(lambda x, t: x + 2 * t, [[0.01]], time_dependent=True)
    filter_ = DiracFeynmanFilter(ornstein_uhlenbeck().model, grid, {'s': moving},
                                 KernelSettings(0.1))
    guard = Guard({'s': Gate(outlier_probability=0.1, clutter=clutter_of(moving, grid))})
    made = guard.correct(filter_, filter_.gaussian([0.0], [[0.25]]), (y,), 's',
                         round(at * 1e9), tracker_watch())
    # eight deviations from all that is believed: clutter, of which ten and six tenths are the span
    assert made.log_evidence == pytest.approx(
        np.log(0.1 * stats.norm.pdf(4.0, 0.0, 10.6)), abs=0.02)
    assert made.belief.mean() == pytest.approx(0.0, abs=1e-3)


@EVERY
def test_clutter_leaves_the_belief_where_it_was_and_others_move_it(kind):
    filter_ = FILTERS[kind]
    guard = Guard({'place': Gate(outlier_probability=0.05, clutter=CLUTTER)})
    prior, watch = filter_.gaussian([0.5], [[0.4]]), tracker_watch()
    far = guard.correct(filter_, prior, (1e4,), 'place', 0, watch)
    np.testing.assert_allclose(far.belief.mean(), prior.mean(), atol=1e-9)
    np.testing.assert_allclose(far.belief.covariance(), prior.covariance(), rtol=1e-6)
    assert np.isfinite(far.log_evidence)
    near, plain = (one.correct(filter_, prior, (0.6,), 'place', 0, watch).belief
                   for one in (guard, Guard()))
    np.testing.assert_allclose(near.mean(), plain.mean(), atol=0.01)


@EVERY
def test_a_mixture_has_the_moments_of_its_parts(kind):
    filter_ = FILTERS[kind]
    one, other = filter_.gaussian([-1.0], [[0.3]]), filter_.gaussian([2.0], [[0.5]])
    mixed, share = filter_.mixed(one, other, 0.25, 7), 0.25
    mean = 0.75 * one.mean() + share * other.mean()
    spread = (0.75 * one.covariance() + share * other.covariance()
              + 0.75 * share * (other.mean() - one.mean())**2)
    assert mixed.mass + getattr(mixed, 'dropped', 0.0) == pytest.approx(1.0, abs=1e-9)
    # 300 particles tell a mean to a tenth
    loose = 0.15 if kind == 'particle' else 1e-4
    np.testing.assert_allclose(mixed.mean(), mean, atol=loose)
    np.testing.assert_allclose(mixed.covariance(), spread, rtol=2 * loose)


def test_a_mixture_with_what_has_left_the_grid_is_the_other():
    gone = GridBelief(GRID, np.zeros(GRID.shape))
    assert DF.mixed(gone, DF.uniform(), 0.1, 0).mass == pytest.approx(1.0)


def test_where_all_has_left_the_grid_nothing_is_made_of_what_may_be_clutter():
    gone = GridBelief(GRID, np.zeros(GRID.shape))
    open_, gated = (guard.correct(DF, gone, (0.6,), 'place', 0, tracker_watch()) for guard in (
        Guard({'place': Gate(outlier_probability=0.05, clutter=CLUTTER)}),
        guard_of(DF, outlier_probability=1e-4, clutter=CLUTTER)))
    assert open_.belief.mass == gated.belief.mass == 0
    assert open_.log_evidence == -np.inf and gated.gated and gated.tail == 1e-4


@pytest.mark.parametrize('o', [0.0, 0.05, 0.4])
def test_as_rare_as_a_measurement_is_all_of_the_clutter_too(o):
    expected = DF.predictive(DF.gaussian([0.0], [[0.3]]), 'place', 0)
    for y in (0.0, 1.5, 3.0):
        assert Gate(outlier_probability=o, clutter=CLUTTER).tail(expected, [y]) == pytest.approx(
            1 - (1 - o) * (1 - expected.tail([y])), rel=1e-12)


def test_clutter_is_a_density_on_lines_and_circles():
    both = Sensor(lambda x, t: np.stack([x[0], x[0] / 10]), np.diag([0.25, 0.01]),
                  angular=(False, True))
    clutter = Clutter.spanning(both, GRID)
    line = np.linspace(-300, 300, 6001)
    mass = sum(np.exp(clutter.log_density([y, 0.1])) for y in line) * 0.1 * 2 * np.pi
    assert mass == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize('fields, name', [
    ({'tail_probability': 1.0}, 'tail_probability'),
    ({'tail_probability': -0.1}, 'tail_probability'),
    ({'outlier_probability': 1.0, 'clutter': CLUTTER}, 'outlier_probability'),
    ({'outlier_probability': 0.1}, 'clutter'),
    ({'tail_probability': 0.1, 'outlier_probability': 0.1, 'clutter': CLUTTER},
     'tail_probability'),
    ({'max_consecutive_rejections': 0}, 'max_consecutive_rejections')])
def test_refuses_what_makes_no_gate(fields, name):
    with pytest.raises(ValueError, match=f'^{name}: expected '):
        Gate(**fields)


def test_refuses_a_gate_that_nothing_opens_again_and_a_share_that_is_none():
    with pytest.raises(ValueError, match='^recovery: expected '):
        Guard({'place': Gate(0.01)})
    for share in (0, 1):
        with pytest.raises(ValueError, match=f'^share: expected .*, got {share}$'):
            Recovery(DF.uniform(), share)


def test_nobody_looks_before_he_is_asked_to_however_much_is_forgotten(monkeypatch):
    tracker, looked = Tracker(DF, DF.gaussian([0.5], [[0.4]]), 0.2, guard=Guard(alarm=Alarm())), []
    watched = Guard.watched
    monkeypatch.setattr(Guard, 'watched', lambda *given: (looked.append(1), watched(*given))[1])
    for k in range(12):
        tracker.observe(Measurement(k * SECOND // 20, 'place', (0.2,)))
        tracker.estimate(look=False)
        assert not looked
        tracker.look()
        assert looked.pop() and not looked
    assert tracker.kept < 6


@pytest.mark.parametrize('outliers', [0.0, 5e-4])
def test_a_gated_measurement_has_the_log_evidence_that_it_would_have_had(outliers):
    full = DF.gaussian([0.5], [[0.4]])
    belief = GridBelief(GRID, 0.3 * full.density)
    more = {'outlier_probability': outliers, 'clutter': CLUTTER} if outliers else {}
    gate = Gate(1e-3, 3, **more)
    shut = Guard({'place': gate}, Recovery(DF.uniform(), 0.2, False))
    open_ = Guard({'place': Gate(**more)}) if outliers else Guard()
    gated = shut.correct(DF, belief, (4.5,), 'place', 0, Watch())
    used = open_.correct(DF, belief, (4.5,), 'place', 0, Watch())
    assert gated.gated and not used.gated
    # cells of 0.2 beside a deviation of 0.55
    assert gated.log_evidence == pytest.approx(used.log_evidence, abs=1e-6)
