"""What a user may set, and how everything else is refused."""

from pathlib import Path
import tracemalloc
from types import SimpleNamespace

import numpy as np
from pif_ros.config import build_tracker, Config, ConfigError, find_grid, specifications
from pif_ros.config.filters import make_filter
from pif_ros.core.active import ActiveGridFilter, RegionSettings
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from pif_ros.core.systems import unicycle_2d
from pif_ros.filter_node import FilterNode
import pytest
from ros import Graph, ROOT, write_parameters
import yaml

FILES = sorted((ROOT / 'config').glob('*.yaml'))
NAN, INF = float('nan'), float('inf')

SMALL = {'grid.shape': [12, 12], 'kernel.time_step': 0.1}
PLANE = {'model.name': 'position_2d', 'measurements.main.sensor': 'position',
         'measurements.main.params.sigma': 0.5, **SMALL}
RANGE = {**PLANE, 'measurements.main.sensor': 'range',
         'measurements.main.params.landmark': [1.0, 2.0]}
LINE = {'model.name': 'wiener', 'grid.lower': [-3.0], 'grid.upper': [3.0], 'grid.shape': [30],
        'prior.mean': [0.0], 'prior.covariance_diagonal': [1.0]}
POINT = {**PLANE, 'measurements.main.topic': 'point',
         'measurements.main.type': 'geometry_msgs/msg/PointStamped',
         'measurements.main.fields': ['point.x', 'point.y']}
FIXED = {**PLANE, 'measurements.main.topic': 'fixed',
         'measurements.main.type': 'geometry_msgs/msg/PoseWithCovariance',
         'measurements.main.fields': ['covariance[0]', 'covariance[35]']}
#: Ten million cells, which are 3.2 GB at work.
WORLD = {'model.name': 'unicycle_2d', 'grid.lower': [-50.0, -50.0, -3.0],
         'grid.upper': [50.0, 50.0, 3.0], 'grid.shape': [500, 500, 40],
         'prior.mean': [0.0] * 3, 'prior.covariance_diagonal': [1.0, 1.0, 0.1],
         'measurements.main.sensor': 'position', 'measurements.main.params.sigma': 0.5}
TWO = {'measurements.names': ['a', 'b'], 'measurements.a.topic': 'seen',
       'measurements.b.topic': 'seen'}


def wrong(parameter, value, *words, of=SMALL, got=None, says=None):
    """Return a configuration that is wrong, the parameter to blame, and what its line must say."""
    shown = repr(value) if got is None else got
    return pytest.param({**of, parameter: value}, says or parameter, words, shown,
                        id=f'{parameter}={value!r}'[:60])


def lacks(parameter, of):
    """Return a configuration that lacks something."""
    return pytest.param({k: v for k, v in of.items() if k != parameter}, parameter, ('a value',),
                        'none', id=f'{parameter} is missing')


