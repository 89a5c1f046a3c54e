"""The density of a path, its gradient and its curvature."""

import numpy as np
from pif_ros.core.estimates import Measurement
from pif_ros.core.kernels import KernelSettings, log_transition_density
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.path_monte_carlo import PathPosterior
from pif_ros.core.systems import coupled_trigonometric, geometric_brownian_motion
import pytest

MS = 1_000_000


def drift(x, t):
    return np.stack([np.sin(x[1] - t) - x[0], np.cos(x[0] * x[1]) + t * x[0]])


def vielbein(t):
    return np.array([[0.5, 0.2 + t, 0.1], [0.1, 0.4, -0.2]])


def noise(t):
    return np.diag([1.0, 1 + t, 0.5])


#: Everything depends on time, the noises are correlated, and no derivative is given.
CHANGING = StateModel(('a', 'b'), drift, vielbein, noise, time_dependent=True)
SENSORS = {
    'bearing': Sensor(lambda x, t: np.arctan2(x[1], x[0])[None], [[0.05]], angular=(True,)),
    'both': Sensor(lambda x, t: np.stack([x[0] * t, x[0]**2 + x[1]]),
                   lambda t: np.array([[1 + t, 0.3], [0.3, 0.5]]), time_dependent=True)}
#: Whole steps of 100 ms and rests, two at one stamp, the same sensor twice at one stamp.
MEASURED = [(250 * MS, 'bearing', [3.1]), (300 * MS, 'both', [0.3, 1.2]),
            (300 * MS, 'bearing', [-3.0]), (300 * MS, 'bearing', [2.9]),
            (400 * MS, 'both', [0.1, 0.4])]
SYSTEM = coupled_trigonometric()
SQUARES = {'squares': SYSTEM.sensors['squares']()}
POSTERIORS = {
    'all in time': lambda r, jacobian: PathPosterior(
        CHANGING, SENSORS, KernelSettings(0.1, r=r, jacobian=jacobian), [0.5, -0.3],
        [[0.2, 0.1], [0.1, 0.3]], MEASURED, 20 * MS),
    'coupled': lambda r, jacobian: PathPosterior(
        SYSTEM.model, SQUARES, KernelSettings(0.1, r=r, jacobian=jacobian), [0.0, 0.0],
        np.eye(2), [(100 * MS, 'squares', [1.0, 2.0]), (250 * MS, 'squares', [0.3, 1.2])]),
}
WAYS = [(0.0, 'determinant'), (0.3, 'determinant'), (0.5, 'exponential'), (1.0, 'determinant')]
EVERY = pytest.mark.parametrize('name, r, jacobian', [
    (name, *way) for name in POSTERIORS for way in WAYS])


def action(posterior, path):
    """Return U of one path (n, N + 1), summed as it is written  [TM, Eq. 130, put right]."""
    model, r, n = posterior.model, posterior.kernel.r, len(path)
    t, x = np.array(posterior.stamps_ns) / 1e9, path.T
    P0 = np.asarray(posterior.covariance)
    d = x[0] - posterior.mean
    U = 0.5 * d @ np.linalg.solve(P0, d) + 0.5 * np.log(np.linalg.det(2 * np.pi * P0))
    for k in range(len(t) - 1):
        eps, at = t[k + 1] - t[k], x[k] + r * (x[k + 1] - x[k])
        e, Q = vielbein(t[k] + r * eps), noise(t[k] + r * eps)
        g = e @ Q @ e.T if model is CHANGING else np.eye(2)
        J = x[k + 1] - x[k] - eps * model.drift(at, t[k] + r * eps)
        D = model.jacobian(at, t[k] + r * eps)
        U += J @ np.linalg.solve(g, J) / (2 * eps)
        U += 0.5 * np.log(np.linalg.det(2 * np.pi * eps * g))
        if posterior.kernel.jacobian == 'exponential':
            U += r * eps * np.trace(D)
        else:
            U -= np.log(abs(np.linalg.det(np.eye(n) - r * eps * D)))
    for m in posterior.measurements:
        k, sensor = posterior.stamps_ns.index(m.stamp_ns), posterior.sensors[m.source]
        v = np.array(m.values) - sensor.function(x[k], t[k])
        if any(sensor.angular):
            v = np.angle(np.exp(1j * v))
        R = sensor.noise(t[k])
        U += 0.5 * v @ np.linalg.solve(R, v) + 0.5 * np.log(np.linalg.det(2 * np.pi * R))
    return U


