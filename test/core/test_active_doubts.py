"""Where active cells were wrong: focusing, noise along a line, many turns, hidden rates, edges."""

import numpy as np
from pif_ros.core.active import ActiveGridFilter, RegionSettings
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.resolution import halved, paired
from pif_ros.core.active.transport import heated
from pif_ros.core.active.window import Window
from pif_ros.core.estimates import Measurement
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.saved import arrays_of, memory_from
from pif_ros.core.systems.robots import position_sensor
from pif_ros.core.tracker import Tracker
import pytest
from scipy import stats

SECOND = 1_000_000_000


def still(n, noise=0.1):
    return StateModel(tuple('xyz'[:n]), lambda x, t: 0 * x, noise * np.eye(n))


def test_focusing_has_each_cell_of_the_prior_once():
    # a narrow stripe across many cells, of which focusing keeps several parts that touch
    world = Grid((-30, -30), (30, 30), (300, 300))
    stripe = Sensor(lambda x, t: x[:1] - x[1:], [[0.0025]])
    filter_ = ActiveGridFilter(still(2), world, {'stripe': stripe}, 1.0)
    prior = filter_.gaussian([1.0, 0.0], 9 * np.eye(2))
    posterior, log_evidence = filter_.correct(prior, [0.3], 'stripe', 0)
    exact = stats.norm(1.0, np.sqrt(18 + 0.0025)).logpdf(0.3)
    assert log_evidence == pytest.approx(exact, abs=0.005)
    assert np.diag(posterior.covariance()) == pytest.approx(9 - 81 / 18.0025, rel=1e-3)
    assert len(posterior.patches) > 1


