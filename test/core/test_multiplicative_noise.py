"""Steps of noise that depends on the state, in any sense of it."""

from dataclasses import replace
import math

import numpy as np
from numpy.testing import assert_allclose
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings, log_transition_density
from pif_ros.core.models import StateModel
import pytest
from scipy import special, stats

SENSES = (0.0, 0.25, 0.5, 1.0)
POINTS = (0.0, 0.5, 1.0)
JACOBIANS = ('determinant', 'exponential')
STEPS = (4, 8, 16)


def geometric(mu=0.2, sigma=0.3, **changes):
    """Return dx = mu x dt + sigma x dv, without derivatives."""
    return StateModel(('x',), lambda x, t: mu * x, lambda x, t: sigma * x[:, None],
                      multiplicative=True, **changes)


def square_root(s, a=2.0, b=1.0, c=0.5):
    """Return dx = a (b - x) dt + c sqrt(x) dv of Ito's sense, written in the sense s."""
    return StateModel(
        ('x',), lambda x, t: a * (b - x) - s * c * c / 2,
        lambda x, t: c * np.sqrt(np.maximum(x, 0))[:, None], multiplicative=True, s=s)


def complex_geometric(sigma=0.35, **changes):
    """Return dz = sigma z (dv1 + i dv2) as two real states."""
    turn = sigma * np.array([[[1, 0], [0, -1]], [[0, 1], [1, 0]]])
    return StateModel(('x1', 'x2'), lambda x, t: np.zeros_like(x),
                      lambda x, t: sigma * np.stack([np.stack([x[0], -x[1]]),
                                                     np.stack([x[1], x[0]])]),
                      vielbein_jacobian=lambda x, t: np.broadcast_to(turn.reshape(
                          (2, 2, 2) + (1,) * (x.ndim - 1)), (2, 2, 2) + x.shape[1:]),
                      multiplicative=True, **changes)


def order(model, grid, settings, duration, before, after, counts=STEPS):
    """Return the L1 errors at the end of a duration over more and more steps, and their order."""
    errors = []
    for steps in counts:
        kernel = dirac_feynman(model, grid, replace(settings, time_step=duration / steps))
        p = before
        for _ in range(steps):
            p = kernel @ p
        errors.append(np.abs(p - after).sum() * grid.cell_volume)
    return errors, -np.polyfit(np.log(counts), np.log(errors), 1)[0]


# Against exact densities

@pytest.mark.parametrize('jacobian', JACOBIANS)
@pytest.mark.parametrize('r', POINTS)
@pytest.mark.parametrize('s', SENSES)
def test_geometric_brownian_motion_of_any_sense_converges_at_first_order(s, r, jacobian):
    mu, sigma, v, T = 0.2, 0.3, 0.04, 1.0
    grid = Grid((0.02,), (5.0,), (700,))
    # d log x = (mu + (s - 1/2) sigma^2) dt + sigma dv
    before = stats.lognorm(math.sqrt(v)).pdf(grid.points[0])
    after = stats.lognorm(math.sqrt(v + sigma**2 * T), scale=math.exp(
        (mu + (s - 0.5) * sigma**2) * T)).pdf(grid.points[0])
    errors, found = order(geometric(mu, sigma, s=s), grid, KernelSettings(1.0, r, jacobian), T,
                          before, after)
    assert found == pytest.approx(1.0, abs=0.1)
    assert errors[-1] < 0.02


@pytest.mark.parametrize('jacobian', JACOBIANS)
@pytest.mark.parametrize('r', POINTS)
@pytest.mark.parametrize('s', SENSES)
def test_a_square_root_process_in_the_form_of_any_sense_converges_at_first_order(s, r, jacobian):
    a, b, c, t0, T = 2.0, 1.0, 0.5, 0.25, 0.5

    def density(x, t, x0=1.5):
        # a non-central chi-square  [Cox, Ingersoll and Ross 1985]
        k = 4 * a / (c * c * -math.expm1(-a * t))
        return k * stats.ncx2(4 * a * b / c**2, k * x0 * math.exp(-a * t)).pdf(k * x)

    grid = Grid((0.0,), (4.0,), (600,))
    x = grid.points[0]
    errors, found = order(square_root(s, a, b, c), grid, KernelSettings(1.0, r, jacobian), T,
                          density(x, t0), density(x, t0 + T))
    # with r = 1/2 what is left of the first order is small, and the second still shows
    assert found == pytest.approx(1.0, abs=0.25)
    assert errors[-1] < 0.06


