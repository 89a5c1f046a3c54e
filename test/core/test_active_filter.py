"""The filter that works where the belief is: against exact answers and the filter on all cells."""

import dataclasses
import math

import numpy as np
from oracles import linear_moments
from pif_ros.core.active import ActiveBelief, ActiveGridFilter, compiled, RegionSettings
from pif_ros.core.active.belief import Patch
from pif_ros.core.active.window import Window
from pif_ros.core.controls import Controls
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems import coupled_trigonometric, ornstein_uhlenbeck
from pif_ros.core.systems.robots import position_sensor, range_sensor, unicycle_2d
import pytest

SECOND = 1_000_000_000
#: A world of 10^12 cells.
VAST = Grid((-1e5, -1e5), (1e5, 1e5), (10**6, 10**6))


def spiral(sigma=0.4):
    """Return a linear model in two states, which turn and draw together."""
    A = np.array([[-0.1, 0.35], [-0.35, -0.1]])
    return A, StateModel(('x', 'y'), lambda x, t: np.tensordot(A, x, axes=1),
                         sigma * np.eye(2))


def test_predicts_as_the_kalman_filter_does_second_order_in_the_step():
    A, model = spiral()
    mean, C = np.array([2.0, -1.0]), np.diag([0.5, 0.2])
    F, noise = linear_moments(A, 0.16 * np.eye(2), 2.0)
    errors = []
    for step in (1.0, 0.5, 0.25):
        grid = Grid((-8, -8), (8, 8), (160, 160))
        filter_ = ActiveGridFilter(model, grid, {}, step, region=RegionSettings(1e-9, finest=0))
        belief = filter_.predict(filter_.gaussian(mean, C), 0, 2 * SECOND)
        np.testing.assert_allclose(belief.mean(), F @ mean, atol=1e-4)
        errors.append(np.linalg.norm(belief.covariance() - F @ C @ F.T - noise))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(orders > 1.7), errors
    assert errors[-1] < 1e-3


