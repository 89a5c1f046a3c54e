"""The node's parameters as ROS 2 tools see them."""

from pif_ros import parameters
from pif_ros.config import Config, ConfigError, specifications
import pytest
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from ros import Rig

PLANE = {
    'model.name': 'position_2d', 'model.params.diffusion': 1, 'grid.shape': [12, 12],
    'kernel.time_step': 0.1, 'measurements.names': ['gps', 'tower'],
    'measurements.gps.sensor': 'position', 'measurements.gps.params.sigma': 0.5,
    'measurements.tower.sensor': 'range', 'measurements.tower.params.sigma': 0.5,
    'measurements.tower.params.landmark': [4.0, 4.0]}
LIVE = {'pose.estimator', 'density.rate', 'modes.rate'}


@pytest.fixture
def rig(graph):
    """Return a node with two sources, and a peer."""
    return Rig(graph, PLANE)


def values(rig, names):
    """Return what the node's parameter service says that parameters are."""
    client = rig.client(GetParameters, '/filter_node/get_parameters')
    answer = rig.graph.call(client, GetParameters.Request(names=names))
    return dict(zip(names, map(parameter_value_to_python, answer.values)))


def test_every_parameter_of_the_table_is_listed_for_every_source(rig):
    client = rig.client(ListParameters, '/filter_node/list_parameters')
    listed = set(rig.graph.call(client, ListParameters.Request()).result.names)
    table = set(specifications(('gps', 'tower')))
    assert {'grid.lower', 'measurements.gps.topic', 'measurements.tower.topic'} <= table
    assert listed == table | PLANE.keys() | set(parameters.FOREIGN)


def test_what_was_given_is_shown_and_else_the_default(rig):
    names = sorted(specifications(('gps', 'tower')))
    shown = values(rig, names)
    for name, spec in specifications(('gps', 'tower')).items():
        expected = PLANE.get(name, spec.default)
        assert list(shown[name]) == list(expected) if isinstance(
            expected, (tuple, list)) else shown[name] == expected
    assert values(rig, ['measurements.tower.params.landmark']) == {
        'measurements.tower.params.landmark': PLANE['measurements.tower.params.landmark']}


def test_the_documentation_says_what_is_wanted_and_which_may_be_set_while_running(rig):
    client = rig.client(DescribeParameters, '/filter_node/describe_parameters')
    specs = specifications(('gps', 'tower'))
    names = [*specs, 'model.params.diffusion']
    described = rig.graph.call(client, DescribeParameters.Request(names=names)).descriptors
    for name, descriptor in zip(names, described):
        assert descriptor.read_only == (name not in LIVE
                                        and not name.endswith('.enabled')), name
        assert descriptor.description
        if name in specs:
            assert descriptor.additional_constraints == specs[name].metadata['kind'].wanted
    units = {d.name: d.description for d in described}
    assert units['kernel.time_step'].endswith('[s]')
    assert units['publish.rate'].endswith('[Hz]')


def test_an_empty_list_in_a_file_is_an_empty_list(graph):
    node = graph.filter_node({
        'grid.shape': [12, 12], 'grid.periodic': [], 'pose.axes': [], 'density.axes': [],
        'measurements.main.fields': []})
    assert node.config.grid.periodic == node.config.pose.axes == node.config.density.axes == ()
    assert node.config.measurements.sources['main'].fields == ()


def test_what_an_overriding_argument_says_comes_after_the_file(graph):
    node = graph.filter_node({'grid.shape': [12, 12], 'frame_id': 'map'}, '-p', 'frame_id:=odom')
    assert node.config.frame_id == 'odom'
    assert node.get_parameter('frame_id').value == 'odom'


def test_a_parameter_file_for_another_name_tells_the_node_nothing(graph, tmp_path):
    told = graph.filter_node({'frame_id': 'odom'})
    sim_time_only = graph.filter_node({'use_sim_time': True}, '-r', '__node:=other')
    assert (told.told, sim_time_only.told) == (True, False)
    assert sim_time_only.config == Config.from_parameters({})


@pytest.mark.parametrize('name', parameters.FOREIGN)
@pytest.mark.parametrize('value', [1, 'true', [], [True]], ids=repr)
def test_rclpys_own_parameters_are_refused_like_the_others(graph, name, value):
    with pytest.raises(ConfigError) as refused:
        graph.filter_node({name: value})
    assert str(refused.value) == f'{name}: expected true or false, got {value!r}'


def test_live_values_are_taken_as_the_table_takes_them():
    changes = [Parameter('density.rate', value=5), Parameter('pose.estimator', value='mode')]
    taken = parameters.live_values(changes, ('main',))
    assert taken == {'density.rate': 5.0, 'pose.estimator': 'mode'}
    assert type(taken['density.rate']) is float


@pytest.mark.parametrize(('name', 'value'), [
    ('density.rate', float('nan')), ('density.rate', -1), ('density.rate', 'fast'),
    ('density.rate', None), ('density.rate', True), ('pose.estimator', 'median'),
    ('pose.estimator', None), ('pose.estimator', 3)])
def test_live_values_that_cannot_be_are_refused_with_the_line(name, value):
    with pytest.raises(ConfigError, match=f'^{name}: expected .*, got {value!r}$'):
        parameters.live_values([Parameter(name, value=value)], ('main',))


def test_parameters_that_are_not_in_the_table_are_none_of_its_business():
    assert parameters.live_values([Parameter('qos', value=True)], ('main',)) == {}


@pytest.mark.parametrize('value', [True, False])
def test_the_clock_is_chosen_at_the_start_only(value):
    with pytest.raises(ConfigError, match=f'^use_sim_time: .* the start only, got {value}$'):
        parameters.live_values([Parameter('density.rate', value=2.0),
                                Parameter('use_sim_time', value=value)], ('main',))
