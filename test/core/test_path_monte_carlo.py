"""Whole paths drawn from their posterior."""

from functools import cache

import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.path_monte_carlo import PathPosterior, sample, SamplerSettings
from pif_ros.core.rivals import ParticleFilter
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.smoothing import smooth
from pif_ros.core.systems import coupled_trigonometric, sine_cubic_drift
import pytest

#: A standard error is itself estimated, to 10 % or so; none of some hundred deviations, most of
#: them of one path's neighbours, is as large as this.
SIGMAS = 4.0


# Against smoothing on the grid


def window(system, seed, steps, time_step, start):
    """Return measurements (stamp_ns, source, values) at every step of a simulated path."""
    rng, [(name, make)] = np.random.default_rng(seed), system.sensors.items()
    times = time_step * np.arange(steps + 1)
    path = simulate(system.model, start, times, rng, substeps=10)
    return [(round(t * 1e9), name, measure(make(), x, t, rng))
            for t, x in zip(times[1:], path[1:])]


class Problem:
    """A posterior over paths, the same on the grid, and a sample of it."""

    def __init__(self, system, grid, kernel, prior, measurements, settings):
        [(name, make)] = system.sensors.items()
        sensors = {name: make()}
        self.posterior = PathPosterior(system.model, sensors, kernel, *prior, measurements, 0)
        filter_ = DiracFeynmanFilter(system.model, grid, sensors, kernel, average_cells=False)
        self.smoothed = smooth(filter_, GridBelief.gaussian(grid, *prior), measurements, 0)
        self.sample = sample(self.posterior, settings, seed=1)
        self.grid = grid

    def exact(self, function):
        """Return the smoothed averages of a function of states, (N + 1, ...)."""
        return np.stack([function(self.grid.points) @ (b.density.ravel() * self.grid.cell_volume)
                         for b in self.smoothed.beliefs])


@cache
def sine_cubic():
    # a step's standard deviation is 0.42, eight cells; the path comes by 0, where signs change
    system = sine_cubic_drift()
    return Problem(system, Grid((-7,), (7,), (280,)),
                   KernelSettings(0.02, tolerance=1e-10), ([0.5], [[1.0]]),
                   window(system, 5, 25, 0.02, [1.0]),
                   SamplerSettings(chains=4, draws=300, warm_up=40, particles=150))


@cache
def coupled():
    # a step's standard deviation is 0.22, two cells; the likelihood's at |x| = 3 is 0.17
    system = coupled_trigonometric()
    return Problem(system, Grid((-5.5, -5.5), (5.5, 5.5), (100, 100)),
                   KernelSettings(0.05, tolerance=1e-8), ([0.5, 0.0], np.eye(2)),
                   window(system, 8, 20, 0.05, [1.2, -0.8]),
                   SamplerSettings(chains=4, draws=250, warm_up=40, particles=200))


PROBLEMS = pytest.mark.parametrize('problem', [sine_cubic, coupled])


@PROBLEMS
@pytest.mark.parametrize('function', [
    lambda x: x, np.abs, np.square, lambda x: (x > 0) * 1.0, lambda x: (x[0] > 0) * x[-1],
    lambda x: np.exp(-np.square(x - 1))])
def test_averages_are_those_of_the_grid_smoother(problem, function):
    found, exact = problem().sample.average(function), problem().exact(function)
    errors = (found.mean - exact) / found.standard_error
    assert np.abs(errors).max() < SIGMAS


@PROBLEMS
def test_marginal_densities_are_those_of_the_grid_smoother(problem):
    drawn, smoothed = problem().sample, problem().smoothed
    for stamp in drawn.stamps_ns[::8]:
        for axis in range(len(drawn.names)):
            exact = smoothed.at(stamp).marginal([axis])
            share = exact.density.reshape(20, -1).sum(axis=1) * exact.grid.cell_volume
            grid = Grid(exact.grid.lower, exact.grid.upper, (20,))
            found = drawn.marginal(stamp, grid, [axis])
            count = drawn.average(lambda x: np.stack([
                (x[axis] >= low) & (x[axis] < low + grid.spacing[0])
                for low in grid.axes[0] - grid.spacing[0] / 2]))
            k = drawn.stamps_ns.index(stamp)
            np.testing.assert_allclose(found.density * grid.cell_volume, count.mean[k],
                                       atol=1e-12)
            # bins with some tens of draws, so that a standard error says something
            some = share > 0.02
            assert some.sum() > 2
            errors = (count.mean[k] - share)[some] / count.standard_error[k][some]
            assert np.abs(errors).max() < SIGMAS