WRONG = [
    # names that nobody knows
    wrong('grid.lowr', [-1.0, -1.0], "'grid.lower'?"),
    wrong('frameid', 'map', "'frame_id'?"),
    wrong('filter.tpe', 'df', "'filter.type'?"),
    wrong('measurements.main.tpic', 'y', "'measurements.main.topic'?"),
    wrong('measurements.other.topic', 'y', 'known parameter'),
    wrong('kernel', 3, 'known parameter'),
    wrong('model.params', 3, 'known parameter'),
    wrong('model.params.sigma', 1.0, 'sigma_x, sigma_y'),
    wrong('measurements.main.params.sgma', 0.5, 'sigma', of=PLANE),
    wrong('model.name', 'coupled', 'coupled_trigonometric'),
    wrong('model.name', 'os.path', 'coupled_trigonometric'),
    wrong('model.name', '', 'a name'),
    wrong('filter.type', 'kalman', 'df'),
    wrong('filter.scheme', 'strang', 'symmetric', 'pre_printed'),
    wrong('prior.type', 'flat', 'gaussian', 'uniform'),
    wrong('pose.estimator', 'median', 'mean', 'mode', 'heaviest_mode'),
    wrong('modes.share', 1.0, 'below 1'),
    wrong('modes.rate', -1.0, '0 or more'),
    wrong('kernel.jacobian', 'exact', 'determinant', 'exponential'),
    wrong('kernel.weights', 'all', 'auto', 'sampled', 'moments'),
    wrong('measurements.main.sensor', 'sonar', 'position', 'range', 'bearing', of=PLANE),
    # what does not go together
    wrong('measurements.names', ['a', 'b'], 'one source', 'dfy', of={
        **SMALL, 'filter.type': 'dfy', 'measurements.a.topic': 'a', 'measurements.b.topic': 'b'}),
    wrong('operator.steps', 4, '1', 'particle', of={**SMALL, 'filter.type': 'particle'}),
    wrong('operator.file', 'a.kernel', "''", 'dfy', of={**SMALL, 'filter.type': 'dfy'}),
    wrong('filter.significance', 0.5, '0', 'ekf', of={**SMALL, 'filter.type': 'ekf'}),
    # lengths
    wrong('grid.lower', [-6.0], '2 values', 'x1, x2'),
    wrong('grid.upper', [6.0, 6.0, 6.0], '2 values'),
    wrong('grid.shape', [], '2 values'),
    wrong('grid.shape', [12, 12], '1 values', of=LINE),
    wrong('grid.periodic', [True], '2 values'),
    wrong('prior.mean', [0.0], '2 values'),
    wrong('prior.covariance_diagonal', [1.0, 1.0, 1.0], '2 values'),
    wrong('measurements.names', [], 'at least one'),
    # filters and operators
    wrong('kernel.s', 0.5 + 1, '0 to 1', '-1'),
    wrong('filter.significance', 1.0, 'below 1'),
    wrong('filter.resample_below', 1.5, '0 to 1'),
    wrong('filter.seed', -1, '0 or more'),
    wrong('kernel.noise_inflation', 1.0, 'ekf', of={**SMALL, 'filter.type': 'ekf'}),
    wrong('kernel.extent', 2, 'particle', of={**SMALL, 'filter.type': 'particle'}),
    wrong('filter.particles', 0, '1 to'),
    wrong('operator.steps', 2000, '1 to 1000'),
    wrong('operator.level', 40, '1 to', of={**SMALL, 'operator.wavelet': 'db4'}),
    wrong('operator.threshold', 2.0, 'below 1', of={**SMALL, 'operator.wavelet': 'db4'}),
    wrong('operator.wavelet', 'mexican', 'wavelet'),
    wrong('operator.file', '/dev/null', 'stored kernel', got='no regular file'),
    wrong('operator.file', '/nowhere/kernel', 'can be read or made'),
    # numbers that are none
    wrong('grid.lower', [NAN, -6.0], 'finite'),
    wrong('grid.upper', [6.0, INF], 'finite'),
    wrong('prior.mean', [0.0, -INF], 'finite'),
    wrong('kernel.time_step', NAN, 'number'),
    wrong('kernel.r', INF, 'number'),
    wrong('publish.rate', NAN, 'number'),
    wrong('model.params.sigma_y', NAN, 'finite'),
    wrong('model.params.sigma_y', INF, 'finite'),
    wrong('measurements.main.params.landmark', [NAN, 0.0], 'finite', of=RANGE, got='[nan'),
    # other types
    wrong('kernel.time_step', 'fast', 'number'),
    wrong('kernel.time_step', True, 'number'),
    wrong('kernel.time_step', [0.1], 'number'),
    wrong('grid.shape', [12.5, 12.0], 'whole numbers'),
    wrong('grid.shape', 12, 'list'),
    wrong('grid.shape', [True, True], 'whole numbers'),
    wrong('grid.periodic', [1, 0], 'true or false'),
    wrong('filter.average_cells', 1, 'true or false'),
    wrong('frame_id', 7, 'name'),
    wrong('frame_id', [], 'name'),
    wrong('pose.axes', [1, 2], 'names'),
    wrong('pose.axes', 'x1', 'list'),
    wrong('measurements.names', 'main', 'list'),
    wrong('model.params.sigma_x', True, 'number'),
    wrong('model.params.sigma_x', 'one', 'number'),
    wrong('measurements.main.params.landmark', 3.0, '2 finite numbers', of=RANGE),
    wrong('measurements.main.params.landmark', [1.0, 2.0, 3.0], '2 finite numbers', of=RANGE,
          got='[1.0, 2.0, 3.0]'),
    wrong('measurements.main.fields', [0, 1], 'names'),
    wrong('use_sim_time', 'yes', 'true or false'),
    # out of bounds
    wrong('grid.upper', [-7.0, 6.0], 'lower < upper', got='-6 and -7'),
    wrong('grid.upper', [6.0, -6.0], 'lower < upper', got='-6 and -6'),
    wrong('grid.shape', [1, 12], 'at least 2 cells', got='1'),
    wrong('grid.shape', [0, 12], 'at least 2 cells', got='0'),
    wrong('grid.shape', [-12, 12], 'at least 2 cells', got='-12'),
    wrong('grid.shape', [60000, 60000], 'memory'),
    wrong('grid.shape', [2**40, 2**40], 'memory'),
    wrong('prior.mean', [0.0, 7.0], 'on the grid'),
    wrong('prior.covariance_diagonal', [1.0, 0.0], 'positive'),
    wrong('prior.covariance_diagonal', [-1.0, 1.0], 'positive'),
    wrong('kernel.time_step', 0.0, 'positive'),
    wrong('kernel.time_step', -0.1, 'positive'),
    wrong('kernel.r', 1.5, '0 to 1'),
    wrong('kernel.r', -0.5, '0 to 1'),
    wrong('kernel.extent', -1, '0 or more'),
    wrong('kernel.tolerance', 0.5, '0.1'),
    wrong('model.params.sigma_x', 0.0, 'positive'),
    wrong('model.params.sigma_y', -1.0, 'positive'),
    wrong('model.params.sigma_y', 1e200, 'positive'),
    wrong('model.params.sigma_y', 1e-200, 'positive'),
    wrong('measurements.main.params.sigma', 'big', 'a positive number', got='big', of=PLANE),
    wrong('measurements.main.params.sigma', [1.0, 2.0], 'a positive number', got='(1.0, 2.0)',
          of=PLANE),
    wrong('measurements.main.params.sigma', True, 'a positive number', of=PLANE),
    wrong('grid.upper', [1e308, 1e308], 'finite lower < upper', got='-1e+308 and 1e+308',
          of={**SMALL, 'grid.lower': [-1e308, -1e308]}),
    wrong('measurements.main.params.sigma', 0.0, 'positive', of=PLANE),
    wrong('measurements.queue_length', 0, '1 to'),
    wrong('diagnostics.max_age', [2.0, 1.0], 'two numbers'),
    wrong('diagnostics.max_busy', [0.5], 'two numbers'),
    wrong('diagnostics.max_delay', [-1.0, 1.0], 'two numbers'),
    wrong('measurements.main.enabled', 'yes', 'true or false'),
    wrong('measurements.queue_length', -5, '1 to'),
    wrong('measurements.queue_length', 2**40, '1000000'),
    wrong('publish.rate', -1.0, '0, or'),
    wrong('publish.rate', 1e-12, '0.001'),
    wrong('publish.rate', 1e12, '1000'),
    wrong('density.rate', -1.0, '0 or more'),
    wrong('pose.unestimated_variance', -1.0, '0 or more'),
    wrong('time.history', -1.0, 'from 0'),
    wrong('time.history', 1e300, '1e9'),
    wrong('time.max_ahead', -1.0, 'from 0'),
    wrong('time.max_ahead', 1e300, '1e9'),
    wrong('time.max_forecast', -0.1, 'from 0'),
    wrong('time.history_memory', 0.0, 'positive'),
    # what is missing
    lacks('measurements.main.params.sigma', of=PLANE),
    lacks('measurements.main.params.landmark', of=RANGE),
    # states and sources
    wrong('pose.axes', ['x1', 'z'], 'x1, x2', got="'z'"),
    wrong('pose.axes', ['x1', 'x1'], 'once'),
    wrong('pose.axes', ['x1', 'x2', '', '', '', '', ''], 'at most 6'),
    wrong('density.axes', ['speed'], 'x1, x2', got="'speed'"),
    wrong('density.axes', ['x2', 'x2'], 'once'),
    wrong('density.axes', ['x1', ''], 'names of states', got="''"),
    wrong('measurements.names', ['a', 'a'], 'once'),
    wrong('measurements.names', ['a b'], 'letters', got="'a b'"),
    wrong('measurements.names', ['names'], 'none of', got="'names'"),
    *(wrong('measurements.names', [task], 'none of', task, got=repr(task))
      for task in ('filter', 'belief', 'control', 'initialpose', 'timing')),
    # what is too large to be made or reckoned with
    wrong('kernel.time_step', 1e300, 'up to 1e9'),
    wrong('kernel.time_step', 2e9, 'up to 1e9', of={**SMALL, 'filter.type': 'ekf'}),
    wrong('kernel.time_step', 1e7, '2 times as wide', of=PLANE),
    wrong('kernel.time_step', 1e7, '2 times as wide', of={**PLANE, 'region.kind': 'active'}),
    wrong('kernel.time_step', 1e9, '2 times as wide', of=WORLD),
    wrong('control.hold', 1e300, 'up to 1e9', of=WORLD),
    wrong('control.hold', 0.0, 'positive', of=WORLD),
    wrong('grid.shape', [2**40, 2**40, 2**40], 'memory', of=WORLD),
    wrong('grid.shape', [2**62, 2**62], 'at most 1099511627776',
          of={**PLANE, 'filter.type': 'ekf'}),
    wrong('grid.shape', [10**9, 10**9, 10**9], 'memory', of=WORLD),
    wrong('measurements.main.topic', '', 'name'),
    wrong('measurements.main.topic', 'bad topic', 'topic'),
    wrong('measurements.main.topic', 'a//b', 'topic'),
    wrong('measurements.main.topic', 'initialpose', 'PoseWithCovarianceStamped'),
    wrong('measurements.b.type', 'std_msgs/msg/Int32MultiArray', 'Float64MultiArray',
          of={**SMALL, **TWO}, says='measurements.b.topic', got="'seen'"),
    wrong('measurements.main.type', 'os/msg/Path', 'installed'),
    wrong('measurements.main.type', 'std_msgs/msg/Float65', 'std_msgs'),
    wrong('measurements.main.type', 'std_msgs/Float64', 'sensor_msgs/msg/Range'),
    wrong('measurements.main.type', 'std_msgs/srv/Float64', 'message type'),
    wrong('measurements.main.type', 'std_msgs/msg/String', 'number', got="'data' (string)",
          says='measurements.main.fields'),
    wrong('measurements.main.fields', ['dta'], 'layout, data', got="'dta'"),
    wrong('measurements.main.fields', ['layout'], 'number', got="'layout'"),
    # what never holds the two numbers of the sensor
    wrong('measurements.main.fields', ['point.x'], '2 numbers', of=POINT),
    wrong('measurements.main.fields', ['point.x', 'point.y', 'point.z'], '2 numbers', of=POINT),
    wrong('measurements.main.fields', ['covariance'], '2 numbers', of=FIXED),
    wrong('measurements.main.fields', ['covariance', 'pose.position.x'], '2 numbers', of=FIXED),
    wrong('measurements.main.fields', ['covariance[0]', 'covariance[36]'], 'below 36', of=FIXED,
          got="'covariance[36]'"),
]


