"""Configurations that look right: angles that do not come round, a package's own mistakes."""

import math
from math import pi

import numpy as np
from pif_ros.config import build, build_tracker, Config, ConfigError, remarks
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import System, SYSTEMS
import pytest
from ros import Rig

ROBOT = {'model.name': 'unicycle_2d', 'grid.lower': [-4.0, -3.0, -pi],
         'grid.upper': [4.0, 3.0, pi], 'grid.shape': [8, 6, 12],
         'grid.periodic': [False, False, True], 'prior.type': 'uniform',
         'measurements.main.params.sigma': 0.5}


def tracker(**changes):
    given = {name.replace('__', '.'): value for name, value in changes.items()}
    return build_tracker(Config.from_parameters({**ROBOT, **given}))


def said(**changes):
    """Return what is remarked of the grid's turns."""
    config = Config.from_parameters({**ROBOT, **{name.replace('__', '.'): value
                                                 for name, value in changes.items()}})
    return [line for line in remarks(config, build_tracker(config).filter)
            if line.startswith('grid.periodic')]


def refusal(**changes):
    with pytest.raises(ConfigError) as error:
        tracker(**changes)
    assert '\n' not in str(error.value)
    return str(error.value)


# Angles


def test_a_system_says_which_of_its_states_are_angles():
    angles = {name: [made.names[i] for i in made.angles] for name, made in (
        (name, make().model) for name, make in SYSTEMS.items())}
    assert {name for name, found in angles.items() if found} == {'unicycle_2d'}
    assert angles['unicycle_2d'] == ['theta']
    with pytest.raises(ValueError, match='^angles: expected numbers of states, 0 to 0, got'):
        StateModel(('a',), lambda x, t: 0 * x, [[1.0]], angles=(1,))


@pytest.mark.parametrize('kind', ['df', 'particle'])
def test_an_angle_that_does_not_come_round_is_remarked(kind):
    for missing in ([], [False, False, False]):
        [line] = said(grid__periodic=missing, filter__type=kind)
        assert "'theta' is an angle" in line and 'past -3.14159 and 3.14159' in line
    assert not said(filter__type=kind)


def test_a_full_turn_is_2_pi_from_wherever_it_begins():
    for low, high in ((0.0, 2 * pi), (-3.14159, 3.14159), (-3.1416, 3.1416)):
        assert not said(grid__lower=[-4.0, -3.0, low], grid__upper=[4.0, 3.0, high])
    for low, high in ((-180.0, 180.0), (-3.0, 3.0), (-pi, 3.0)):
        assert refusal(grid__lower=[-4.0, -3.0, low], grid__upper=[4.0, 3.0, high]) == (
            "grid.upper: expected 2 pi above grid.lower for 'theta', an angle in radians, "
            f'got {high!r} above {low!r}')


def test_the_node_says_so_at_its_start(graph):
    rig = Rig(graph, {**ROBOT, 'filter.type': 'ekf', 'grid.periodic': [False] * 3})
    assert "'theta' is an angle" in rig.line('grid.periodic')


# Mistakes in a system of another package


def fails(sigma=1.0):
    raise RuntimeError('my bug')


def system(model, h=lambda x, t: x[:1], **given):
    """Return what makes a system of two states, with mistakes of its own."""
    return lambda sigma=1.0: System(StateModel(**{
        'names': ('a', 'b'), 'drift': lambda x, t: -x, 'vielbein': np.eye(2), **model}), {
            'first': lambda: Sensor(h, **{'covariance': np.eye(1), **given})})


