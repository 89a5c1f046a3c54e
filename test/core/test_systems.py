"""Named systems."""

import inspect
import math

import numpy as np
from pif_ros.core.systems import (bearing_sensor, position_2d, position_sensor, range_sensor,
                                  SYSTEMS, unicycle_2d)
import pytest

X = np.linspace(-3, 3, 13)
X1, X2 = np.meshgrid(X, X)

#: Drift, strength of the noise, measurement and strength of its noise, as printed.
SCALAR = {
    # dx = sigma dv  [TM, Eq. 122]
    'wiener': (lambda x: 0 * x, 1.0, lambda x: x, 1.0),
    'ornstein_uhlenbeck': (lambda x: -x, 1.0, lambda x: x, 0.5),
    'benes': (lambda x: np.sinh(x) / np.cosh(x), 1.0, lambda x: x, 1.0),
    # dx = -4 x (x^2 - 1) dt + 0.1 dv  [TM, Eq. 124]
    'double_well': (lambda x: 4 * x - 4 * x**3, 0.1, lambda x: x, 0.1),
    # dx = 1.2 cos(3 x) dt + 0.3 dv  [TM, Eq. 125]
    'cosine_drift': (lambda x: 1.2 * np.cos(3 * x), 0.3, lambda x: x, 0.1),
    # dx = -sin(x (x^2 - 1)) dt + 3 dv, y = x^2 + w  [TM, Eq. 126]
    'sine_cubic_drift': (lambda x: np.sin(x - x**3), 3.0, lambda x: x * x, 1.0),
    # dx = 1.2 cos(3 x) dt + 0.3 dv, dy = arctan(x) dt + 0.05 dw  [PMC, Eq. 40]
    'arctangent_sensor': (lambda x: 1.2 * np.cos(3 * x), 0.3, np.arctan, 0.05),
    # dx = dv, dy = x^3 dt + dw  [PMC, Eqs. 42, 43]
    'cubic_sensor': (lambda x: 0 * x, 1.0, lambda x: x**3, 1.0),
}


def first_sensor(system):
    return next(iter(system.sensors.values()))


def states(n, shape, positive=False):
    """Return some states, only positive ones where a model has no others."""
    x = np.random.default_rng(0).normal(size=(n,) + shape)
    return np.abs(x) + 0.1 if positive else x


@pytest.mark.parametrize('name', SCALAR)
def test_scalar_systems_are_what_is_printed(name):
    drift, sigma, h, sigma_y = SCALAR[name]
    system = SYSTEMS[name]()
    sensor = first_sensor(system)()
    assert system.model.names == ('x',)
    np.testing.assert_allclose(system.model.drift(X[None], 0.0)[0], drift(X), atol=1e-12)
    np.testing.assert_allclose(system.model.diffusion(0.0), [[sigma**2]], rtol=1e-12)
    np.testing.assert_allclose(sensor.function(X[None], 0.0)[0], h(X), atol=1e-12)
    np.testing.assert_allclose(sensor.noise(0.0), [[sigma_y**2]], rtol=1e-12)


def test_the_arctangent_sensors_drift_has_the_constants_of_the_paper():
    system = SYSTEMS['arctangent_sensor'](a=0.7, b=2.0, sigma_x=0.4, sigma_y=0.0125)
    np.testing.assert_allclose(system.model.drift(X[None], 0.0)[0], 0.7 * np.cos(2 * X),
                               atol=1e-12)
    np.testing.assert_allclose(system.model.diffusion(0.0), [[0.16]], rtol=1e-12)
    np.testing.assert_allclose(first_sensor(system)().noise(0.0), [[0.0125**2]], rtol=1e-12)


def test_geometric_brownian_motion_has_noise_in_proportion_to_the_state():
    system = SYSTEMS['geometric_brownian_motion'](mu=-0.2, sigma=0.4, sigma_y=0.3)
    x = np.array([[0.5, 1.0, 3.0]])
    np.testing.assert_allclose(system.model.drift(x, 0.0), -0.2 * x, rtol=1e-12)
    np.testing.assert_allclose(system.model.diffusion_at(x, 0.0)[0], (0.4 * x)**2, rtol=1e-12)
    sensor = system.sensors['logarithm']()
    np.testing.assert_allclose(sensor.function(x, 0.0), np.log(x), rtol=1e-12)
    assert first_sensor(system) is system.sensors['logarithm']
    np.testing.assert_array_equal(system.sensors['position']().function(x, 0.0), x)
    np.testing.assert_allclose(sensor.noise(0.0), [[0.09]], rtol=1e-12)