@pytest.fixture(scope='module')
def one_graph(tmp_path_factory):
    """Return one graph for all configurations that make no node."""
    graph = Graph(tmp_path_factory.mktemp('graph'))
    yield graph
    graph.close()


@pytest.mark.parametrize(('given', 'parameter', 'wanted', 'got'), WRONG)
def test_a_wrong_configuration_is_refused_in_one_line_with_parameter_wish_and_value(
        one_graph, given, parameter, wanted, got):
    with pytest.raises(ConfigError) as refused:
        one_graph.filter_node(given)
    line = str(refused.value)
    assert '\n' not in line
    blamed, _, rest = line.partition(': expected ')
    assert blamed == parameter
    assert rest.partition(', got ')[2].startswith(got)
    for word in wanted:
        assert word in rest.replace(got, '', 1)


def test_there_are_many_wrong_configurations_and_each_is_another():
    assert len({str(case.values[0]) for case in WRONG}) == len(WRONG) >= 40


@pytest.mark.parametrize('base', [SMALL, PLANE, RANGE, LINE, POINT, FIXED, WORLD],
                         ids=['small', 'plane', 'range', 'line', 'point', 'fixed', 'world'])
def test_what_the_wrong_configurations_were_made_from_is_right(one_graph, base):
    assert isinstance(one_graph.filter_node(base), FilterNode)


