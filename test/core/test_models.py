"""How the world moves, and how it is seen."""

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.models import central_differences, Sensor, StateModel
import pytest
from scipy import stats


def still(x, t):
    return np.zeros_like(x)


def test_the_diffusion_is_e_q_e_transposed_at_the_time_asked_for():
    model = StateModel(('a', 'b'), still, lambda t: np.array([[1.0, t, 0], [0, 2.0, 1.0]]),
                       lambda t: np.diag([1.0, 2.0, t]))
    # by hand at t = 3: rows (1, 3, 0) and (0, 2, 1), weights 1, 2, 3
    np.testing.assert_allclose(model.diffusion(3.0), [[1 + 18, 12], [12, 8 + 3]], rtol=1e-15)
    assert model.changes_with_time


def test_without_a_noise_covariance_the_noise_is_white_of_unit_strength():
    model = StateModel(('a', 'b'), still, [[1, 2], [0, 3]])
    np.testing.assert_allclose(model.diffusion(0.0), [[5, 6], [6, 9]], rtol=1e-15)
    assert not model.changes_with_time and model.ndim == 2


@pytest.mark.parametrize('model', [
    StateModel(('a',), still, np.eye(1), time_dependent=True),
    StateModel(('a',), still, lambda t: np.eye(1)),
    StateModel(('a',), still, np.eye(1), lambda t: np.eye(1))])
def test_drift_vielbein_or_noise_may_change_with_time(model):
    assert model.changes_with_time


@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=3))
def test_central_differences_are_derivatives(x):
    def function(x):
        return np.stack([np.sin(x[0]) + x[1], x[1] * x[2]])

    x = np.array(x)
    found = central_differences(function, np.stack([x, x + 1], axis=1))
    for k, (a, b, c) in enumerate((x, x + 1)):
        # far from the origin, too, a step is short against the sine's period and long against
        # rounding, which is 1e-16 of the function's value over the step
        np.testing.assert_allclose(found[0, :, k], [np.cos(a), 1, 0], atol=1e-4)
        np.testing.assert_allclose(found[1, :, k], [0, c, b], rtol=1e-6,
                                   atol=1e-4 * (1 + np.abs([a, b, c]).max()))


@given(st.floats(-50, 50), st.floats(-np.pi, np.pi))
def test_angular_residuals_go_the_short_way_round_and_others_do_not(y, h):
    sensor = Sensor(lambda x, t: x, np.eye(2), angular=(True, False))
    v = sensor.residual([y, y], np.array([h, h]))
    assert -np.pi <= v[0] <= np.pi
    assert np.exp(1j * v[0]) == pytest.approx(np.exp(1j * (y - h)), abs=1e-12)
    assert v[1] == y - h


def test_the_likelihood_is_the_gaussian_of_the_residual_for_any_shape_of_states():
    R = np.array([[2.0, 0.7], [0.7, 1.0]])
    sensor = Sensor(lambda x, t: x, R)
    h = np.random.default_rng(0).normal(size=(2, 3, 4))
    exact = stats.multivariate_normal([0, 0], R).logpdf(
        np.moveaxis(np.array([0.3, -1])[:, None, None] - h, 0, -1))
    np.testing.assert_allclose(sensor.log_likelihood([0.3, -1], h), exact, rtol=1e-12)
    changing = Sensor(lambda x, t: x, lambda t: R * t)
    exact = stats.multivariate_normal([0, 0], 3 * R).logpdf([0.3, -1])
    assert changing.log_likelihood([0.3, -1], np.zeros(2), 3.0) == pytest.approx(exact)
    assert sensor.size == changing.size == 2


def test_the_slope_of_a_bearing_is_finite_where_it_jumps():
    sensor = Sensor(lambda x, t: np.arctan2(-x[1], -x[0])[None], [[0.01]], angular=(True,))
    # seen from (2, 0) the origin lies at pi, where the bearing turns by 1 / 2 per unit
    np.testing.assert_allclose(sensor.jacobian(np.array([2.0, 0.0]), 0.0), [[0, 0.5]], atol=1e-6)


@pytest.mark.parametrize('covariance, wanted', [
    ([[1.0, 2.0]], '1 x 1 numbers, got 1 x 2'),
    ([[float('nan')]], 'finite numbers, got [[nan]]'),
    ([[1.0, 0.5], [0.0, 1.0]], 'a symmetric matrix, got [[1.0, 0.5], [0.0, 1.0]]'),
    ([[1.0, 2.0], [2.0, 1.0]], 'a positive definite matrix, got [[1.0, 2.0], [2.0, 1.0]]'),
    ([[0.0]], 'a positive definite matrix, got [[0.0]]'),
])
def test_a_sensor_refuses_what_is_no_covariance(covariance, wanted):
    with pytest.raises(ValueError) as error:
        Sensor(lambda x, t: x, covariance)
    assert str(error.value) == f'covariance: expected {wanted}'


def test_a_sensor_refuses_angles_that_are_not_one_for_each_component():
    with pytest.raises(ValueError, match='^angular: expected 2 .*got 1'):
        Sensor(lambda x, t: x, np.eye(2), angular=(True,))


def test_an_angle_has_noise_whose_likelihood_is_a_density_on_the_circle():
    with pytest.raises(ValueError, match='^covariance: expected .* 1 rad of an angle.* got 1.5$'):
        Sensor(lambda x, t: x, np.diag([9.0, 2.25]), angular=(False, True))
    Sensor(lambda x, t: x, np.diag([9.0, 1.0]), angular=(False, True))
    turn = 2 * np.pi * np.linspace(0, 1, 1000, endpoint=False)
    for sigma in (0.1, 1.0):
        compass = Sensor(lambda x, t: x, [[sigma**2]], angular=(True,))
        density = np.exp(compass.log_likelihood([2.0], turn[None]))
        assert density.mean() * 2 * np.pi == pytest.approx(1, abs=2e-3)