def test_a_logarithm_gives_no_likelihood_to_what_no_path_reaches():
    sensor = SYSTEMS['geometric_brownian_motion']().sensors['logarithm']()
    found = sensor.log_likelihood([0.0], sensor.function(np.array([[-1.0, 0.0, 1.0]]), 0.0))
    assert not np.any(found[:2] > -np.inf) and np.isfinite(found[2])


def test_coupled_trigonometric_is_what_is_printed():
    # dx1 = (-x2 + cos x1) dt + dv1, dx2 = (x1 + sin x2) dt + dv2, y_i = x_i^2 + w_i
    # [Sensors, Eqs. 31, 32]
    system = SYSTEMS['coupled_trigonometric'](sigma_x=0.7, sigma_y=0.2)
    sensor = first_sensor(system)()
    x = np.stack([X1, X2])
    assert system.model.names == ('x1', 'x2')
    np.testing.assert_allclose(system.model.drift(x, 0.0),
                               [np.cos(X1) - X2, np.sin(X2) + X1], atol=1e-12)
    np.testing.assert_allclose(system.model.diffusion(0.0), 0.49 * np.eye(2), rtol=1e-12)
    np.testing.assert_allclose(sensor.function(x, 0.0), [X1**2, X2**2], rtol=1e-12)
    np.testing.assert_allclose(sensor.noise(0.0), 0.04 * np.eye(2), rtol=1e-12)


def test_cubic_bearing_is_what_is_meant():
    # dx1 = (-189 x2^3 + 9.16 x2) dt + 0.001 dv1, dx2 = -dt / 3 + 0.03 dv2,
    # y = arcsin(x2 / sqrt(x1^2 + x2^2)) + 0.2 w  [Sensors, Eqs. 28, 29; the square is missing]
    system = SYSTEMS['cubic_bearing']()
    sensor = first_sensor(system)()
    x = np.stack([X1, X2])
    np.testing.assert_allclose(system.model.drift(x, 0.0),
                               [-189 * X2**3 + 9.16 * X2, 0 * X2 - 1 / 3], atol=1e-9)
    np.testing.assert_allclose(system.model.diffusion(0.0), np.diag([1e-6, 9e-4]), rtol=1e-12)
    with np.errstate(invalid='ignore'):
        ratio = X2 / np.sqrt(X1**2 + X2**2)
    # arcsin's argument is rounded, and its slope has no end at 1: sqrt(2e-16) = 1.5e-8
    np.testing.assert_allclose(sensor.function(x, 0.0)[0],
                               np.arcsin(np.nan_to_num(ratio).clip(-1, 1)), atol=3e-8)
    np.testing.assert_allclose(sensor.noise(0.0), [[0.04]], rtol=1e-12)


def test_the_bearing_of_the_origin_is_a_number():
    sensor = first_sensor(SYSTEMS['cubic_bearing']())()
    assert sensor.function(np.zeros(2), 0.0).tolist() == [0.0]


def printed_4d(x):
    """Return f, e, and h of both sensors at one state, entry by entry  [Sensors, Eqs. 33-35]."""
    x1, x2, x3, x4 = map(float, x)
    sin, cos, tanh = math.sin, math.cos, math.tanh
    f = [x2 - x1, x1 * (1 - x3) - x2, x1 * x2 - x3, (1 - x2) * x3 - x4]
    d = [5 + 0.1 * tanh(x1 + x2), 5 + 0.1 * tanh(x2 - x3**2), 5 + 0.1 * tanh(x3 - x4),
         5 + 0.1 * tanh(x1 - x4)]
    e = [[d[0], sin(x2), cos(x3), sin(x4)], [sin(x4), d[1], cos(x3), sin(x1)],
         [cos(x1), sin(x4), d[2], cos(x3)], [sin(x1), cos(x2), sin(x3), d[3]]]
    first = [sin(x1 + x2), cos(x2 - x3), sin(x3 + x4), sin(x4 - x1)]
    second = [math.atan(math.sqrt(x1**2 + x3**2)),
              math.acos(x1 / math.sqrt(1 + x1**2 + x4**2)),
              math.asin(x4 / math.sqrt(1 + x3**2 + x4**2)),
              math.atan(1 + x4**2 + sin(x1)**2)]
    return f, e, first, second