def test_a_grid_too_large_for_the_memory_is_refused_before_it_is_made():
    config = Config.from_parameters({'grid.shape': [46000, 46000]})
    with pytest.raises(ConfigError, match='^grid.shape: .* memory'):
        build_tracker(config)


@pytest.mark.parametrize(('more', 'name'), [
    ({'prior.type': 'uniform'}, 'grid.shape'),
    ({'prior.covariance_diagonal': [1e6, 1e6, 10.0]}, 'grid.shape'),
    ({'measurements.main.gate.tail_probability': 1e-4}, 'recovery.belief'),
    ({'recovery.when_lost': True}, 'recovery.belief')],
    ids=['uniform prior', 'wide prior', 'gate', 'recovery'])
def test_a_belief_of_all_of_a_world_that_does_not_fit_is_refused_before_it_is_made(
        monkeypatch, more, name):
    monkeypatch.setattr('pif_ros.config.filters._available_memory', lambda: 2_000_000_000)
    assert build_tracker(Config.from_parameters(WORLD)).prior.size < 100_000
    tracemalloc.start()
    with pytest.raises(ConfigError, match=f'^{name}: expected .* fits into the 2.0 GB of memory'):
        build_tracker(Config.from_parameters({**WORLD, **more}))
    assert tracemalloc.get_traced_memory()[1] < 20_000_000  # one array of all cells has 80 MB
    tracemalloc.stop()