@pytest.mark.parametrize('own', [0.0, 1e-3, 1e-2])
def test_noise_along_a_line_goes_on_at_every_width_of_the_cells(own):
    e = np.array([[0.05], [0.2]]) if not own else np.array([[0.05, own, 0], [0.2, 0, own]])
    model = StateModel(('x', 'heading'), lambda x, t: 0 * x, e)
    world = Grid((-10, -np.pi), (10, np.pi), (40, 72), (False, True))
    compass = Sensor(lambda x, t: x[1:], [[1e-4]], states=(1,))
    filter_ = ActiveGridFilter(model, world, {'compass': compass}, 0.1)
    belief = filter_.gaussian([0.0, 0.5], np.diag([4.0, 0.04]))
    for k in range(4):
        belief, _ = filter_.correct(belief, [0.5], 'compass', k * SECOND // 2)
        belief = filter_.predict(belief, k * SECOND // 2, (k + 1) * SECOND // 2)
    assert belief.mass == pytest.approx(1, abs=1e-3)
    assert belief.covariance()[1, 1] == pytest.approx(0.04 / 2 + 1e-4, rel=0.1)


@pytest.mark.parametrize('stretch', [1.0, 0.07, 1 / 3, np.sqrt(2), 16.3])
@pytest.mark.parametrize('rest', [0.0, 1e-9, 1e-3])
def test_short_directions_make_a_covariance_but_for_a_share_of_its_variances(stretch, rest):
    v = np.array([1.0, stretch])
    D = np.outer(v, v) + rest * np.eye(2)
    axes, others = integer_directions(D, 32)
    found = np.diag(axes) + sum(s * np.outer(d, d) for s, d in others)
    assert np.all(axes >= 0) and all(s > 0 and np.abs(d).max() <= 32 for s, d in others)
    assert found[0, 1] == pytest.approx(D[0, 1], rel=1e-9)
    more = np.diag(found) - np.diag(D)
    assert more.min() > -1e-9 and more.max() < D.max() / 32**2 / 2


def test_three_states_on_a_line_have_short_directions_too():
    D = np.outer([1.0, 0.37, 2.2], [1.0, 0.37, 2.2])
    axes, others = integer_directions(D, 32)
    found = np.diag(axes) + sum(s * np.outer(d, d) for s, d in others)
    np.testing.assert_allclose(found - np.diag(np.diag(found)), D - np.diag(np.diag(D)), rtol=1e-9)
    assert np.all(np.diag(found) - np.diag(D) < D.max() / 32**2 / 2)


def test_whoever_turns_more_often_than_the_others_is_at_his_own_angle():
    # rates of up to 20 turn up to six times in a step about the middle's none
    model = StateModel(('phase', 'rate'), lambda x, t: np.stack([x[1], 0 * x[1]]),
                       np.eye(2), np.diag([0.15**2, 0.05**2]))
    world = Grid((0.0, -20.0), (2 * np.pi, 20.0), (36, 400), (True, False))
    filter_ = ActiveGridFilter(model, world, {}, 1.0, region=RegionSettings(finest=0))
    x, rate = np.meshgrid(*world.axes, indexing='ij')
    p = np.exp(-0.5 * (np.angle(np.exp(1j * (x - 1))) / 0.3)**2)
    window = Window.whole(world)
    belief = filter_.predict(ActiveBelief(world, (Patch(window, p),)).normalised(), 0, SECOND)
    shown = belief.on(world, (0, 1)).density
    fast = np.abs(rate) > 14
    turn = (shown * np.exp(1j * (x - 1 - rate)))[fast].sum() / shown[fast].sum()
    # of the phase's own spread, its noise, and half of the rate's
    exact = np.exp(-(0.3**2 + 0.15**2 + 0.05**2 / 3) / 2)
    assert turn.real == pytest.approx(exact, abs=0.01)


@pytest.mark.parametrize('box', [2.0, 2.3])
def test_a_rate_that_hides_at_regular_places_is_seen(box):
    model = StateModel(('x',), lambda x, t: 3 * np.cos(2 * np.pi * x), [[0.2]])
    world = Grid((-box,), (box,), (401,))
    far = ActiveGridFilter(model, world, {}, 0.5)
    start = far.gaussian([0.0], [[0.25]])
    near = ActiveGridFilter(model, world, {}, 0.002)
    one, many = (each.predict(start, 0, SECOND // 2).on(world, (0,)) for each in (far, near))
    wave = np.sin(2 * np.pi * world.axes[0])
    assert one.density @ wave / one.density.sum() == pytest.approx(
        many.density @ wave / many.density.sum(), abs=0.005)


def test_a_rate_that_hides_at_the_stamps_is_seen():
    def gain(t):
        return 40 * np.sin(np.pi * t)**2

    model = StateModel(('x',), lambda x, t: gain(t) * (0.5 - x), [[0.1]], time_dependent=True)
    world = Grid((-5,), (5,), (400,))
    long, short = (ActiveGridFilter(model, world, {}, step) for step in (1.0, 0.01))
    start = long.gaussian([2.0], [[0.1]])
    one, many = (each.predict(start, 0, SECOND) for each in (long, short))
    assert one.mass == pytest.approx(1, abs=2e-3)
    assert one.mean() == pytest.approx(many.mean(), abs=1e-3)


@pytest.mark.parametrize('noise', [0.0, 0.1])
def test_a_drift_that_would_take_for_ever_is_refused_with_how_stiff_it_is(noise):
    world, model = Grid((0.0,), (4.0,), (400,)), StateModel(
        ('x',), lambda x, t: x**-3, [[noise]], drift_jacobian=lambda x, t: -3 * x[None]**-4)
    filter_ = ActiveGridFilter(model, world, {}, 0.1)
    # in the first cell, at 0.005, in the step of 0.1 s
    with pytest.raises(ValueError, match='^drift: .* at most 50000 times in a step of 0.1 s, got '
                                         f'{0.3 * 0.005**-4:.2g} times'.replace('+', r'\+')):
        filter_.predict(filter_.uniform(), 0, SECOND)
    assert filter_.predict(filter_.gaussian([2.0], [[0.01]]), 0, SECOND).mean()[0] > 2


def test_noise_much_wider_than_the_world_is_cut_to_it():
    world = Grid((-5, -5), (5, 5), (100, 100))
    patch = Patch(Window(world, (0, 0), (40, 40), (20, 20)), np.ones((20, 20)))
    wide = heated(patch, np.full(2, 1e8))
    assert max(wide.window.shape) <= 20 + 2 * 100
    share = wide.density.sum() / patch.density.sum()
    # of a Gaussian a hundred times as wide as the world
    assert share == pytest.approx((2 * stats.norm.cdf(100.5 / 1e4) - 1)**2, rel=0.01)


@pytest.mark.parametrize('offset, count', [(0, 5), (1, 4), (15, 5), (16, 4), (0, 20), (3, 6)])
def test_cells_stay_in_the_world_whatever_their_width(offset, count):
    line = Grid((0.0,), (20.0,), (20,))
    rng = np.random.default_rng(offset)
    patch = Patch(Window(line, (0,), (offset,), (count,)), rng.random(count))
    fine = halved(halved(patch, 0), 0)
    for each in (halved(patch, 0), fine, paired(fine, 0), paired(paired(fine, 0), 0)):
        window = each.window
        assert window.offset[0] >= 0
        assert window.offset[0] + window.shape[0] <= window.cells[0]
        assert each.mass == pytest.approx(patch.mass, rel=1e-12)


@pytest.mark.parametrize('sigma', [0.05, 0.3, 1.0])
def test_what_is_believed_at_the_edge_of_the_world_is_saved_and_gone_on_from(sigma):
    rng = np.random.default_rng(7)
    world, sensors = Grid((-3, -4), (3, 4), (20, 24)), {'place': position_sensor(sigma)}
    filter_ = ActiveGridFilter(still(2), world, sensors, 0.1)
    tracker, other = (Tracker(filter_, filter_.uniform(), 0.2) for _ in range(2))
    for k in range(20):
        near = np.array([-2.8, 3.8]) + rng.normal(0, 0.15, 2)
        tracker.observe(Measurement(k * SECOND // 10, 'place', tuple(near.tolist())))
        belief = tracker.estimate().belief
        for patch in belief.patches:
            w = patch.window
            assert all(0 <= first and first + count <= cells for first, count, cells in
                       zip(w.offset, w.shape, w.cells))
        other.recall(memory_from(other, arrays_of(tracker)))
    assert other.estimate().belief.mean().tobytes() == belief.mean().tobytes()