def test_multiplicative_4d_is_what_is_printed():
    system = SYSTEMS['multiplicative_4d']()
    model, sensors = system.model, system.sensors
    x = 4 * states(4, (7, 3))
    found = (model.drift(x, 0.0), model.vielbein_at(x, 0.0),
             sensors['trigonometric']().function(x, 0.0),
             sensors['inverse_trigonometric'](c=0.7).function(x, 0.0) / 0.7)
    for index in np.ndindex(7, 3):
        for ours, printed in zip(found, printed_4d(x[(slice(None),) + index])):
            np.testing.assert_allclose(ours[(...,) + index], printed, atol=1e-12)
    assert model.names == ('x1', 'x2', 'x3', 'x4')
    assert first_sensor(system) is sensors['trigonometric']
    for sensor in (sensors['trigonometric'](), sensors['inverse_trigonometric']()):
        np.testing.assert_array_equal(sensor.noise(0.0), np.eye(4))
    np.testing.assert_allclose(sensors['inverse_trigonometric']().function(x, 0.0),
                               0.1 * found[3], rtol=1e-12)


def test_lorenz_63_rests_where_lorenz_said():
    system = SYSTEMS['lorenz_63'](sigma=10.0, rho=20.0, beta=2.0, sigma_x=0.5, sigma_y=0.1)
    # x1 = x2 = sqrt(beta (rho - 1)), x3 = rho - 1  [Lorenz 1963, section 7]
    rest = np.array([math.sqrt(38), math.sqrt(38), 19.0])
    np.testing.assert_allclose(system.model.drift(rest, 0.0), 0, atol=1e-12)
    np.testing.assert_allclose(system.model.drift(np.array([1.0, 2.0, 3.0]), 0.0),
                               [10.0, 15.0, -4.0], rtol=1e-12)
    np.testing.assert_allclose(system.model.diffusion(0.0), 0.25 * np.eye(3), rtol=1e-12)
    np.testing.assert_array_equal(first_sensor(system)().function(rest, 0.0), rest[:1])
    np.testing.assert_array_equal(system.sensors['position']().function(rest, 0.0), rest)


def test_position_2d_is_a_random_walk_that_reads_x_and_y():
    model = position_2d(diffusion=1.5).model
    assert model.names == ('x', 'y')
    np.testing.assert_array_equal(model.drift(np.stack([X1, X2]), 0.0), 0)
    np.testing.assert_allclose(model.diffusion(0.0), 2.25 * np.eye(2), rtol=1e-12)


def differences(function, x):
    """Return d function / dx_j on a new axis behind those of function(x) that are no state's."""
    columns = []
    for j in range(len(x)):
        # a difference over 2e-5 has an error of 1e-10 f''' / 6 and 1e-11 of rounding
        step = np.zeros(len(x)).reshape((len(x),) + (1,) * (x.ndim - 1))
        step[j] = 1e-5
        columns.append((function(x + step) - function(x - step)) / 2e-5)
    return np.stack(columns, axis=columns[0].ndim - x.ndim + 1)


@pytest.mark.parametrize('name', SYSTEMS)
@pytest.mark.parametrize('shape', [(), (5,), (2, 3)])
def test_models_keep_the_shape_of_states_and_say_their_own_slopes(name, shape):
    model = SYSTEMS[name]().model
    model = model.under([0.7, -0.4][:len(model.inputs)])
    n = model.ndim
    x = states(n, shape)
    assert np.shape(model.drift(x, 0.0)) == (n,) + shape
    slope = model.jacobian(x, 0.0)
    assert slope.shape == (n, n) + shape and model.drift_jacobian is not None
    # the largest third derivative here, of cubic_bearing, is 1134: 2e-8
    np.testing.assert_allclose(slope, differences(lambda y: model.drift(y, 0.0), x), atol=1e-7)
    if model.multiplicative:
        columns = model.noise(0.0).shape[0]
        assert model.vielbein_at(x, 0.0).shape == (n, columns) + shape
        np.testing.assert_allclose(model.vielbein_jacobian(x, 0.0),
                                   differences(lambda y: model.vielbein_at(y, 0.0), x), atol=1e-7)


@pytest.mark.parametrize('name', SYSTEMS)
@pytest.mark.parametrize('shape', [(), (5,), (2, 3)])
def test_sensors_without_constants_keep_the_shape_of_states(name, shape):
    system = SYSTEMS[name]()
    x = states(system.model.ndim, shape, positive=True)
    made = [sensor() for sensor in system.sensors.values() if not any(
        p.default is p.empty for p in inspect.signature(sensor).parameters.values())]
    assert made or name in ('position_2d', 'unicycle_2d')
    for sensor in made:
        assert sensor.function(x, 0.0).shape == (sensor.size,) + shape
        assert np.all(np.isfinite(sensor.function(x, 0.0)))


