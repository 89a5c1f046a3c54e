"""What a tracker remembers as arrays: whoever goes on from them goes on to the same bits."""

import dataclasses
import math

import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.bank import Member
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Estimate, Measurement, Memory, Rejection
from pif_ros.core.saved import arrays_of, forms_of, memory_from
from pif_ros.core.tracker import Tracker
import pytest

SECOND = 1_000_000_000
T = 1_000 * SECOND
PLANE = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [24, 20], 'prior.mean': [0.5, 0.0], 'prior.covariance_diagonal': [1.0, 0.5],
    'kernel.time_step': 0.05, 'filter.particles': 500,
    'measurements.main.sensor': 'position', 'measurements.main.params.sigma': 0.4}
YARD = {
    'model.name': 'unicycle_2d', 'model.params.sigma_position': 0.1,
    'grid.lower': [-9.0, -9.0, -math.pi], 'grid.upper': [9.0, 9.0, math.pi],
    'grid.shape': [30, 30, 24], 'grid.periodic': [False, False, True],
    'prior.mean': [0.5, -0.5, 3.0], 'prior.covariance_diagonal': [0.3, 0.2, 0.1],
    'kernel.time_step': 0.1, 'control.hold': 0.5, 'filter.particles': 500,
    'measurements.main.sensor': 'position', 'measurements.main.params.sigma': 0.3}
TWO = {'measurements.names': ['main', 'far'], 'measurements.far.sensor': 'range',
       'measurements.far.params.landmark': [3.0, 3.0], 'measurements.far.params.sigma': 0.2}

FILTERS = {
    'df': PLANE, 'df, single': {**PLANE, 'kernel.form': 'split', 'kernel.precision': 'single'},
    'df, two sensors': {**PLANE, **TWO},
    'df, long steps': {**PLANE, 'kernel.macro_error': 0.1},
    'df, gated': {**PLANE, **TWO, 'measurements.main.gate.tail_probability': 0.4,
                  'recovery.when_lost': True},
    'df, active': {**PLANE, 'region.kind': 'active'}, 'df, driven': {**YARD, **TWO},
    **{kind: {**PLANE, 'filter.type': kind}
       for kind in ('dfy', 'particle', 'ekf', 'ekf_continuous', 'ukf')},
    'dfy, printed': {**PLANE, 'filter.type': 'dfy', 'filter.scheme': 'pre_printed'},
    **{f'{kind}, driven': {**YARD, 'filter.type': kind}
       for kind in ('particle', 'ekf', 'ekf_continuous', 'ukf')}}


def made(name, **more):
    """Return a new tracker of a filter, with nothing in common with others."""
    return build_tracker(Config.from_parameters({'time.history': 0.6, **FILTERS[name], **more}))


def bits(value):
    """Return all that something is made of, to the last bit."""
    if dataclasses.is_dataclass(value):
        return [bits(getattr(value, field.name)) for field in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [bits(each) for each in value]
    return value.tobytes() if isinstance(value, np.ndarray) else value


def resumed(tracker, name, **more):
    """Return a new tracker that goes on from what another remembers."""
    other, arrays = made(name, **more), arrays_of(tracker)
    # as from a file: in memory of their own
    copies = {key: np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape).copy()
              for key, array in arrays.items()}
    other.recall(memory_from(other, copies))
    return other


def events(tracker, count, seed):
    """Return measurements and controls in the order of their arrival, some of them late."""
    rng, found = np.random.default_rng(seed), []
    names = list(tracker.filter.sensors)
    for k in range(count):
        stamp, late = T + k * SECOND // 9, int(rng.integers(0, 400_000_000))
        source = names[k % len(names)]
        size = tracker.filter.sensors[source].size
        values = (rng.uniform(3.5, 4.5, 1) if size == 1 else
                  np.array([0.3 + 0.03 * k, 0.05 * k]) + 0.2 * rng.normal(size=2))
        found.append((stamp + late * (k % 3 == 0),
                      Measurement(stamp, source, tuple(map(float, values)))))
        if tracker.filter.model.inputs:
            found.append((stamp + late * (k % 4 == 1),
                          (stamp - 30_000_000, tuple(map(float, rng.normal(size=2))))))
    return [event for _, event in sorted(found, key=lambda pair: pair[0])]