def paths_of(posterior, count=3):
    shape = (2, len(posterior.stamps_ns), count)
    return np.random.default_rng(5).normal(0.8, 0.7, size=shape)


@EVERY
def test_the_density_is_that_of_the_action(name, r, jacobian):
    posterior = POSTERIORS[name](r, jacobian)
    paths = paths_of(posterior)
    np.testing.assert_allclose(posterior.log_density(paths), [
        -action(posterior, paths[..., b]) for b in range(3)], rtol=1e-12)


def test_of_the_likelihood_a_share_may_count():
    posterior = POSTERIORS['all in time'](0.5, 'determinant')
    paths, shares = paths_of(posterior), np.array([0.0, 0.3, 1.0])
    free, whole = posterior.log_density(paths, 0.0), posterior.log_density(paths)
    np.testing.assert_allclose(whole - free, posterior.log_likelihood(paths), rtol=1e-9)
    np.testing.assert_allclose(posterior.log_density(paths, shares),
                               free + shares * (whole - free), rtol=1e-12)
    slope = posterior.gradient(paths, 0.0)
    np.testing.assert_allclose(posterior.gradient(paths, shares),
                               slope + shares * (posterior.gradient(paths) - slope), rtol=1e-9)
    at_stamps = [posterior.log_likelihood_at(k, paths[:, k]) for k in range(paths.shape[1])]
    np.testing.assert_allclose(np.sum(at_stamps, axis=0), posterior.log_likelihood(paths))