@PROBLEMS
def test_chains_agree_though_the_posterior_has_humps_with_gaps_between(problem):
    drawn = problem().sample
    positive = problem().exact(lambda x: (x > 0) * 1.0)
    assert np.all((0.05 < positive[5]) & (positive[5] < 0.95))
    assert drawn.r_hat.max() < 1.05
    assert drawn.effective_sample_size.min() > 150


def test_temperatures_change_humps_too():
    settings = SamplerSettings(chains=4, draws=300, warm_up=100, particles=0, moves=2,
                               temperatures=8)
    drawn = sample(coupled().posterior, settings, seed=3)
    assert drawn.r_hat.max() < 1.1
    assert drawn.exchange.shape == (7,) and np.all(drawn.exchange > 0.2)
    for function in (lambda x: x, np.square):
        found, exact = drawn.average(function), coupled().exact(function)
        assert np.abs((found.mean - exact) / found.standard_error).max() < SIGMAS


def test_gradients_alone_do_not_change_humps():
    settings = SamplerSettings(chains=8, draws=60, warm_up=20, particles=0)
    stuck = sample(coupled().posterior, settings, seed=1)
    assert stuck.r_hat.max() > 1.2
    assert np.all(np.isnan(stuck.renewal)) and stuck.acceptance > 0.5


def test_what_all_signs_share_gradients_alone_find():
    # |x| with particles and without: the same, in each hump
    settings = SamplerSettings(chains=16, draws=100, warm_up=60, particles=0, moves=2)
    found = sample(sine_cubic().posterior, settings, seed=2).average(np.square)
    late = slice(10, None)
    errors = (found.mean - sine_cubic().exact(np.square))[late] / found.standard_error[late]
    assert np.abs(errors).max() < SIGMAS


# Ten dimensions


def ring(x, t):
    """Return the drift of coupled_trigonometric continued around a ring of ten."""
    f = np.roll(x, 1, axis=0) - np.roll(x, -1, axis=0)
    f[0::2] += np.cos(x[0::2])
    f[1::2] += np.sin(x[1::2])
    return f


def ring_jacobian(x, t):
    D = np.zeros((10,) + x.shape)
    here = np.arange(10)
    D[here, here - 1], D[here, (here + 1) % 10] = 1, -1
    D[here[0::2], here[0::2]], D[here[1::2], here[1::2]] = -np.sin(x[0::2]), np.cos(x[1::2])
    return D


APART = np.abs(np.subtract.outer(np.arange(10), np.arange(10)))
RING = StateModel(tuple(f'x{i}' for i in range(10)), ring, np.eye(10),
                  0.5**np.minimum(APART, 10 - APART), drift_jacobian=ring_jacobian)
EVERY_OTHER = Sensor(lambda x, t: x[0::2]**2, np.eye(5))


def test_ten_coupled_states_of_which_five_squares_are_seen_agree_with_a_large_particle_filter():
    rng, h, steps = np.random.default_rng(1), 0.05, 12
    mean, covariance = np.full(10, 1.0), 0.2 * np.eye(10)
    start = mean + np.sqrt(0.2) * rng.standard_normal(10)
    path = simulate(RING, start, h * np.arange(steps + 1), rng, substeps=4)
    measured = [(round(k * h * 1e9), 's', measure(EVERY_OTHER, path[k], 0.0, rng))
                for k in range(1, steps + 1)]
    # r = 0, as the particle filter's Euler steps are
    drawn = sample(PathPosterior(RING, {'s': EVERY_OTHER}, KernelSettings(h, r=0.0), mean,
                                 covariance, measured, 0),
                   SamplerSettings(chains=4, draws=300, warm_up=80, particles=0, moves=2,
                                   temperatures=4, least_share=0.3))
    assert drawn.paths.shape == (4, 300, steps + 1, 10)
    assert drawn.r_hat.max() < 1.02
    assert drawn.effective_sample_size.min() > 500

    means = []
    for seed in range(8):
        filter_ = ParticleFilter(RING, {'s': EVERY_OTHER}, h, particles=40_000, seed=seed)
        belief, now = filter_.gaussian(mean, covariance), 0
        for stamp, source, y in measured:
            belief = filter_.predict(belief, now, stamp)
            belief, _ = filter_.correct(belief, y, source, stamp)
            now = stamp
        means.append(np.concatenate([belief.mean(), belief.points**2 @ belief.weights]))
    found = [drawn.average(function) for function in (lambda x: x, np.square)]
    error = np.concatenate([a.standard_error[-1] for a in found])
    error = np.hypot(error, np.std(means, axis=0, ddof=1) / np.sqrt(8))
    errors = (np.concatenate([a.mean[-1] for a in found]) - np.mean(means, axis=0)) / error
    assert np.abs(errors).max() < SIGMAS


