"""Configurations that look right: angles that do not come round, a package's own mistakes."""

from math import pi

from pif_ros.config import build_tracker, Config, ConfigError, remarks
from pif_ros.core.models import StateModel
from pif_ros.core.systems import SYSTEMS
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