def test_a_recovery_to_the_prior_needs_no_room_for_all_of_the_world(monkeypatch):
    monkeypatch.setattr('pif_ros.config.filters._available_memory', lambda: 2_000_000_000)
    build_tracker(Config.from_parameters({**WORLD, 'recovery.belief': 'prior',
                                          'recovery.when_lost': True}))


def test_a_prior_off_a_world_that_does_not_fit_is_blamed_for_its_place(monkeypatch):
    monkeypatch.setattr('pif_ros.config.filters._available_memory', lambda: 2_000_000_000)
    with pytest.raises(ConfigError, match='^prior.mean: expected a point on the grid'):
        build_tracker(Config.from_parameters({**WORLD, 'prior.mean': [60.0, 0.0, 0.0]}))


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_every_file_of_the_package_makes_a_filter(path):
    config = Config.from_yaml(path)
    tracker = build_tracker(config)
    names = yaml.safe_load(path.read_text())['/**']['ros__parameters']['measurements']['names']
    assert list(tracker.filter.sensors) == names
    belief = tracker.estimate().belief
    # an active region may leave out its negligible share
    left_out = config.region.negligible if tracker.filter.model.inputs else 1e-9
    assert belief.mass == pytest.approx(1.0, abs=left_out)
    assert np.all(belief.on(find_grid(config, tracker.filter.model), [0]).density >= 0)


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.stem)
def test_every_file_of_the_package_says_the_same_to_the_node(graph, path):
    assert graph.filter_node_of(path).config == Config.from_yaml(path)


@pytest.mark.parametrize('foreign', [
    {'use_sim_time': False}, {'start_type_description_service': True},
    {'qos_overrides': {'/clock': {'subscription': {'depth': 5}}}}], ids=lambda given: min(given))
def test_a_file_with_parameters_of_rclpy_says_the_same_to_the_library_as_to_the_node(
        graph, tmp_path, foreign):
    file = write_parameters(tmp_path / 'file.yaml', {**PLANE, **foreign})
    assert graph.filter_node_of(file).config == Config.from_yaml(file)
    assert Config.from_yaml(file) == Config.from_parameters(PLANE)


