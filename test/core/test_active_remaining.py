"""Where active cells were wrong: a prior of all cells, drifts that bend, seams, wide noise."""

import tracemalloc

import numpy as np
from pif_ros.core.active import (
    ActiveBelief, ActiveGridFilter, Patch, RegionSettings, Window)
from pif_ros.core.active.flow import flow
from pif_ros.core.active.focus import focused, loosened
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.systems.robots import position_sensor
import pytest
from scipy import integrate, stats

SECOND = 1_000_000_000


def still(n, noise=0.1):
    return StateModel(tuple('xyz'[:n]), lambda x, t: 0 * x, noise * np.eye(n))


def test_a_prior_of_all_cells_is_focused_as_any_other():
    world, sigma, y = Grid((-50, -50), (50, 50), (100, 100)), 0.1, [3.13, -7.2]
    filter_ = ActiveGridFilter(still(2), world, {'position': position_sensor(sigma)}, 1.0)
    belief, log_evidence = filter_.correct(filter_.uniform(), y, 'position', 0)
    assert log_evidence == pytest.approx(-np.log(100**2), abs=0.005)
    np.testing.assert_allclose(belief.mean(), y, atol=0.02 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance())), sigma, rtol=0.05)


def test_focused_cells_are_hardly_more_than_the_world_has():
    # a stripe from corner to corner, in several parts, of which not all can be halved
    world = Grid((-30, -30), (30, 30), (100, 100))
    x, y = np.meshgrid(*world.axes, indexing='ij')
    prior, posterior = (
        ActiveBelief(world, (Patch(Window.whole(world), p),)).normalised()
        for p in (np.ones_like(x), np.exp(-0.5 * ((x - y - 0.3) / 0.4)**2)))
    finer = focused(prior, posterior, RegionSettings())
    assert 0.8 * world.size < finer.size < 1.05 * world.size


@pytest.mark.parametrize('turn', [3.0, 12.0, 8 * np.pi])
def test_who_turns_in_one_long_step_goes_along_the_arc(turn):
    speed, spread, world = 5.0, 0.02, Grid((-50, -50, -np.pi), (50, 50, np.pi), (100, 100, 180),
                                           (False, False, True))
    model = StateModel(('x', 'y', 'heading'), lambda x, u, t: np.stack(
        [speed * np.cos(x[2]), speed * np.sin(x[2]), u[0] + 0 * x[2]]),
        np.diag([0.1, 0.1, 1e-3]), inputs=('turn',), homogeneous=(0, 1))
    filter_ = ActiveGridFilter(model, world, {}, 1.0)
    belief = filter_.predict(filter_.gaussian([0, 0, 0.3], np.diag([4, 4, spread**2])), 0, SECOND,
                             Controls((0,), ((turn,),), SECOND))
    end = np.exp(1j * 0.3 - spread**2 / 2) * (np.exp(1j * turn) - 1) / (1j * turn) * speed
    np.testing.assert_allclose(belief.mean()[:2], [end.real, end.imag], atol=0.02)


@pytest.mark.parametrize('time_dependent', [False, True])
def test_a_drift_that_bends_on_its_way_is_followed(time_dependent):
    # its slope is nothing where the belief is at first
    model = StateModel(('x',), lambda x, t: (
        4 + 0 * x + 3 * np.sin(12.0 * t) if time_dependent
        else 4 + 3 * np.sin(3 * np.maximum(x, 0))), [[0.0]], time_dependent=time_dependent)
    x = np.array([[-2.3, -2.0, -1.7]])
    window = Window(Grid((-5,), (15,), (400,)), (0,), (50,), (20,))
    end = flow(model, window, x, 0, 2 * SECOND, NO_CONTROLS, 0.0)
    exact = integrate.solve_ivp(lambda t, x: model.drift(x, t), (0, 2), x[0], rtol=1e-9).y[:, -1]
    np.testing.assert_allclose(end[0], exact, atol=0.1 * 0.05)


def test_no_place_of_a_circle_is_another_for_sensor_drift_or_what_is_expected():
    world, lap = Grid((0.0,), (100.0,), (400,), (True,)), 100.0
    found = []
    for ahead in (0.0, 50.0):
        # as tables have it: what is known, is known between the edges
        def place(x, t):
            return np.interp(x, [0, lap], [0, lap]) - ahead + np.where(x < ahead, lap, 0.0)

        model = StateModel(('s',), lambda x, t: np.where(place(x, t) < 50, 3.0, 1.0), [[0.4]])
        filter_ = ActiveGridFilter(model, world, {'lap': Sensor(place, [[0.25]])}, 1.0)
        prior = filter_.gaussian([99.5 + ahead - (ahead > 0) * lap], [[1.0]])
        expected = filter_.predictive(prior, 'lap', 0)
        belief, log_evidence = filter_.correct(prior, [1.0], 'lap', 0)
        belief = filter_.predict(belief, 0, 9 * SECOND)
        found.append([(belief.mean()[0] - ahead) % lap, belief.covariance()[0, 0], log_evidence,
                      expected.log_density([1.0])])
    np.testing.assert_allclose(*found, rtol=1e-9)