OTHERS = {
    'right': (system({}), ''),
    'raises': (fails, "model.name 'raises': RuntimeError: my bug"),
    'row': (system({'drift': lambda x, t: -x[0]}),
            "model.name 'row': drift(x, t): expected shape (2, 5), got (5,)"),
    'driven': (system({'drift': lambda x, u, t: u, 'inputs': ('v',)}),
               "model.name 'driven': drift(x, u, t): expected shape (2, 5), got (1,)"),
    'one': (system({'drift': lambda x, t: np.array([math.sin(x[0]), 0])}),
            "model.name 'one': drift(x, t): TypeError: "),
    'lines': (system({'drift': lambda x, t: 1 / 0}),
              "model.name 'lines': drift(x, t): ZeroDivisionError: division by zero"),
    'slope': (system({'drift_jacobian': lambda x, t: np.eye(2)}),
              "model.name 'slope': drift_jacobian(x, t): expected shape (2, 2, 5), got (2, 2)"),
    'flat': (system({'vielbein': np.array([0.0, 1.0])}),
             "model.name 'flat': vielbein: expected 2 rows of finite numbers, one "
             'for each state, got [0.0, 1.0]'),
    'late': (system({'vielbein': lambda t: np.eye(3)}),
             "model.name 'late': vielbein(t): expected shape (2, p), got (3, 3)"),
    'bent': (system({'vielbein': lambda x, t: np.eye(2), 'multiplicative': True}),
             "model.name 'bent': vielbein(x, t): expected shape (2, p, 5), got (2, 2)"),
    'number': (system({}, lambda x, t: x[0]),
               'measurements.main.sensor: h(x, t): expected shape (1, 5), got (5,)'),
    'none': (system({}, lambda x, t: x[:1], covariance=lambda t: [[1.0, 0.0]]),
             'measurements.main.sensor: covariance(t): expected shape (m, m), got (1, 2)')}


def test_a_mistake_in_a_system_is_named_by_model_and_function_in_one_line(monkeypatch):
    monkeypatch.setattr(build, 'SYSTEMS', {name: maker for name, (maker, _) in OTHERS.items()})
    plane = {'grid.lower': [-2.0] * 2, 'grid.upper': [2.0] * 2, 'grid.shape': [10, 10],
             'prior.type': 'uniform'}
    build_tracker(Config.from_parameters({**plane, 'model.name': 'right'}))
    for name, (_, line) in OTHERS.items():
        if line:
            with pytest.raises(ConfigError) as error:
                build_tracker(Config.from_parameters({**plane, 'model.name': name}))
            assert str(error.value).startswith(line) and '\n' not in str(error.value)


# Sensors


def test_a_compass_that_says_next_to_nothing_is_refused():
    line = refusal(measurements__main__sensor='heading', measurements__main__params__sigma=2.0)
    assert line == ('measurements.main.sensor: covariance: expected a standard deviation of at '
                    'most 1 rad of an angle, which is cut at half a turn, got 2')


def test_a_sensor_that_was_assumed_is_named():
    of = " (of sensor 'position', the first, since measurements.main.sensor is not set), got "
    line = refusal(measurements__main__params__landmark=[1.0, 2.0])
    assert line == f'measurements.main.params.landmark: expected one of sigma{of}[1.0, 2.0]'
    config = {k: v for k, v in ROBOT.items() if k != 'measurements.main.params.sigma'}
    with pytest.raises(ConfigError) as error:
        build_tracker(Config.from_parameters(config))
    assert str(error.value) == f'measurements.main.params.sigma: expected a value{of}none'
    named = refusal(measurements__main__sensor='range', measurements__main__params__landmark=[1.0])
    assert named == 'measurements.main.params.landmark: expected 2 finite numbers, got [1.0]'


@pytest.mark.parametrize(('name', 'hint'), [('density.axes', True), ('grid.lower', False)])
def test_where_yaml_made_a_name_true_that_is_said(name, hint):
    with pytest.raises(ConfigError, match=f'^{name}: expected') as error:
        Config.from_parameters({**ROBOT, name: [True, False]})
    assert ("unless in quotes: 'y'" in str(error.value)) is hint


@pytest.mark.parametrize(('name', 'taken', 'refused'), [
    ('operator.steps', [1, 1000], [0, 1001]), ('time.history', [0.0, 1e9], [-1e-9, 1e9 + 1]),
    ('filter.seed', [0, 2**63 - 1], [-1]),
    ('measurements.queue_length', [1, 10**6], [0, 10**6 + 1]),
    ('publish.rate', [0.0, 1e-3, 1e3], [5e-4, 1000.5]),
    ('checkpoint_period', [0.0, 0.1, 1e9], [0.05, 2e9]),
    ('diagnostics.rate', [0.0, 1e-3, 1e3], [-1.0, 1000.5])])
def test_what_is_said_of_a_parameter_s_range_holds_to_its_ends(name, taken, refused):
    for value in taken:
        assert Config.from_parameters({**ROBOT, name: value})
    for value in refused:
        with pytest.raises(ConfigError, match=f'{name}: expected'):
            Config.from_parameters({**ROBOT, name: value})