def test_every_parameter_stands_in_a_file_of_the_package():
    told = set()
    for path in FILES:
        parameters = flat(yaml.safe_load(path.read_text())['/**']['ros__parameters'])
        sources = parameters['measurements.names']
        told |= {'.'.join('NAME' if part in sources else part for part in name.split('.'))
                 for name in parameters}
    assert set(specifications(('NAME',))) <= told


def flat(tree, prefix=''):
    """Return the leaves of a YAML tree by their dotted names."""
    leaves = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            leaves.update(flat(value, f'{prefix}{key}.'))
        else:
            leaves[f'{prefix}{key}'] = value
    return leaves


# A whole number for each parameter that is a real one.
INTEGERS = {
    'grid.lower': [-6, -6], 'grid.upper': [6, 6], 'prior.mean': [0, 1],
    'prior.covariance_diagonal': [10, 9], 'kernel.time_step': 1, 'kernel.r': 1,
    'pose.unestimated_variance': 2, 'publish.rate': 10, 'density.rate': 2, 'time.history': 3,
    'time.history_memory': 100, 'time.max_ahead': 2, 'time.max_forecast': 30,
    'time.max_gap': 60, 'control.hold': 1, 'region.resolution': 2,
    'kernel.noise_inflation': 1, 'kernel.macro_error': 0, 'kernel.s': 0,
    'filter.significance': 0, 'diagnostics.rate': 2, 'diagnostics.max_age': [1, 2],
    'diagnostics.max_delay': [1, 1], 'diagnostics.max_refused': [0, 1],
    'diagnostics.max_lost_mass': [0, 1], 'diagnostics.max_edge_mass': [0, 1],
    'diagnostics.max_busy': [0, 1], 'modes.rate': 3, 'modes.share': 0,
    'checkpoint_period': 5, 'measurements.main.gate.tail_probability': 0,
    'measurements.main.outlier_probability': 0, 'lost.false_alarm_rate': 0,
    'filter.resample_below': 1, 'operator.threshold': 0,
    'model.params.sigma_x': 1, 'model.params.sigma_y': 2}


def test_integers_are_welcome_where_reals_are_meant(graph):
    node = graph.filter_node({**INTEGERS, 'grid.shape': [12, 12]})
    reals = {name: [float(v) for v in value] if isinstance(value, list) else float(value)
             for name, value in INTEGERS.items()}
    expected = build_tracker(Config.from_parameters({**reals, 'grid.shape': [12.0, 12.0]}))
    assert node.tracker.filter.grid == expected.filter.grid
    assert node.tracker.filter.kernel == expected.filter.kernel
    assert node.tracker.prior.density.tobytes() == expected.prior.density.tobytes()
    for name in INTEGERS.keys() - {'model.params.sigma_x', 'model.params.sigma_y'}:
        value = node.config
        for part in name.split('.'):
            sources = getattr(value, 'sources', {})
            value = sources[part] if part in sources else getattr(value, part)
        assert value == (tuple(reals[name]) if isinstance(reals[name], list) else reals[name])
        assert all(type(v) is float for v in (value if isinstance(value, tuple) else [value]))
    assert node.tracker.filter.sensors['main'].noise(0.0).tolist() == [[4.0, 0.0], [0.0, 4.0]]


def test_every_real_parameter_was_tried_with_an_integer():
    reals = {name for name, spec in specifications().items()
             if isinstance(spec.default, float)
             or (isinstance(spec.default, tuple) and any(type(v) is float for v in spec.default))}
    # a tolerance is at most 0.1, and no whole number is; nor is one between 0 and 1, or 0.01
    assert reals - {'kernel.tolerance', 'recovery.share', 'region.negligible'} <= INTEGERS.keys()