@pytest.mark.parametrize('s, jacobian', [
    (0.0, 'determinant'), (0.25, 'exponential'), (0.5, 'exponential'), (0.5, 'determinant'),
    (1.0, 'determinant')])
def test_complex_geometric_brownian_motion_converges_at_first_order(s, jacobian):
    sigma, v, T = 0.35, 0.05, 0.5
    grid = Grid((-0.8, -1.6), (3.2, 1.6), (50, 40))

    def density(variance):
        # log z = sigma W in every sense, since (dv1 + i dv2)^2 = 0
        x, y = grid.points
        length = np.hypot(x, y)
        return np.exp(-(np.log(length)**2 + np.arctan2(y, x)**2) / (2 * variance)) / (
            2 * np.pi * variance * length**2)

    errors, found = order(complex_geometric(sigma, s=s), grid,
                          KernelSettings(1.0, 0.5, jacobian), T,
                          density(v), density(v + sigma**2 * T), counts=(2, 4))
    # s = 1/2 has no error of first order here, and shows at once what the cells leave
    assert found > 0.9 or s == 0.5 and errors[-1] < 0.003
    assert errors[-1] < 0.05


def test_the_printed_sign_of_the_noise_drift_never_converges():
    # J = x'' - x' - eps f - s eps e Q u as printed  [Sensors, Eq. 50]
    mu, sigma, v, T, s = 0.2, 0.5, 0.04, 1.0, 0.5
    grid = Grid((0.02,), (9.0,), (500,))
    x = grid.points[0]
    after = stats.lognorm(math.sqrt(v + sigma**2 * T), scale=math.exp(mu * T)).pdf(x)

    def error(steps, sign):
        eps = T / steps
        middle = (x[:, None] + x) / 2
        J = x[:, None] - x - eps * mu * middle + sign * s * eps * sigma**2 * middle
        K = np.exp(-J**2 / (2 * eps * (sigma * middle)**2) - eps / 2 * mu) / (
            sigma * middle * math.sqrt(2 * np.pi * eps)) * grid.cell_volume
        p = stats.lognorm(math.sqrt(v)).pdf(x)
        for _ in range(steps):
            p = K @ p
        return np.abs(p - after).sum() * grid.cell_volume

    printed, right = ([error(steps, sign) for steps in STEPS] for sign in (-1, 1))
    assert min(printed) > 0.3 and printed[-1] > 0.9 * printed[0]
    assert right[-1] < 0.3 * right[0] < 0.03


def test_without_the_bracket_of_the_action_mass_is_lost_at_first_order():
    # s^2 eps / 2 ((d_i e_ja) Q_ab (d_j e_ib) - u_a Q_ab u_b) = s^2 eps / 2 (4 sigma^2) here
    sigma, eps, s = 0.35, 0.02, 0.5
    model = complex_geometric(sigma, s=s)
    near = Grid((0.6, -0.4), (1.4, 0.4), (200, 200))
    start = np.array([[1.0], [0.0]])
    settings = KernelSettings(eps, 0.0, 'exponential')
    mass = np.exp(log_transition_density(model, near.points, start, settings)).sum() * (
        near.cell_volume)
    loss = math.exp(-s**2 * eps / 2 * 4 * sigma**2)
    # what is left is of second order in sigma^2 eps = 0.00245
    assert abs(mass - 1) < 3e-5
    assert abs(mass * loss - 1) > 1e-3


@pytest.mark.parametrize('model, start, box', [
    (geometric(s=0.5), [1.0], Grid((0.2,), (2.5,), (4000,))),
    (geometric(s=1.0), [1.0], Grid((0.2,), (2.5,), (4000,))),
    (complex_geometric(s=0.5), [1.0, 0.0], Grid((0.3, -0.8), (1.9, 0.8), (300, 300)))])
def test_the_determinant_is_the_density_of_the_discretised_equation(model, start, box):
    # its mass is 1 at any step, up to the far tail, in which the noise turns back
    settings = KernelSettings(0.05, 0.5, 'determinant')
    p = np.exp(log_transition_density(model, box.points, np.array(start)[:, None], settings))
    assert p.sum() * box.cell_volume == pytest.approx(1.0, abs=2e-6)