def test_noise_much_wider_than_its_cells_makes_few_of_them():
    world, spread = Grid((-50, -50), (50, 50), (100, 100)), 5.0
    filter_ = ActiveGridFilter(still(2, spread), world, {}, 1.0)
    narrow = filter_.gaussian([0, 0], 0.09**2 * np.eye(2))
    filter_.describe()
    tracemalloc.start()
    wide = filter_.predict(narrow, 0, SECOND)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 20 * 8 * world.size
    assert np.diag(wide.covariance()) == pytest.approx(spread**2 + 0.09**2, rel=0.01)


@pytest.mark.parametrize('rho, level', [(0.0, 0), (0.99, 3), (1.0, 4)])
def test_noise_that_is_narrow_across_leaves_fine_cells(rho, level):
    world = Grid((-50, -50), (50, 50), (100, 100))
    patch = Patch(Window(world, (4, 4), (800, 800), (6, 6)), np.ones((6, 6)))
    loose = loosened(patch, 25 * np.array([[1, rho], [rho, 1]]), RegionSettings())
    assert loose.window.level == (level, level)
    assert loose.mass == pytest.approx(patch.mass, rel=1e-12)


def test_a_light_hump_in_the_box_of_a_heavy_one_lives_on():
    # beside a narrow diagonal hump, so that their boxes overlap
    world, place, share = Grid((-50, -50), (50, 50), (200, 200)), [9.0, -9.0], 1e-7
    heavy = np.array([[60, 59.5], [59.5, 60]])
    filter_ = ActiveGridFilter(still(2, 0.3), world, {'position': position_sensor(1.0)}, 1.0,
                               region=RegionSettings(finest=0))
    belief = filter_.mixed(filter_.gaussian([0, 0], heavy),
                           filter_.gaussian(place, np.eye(2)), share, 0)
    for k in range(5):
        belief = filter_.predict(belief, k * SECOND, (k + 1) * SECOND)
    _, log_evidence = filter_.correct(belief, place, 'position', 5 * SECOND)
    more = (1 + 5 * 0.09) * np.eye(2)
    exact = ((1 - share) * stats.multivariate_normal([0, 0], heavy + more).pdf(place)
             + share * stats.multivariate_normal(place, np.eye(2) + more).pdf(place))
    assert log_evidence == pytest.approx(np.log(exact), abs=0.01)


def test_what_a_step_leaves_out_is_no_more_where_it_is_made_in_many():
    # the second state relaxes so fast that a step is made in two hundred
    rate, spread = 50.0, 0.2
    model = StateModel(('x', 'v'), lambda x, t: np.stack([1.037 + 0 * x[0], -rate * x[1]]),
                       np.diag([0.5, spread * np.sqrt(2 * rate)]), homogeneous=(0,))
    filter_ = ActiveGridFilter(model, Grid((0, -1), (100, 1), (200, 20)), {}, 1.0)
    belief = filter_.predict(filter_.gaussian([10, 0], np.diag([1, spread**2])), 0, 2 * SECOND)
    assert belief.dropped < 5 * RegionSettings().negligible


def test_what_the_first_cells_allow_is_possible_though_finer_ones_miss_it():
    # a light barrier, in sight from the centre of a wide cell and of none of its halves
    world = Grid((0,), (100,), (400,))
    barrier = Sensor(lambda x, t: np.where(np.abs(x - 50.125) < 0.05, 1.0, np.nan), [[0.25]])
    filter_ = ActiveGridFilter(still(1), world, {'barrier': barrier}, 1.0)
    belief, log_evidence = filter_.correct(filter_.gaussian([50], [[4]]), [1.0], 'barrier', 0)
    assert np.isfinite(log_evidence)
    assert belief.mass == pytest.approx(1, abs=1e-4)
    assert belief.mean() == pytest.approx([50.125], abs=0.125)


@pytest.mark.parametrize('period', [0.0, 2.0])
def test_noise_that_comes_to_be_correlated_among_four_is_refused_at_once(period):
    late = np.eye(4) + 0.3 * (1 - np.eye(4))
    model = StateModel(tuple('xyzw'), lambda x, t: 0 * x, 0.1 * np.eye(4),
                       lambda t: np.eye(4) if t < 1 else late, period=period)
    with pytest.raises(ValueError, match="region: expected 'full'"):
        ActiveGridFilter(model, Grid((-2,) * 4, (2,) * 4, (8,) * 4), {}, 1.0)


def test_a_light_patch_in_a_stiff_place_does_not_widen_another():
    model = StateModel(('x',), lambda x, t: np.where(
        x < 50, 1.037, 1.037 + 40 * np.sin(x - 50)), [[0.5]])
    filter_ = ActiveGridFilter(model, Grid((0,), (100,), (200,)), {}, 1.0)
    far = filter_.gaussian([80], [[1]])
    both = filter_.mixed(filter_.gaussian([10], [[1]]), far, 1e-6, 0)
    both = filter_.predict(both, 0, 2 * SECOND)
    main = ActiveBelief(both.base, (max(both.patches, key=lambda patch: patch.mass),))
    assert main.mean() == pytest.approx([10 + 2 * 1.037], abs=1e-3)
    assert main.covariance() == pytest.approx(np.array([[1 + 2 * 0.25]]), rel=0.01)
    assert both.mass - main.mass == pytest.approx(1e-6, rel=0.02)