@pytest.mark.parametrize('kind', ['auto', 'full', 'active'])
def test_what_is_said_of_a_negligible_share_is_what_is_taken(kind):
    said = specifications()['region.negligible'].metadata['kind'].wanted
    for value in (0.0, 0.0101, 0.5, -1e-5):
        with pytest.raises(ConfigError, match=f'^region.negligible: expected {said}, got {value}'):
            Config.from_parameters({'region.kind': kind, 'region.negligible': value})
    for value in (1e-12, 0.01):
        given = {'region.kind': kind, 'region.negligible': value}
        assert Config.from_parameters(given).region.negligible == value
        assert RegionSettings(negligible=value).negligible == value


def test_a_configuration_of_nothing_is_the_first_example_of_the_papers():
    # Sensors 2009, example 2: 62 x 62 cells on [-6, 6]^2, from N(0, 10 I), a step of 0.01
    tracker = build_tracker(Config.from_parameters({}))
    assert tracker.filter.grid == Grid((-6, -6), (6, 6), (62, 62))
    assert tracker.filter.time_step_ns == 10_000_000
    x = tracker.filter.grid.points
    p = np.exp(-(x**2).sum(axis=0) / 20).reshape(62, 62)
    np.testing.assert_allclose(tracker.prior.density, p / p.sum() / (12 / 62)**2, rtol=1e-12)


LORENZ = {'model.name': 'lorenz_63', 'model.params.sigma_x': 10.0, 'grid.shape': [40, 40, 40],
          'grid.lower': [-30, -30, -5], 'grid.upper': [30, 30, 55], 'prior.mean': [0, 0, 25],
          'prior.covariance_diagonal': [16, 16, 16], 'pose.axes': ['x1', 'x2', 'x3']}


def test_the_form_of_the_kernel_is_the_one_that_suits_or_else_the_one_that_fits(monkeypatch):
    def form(**given):
        return build_tracker(Config.from_parameters({
            **LORENZ, **{name.replace('__', '.'): v for name, v in given.items()}})).filter.form

    # strongly coupled axes: tabulated, with 280 weights a cell of which there are 64,000
    assert form() == 'tabulated'
    assert form(kernel__form='split') == 'split'
    monkeypatch.setattr('pif_ros.config.filters._available_memory', lambda: 200_000_000)
    assert form() == 'split'
    for given in ({'kernel__form': 'tabulated'}, {'operator__steps': 2}, {'kernel__r': 0.0}):
        with pytest.raises(ConfigError, match='^grid.shape: expected a grid whose kernel fits'):
            form(**given)


def test_a_form_that_cannot_be_is_refused_by_name():
    with pytest.raises(ConfigError, match="^kernel.form: expected 'auto' or 'tabulated' with r = "
                                          "0.0, got 'split'$"):
        build_tracker(Config.from_parameters({'kernel.form': 'split', 'kernel.r': 0.0}))
    with pytest.raises(ConfigError, match='^kernel.macro_error: expected 0 where .*, got 0.01$'):
        build_tracker(Config.from_parameters({'kernel.macro_error': 0.01, 'operator.steps': 2}))
    with pytest.raises(ConfigError, match="^kernel.form: expected 'auto' with filter.type 'dfy'"):
        build_tracker(Config.from_parameters({'kernel.form': 'split', 'filter.type': 'dfy'}))


def test_a_source_without_a_sensors_name_gets_the_first_of_the_system():
    tracker = build_tracker(Config.from_parameters(
        {k: v for k, v in PLANE.items() if k != 'measurements.main.sensor'}))
    assert tracker.filter.sensors['main'].size == 2


# Systems of other packages

SYSTEM = """
from pif_ros.core.systems import System, double_well

def steep(sigma=0.5, sigma_y=0.25):
    return double_well(sigma, sigma_y)

def typed(sigma=0.5):
    return double_well(sigma if type(sigma) is float else 99.0)

def nothing():
    return None
"""
ENTRIES = """
[pif_ros.systems]
steep_well = systems_of_another:steep
typed_well = systems_of_another:typed
nothing = systems_of_another:nothing
number = systems_of_another:NUMBER
broken = systems_of_another_that_does_not_exist:steep
wiener = systems_of_another:steep
"""


