"""Named systems."""

import inspect

import numpy as np
from pif_ros.core.systems import (
    bearing_sensor, position_2d, position_sensor, range_sensor, SYSTEMS)
import pytest

X = np.linspace(-3, 3, 13)
X1, X2 = np.meshgrid(X, X)

#: Drift, sigma and measurement as printed.
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
}


def first_sensor(system):
    return next(iter(system.sensors.values()))


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


def test_position_2d_is_a_random_walk_that_reads_x_and_y():
    model = position_2d(diffusion=1.5).model
    assert model.names == ('x', 'y')
    np.testing.assert_array_equal(model.drift(np.stack([X1, X2]), 0.0), 0)
    np.testing.assert_allclose(model.diffusion(0.0), 2.25 * np.eye(2), rtol=1e-12)


@pytest.mark.parametrize('name', SYSTEMS)
@pytest.mark.parametrize('shape', [(), (5,), (2, 3)])
def test_models_keep_the_shape_of_states_and_say_their_own_slope(name, shape):
    model = SYSTEMS[name]().model
    n = model.ndim
    x = np.random.default_rng(0).normal(size=(n,) + shape)
    assert np.shape(model.drift(x, 0.0)) == (n,) + shape
    slope = model.jacobian(x, 0.0)
    assert slope.shape == (n, n) + shape
    for j in range(n):
        # a difference over 2e-5 has an error of 1e-10 f''' / 6 and 1e-11 of rounding
        step = np.zeros(n).reshape((n,) + (1,) * len(shape))
        step[j] = 1e-5
        difference = (model.drift(x + step, 0.0) - model.drift(x - step, 0.0)) / 2e-5
        np.testing.assert_allclose(slope[:, j], difference, atol=1e-7)


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


def test_the_names_are_those_promised_and_every_constant_has_a_default():
    promised = {'wiener', 'ornstein_uhlenbeck', 'benes', 'double_well', 'cosine_drift',
                'sine_cubic_drift', 'coupled_trigonometric', 'position_2d'}
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
    (lambda: position_2d(diffusion=-0.5), 'diffusion: expected a positive number', '-0.5'),
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