# What comes out


TINY = SamplerSettings(chains=3, draws=6, warm_up=4, particles=8, thinning=2)


def test_the_same_seed_gives_the_same_paths_and_another_seed_others():
    one, same, other = (sample(coupled().posterior, TINY, seed=seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(one.paths, same.paths)
    assert np.all(one.paths != other.paths)


def test_progress_is_told_after_every_round():
    told = []
    sample(coupled().posterior, TINY, progress=told.append)
    np.testing.assert_allclose(told, np.arange(1, 17) / 16)


def test_a_sample_can_be_read_at_its_stamps():
    drawn = sample(coupled().posterior, TINY)
    assert drawn.names == ('x1', 'x2') and drawn.paths.shape == (3, 6, 21, 2)
    assert drawn.stamps_ns == coupled().posterior.stamps_ns
    x = drawn.at(100_000_000)
    np.testing.assert_array_equal(x, drawn.paths[:, :, 2])
    flat = x.reshape(-1, 2)
    np.testing.assert_allclose(drawn.mean()[2], flat.mean(axis=0))
    np.testing.assert_allclose(drawn.covariance()[2], np.cov(flat.T, ddof=0))
    assert drawn.average(lambda x: x[0]).mean.shape == (21,)
    box = drawn.marginal(100_000_000, Grid((-1, -9), (0, 9), (2, 3)), [1, 0])
    assert box.mass == pytest.approx(np.mean((flat[:, 1] >= -1) & (flat[:, 1] < 0)))


def test_a_window_without_a_step_is_only_bayes_rule():
    posterior = PathPosterior(StateModel(('x',), lambda x, t: -x, np.eye(1)),
                              {'s': Sensor(lambda x, t: x, [[1.0]])}, KernelSettings(0.1),
                              [1.0], [[1.0]], [(5, 's', [0.0])])
    drawn = sample(posterior, SamplerSettings(particles=16, draws=400)).average(lambda x: x[0])
    assert abs(drawn.mean[0] - 0.5) < SIGMAS * drawn.standard_error[0]


@pytest.mark.parametrize('changes, line', [
    ({'chains': 0}, 'chains: expected 1 or more, got 0'),
    ({'draws': 3}, 'draws: expected 4 or more, got 3'),
    ({'particles': 1}, 'particles: expected 2 or more, or 0 with moves, got 1 with 1 moves'),
    ({'particles': 0, 'moves': 0}, 'particles: expected 2 or more, or 0 with moves, got 0 with 0 '
                                   'moves'),
    ({'moves': 0, 'temperatures': 3}, 'moves: expected 1 or more where there are temperatures, '
                                      'got 0'),
    ({'least_share': 1.0}, 'least_share: expected a share, 0 to below 1, got 1.0'),
    ({'travel': float('nan')}, 'travel: expected a positive number, got nan'),
])
def test_refuses_settings_that_draw_nothing(changes, line):
    with pytest.raises(ValueError) as error:
        SamplerSettings(**changes)
    assert str(error.value) == line


def test_refuses_a_stamp_that_is_none_of_the_path():
    with pytest.raises(ValueError, match='^stamp_ns: expected one of the 21 stamps .* got 3$'):
        sample(coupled().posterior, TINY).at(3)