@pytest.fixture
def other_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install a distribution that brings systems of its own."""
    (tmp_path / 'systems_of_another.py').write_text(SYSTEM + 'NUMBER = 3\n')
    info = tmp_path / 'systems_of_another-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: systems-of-another\n'
                                   'Version: 1.0\n')
    (info / 'entry_points.txt').write_text(ENTRIES)
    monkeypatch.syspath_prepend(str(tmp_path))


@pytest.mark.usefixtures('other_package')
def test_a_system_of_an_installed_package_is_found_by_its_entry_point(graph):
    node = graph.filter_node({**LINE, 'model.name': 'steep_well', 'model.params.sigma': 0.75})
    model = node.tracker.filter.model
    assert model.names == ('x',)
    assert model.drift(np.array([[2.0]]), 0.0).tolist() == [[-24.0]]  # -4 x (x^2 - 1)
    assert model.diffusion(0.0).tolist() == [[0.5625]]
    assert node.tracker.filter.sensors['main'].noise(0.0).tolist() == [[0.0625]]


@pytest.mark.usefixtures('other_package')
def test_a_system_of_another_package_gets_real_numbers_for_integers(graph):
    node = graph.filter_node({**LINE, 'model.name': 'typed_well', 'model.params.sigma': 2})
    assert node.tracker.filter.model.diffusion(0.0).tolist() == [[4.0]]


@pytest.mark.usefixtures('other_package')
@pytest.mark.parametrize(('name', 'words'), [
    ('systems_of_another', ['steep_well', 'wiener']),
    ('systems_of_another.steep', ['steep_well']),
    ('systems_of_another:steep', ['steep_well']),
    ('broken', ['loads', 'ModuleNotFoundError']),
    ('nothing', ['System', 'None']),
    ('number', ['System', '3'])])
def test_what_is_no_entry_point_of_a_system_is_refused_in_one_line(one_graph, name, words):
    with pytest.raises(ConfigError, match=rf"^model\.name: expected .*, got '{name}'.*$") as line:
        one_graph.filter_node({**LINE, 'model.name': name})
    assert all(word in str(line.value) for word in words)


@pytest.mark.usefixtures('other_package')
def test_a_package_cannot_take_the_name_of_a_system_of_this_one():
    model = build_tracker(Config.from_parameters(LINE)).filter.model
    assert model.drift(np.array([[2.0]]), 0.0).tolist() == [[0.0]]


def test_no_module_is_imported_for_a_name_in_a_parameter(
        one_graph, tmp_path, monkeypatch, other_package):
    imported = SimpleNamespace(names=[])
    (tmp_path / 'evil.py').write_text('raise SystemExit("imported")\n')
    (tmp_path / 'evil').mkdir()
    (tmp_path / 'evil' / '__init__.py').write_text('raise SystemExit("imported")\n')
    monkeypatch.setattr('importlib.import_module',
                        lambda name, package=None: imported.names.append(name))
    for parameter, name in (('model.name', 'evil'), ('measurements.main.type', 'evil/msg/Evil'),
                            ('measurements.main.sensor', 'evil')):
        with pytest.raises(ConfigError, match=f'^{parameter}: '):
            one_graph.filter_node({**SMALL, parameter: name})
    assert imported.names == []


def drifting(**more):
    return StateModel(('x',), lambda x, t: np.cos(t) - x, [[0.5]], **more)


@pytest.mark.parametrize('model, given, kind', [
    (drifting(time_dependent=True), {}, ActiveGridFilter),
    (drifting(time_dependent=True), {'region.kind': 'full'}, DiracFeynmanFilter),
    (drifting(time_dependent=True), {'kernel.r': 0.0}, DiracFeynmanFilter),
    (drifting(time_dependent=True, period=1.0), {}, DiracFeynmanFilter),
    (drifting(), {}, DiracFeynmanFilter),
    (drifting(), {'region.kind': 'active'}, ActiveGridFilter),
    (unicycle_2d().model, {}, ActiveGridFilter)])
def test_the_engine_is_the_one_that_suits_the_model_unless_another_is_asked_for(
        model, given, kind):
    grid = Grid((-5.0,) * model.ndim, (5.0,) * model.ndim, (20,) * model.ndim)
    filter_ = make_filter(Config.from_parameters(given), model, grid, {})
    assert type(filter_) is kind