@pytest.mark.parametrize('fields', [
    {'vielbein': np.ones(2)},
    {'vielbein': np.ones((3, 3))},
    {'vielbein': np.array([[1.0, float('nan')], [0.0, 1.0]])},
    {'noise_covariance': np.eye(3)},
    {'noise_covariance': np.array([[1.0, 2.0], [2.0, 1.0]])},
    {'noise_covariance': np.array([[1.0, 0.5], [0.0, 1.0]])},
])
def test_a_state_model_refuses_noise_that_does_not_fit_its_states_or_is_none(fields):
    [name] = fields
    with pytest.raises(ValueError, match=f'^{name}: expected .* got'):
        model = StateModel(**{'names': ('a', 'b'), 'drift': still, 'vielbein': np.eye(2),
                              **fields})
        grid = Grid((0, 0), (4, 4), (4, 4))
        dirac_feynman(model, grid, KernelSettings(1.0)) @ GridBelief.uniform(grid).density.ravel()


def test_no_measurement_is_likelier_than_the_one_expected():
    R = np.array([[2.0, 0.7], [0.7, 1.0]])
    sensor = Sensor(lambda x, t: x, lambda t: R * t)
    # the peak of a Gaussian of two dimensions is 1 / (2 pi sqrt(det R))
    assert sensor.log_peak(3.0) == pytest.approx(
        -np.log(2 * np.pi * np.sqrt(np.linalg.det(3 * R))), rel=1e-12)


# Models that are driven


def driven_model(jacobian=None):
    return StateModel(('a', 'b'), lambda x, u, t: np.stack([u[0] * x[1] + t, u[1] * x[0]**2]),
                      np.eye(2), drift_jacobian=jacobian, inputs=('p', 'q'))


def slopes(x, u, t):
    zero = np.zeros_like(x[0])
    return np.array([[zero, zero + u[0]], [2 * u[1] * x[0], zero]])


@pytest.mark.parametrize('jacobian', [None, slopes])
def test_a_model_under_a_control_is_a_plain_one_with_that_drift_and_its_slopes(jacobian):
    plain = driven_model(jacobian).under((3.0, -2.0))
    x = np.array([[1.0, 2.0], [4.0, 5.0]])
    assert plain.inputs == ()
    np.testing.assert_array_equal(plain.drift(x, 10.0), [[22, 25], [-2, -8]])
    np.testing.assert_array_equal(plain.ito_drift(x, 10.0), plain.drift(x, 10.0))
    # the central differences of a square and of what is linear are exact but for rounding
    np.testing.assert_allclose(plain.ito_jacobian(x, 10.0),
                               [[[0, 0], [3, 3]], [[-4, -8], [0, 0]]], atol=1e-8)


def test_no_control_stands_for_zeros_and_a_model_without_inputs_for_itself():
    x = np.array([[1.0], [4.0]])
    np.testing.assert_array_equal(driven_model().under(()).drift(x, 5.0),
                                  driven_model().under((0.0, 0.0)).drift(x, 5.0))
    model = StateModel(('a',), still, np.eye(1))
    assert model.under(()) is model and model.under((1.0,)) is model


def test_a_model_is_made_once_for_each_control():
    model = driven_model()
    assert model.under((1.0, 2.0)) is model.under([1, 2])
    assert model.under((1.0, 2.0)) is not model.under((2.0, 2.0))


def test_refuses_a_control_of_another_length_and_states_that_it_has_not():
    with pytest.raises(ValueError, match=r'^u: expected 2 components \(p, q\), got 1$'):
        driven_model().under((1.0,))
    with pytest.raises(ValueError, match='^homogeneous: expected numbers of states, 0 to 0, got'):
        StateModel(('a',), still, np.eye(1), homogeneous=(1,))


@given(st.integers(-30, 0), st.floats(-100, 100))
def test_central_differences_go_with_the_scale_of_a_function(power, place):
    length = 2.0**power
    found = central_differences(lambda x: length * np.sin(x / length),
                                np.array([length * place]), [length])
    # a step of cbrt(2e-16 * 100), squared over 6
    assert found[0, 0] == pytest.approx(np.cos(place), abs=1e-9)


def test_a_model_takes_its_derivatives_on_the_cells_it_is_asked_for_and_a_unit_at_most():
    micro = StateModel(('x', 'y'), lambda x, t: np.sin(x * np.array([[1e6], [1.0]])), np.eye(2))
    x, exact = np.full((2, 1), 3e-7), [[1e6 * np.cos(0.3), 0], [0, np.cos(3e-7)]]
    found = micro.at_scale([1e-7, 1.0]).jacobian(x, 0.0)[..., 0]
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-6)
    assert micro.at_scale([0.01, 1e9]) is micro
    given = StateModel(('x', 'y'), still, np.eye(2), scale=(1e-3, 1e-9))
    assert given.at_scale([1e-6, 1e-6]).scale == pytest.approx((1e-4, 1e-9))
    mega = StateModel(('x', 'y'), still, np.eye(2), scale=(1e6, 1.0))
    assert mega.at_scale([1e5, 1e5]) is mega
    analytic = StateModel(('x',), still, np.eye(1), drift_jacobian=lambda x, t: 0 * x[None])
    assert analytic.at_scale([1e-6]) is analytic


@pytest.mark.parametrize('scale', [(1.0,), (1.0, 0.0), (1.0, np.nan), (-1.0, 1.0)])
def test_a_scale_is_a_length_for_each_state(scale):
    with pytest.raises(ValueError, match='^scale: expected 2 positive lengths, .* got'):
        StateModel(('x', 'y'), still, np.eye(2), scale=scale)