# Against other ways to say the same

def test_noise_of_a_rectangular_vielbein_is_that_of_the_same_process_in_itos_sense():
    s, sigma, tau = 0.5, 0.4, 0.5
    e = (lambda x, t: np.stack([sigma * x, np.full_like(x, tau)], axis=1))
    bent = StateModel(('x',), lambda x, t: -x, e, multiplicative=True, s=s)
    ito = StateModel(('x',), lambda x, t: -x + s * sigma**2 * x, e, multiplicative=True)
    grid = Grid((-4.0,), (4.0,), (400,))
    p = np.exp(-(grid.points[0] - 1)**2)

    def difference(eps):
        settings = KernelSettings(eps, 0.0, 'exponential')
        return np.abs(dirac_feynman(bent, grid, settings) @ p
                      - dirac_feynman(ito, grid, settings) @ p).sum() / p.sum()

    # one step of two first-order forms: apart by eps^2, with terms of eps^(5/2) behind it
    assert difference(0.04) / difference(0.02) == pytest.approx(4.0, rel=0.15)


def test_a_determinant_is_refused_where_the_noise_cannot_be_told_from_the_step():
    model = StateModel(('x',), lambda x, t: -x, lambda x, t: np.stack([x, x], axis=1),
                       multiplicative=True, s=0.5)
    grid = Grid((1.0,), (2.0,), (50,))
    with pytest.raises(ValueError, match="^jacobian: expected 'exponential' where s > 0 and e is "
                       "not square, got 'determinant' with an e of 1 x 2$"):
        dirac_feynman(model, grid, KernelSettings(0.01))
    assert dirac_feynman(replace(model, s=0.0), grid, KernelSettings(0.01)).nnz


def test_constant_noise_written_as_a_function_of_the_state_makes_the_same_kernel():
    e = np.array([[1.0, 0.3], [0.2, 0.8]])
    Q = np.array([[0.5, 0.1], [0.1, 0.4]])

    def drift(x, t):
        return np.stack([-x[1], np.sin(x[0])])

    plain = StateModel(('a', 'b'), drift, e, Q)
    grid = Grid((-2.0, -2.0), (2.0, 2.0), (30, 30))
    settings = KernelSettings(0.05)
    for s in (0.0, 0.5):
        written = StateModel(
            ('a', 'b'), drift, lambda x, t: e.reshape(2, 2, *[1] * (x.ndim - 1)) + 0 * x[0], Q,
            multiplicative=True, s=s)
        difference = (dirac_feynman(written, grid, settings) - dirac_feynman(
            plain, grid, settings))
        # windows are not quite the same: each leaves out 1e-5 of the tail
        assert abs(difference).sum(axis=0).max() < 3e-5


@pytest.mark.parametrize('s', SENSES)
def test_thin_multiplicative_noise_keeps_mass_mean_and_variance(s):
    model, eps = geometric(0.2, 0.3, s=s), 0.01
    grid = Grid((0.0,), (10.0,), (50,))   # 0.3 x sqrt(eps) is 1 % to 150 % of a cell
    x = grid.points[0]
    kernel = dirac_feynman(model, grid, KernelSettings(eps, 0.0, weights='moments'))
    inner, thin = slice(2, 40), slice(2, 20)
    mean = kernel.T @ x
    variance = kernel.T @ x**2 - mean**2
    assert_allclose((kernel.T @ np.ones(50))[inner], 1.0, atol=1e-12)
    assert_allclose((mean - x)[thin], (0.2 + s * 0.09) * eps * x[thin], rtol=1e-9)
    # sampled at 0.7 of a cell a mean is off by up to 2 exp(-2 pi^2 0.7^2) = 1.3e-4 cells
    assert_allclose((mean - x)[inner], (0.2 + s * 0.09) * eps * x[inner], atol=1.5e-4 * 0.2)
    # a mean between two nodes spreads by offset (1 - offset) cells squared at least
    offset = np.abs(mean - x)[thin] / grid.spacing[0]
    least = offset * (1 - offset) * grid.spacing[0]**2
    assert_allclose(variance[thin], np.maximum((0.3 * x[thin])**2 * eps, least), rtol=1e-6)
    assert_allclose(variance[inner], np.maximum((0.3 * x)**2 * eps, 0)[inner], rtol=0.01,
                    atol=least.max())