def test_a_drift_of_whole_numbers_is_none_of_whole_numbers():
    for name in ('cubic_bearing', 'coupled_trigonometric', 'multiplicative_4d', 'lorenz_63'):
        model = SYSTEMS[name]().model
        whole = np.arange(1, model.ndim + 1)
        np.testing.assert_array_equal(model.drift(whole, 0.0), model.drift(whole * 1.0, 0.0))


def test_ranges_are_scaled_and_biased_distances():
    sensor = range_sensor([3.0, -1.0], sigma=0.4, scale=1.066, bias=0.2)
    x = np.array([[3.0, 7.0, 0.0], [-1.0, 2.0, 3.0]])
    np.testing.assert_allclose(sensor.function(x, 0.0),
                               [[0.2, 1.066 * 5 + 0.2, 1.066 * 5 + 0.2]], rtol=1e-12)
    np.testing.assert_allclose(sensor.noise(0.0), [[0.16]], rtol=1e-12)
    assert not any(sensor.angular)


@pytest.mark.parametrize('x, angle', [
    ([0, 0], np.arctan2(1, 2)), ([4, 1], np.pi), ([2, 0], np.pi / 2), ([2, 5], -np.pi / 2)])
def test_bearings_point_from_the_robot_to_the_landmark(x, angle):
    sensor = bearing_sensor([2.0, 1.0], sigma=0.1, bias=0.05)
    found = sensor.function(np.array(x, dtype=float), 0.0)
    assert np.exp(1j * found[0]) == pytest.approx(np.exp(1j * (angle + 0.05)), abs=1e-12)
    assert sensor.angular == (True,)


def test_positions_read_both_coordinates():
    sensor = position_sensor(2.0)
    np.testing.assert_array_equal(sensor.function(np.stack([X1, X2]), 0.0), [X1, X2])
    np.testing.assert_allclose(sensor.noise(0.0), 4 * np.eye(2), rtol=1e-12)


def test_a_unicycle_drives_where_it_heads_and_turns_as_it_is_told():
    model = unicycle_2d(sigma_position=0.2, sigma_heading=0.3).model
    assert (model.names, model.inputs) == (('x', 'y', 'theta'), ('v', 'omega'))
    headings = np.array([[5.0] * 3, [-2.0] * 3, [0.0, np.pi / 2, np.pi]])
    np.testing.assert_allclose(model.under((2.0, 0.5)).drift(headings, 0.0),
                               [[2, 0, -2], [0, 2, 0], [0.5] * 3], atol=1e-15)
    np.testing.assert_allclose(model.diffusion(0.0), np.diag([0.04, 0.04, 0.09]), rtol=1e-15)
    np.testing.assert_array_equal(model.under(()).drift(headings, 0.0), 0)


def test_a_unicycle_moves_alike_wherever_it_stands():
    model = unicycle_2d().model
    here, there = np.array([[0.0], [0.0], [0.7]]), np.array([[9.0], [-4.0], [0.7]])
    assert model.homogeneous == (0, 1)
    plain = model.under((1.5, -0.2))
    np.testing.assert_array_equal(plain.drift(here, 0.0), plain.drift(there, 0.0))


def test_a_unicycle_has_the_sensors_of_the_plane_and_a_compass():
    sensors = unicycle_2d().sensors
    assert set(position_2d().sensors) | {'heading', 'relative_bearing'} == set(sensors)
    compass = sensors['heading'](sigma=0.1, bias=0.2)
    x = np.array([[1.0, 2.0], [3.0, 4.0], [3.1, -0.5]])
    np.testing.assert_allclose(compass.function(x, 0.0), [[3.3, -0.3]], rtol=1e-15)
    # 3.3 and -3.1 are 0.117 apart on the circle
    assert compass.residual([-3.1], compass.function(x, 0.0))[0, 0] == pytest.approx(
        2 * np.pi - 6.4)
    assert sensors['range']([1.0, 0.0], 0.1).function(x, 0.0)[0, 0] == 3.0
    # what lies ahead of a robot that looks along y is at 0, what lies along x at its right
    looking = np.array([[1.0], [3.0], [np.pi / 2]])
    ahead, right = (sensors['relative_bearing'](place, 0.1) for place in ([1.0, 9.0], [9.0, 3.0]))
    assert ahead.function(looking, 0.0)[0, 0] == pytest.approx(0.0)
    assert right.function(looking, 0.0)[0, 0] == pytest.approx(-np.pi / 2)