def give(tracker, event):
    """Give a tracker a measurement, or a control as (stamp, values)."""
    if isinstance(event, Measurement):
        return tracker.observe(event)
    return tracker.control(*event)


@pytest.mark.parametrize('name', FILTERS)
def test_who_goes_on_from_what_was_saved_goes_on_bitwise_late_ones_included(name):
    twin = made(name)
    came = events(twin, 16, seed=sum(name.encode()))
    stops = {0, 1, 5, len(came) // 2, len(came) - 6}
    tracker = made(name)
    for k, event in enumerate(came):
        if k in stops:
            tracker = resumed(tracker, name)
        assert give(tracker, event) == give(twin, event)
        if k % 4 == 3:
            # saved just as well with corrections that wait
            continue
        now = twin.stamp_ns
        for stamp in (now, now + 130_000_000) if now is not None else (T,):
            found, expected = tracker.forecast(stamp), twin.forecast(stamp)
            assert bits(found) == bits(expected)
    assert bits(tracker.memory()) == bits(twin.memory())
    assert twin.memory().anchored is not None, 'nothing was ever forgotten'


@pytest.mark.parametrize('name', FILTERS)
def test_beliefs_are_kept_in_c_order_in_which_they_are_saved(name):
    # a sum over another order in memory would round otherwise
    def arrays(value):
        if dataclasses.is_dataclass(value):
            return [a for f in dataclasses.fields(value) for a in arrays(getattr(value, f.name))]
        if isinstance(value, tuple):
            return [a for each in value for a in arrays(each)]
        return [value] if isinstance(value, np.ndarray) else []

    tracker = made(name)
    for event in events(tracker, 12, seed=3):
        give(tracker, event)
        tracker.estimate()
        # that of ekf_continuous is cut out of a larger matrix, and copied before it is used
        if 'continuous' not in name:
            assert all(a.flags.c_contiguous for a in arrays(tracker.newest.belief))


def test_what_is_remembered_of_how_they_fitted_is_saved():
    wary = {'measurements.main.gate.tail_probability': 0.5,
            'measurements.main.gate.max_consecutive_rejections': 9,
            'measurements.far.gate.tail_probability': 0.6, 'recovery.when_lost': True,
            'measurements.far.outlier_probability': 0.1, 'lost.false_alarm_rate': 0.1}
    tracker, seen = made('df, two sensors', **wary), set()
    for k in range(40):
        # it is where it was, then somewhere else
        x = 0.5 if k < 10 else 3.0
        tracker.observe(Measurement(T + k * SECOND // 9, 'main', (x, 0.1 * (k % 3))))
        if k % 7 == 6:
            tracker.observe(Measurement(T + k * SECOND // 9, 'far', (4.0 - 0.1 * (k % 4),)))
        tracker.estimate()
        watch = tracker.memory().anchor.watch
        assert resumed(tracker, 'df, two sensors', **wary).memory().anchor.watch == watch
        seen |= {('score', watch.score > 0), ('lost', watch.lost), watch.rejected}
        seen.add(('recoveries', watch.recoveries > 0))
    assert {('score', True), ('lost', True), ('recoveries', True)} < seen and len(seen) > 7


def test_what_decides_is_saved_and_how_late_is_too_late_goes_on():
    tracker = made('df')
    for event in events(tracker, 16, seed=1):
        give(tracker, event)
    tracker.estimate()
    memory = tracker.memory()
    other = resumed(tracker, 'df')
    early = dataclasses.replace(memory.anchored, stamp_ns=memory.anchored.stamp_ns - 1)
    for late in (early, memory.anchored):
        assert other.observe(late) is Rejection.TOO_LATE is tracker.observe(late)
    for known in memory.measurements:
        assert other.observe(known) is Rejection.DUPLICATE
    assert other.backlog == len(memory.measurements) > 0
    assert other.estimate().total_log_evidence == tracker.estimate().total_log_evidence


def test_of_equal_stamps_those_before_the_last_that_was_forgotten_stay_too_late():
    # there is memory for two beliefs and a bit, of 3,840 bytes each
    few = {'time.history_memory': 0.009}
    tracker, twin = (made('df', **few) for _ in range(2))
    for each in (tracker, twin):
        for k, x in enumerate((0.1, 0.2, 0.3, 0.4)):
            each.observe(Measurement(T + (k > 2), 'main', (x, 0.0)))
            each.estimate()
    tracker = resumed(tracker, 'df', **few)
    assert tracker.memory().anchored.values == (0.2, 0.0)
    for x, expected in ((0.15, Rejection.TOO_LATE), (0.2, Rejection.TOO_LATE), (0.25, None)):
        late = Measurement(T, 'main', (x, 0.0))
        assert tracker.observe(late) is expected is twin.observe(late)
    assert bits(tracker.estimate()) == bits(twin.estimate())


def test_a_prior_that_waits_is_that_of_whoever_goes_on():
    tracker = made('df')
    arrays = arrays_of(tracker)
    assert not any(name.startswith('belief') for name in arrays)
    other = made('df', **{'prior.mean': [1.0, 1.0]})
    other.recall(memory_from(other, arrays))
    assert other.newest.belief is other.prior and other.stamp_ns is None


def test_a_belief_that_waits_without_a_stamp_is_saved():
    tracker = made('df')
    tracker.reset(tracker.filter.uniform())
    other = resumed(tracker, 'df')
    assert bits(other.newest) == bits(tracker.newest) and other.stamp_ns is None


def test_a_measurement_that_no_state_allows_leaves_the_evidence_as_it_was():
    tracker = made('df')
    for k, values in enumerate([(0.1, 0.2), (1e200, 0.0), (0.2, 0.2), (1e200, 1.0)]):
        tracker.observe(Measurement(T + k * SECOND, 'main', values))
        tracker.estimate()
    assert tracker.memory().anchor.log_evidence > -math.inf == tracker.newest.log_evidence
    assert bits(resumed(tracker, 'df').estimate()) == bits(tracker.newest)


def test_lost_beliefs_are_saved_as_such():
    for name, lost in (('ekf', lambda b: dataclasses.replace(
            b, location=b.location * np.nan, spread=b.spread * np.nan)),
            ('particle', lambda b: dataclasses.replace(
                b, log_weights=np.full_like(b.log_weights, -np.inf))),
            ('df, active', lambda b: dataclasses.replace(b, patches=())),
            ('df', lambda b: dataclasses.replace(b, density=0 * b.density))):
        tracker = made(name)
        tracker.reset(lost(tracker.prior), T)
        other = resumed(tracker, name)
        assert bits(other.newest) == bits(tracker.newest)
        assert other.newest.belief.mass == 0


def test_a_member_of_a_bank_goes_on_and_keeps_nothing_foreseen():
    config = Config.from_parameters(PLANE)
    member, twin = (build_tracker(config, kind=Member) for _ in range(2))
    for each in (member, twin):
        each.observe(Measurement(T, 'main', (0.1, 0.2)))
        each.estimate()
    member.foresee(T + 20_000_000, GridBelief.uniform(member.prior.grid))
    member.recall(memory_from(member, arrays_of(member)))
    member.observe(Measurement(T + 20_000_000, 'main', (0.3, 0.2)))
    twin.observe(Measurement(T + 20_000_000, 'main', (0.3, 0.2)))
    assert bits(member.estimate()) == bits(twin.estimate())


def test_more_than_is_kept_of_anything_is_not_saved():
    tracker = Tracker(made('df').filter, made('df').prior, history=1e9)
    tracker.recall(Memory(Estimate(None, tracker.prior), measurements=tuple(
        Measurement(k, 'main', (0.0, 0.0)) for k in range(1_000_001))))
    with pytest.raises(ValueError, match='^measurements.stamps_ns: expected .*0 to 1000000'):
        arrays_of(tracker)


@pytest.mark.parametrize('name', FILTERS)
def test_every_array_is_of_its_form(name):
    tracker = made(name)
    for event in events(tracker, 8, seed=2):
        give(tracker, event)
    tracker.estimate()
    arrays, (forms, without) = arrays_of(tracker), forms_of(tracker)
    assert arrays.keys() == forms.keys() > without.keys()
    assert all(forms[key].allows(array.dtype.str, array.shape) for key, array in arrays.items())


def replaced(name, key, value):
    """Return the arrays of a tracker with a number of one of them replaced."""
    tracker = made(name)
    for event in events(tracker, 12, seed=4):
        give(tracker, event)
    tracker.estimate()
    arrays = {k: array.copy() for k, array in arrays_of(tracker).items()}
    arrays[key].flat[0] = value
    return tracker, arrays


@pytest.mark.parametrize(('name', 'key', 'value'), [
    ('df', 'belief.density', math.nan), ('df', 'belief.density', -1e-9),
    ('df', 'belief.density', 1e9), ('df', 'measurements.values', math.inf),
    ('df', 'measurements.stamps_ns', 0), ('df', 'measurements.stamps_ns', T + 10 * SECOND),
    ('df', 'measurements.sources', 1), ('df', 'measurements.sources', -1),
    ('df, two sensors', 'anchored.sources', 2), ('df', 'anchored.stamps_ns', 1),
    ('df', 'watch.score', -1.0), ('df', 'watch.score', math.inf), ('df', 'watch.counts', 2),
    ('df', 'anchor.stamp_ns', 0), ('df', 'anchor.total_log_evidence', math.nan),
    ('df, active', 'belief.windows', 21), ('df, active', 'belief.windows', -1),
    ('df, active', 'belief.cells', math.inf), ('df, active', 'belief.cells', -1.0),
    ('df, active', 'belief.dropped', 1.5), ('df, active', 'belief.dropped', math.nan),
    ('particle', 'belief.points', math.inf), ('particle', 'belief.log_weights', 0.1),
    ('particle', 'belief.log_weights', math.nan), ('ekf', 'belief.location', math.nan),
    ('ekf', 'belief.location', 1e101), ('ekf', 'belief.spread', -1.0),
    ('ekf', 'belief.spread', math.nan), ('dfy', 'belief.y', math.nan),
    ('dfy', 'belief.anchor.density', -1.0), ('ekf, driven', 'controls.values', math.nan),
    ('ekf, driven', 'controls.stamps_ns', T + 100 * SECOND)])
def test_numbers_that_are_no_memory_are_refused_in_a_line(name, key, value):
    tracker, arrays = replaced(name, key, value)
    with pytest.raises(ValueError, match='^[a-z_.]+: expected [^\n]*$'):
        memory_from(tracker, arrays)


def test_windows_must_lie_in_the_world_and_hold_all_cells():
    tracker = made('df, driven')
    for event in events(tracker, 12, seed=4):
        give(tracker, event)
    tracker.estimate()
    for row, wrong in ((1, 1 << 40), (1, -1), (2, 1), (2, 1 << 50), (0, 62)):
        arrays = {k: array.copy() for k, array in arrays_of(tracker).items()}
        for axis in range(3):
            arrays['belief.windows'][0, row, axis] = wrong
        with pytest.raises(ValueError, match='^windows: expected'):
            memory_from(tracker, arrays)


def test_a_filter_that_is_not_known_cannot_be_saved():
    tracker = made('df')
    tracker.reset(object())
    with pytest.raises(TypeError, match='^belief: expected one of GridBelief, .* got a object'):
        arrays_of(tracker)