def test_noise_that_vanishes_somewhere_is_sampled_where_it_is_wide_and_kept_where_it_is_not():
    grid = Grid((-3.0,), (3.0,), (301,))   # a cell's centre lies at 0
    kernel = dirac_feynman(geometric(s=0.5), grid, KernelSettings(0.01))
    assert np.all(np.isfinite(kernel.data))
    assert_allclose(kernel.T @ np.ones(301), np.where(
        np.abs(grid.points[0]) < 2.6, 1.0, kernel.T @ np.ones(301)), atol=1e-9)
    assert kernel[150, 150] == pytest.approx(1.0)


def test_inflated_noise_keeps_the_drift_that_comes_of_the_sense_of_the_models_own():
    model, eps = geometric(0.0, 1.0, s=0.5), 0.01
    grid = Grid((0.0,), (10.0,), (200,))
    x = grid.points[0]
    kernel = dirac_feynman(model, grid, KernelSettings(eps, 0.0, noise_inflation=1.0))
    move = (kernel.T @ x - x)[20:150]
    # s sigma^2 x eps; thin weights are exact in the mean
    assert_allclose(move, 0.5 * x[20:150] * eps, rtol=1e-6)


def test_a_vielbein_that_is_not_finite_is_refused_by_name():
    model = StateModel(('x',), lambda x, t: 1 - x,
                       lambda x, t: np.sqrt(x)[:, None], multiplicative=True)
    grid = Grid((-1.0,), (3.0,), (40,))
    for s in (0.0, 0.5):
        with pytest.raises(ValueError, match='^vielbein: expected finite numbers'), \
                np.errstate(invalid='ignore'):
            dirac_feynman(replace(model, s=s), grid, KernelSettings(0.01))


# The model's own derivatives

def test_derivatives_that_a_model_gives_make_the_kernel_that_differences_make():
    given = geometric(s=0.5, drift_jacobian=lambda x, t: np.full((1, 1, *x.shape[1:]), 0.2),
                      vielbein_jacobian=lambda x, t: np.full((1, 1, 1, *x.shape[1:]), 0.3))
    grid = Grid((0.5,), (3.0,), (200,))
    difference = (dirac_feynman(given, grid, KernelSettings(0.02))
                  - dirac_feynman(geometric(s=0.5), grid, KernelSettings(0.02)))
    assert abs(difference).max() < 1e-9


def test_the_drift_in_itos_sense_is_that_of_the_limit():
    x = np.linspace(0.5, 2.0, 7)[None]
    assert_allclose(geometric(0.2, 0.3, s=0.5).ito_drift(x, 0.0), (0.2 + 0.045) * x, rtol=1e-9)
    assert_allclose(square_root(0.5).ito_drift(x, 0.0), square_root(0.0).drift(x, 0.0), atol=1e-9)
    z = np.array([[1.0, -0.4], [0.2, 0.9]])
    assert_allclose(complex_geometric(s=1.0).ito_drift(z, 0.0), 0.0, atol=1e-10)
    assert_allclose(geometric(0.2, 0.3, s=0.5).ito_jacobian(x, 0.0), np.full((1, 1, 7), 0.245),
                    rtol=1e-6)


def test_the_oracle_of_the_square_root_process_is_a_density():
    x = np.linspace(1e-4, 6, 20001)
    p = stats.ncx2(8.0, 5.0).pdf(x)
    # of order 3: (x / 5)^(3/2) I_3(sqrt(5 x)) exp(-(x + 5) / 2) / 2
    assert_allclose(p, 0.5 * np.exp(-(x + 5) / 2) * (x / 5)**1.5 * special.iv(3, np.sqrt(5 * x)),
                    rtol=1e-6)


def test_a_sense_outside_0_to_1_and_a_constant_multiplicative_vielbein_are_refused():
    with pytest.raises(ValueError, match='^s: expected a number from 0 to 1, got 2$'):
        geometric(s=2)
    with pytest.raises(ValueError, match='^vielbein: expected a function of'):
        StateModel(('x',), lambda x, t: x, np.eye(1), multiplicative=True)
