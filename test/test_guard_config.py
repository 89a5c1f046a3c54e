"""Gates, outliers, recovery and the watch, as parameters have them."""

from pif_ros.config import build_tracker, Config, ConfigError
from pif_ros.config.bank import FilterOfMany
import pytest

SMALL = {'model.name': 'ornstein_uhlenbeck', 'grid.lower': [-6], 'grid.upper': [6],
         'grid.shape': [60], 'prior.mean': [0.5], 'prior.covariance_diagonal': [0.4],
         'kernel.time_step': 0.05}
GATE = 'measurements.main.gate.tail_probability'


def guard(**more):
    return build_tracker(Config.from_parameters({**SMALL, **more})).guard


def test_by_default_nothing_is_rejected_and_nothing_mixed_in_but_it_is_watched():
    found = guard()
    assert found.gates['main'].tail_probability == found.gates['main'].outlier_probability == 0
    assert found.recovery is None and found.alarm.rate == 1e-5


def test_a_gate_comes_with_its_recovery():
    found = guard(**{GATE: 0.001, 'measurements.main.gate.max_consecutive_rejections': 7,
                     'recovery.share': 0.2})
    assert found.gates['main'].tail_probability == 0.001
    assert found.gates['main'].max_consecutive_rejections == 7
    assert (found.recovery.share, found.recovery.when_lost) == (0.2, False)
    assert found.recovery.belief.mean() == pytest.approx([0.0], abs=1e-12)


def test_a_recovery_may_go_back_to_the_prior():
    found = guard(**{'recovery.when_lost': True, 'recovery.belief': 'prior'})
    assert found.recovery.belief.mean() == pytest.approx([0.5], abs=1e-3)


@pytest.mark.parametrize('more, name', [
    ({GATE: 1.0}, GATE), ({GATE: -0.1}, GATE),
    ({GATE: 0.01, 'measurements.main.outlier_probability': 0.02}, GATE),
    ({'recovery.share': 0.0}, 'recovery.share'), ({'recovery.share': 1.0}, 'recovery.share'),
    ({'recovery.belief': 'none'}, 'recovery.belief'),
    ({'recovery.when_lost': True, 'lost.false_alarm_rate': 0.0}, 'recovery.when_lost'),
    ({'measurements.main.gate.tail': 0.1}, 'measurements.main.gate.tail'),
    ({'filter.type': 'dfy', GATE: 0.01}, GATE),
    ({'filter.type': 'dfy', 'measurements.main.outlier_probability': 0.1},
     'measurements.main.outlier_probability'),
    ({'filter.type': 'ekf_continuous', 'recovery.when_lost': True}, 'recovery.when_lost')])
def test_what_cannot_be_is_refused_by_its_name(more, name):
    with pytest.raises(ConfigError, match=f'^{name}: expected '):
        guard(**more)


@pytest.mark.parametrize('kind', ['dfy', 'ekf_continuous'])
def test_a_filter_of_a_measured_path_is_not_watched(kind):
    assert guard(**{'filter.type': kind}).alarm is None


@pytest.mark.parametrize('kind', ['df', 'particle', 'ekf', 'ukf'])
def test_every_other_filter_is(kind):
    tracker = build_tracker(Config.from_parameters({**SMALL, 'filter.type': kind, GATE: 0.01}))
    assert tracker.guard.alarm is not None and tracker.guard.recovery is not None


def test_targets_of_one_filter_may_say_it_in_more_or_fewer_words():
    many = FilterOfMany()
    many.tracker('one', Config.from_parameters(SMALL))
    many.tracker('two', Config.from_parameters({
        **SMALL, 'model.params.sigma': 1.0, 'measurements.main.sensor': 'position'}))
    assert len(many) == 1


def test_a_target_of_many_is_watched_only_where_it_is_to_recover():
    many = FilterOfMany()
    plain = many.tracker('one', Config.from_parameters(SMALL))
    careful = many.tracker('two', Config.from_parameters({**SMALL, 'recovery.when_lost': True}))
    assert plain.guard.alarm is None and careful.guard.alarm is not None


@pytest.mark.parametrize('name, value', [
    ('sensor', 'nope'), ('params.nope', 1.0), ('params.sigma', -1.0)])
@pytest.mark.parametrize('known', [0, 1])
def test_a_target_whose_sensor_cannot_be_made_is_refused_by_the_name_of_the_parameter(
        known, name, value):
    many = FilterOfMany()
    for k in range(known):
        many.tracker(f'/{k}', Config.from_parameters(SMALL))
    parameter = f'measurements.main.{name}'
    with pytest.raises(ConfigError, match=f'^{parameter}: expected .*, got '):
        many.tracker('/new', Config.from_parameters({**SMALL, parameter: value}))