def test_a_sensor_of_a_robot_depends_on_the_states_that_it_says_it_sees():
    rng = np.random.default_rng(0)
    x, other = rng.normal(0, 2, (2, 3, 20))
    constants = {'position': {}, 'heading': {}}
    for name, maker in unicycle_2d().sensors.items():
        sensor = maker(**constants.get(name, {'landmark': [1.0, 2.0]}), sigma=0.1)
        mixed = other.copy()
        mixed[list(sensor.states)] = x[list(sensor.states)]
        np.testing.assert_array_equal(sensor.function(mixed, 0.0), sensor.function(x, 0.0))
        for i in sensor.states:
            moved = x.copy()
            moved[i] += 0.3
            assert np.any(sensor.function(moved, 0.0) != sensor.function(x, 0.0))


@pytest.mark.parametrize('name', SYSTEMS)
def test_a_sensor_says_which_states_it_sees_where_these_are_not_all(name):
    system = SYSTEMS[name]()
    n = system.model.ndim
    x, other = np.random.default_rng(1).uniform(0.5, 2, (2, n, 20))
    moved = [np.where(np.arange(n)[:, None] == i, other, x) for i in range(n)]
    for sensor in (maker() for maker in system.sensors.values() if not any(
            p.default is p.empty for p in inspect.signature(maker).parameters.values())):
        seen = [i for i in range(n)
                if np.any(sensor.function(moved[i], 0.0) != sensor.function(x, 0.0))]
        assert list(range(n) if sensor.states is None else sensor.states) == seen


def test_the_names_are_those_promised_and_every_constant_has_a_default():
    promised = {'wiener', 'ornstein_uhlenbeck', 'benes', 'double_well', 'cosine_drift',
                'sine_cubic_drift', 'coupled_trigonometric', 'cubic_bearing', 'multiplicative_4d',
                'arctangent_sensor', 'cubic_sensor', 'geometric_brownian_motion', 'lorenz_63',
                'position_2d', 'unicycle_2d'}
    assert promised <= SYSTEMS.keys()
    for name, system in SYSTEMS.items():
        assert system.__name__ == name and system.__doc__
        assert all(parameter.default is not parameter.empty
                   for parameter in inspect.signature(system).parameters.values())


@pytest.mark.parametrize('call, wanted, got', [
    (lambda: SYSTEMS['wiener'](sigma=0.0), 'sigma: expected a positive number', '0'),
    (lambda: SYSTEMS['wiener'](sigma=float('nan')), 'sigma: expected a positive number', 'nan'),
    (lambda: SYSTEMS['double_well'](sigma_y=-1), 'sigma_y: expected a positive number', '-1'),
    (lambda: SYSTEMS['sine_cubic_drift'](sigma_y=0), 'sigma_y: expected a positive', '0'),
    (lambda: SYSTEMS['coupled_trigonometric'](sigma_x=float('inf')),
     'sigma_x: expected a positive number', 'inf'),
    (lambda: SYSTEMS['cubic_bearing'](sigma_x2=0.0), 'sigma_x2: expected a positive', '0'),
    (lambda: SYSTEMS['cubic_sensor'](sigma_x=0.0), 'sigma_x: expected a positive', '0'),
    (lambda: SYSTEMS['arctangent_sensor'](a=float('nan')), 'a: expected a finite', 'nan'),
    (lambda: SYSTEMS['geometric_brownian_motion'](sigma=0.0), 'sigma: expected a posit', '0'),
    (lambda: SYSTEMS['geometric_brownian_motion'](mu=True), 'mu: expected a finite', 'True'),
    (lambda: SYSTEMS['lorenz_63'](rho=float('inf')), 'rho: expected a finite number', 'inf'),
    (lambda: SYSTEMS['multiplicative_4d']().sensors['inverse_trigonometric'](c='x'),
     'c: expected a finite number', 'x'),
    (lambda: position_2d(diffusion=-0.5), 'diffusion: expected a positive number', '-0.5'),
    (lambda: SYSTEMS['unicycle_2d'](sigma_heading=0.0), 'sigma_heading: expected a pos', '0'),
    (lambda: position_sensor(0.0), 'sigma: expected a positive number', '0'),
    (lambda: range_sensor([1.0], 0.1), 'landmark: expected 2 finite numbers', '[1.0]'),
    (lambda: range_sensor([1.0, float('nan')], 0.1), 'landmark: expected 2 finite', 'nan'),
    (lambda: bearing_sensor([1.0, 2.0, 3.0], 0.1), 'landmark: expected 2 finite', '3.0'),
    (lambda: bearing_sensor([1.0, 2.0], float('nan')), 'sigma: expected a positive', 'nan'),
])
def test_refuses_what_is_no_constant_in_one_line_with_what_was_wanted_and_what_came(
        call, wanted, got):
    with pytest.raises(ValueError) as error:
        call()
    line = str(error.value)
    assert line.startswith(wanted) and got in line.split('got')[1] and '\n' not in line