@EVERY
def test_the_gradient_is_that_of_finite_differences(name, r, jacobian):
    posterior = POSTERIORS[name](r, jacobian)
    paths = paths_of(posterior)
    slope = posterior.gradient(paths)
    for i in range(2):
        for k in range(paths.shape[1]):
            step = np.zeros_like(paths)
            step[i, k] = 1e-5
            difference = (posterior.log_density(paths + step)
                          - posterior.log_density(paths - step)) / 2e-5
            # third derivatives of about 1e3 by (1e-5)^2, values of 1e2 rounded by 1e-16 / 1e-5
            np.testing.assert_allclose(slope[i, k], difference, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize('unit', [1e-3, 1e-6])
@pytest.mark.parametrize('jacobian', ['determinant', 'exponential'])
def test_a_path_does_not_know_the_units_of_its_states(unit, jacobian):
    def posterior(unit):
        well = StateModel(('x',), lambda x, t: x - x**3 / unit**2, [[0.6 * unit]])
        cube = {'cube': Sensor(lambda x, t: (x / unit)**3, [[0.1]])}
        return PathPosterior(well, cube, KernelSettings(0.1, jacobian=jacobian), [0.5 * unit],
                             [[(0.3 * unit)**2]], [(500 * MS, 'cube', [0.4])], 0)

    path = np.random.default_rng(4).normal(0.5, 0.4, size=(1, 6, 1))
    one, other = posterior(1.0), posterior(unit)
    assert other.log_density(path * unit)[0] + 6 * np.log(unit) == pytest.approx(
        one.log_density(path)[0], abs=1e-6)
    # a second derivative by differences of differences
    np.testing.assert_allclose(other.gradient(path * unit) * unit, one.gradient(path), atol=2e-4)
    for found, wanted in zip(other.curvature(path * unit), one.curvature(path)):
        np.testing.assert_allclose(found * unit**2, wanted, rtol=1e-6, atol=1e-6)


def test_a_step_is_the_kernels_own():
    for r, jacobian in WAYS:
        posterior = POSTERIORS['all in time'](r, jacobian)
        paths = paths_of(posterior)
        shorter = PathPosterior(CHANGING, SENSORS, posterior.kernel, posterior.mean,
                                posterior.covariance, MEASURED[:-1], 20 * MS)
        change = posterior.log_density(paths) - shorter.log_density(paths[:, :-1])
        both = SENSORS['both']
        expected = log_transition_density(
            CHANGING, paths[:, -1], paths[:, -2], posterior.kernel, 0.3) + both.log_likelihood(
                [0.1, 0.4], both.function(paths[:, -1], 0.4), 0.4)
        np.testing.assert_allclose(change, expected, rtol=1e-9)


def test_no_stamp_is_rounded_and_steps_are_whole_from_each_measurement_on():
    posterior = POSTERIORS['all in time'](0.5, 'determinant')
    assert posterior.stamps_ns == tuple(t * MS for t in (20, 120, 220, 250, 300, 400))
    later = PathPosterior(SYSTEM.model, SQUARES, KernelSettings(0.1), [0, 0], np.eye(2), [
        (7, 'squares', [1, 1]), (7, 'squares', [2, 1])])
    assert later.stamps_ns == (7,)
    # only prior and measurements then, with their own gradient
    x = np.ones((2, 1, 1))
    assert later.gradient(x)[0, 0, 0] == pytest.approx(-1 + 2 * (2 - 1))


@pytest.mark.parametrize('r', [0.0, 0.5, 1.0])
def test_the_curvature_of_a_linear_model_is_minus_the_second_derivative(r):
    F, H = np.array([[-0.6, 0.8], [-0.5, -0.2]]), np.array([[1.0, -0.5]])
    model = StateModel(('a', 'b'), lambda x, t: np.tensordot(F, x, 1), vielbein(0.3), noise(0.3))
    posterior = PathPosterior(
        model, {'s': Sensor(lambda x, t: np.tensordot(H, x, 1), [[0.2]])},
        KernelSettings(0.1, r=r), [0, 0], [[0.2, 0.1], [0.1, 0.3]],
        [(100 * MS, 's', [0.4]), (250 * MS, 's', [0.7])], 0)
    length = len(posterior.stamps_ns)
    diagonal, below = posterior.curvature(paths_of(posterior))
    for i in range(2):
        for k in range(length):
            unit = np.zeros((2, length, 1))
            unit[i, k] = 1
            column = posterior.gradient(0 * unit) - posterior.gradient(unit)
            dense = np.zeros((length, 2))
            dense[k] += diagonal[k, :, i]
            if k + 1 < length:
                dense[k + 1] += below[k, :, i]
            if k > 0:
                dense[k - 1] += below[k - 1, i, :]
            # a gradient of size 1e2, with slopes by central differences, good to 1e-9
            np.testing.assert_allclose(column[..., 0].T, dense, atol=1e-6)


def test_where_a_sensor_is_undefined_there_is_no_density():
    def root(x, t):
        with np.errstate(invalid='ignore'):
            return np.sqrt(x[:1])

    posterior = PathPosterior(SYSTEM.model, {'root': Sensor(root, [[1.0]])}, KernelSettings(0.1),
                              [0, 0], np.eye(2), [(0, 'root', [1.0])])
    found = posterior.log_density(np.array([[[-1.0, 1.0]], [[0.0, 0.0]]]))
    assert found[0] == -np.inf and np.isfinite(found[1])


def posterior_of(**changes):
    usual = {'model': SYSTEM.model, 'sensors': SQUARES, 'kernel': KernelSettings(0.1),
             'mean': [0, 0], 'covariance': np.eye(2),
             'measurements': [Measurement(5, 'squares', (1.0, 2.0))], 'start_ns': None}
    return PathPosterior(**{**usual, **changes})


@pytest.mark.parametrize('changes, line', [
    ({'model': geometric_brownian_motion().model}, 'model: expected additive noise, got '
                                                   'multiplicative'),
    ({'model': StateModel(('a', 'b'), drift, np.array([[1.0], [0.0]]))},
     'model: e Q e^T: expected a positive definite matrix, got [[1.0, 0.0], [0.0, 0.0]]'),
    ({'model': StateModel(('a', 'b'), lambda x, u, t: 0 * x, np.eye(2), inputs=('u', 'v'))},
     'model: expected one without inputs, got u, v'),
    ({'mean': [0.0]}, 'mean: expected 2 finite numbers, got [0.0]'),
    ({'mean': [0.0, float('inf')]}, 'mean: expected 2 finite numbers, got [0.0, inf]'),
    ({'covariance': np.eye(3)}, 'covariance: expected 2 x 2 numbers, got 3 x 3'),
    ({'measurements': []}, 'measurements: expected at least one, got none'),
    ({'measurements': [(5, 'sonar', [1.0])]}, 'measurements: expected sources squares, got sonar'),
    ({'measurements': [(5, 'squares', [1.0])]},
     'measurements: expected 2 finite values of squares, got [1.0]'),
    ({'measurements': [(5, 'squares', [1.0, float('nan')])]},
     'measurements: expected 2 finite values of squares, got [1.0, nan]'),
    ({'start_ns': 6}, 'measurements: expected stamps from 6 on, that of the prior, got 5'),
])
def test_refuses_what_does_not_fit_in_one_line(changes, line):
    changes = {'measurements': [(5, 'squares', [1.0, 2.0]), (9, 'squares', [1.0, 2.0])],
               **changes}
    with pytest.raises(ValueError) as error:
        posterior_of(**changes)
    assert str(error.value) == line