@pytest.mark.parametrize('heading', [0.0, 3.0])
def test_correlated_noise_has_its_covariance(heading):
    e = np.array([[0.8, 0.0, 0.0], [0.5, 0.3, 0.0], [-0.1, 0.2, 0.4]])
    model = StateModel(('x', 'y', 'theta'), lambda x, t: np.zeros_like(x), e)
    world = Grid((-20, -20, -np.pi), (20, 20, np.pi), (100, 100, 48), (False, False, True))
    filter_ = ActiveGridFilter(model, world, {}, 0.5, region=RegionSettings(1e-9, finest=0))
    C = np.diag([0.5, 0.5, 0.1])
    belief = filter_.predict(filter_.gaussian([1.0, 2.0, heading], C), 0, SECOND // 2)
    np.testing.assert_allclose(belief.mean()[:2], [1.0, 2.0], atol=1e-6)
    np.testing.assert_allclose(belief.covariance(), C + 0.5 * e @ e.T, atol=2e-4)


def test_corrects_as_the_kalman_filter_does_by_what_is_narrower_than_its_cells():
    _, model = spiral()
    grid = Grid((-50, -50), (50, 50), (100, 100))
    sensors = {'position': position_sensor(0.15)}
    filter_ = ActiveGridFilter(model, grid, sensors, 1.0, region=RegionSettings(1e-7, 2.0, 6))
    P = np.array([[9.0, 2.0], [2.0, 6.0]])
    mean, y, R = np.array([3.0, 4.0]), np.array([5.1, 2.3]), 0.15**2 * np.eye(2)
    belief, log_evidence = filter_.correct(filter_.gaussian(mean, P), y, 'position', 0)
    S = P + R
    # halves of cells a third as wide as a Gaussian know its density to a quarter of a per cent
    gain = P @ np.linalg.inv(S)
    v = y - mean
    assert log_evidence == pytest.approx(
        -0.5 * (v @ np.linalg.solve(S, v) + np.linalg.slogdet(2 * np.pi * S)[1]), abs=4e-3)
    np.testing.assert_allclose(belief.mean(), mean + gain @ v, atol=2e-3)
    # a halving keeps moments, but for what is cut off far out: some per cent of a variance
    np.testing.assert_allclose(belief.covariance(), P - gain @ P, atol=0.02 * 0.15**2)
    assert min(belief.patches[0].window.level) >= 3


def test_equals_the_filter_on_all_cells_through_many_measurements():
    system = coupled_trigonometric()
    sensors = {'squares': system.sensors['squares']()}
    grid = Grid((-6, -6), (6, 6), (124, 124))
    active = ActiveGridFilter(system.model, grid, sensors, 0.05,
                              region=RegionSettings(1e-7, finest=0))
    full = DiracFeynmanFilter(system.model, grid, sensors, KernelSettings(0.01))
    a, b = active.gaussian([0.5, 0.5], np.eye(2)), full.gaussian([0.5, 0.5], np.eye(2))
    rng = np.random.default_rng(0)
    evidence = np.zeros(2)
    for k in range(6):
        y = np.square([1.0, 1.5]) + rng.normal(0, 1, 2)
        now, then = k * SECOND // 20, (k + 1) * SECOND // 20
        a, b = active.predict(a, now, then), full.predict(b, now, then)
        (a, first), (b, second) = (f.correct(p, y, 'squares', then)
                                   for f, p in ((active, a), (full, b)))
        evidence += first, second
    difference = np.abs(a.on(grid, (0, 1)).density - b.density).sum() * grid.cell_volume
    # the kernel on all cells is of first order in its step of 0.01 s
    assert difference < 0.01
    np.testing.assert_allclose(*evidence, atol=0.005)
    np.testing.assert_allclose(a.mean(), b.mean(), atol=0.005)


def test_a_vast_world_costs_nothing():
    A, model = spiral()
    sensors = {'range': range_sensor((0.0, 0.0), 0.3)}
    filters = [ActiveGridFilter(model, world, sensors, 0.5)
               for world in (VAST, Grid((-20, -20), (20, 20), (200, 200)))]
    sizes, means = [], []
    for filter_ in filters:
        belief = filter_.predict(filter_.gaussian([3.0, 1.0], np.eye(2)), 0, SECOND)
        belief, _ = filter_.correct(belief, [2.0], 'range', SECOND)
        sizes.append(belief.size)
        means.append(belief.mean())
    assert sizes[0] == sizes[1] < 10_000
    np.testing.assert_allclose(*means, atol=1e-9)


def test_whole_steps_may_be_cut_into_any_number_of_calls_to_the_bit():
    _, model = spiral()
    filter_ = ActiveGridFilter(model, VAST, {}, 0.25)
    start = filter_.gaussian([3.0, 1.0], np.eye(2))
    one = filter_.predict(start, 0, SECOND)
    two = filter_.predict(filter_.predict(start, 0, SECOND // 2), SECOND // 2, SECOND)
    assert [p.window for p in one.patches] == [p.window for p in two.patches]
    for a, b in zip(one.patches, two.patches):
        np.testing.assert_array_equal(a.density, b.density)


def test_a_mode_that_evidence_feeds_again_comes_back_as_the_exact_answer_has_it():
    # two humps far apart; measurements deny the second to 1e-10, and then speak for it
    model = StateModel(('x',), lambda x, t: np.zeros_like(x), 0.05 * np.eye(1))
    sensor = Sensor(lambda x, t: np.tanh(x), 0.45**2 * np.eye(1))
    grid = Grid((-40.0,), (40.0,), (800,))
    active = ActiveGridFilter(model, grid, {'side': sensor}, 1.0)
    full = DiracFeynmanFilter(model, grid, {'side': sensor}, KernelSettings(1.0))
    hump = full.gaussian([15.0], [[1.0]]).density + full.gaussian([-15.0], [[1.0]]).density
    a = dataclasses.replace(active.uniform(), patches=(dataclasses.replace(
        active.uniform().patches[0], density=0.5 * hump),))
    b = dataclasses.replace(full.uniform(), density=0.5 * hump)
    lightest = 1.0
    for k, y in enumerate([1.2] * 2 + [-1.2] * 4):
        now, then = k * SECOND, (k + 1) * SECOND
        a = active.correct(active.predict(a, now, then), [y], 'side', then)[0]
        b = full.correct(full.predict(b, now, then), [y], 'side', then)[0]
        left = b.density[grid.axes[0] < 0].sum() * grid.cell_volume
        lightest = min(lightest, left)
        found = a.on(grid, (0,)).density[grid.axes[0] < 0].sum() * grid.cell_volume
        assert found == pytest.approx(left, rel=1e-3)
    assert lightest < 1e-9 and left > 0.99


def test_an_impossible_measurement_leaves_the_belief_alone():
    _, model = spiral()
    sensor = Sensor(lambda x, t: np.log(x[:1] - 30.0), np.eye(1))
    filter_ = ActiveGridFilter(model, Grid((-20, -20), (20, 20), (40, 40)), {'log': sensor}, 1.0)
    belief = filter_.gaussian([0.0, 0.0], np.eye(2))
    after, log_evidence = filter_.correct(belief, [0.0], 'log', 0)
    assert after is belief
    assert log_evidence == -np.inf


def test_a_measurement_fifty_deviations_away_is_survived():
    _, model = spiral()
    sensors = {'position': position_sensor(0.1)}
    filter_ = ActiveGridFilter(model, Grid((-20, -20), (20, 20), (40, 40)), sensors, 1.0)
    belief, log_evidence = filter_.correct(
        filter_.gaussian([0.0, 0.0], np.eye(2)), [5.0, 5.0], 'position', 0)
    assert np.isfinite(log_evidence)
    assert belief.mass == pytest.approx(1, abs=1e-4)
    assert np.all(np.isfinite(belief.covariance()))


def test_what_leaves_the_world_is_counted_as_lost():
    model = StateModel(('x',), lambda x, t: np.ones_like(x), 1e-3 * np.eye(1))
    filter_ = ActiveGridFilter(model, Grid((-10.0,), (10.0,), (200,)), {}, 0.5)
    belief = filter_.predict(filter_.gaussian([9.0], [[0.04]]), 0, SECOND)
    # the middle of the belief is at the edge
    assert belief.mass == pytest.approx(0.5, abs=0.02)
    assert belief.dropped < 1e-3


def test_a_robot_drives_along_its_exact_arc():
    model = unicycle_2d(1e-3, 1e-3).model
    world = Grid((-20, -20, -np.pi), (20, 20, np.pi), (80, 80, 72), (False, False, True))
    filter_ = ActiveGridFilter(model, world, {}, 10.0)
    controls = Controls((0, 2 * SECOND), ((1.0, 0.5), (2.0, -0.3)), 10 * SECOND)
    start = filter_.gaussian([1.0, 2.0, 3.0], np.diag([0.01, 0.01, 1e-4]))
    belief = filter_.predict(start, 0, 3 * SECOND, controls)
    x, y, theta = 1.0, 2.0, 3.0
    for v, omega, seconds in ((1.0, 0.5, 2.0), (2.0, -0.3, 1.0)):
        x += v / omega * (np.sin(theta + omega * seconds) - np.sin(theta))
        y -= v / omega * (np.cos(theta + omega * seconds) - np.cos(theta))
        theta += omega * seconds
    # a spread heading bends the mean by about its variance
    np.testing.assert_allclose(belief.mean(), [x, y, theta - 2 * np.pi], atol=2e-3)


def test_control_changes_at_its_stamp_and_not_at_a_step():
    model = unicycle_2d(0.1, 0.05).model
    world = Grid((-20, -20, -np.pi), (20, 20, np.pi), (80, 80, 72), (False, False, True))
    filter_ = ActiveGridFilter(model, world, {}, 1.0)
    start = filter_.gaussian([0.0, 0.0, 0.0], np.diag([0.04, 0.04, 0.01]))
    stop = Controls((0, int(0.3 * SECOND)), ((1.0, 0.0), (0.0, 0.0)), 10 * SECOND)
    belief = filter_.predict(start, 0, SECOND, stop)
    # cos of a heading with a variance from 0.01 to 0.011
    assert belief.mean()[0] == pytest.approx(0.3 * np.exp(-0.005), abs=5e-4)


def test_finds_itself_from_anywhere_and_any_heading():
    system = unicycle_2d(0.05, 0.02)
    world = Grid((-15, -15, -np.pi), (15, 15, np.pi), (60, 60, 36), (False, False, True))
    landmarks = [(-10.0, -8.0), (11.0, -3.0), (2.0, 12.0)]
    sensors = {str(k): range_sensor(place, 0.3) for k, place in enumerate(landmarks)}
    filter_ = ActiveGridFilter(system.model, world, sensors, 1.0)
    rng, belief = np.random.default_rng(3), filter_.uniform()
    x, controls = np.array([3.0, -6.0, 1.0]), Controls((0,), ((1.0, 0.2),), 100 * SECOND)
    for k in range(1, 15):
        x += np.array([np.cos(x[2] + 0.1), np.sin(x[2] + 0.1), 0.2])
        belief = filter_.predict(belief, (k - 1) * SECOND, k * SECOND, controls)
        name = str(k % 3)
        y = np.hypot(*(x[:2] - landmarks[k % 3])) + rng.normal(0, 0.3)
        belief, _ = filter_.correct(belief, [y], name, k * SECOND)
    d = world.wrap(belief.mean() - x)
    assert d @ np.linalg.solve(belief.covariance(), d) < 16.3   # 99.9 % of chi squared of 3
    assert np.hypot(*d[:2]) < 0.6 and belief.size < world.size / 4


@pytest.mark.skipif(not compiled.is_available(), reason='numba is not installed')
def test_compiled_loops_and_plain_ones_give_the_same_belief(monkeypatch):
    _, model = spiral()
    filter_ = ActiveGridFilter(model, VAST, {'range': range_sensor((0.0, 0.0), 0.3)}, 0.5)
    beliefs = []
    for way in (True, False):
        monkeypatch.setattr(compiled, 'is_available', lambda: way)
        belief = filter_.gaussian([3.0, 1.0], np.eye(2))
        for k in range(3):
            belief = filter_.predict(belief, k * SECOND, (k + 1) * SECOND)
            belief, _ = filter_.correct(belief, [2.0], 'range', (k + 1) * SECOND)
        beliefs.append(belief)
    a, b = beliefs
    assert [p.window for p in a.patches] == [p.window for p in b.patches]
    for p, q in zip(a.patches, b.patches):
        # sums in another order
        np.testing.assert_allclose(p.density, q.density, rtol=1e-9, atol=1e-15)


def lorenz_without_noise():
    def drift(x, t):
        return np.stack([4 * (x[1] - x[0]), -x[1] - x[0] * x[2], x[0] * x[1] - x[2] - 48])

    return StateModel(('x', 'y', 'z'), drift, np.zeros((3, 1)))


def test_without_noise_the_density_is_that_of_many_states_that_were_simulated():
    mean, cell, model = np.array([-11.5, -10.0, 9.5]), 0.5, lorenz_without_noise()
    world = Grid((-30, -30, -40), (30, 30, 30), (120, 120, 140))
    filter_ = ActiveGridFilter(model, world, {}, 1.0, region=RegionSettings(finest=0))
    belief = filter_.predict(filter_.gaussian(mean, np.eye(3)), 0, SECOND // 3)
    x = np.random.default_rng(0).normal(size=(3, 300_000)) + mean[:, None]
    for _ in range(40):
        h = 1 / 120
        k1 = model.drift(x, 0.0)
        k2 = model.drift(x + h / 2 * k1, 0.0)
        k3 = model.drift(x + h / 2 * k2, 0.0)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + model.drift(x + h * k3, 0.0))
    index = np.floor((x - np.array(world.lower)[:, None]) / cell).astype(int)
    share = np.bincount(np.ravel_multi_index(tuple(index), world.shape),
                        minlength=world.size) / x.shape[1]
    found = belief.on(world, (0, 1, 2)).density.ravel() * world.cell_volume
    # 0.02 of it is the noise of so many; moving mass from neighbour to neighbour has 0.9
    assert np.abs(found - share).sum() < 0.2
    np.testing.assert_allclose(belief.mean(), x.mean(axis=1), atol=0.01)


def test_without_noise_a_density_is_carried_as_the_flow_carries_it():
    # a rotation by a right angle puts every cell onto another
    turn = StateModel(('x', 'y'), lambda x, t: np.stack([-x[1], x[0]]) * np.pi / 2,
                      np.zeros((2, 1)))
    world = Grid((-8, -8), (8, 8), (64, 64))
    filter_ = ActiveGridFilter(turn, world, {}, 10.0, region=RegionSettings(1e-9, finest=0))
    C = np.array([[1.0, 0.3], [0.3, 0.5]])
    belief = filter_.predict(filter_.gaussian([3.0, 1.0], C), 0, SECOND)
    # seven Runge-Kutta steps of pi / 14, each of which misses (pi / 14)^5 / 120 of the radius
    missed = 7 * (np.pi / 14)**5 / 120 * np.hypot(3.0, 1.0)
    np.testing.assert_allclose(belief.mean(), [-1.0, 3.0], atol=missed)
    # what a place off the nodes is shared with, a quarter of a cell squared each time at most
    np.testing.assert_allclose(belief.covariance(), [[0.5, -0.3], [-0.3, 1.0]], atol=0.02)


def test_a_cell_is_never_made_where_there_is_no_room():
    model = ornstein_uhlenbeck().model
    filter_ = ActiveGridFilter(model, Grid((-1000.0,), (1000.0,), (10,)),
                               {'x': Sensor(lambda x, t: x, 1e-4 * np.eye(1))}, 0.1)
    belief, _ = filter_.correct(filter_.uniform(), [3.0], 'x', 0)
    assert belief.size <= 10


@pytest.mark.parametrize('model, told', [
    (StateModel(('x',), lambda x, t: -x, lambda x, t: x[None], multiplicative=True),
     'depends on the state'),
    (StateModel(tuple('abcd'), lambda x, t: -x, np.eye(4) + 0.1), 'at most 3 axes')])
def test_noise_that_it_cannot_carry_is_refused_in_a_line(model, told):
    n = model.ndim
    with pytest.raises(ValueError, match=told):
        ActiveGridFilter(model, Grid((-5,) * n, (5,) * n, (10,) * n), {}, 0.1)


@pytest.mark.parametrize('settings', [{'negligible': 0.0}, {'negligible': 0.5},
                                      {'resolution': 0.1}, {'finest': -1}, {'finest': 1.5}])
def test_settings_that_make_no_sense_are_refused_by_name(settings):
    with pytest.raises(ValueError, match=f'^{next(iter(settings))}: expected '):
        RegionSettings(**settings)


def test_a_sensor_that_sees_some_states_says_what_it_would_cell_by_cell():
    model = unicycle_2d(0.1, 0.05).model
    world = Grid((-8, -8, -np.pi), (8, 8, np.pi), (32, 32, 24), (False, False, True))
    seen = range_sensor((1.0, 2.0), 0.2)
    sensors = {'some': seen, 'all': dataclasses.replace(seen, states=None)}
    filter_ = ActiveGridFilter(model, world, sensors, 1.0, region=RegionSettings(finest=1))
    belief = filter_.gaussian([0.0, 0.0, 1.0], np.diag([1.0, 1.0, 0.2]))
    (a, first), (b, second) = (filter_.correct(belief, [2.5], name, 0) for name in sensors)
    assert first == pytest.approx(second, abs=1e-9)
    # cells of next to no mass may be averaged over by the one and not by the other
    np.testing.assert_allclose(a.on(world, (0, 1, 2)).density, b.on(world, (0, 1, 2)).density,
                               atol=1e-9)


@pytest.mark.parametrize('turns', [0.25, 1.0, 1.25, 2.5, -1.5])
def test_round_a_circle_a_step_may_go_any_number_of_turns(way, turns):
    circle = Grid((-np.pi,), (np.pi,), (64,), (True,))
    model = StateModel(('heading',), lambda x, t: np.full_like(x, 2 * np.pi * turns),
                       0.2 * np.eye(1))
    filter_ = ActiveGridFilter(model, circle, {}, 1.0)
    ended = filter_.predict(filter_.gaussian([-1.0], [[0.05]]), 0, SECOND)
    expected = (-1.0 + 2 * np.pi * turns + np.pi) % (2 * np.pi) - np.pi
    assert ended.mean()[0] == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize('bad', [np.nan, np.inf])
@pytest.mark.parametrize(('centre', 'noise'), [(1.5, 0.05), (1.5, 0.7), (7.0, 0.7), (7.0, 0.05)])
def test_what_the_drift_does_not_tell_is_lost_and_nothing_else(way, bad, centre, noise):
    world = Grid((-10.0, -10.0), (10.0, 10.0), (80, 80))

    model = StateModel(('x', 'y'), lambda x, t: np.where(x[0] > 2.0, bad, np.zeros_like(x)),
                       noise * np.eye(2))
    filter_ = ActiveGridFilter(model, world, {}, 0.1)
    before = filter_.gaussian([centre, 0.0], 0.3 * np.eye(2))
    after = filter_.predict(before, 0, SECOND // 10)
    known = 0.5 * (1 + math.erf((2.0 - centre) / math.sqrt(0.6)))
    assert after.mass == pytest.approx(known, abs=0.06)
    assert after.mass + after.dropped == pytest.approx(1.0, abs=1e-4)


def test_what_is_left_of_a_belief_at_the_edge_of_the_world_stays_to_the_last_plane():
    world = Grid((0.0, 0.0), (20.0, 20.0), (20, 20))
    shift = StateModel(('x', 'y'), lambda x, t: np.stack([np.full_like(x[0], 7.0), 0 * x[1]]),
                       np.zeros((2, 1)))
    filter_ = ActiveGridFilter(shift, world, {}, 1.0, region=RegionSettings(finest=0))
    p = np.zeros((20, 20))
    p[12:16, 8:12] = 1 / 16
    # the first column comes to lie on the last of the world, three others beyond
    belief = filter_.predict(ActiveBelief(world, (Patch(Window.whole(world), p),)), 0, SECOND)
    assert belief.mass == pytest.approx(1 / 4, rel=1e-6)
    assert belief.mean() == pytest.approx([19.5, 10.0])


@pytest.mark.usefixtures('way')
def test_what_turns_more_than_once_in_a_step_is_where_it_turns_to():
    # a phase with its rate, of which few cells of the box around them are held
    model = StateModel(('phase', 'rate', 'z'), lambda x, t: np.stack([x[1], 0 * x[1], 0 * x[1]]),
                       np.eye(3), 1e-4 * np.eye(3))
    world = Grid((0.0, 15.0, -4.0), (2 * np.pi, 25.0, 4.0), (64, 200, 80), (True, False, False))
    filter_ = ActiveGridFilter(model, world, {}, 1.0)
    belief = filter_.predict(filter_.gaussian([1.0, 20.0, 0.0], 0.01 * np.eye(3)), 0, 3 * SECOND)
    assert belief.mean() == pytest.approx([61 % (2 * np.pi), 20.0, 0.0], abs=0.005)
    # the rate's deviation for three seconds, the phase's own, and the noise of both
    exact = np.sqrt(0.01 * 9 + 0.01 + 1e-4 * (3 + 27 / 3))
    assert np.sqrt(belief.covariance()[0, 0]) == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize('heading', [-3.14159, -3.1, -2.9, -0.1, 3.1])
def test_a_prior_may_lie_anywhere_on_a_circle(heading):
    world = Grid((-5, -5, -np.pi), (5, 5, np.pi), (40, 40, 24), (False, False, True))
    filter_ = ActiveGridFilter(unicycle_2d().model, world, {}, 0.1)
    belief = filter_.gaussian([1.0, -2.0, heading], 0.01 * np.eye(3))
    off = belief.mean() - [1.0, -2.0, heading]
    off[2] = math.remainder(off[2], 2 * np.pi)
    assert np.abs(off).max() < 1e-3
    assert np.diag(belief.covariance()) == pytest.approx(0.01, rel=0.02)
