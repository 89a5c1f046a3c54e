"""A control in pieces, and the filters that are driven by one."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from pif_ros.core.continuous import DiracFeynmanYauFilter, ExtendedKalmanBucyFilter
from pif_ros.core.controls import carries_across, Controls, driven, NO_CONTROLS
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.rivals import (ExtendedKalmanFilter, GaussianBelief, ParticleBelief,
                                 ParticleFilter, UnscentedKalmanFilter)
from pif_ros.core.simulation import simulate, simulate_inside
from pif_ros.core.systems import ornstein_uhlenbeck, unicycle_2d
from pif_ros.core.tracker import Tracker
import pytest
from scipy.integrate import solve_ivp

SECOND = 1_000_000_000
VALUES = st.tuples(st.sampled_from([0.0, 1.0, -2.0]))
CONTROLS = st.builds(
    lambda pieces, hold: Controls(*zip(*sorted(pieces.items())), hold),
    st.dictionaries(st.integers(0, 60), VALUES, min_size=1, max_size=8), st.integers(0, 30))
#: Sure of its motion, or nearly: x, y and theta do what the control says.
UNICYCLE = unicycle_2d(sigma_position=1e-9, sigma_heading=1e-9).model
DRIVE = Controls((0, 330_000_000, 1_500_000_000), ((1.0, 0.5), (2.0, -0.8), (0.5, 0.3)), SECOND)
START = np.array([1.0, -2.0, 0.4])


def at(controls, t):
    """Return what holds at a time, by the definition."""
    before = [(stamp, u) for stamp, u in zip(controls.stamps_ns, controls.values) if stamp <= t]
    stamp, u = before[-1] if before else (t, (0.0,))
    return u if t < stamp + controls.hold_ns else (0.0,)


def arc(x, u, seconds):
    """Return where a unicycle is after so long under one control: an arc, or a straight line."""
    v, omega = u
    turned = x[2] + omega * seconds
    if not omega:
        return x + np.array([v * np.cos(x[2]), v * np.sin(x[2]), 0.0]) * seconds
    return np.array([x[0] + v / omega * (np.sin(turned) - np.sin(x[2])),
                     x[1] - v / omega * (np.cos(turned) - np.cos(x[2])), turned])


def driven_by_arcs(x, begin_ns, end_ns):
    """Return where DRIVE takes it, by hand: the second control holds for one second only."""
    cuts = [(0, (1.0, 0.5)), (330_000_000, (2.0, -0.8)), (1_330_000_000, (0.0, 0.0)),
            (1_500_000_000, (0.5, 0.3)), (2_500_000_000, (0.0, 0.0)), (10**18, None)]
    for (start, u), (end, _) in zip(cuts, cuts[1:]):
        x = arc(x, u, max(min(end, end_ns) - max(start, begin_ns), 0) / SECOND)
    return x


# Pieces


@given(CONTROLS, st.integers(-10, 100), st.integers(0, 100))
def test_pieces_cover_the_time_in_order_each_with_what_holds_in_it(controls, begin, length):
    pieces = list(controls.between(begin, begin + length))
    assert [t for start, end, _ in pieces for t in range(start, end)] == list(
        range(begin, begin + length))
    assert all(start < end for start, end, _ in pieces)
    assert all(at(controls, t) == u for start, end, u in pieces for t in range(start, end))
    assert all(before[2] != after[2] for before, after in zip(pieces, pieces[1:]))


@given(CONTROLS, st.integers(-10, 50), st.integers(0, 50), st.integers(0, 50))
def test_where_pieces_are_cut_does_not_depend_on_what_is_asked_for(controls, begin, one, two):
    whole = {end for _, end, _ in controls.between(begin, begin + one + two)}
    first = {end for _, end, _ in controls.between(begin, begin + one)}
    second = {end for _, end, _ in controls.between(begin + one, begin + one + two)}
    assert whole - {begin + one} == (first | second) - {begin + one}


def test_without_a_control_there_is_one_piece_without_a_value():
    assert list(NO_CONTROLS.between(5, 9)) == [(5, 9, ())]
    assert list(NO_CONTROLS.between(5, 5)) == []


def test_a_model_without_inputs_is_not_cut_and_one_with_them_is():
    plain = StateModel(('a',), lambda x, t: -x, np.eye(1))
    steered = StateModel(('a',), lambda x, u, t: u * x, np.eye(1), inputs=('k',))
    controls = Controls((0, 5), ((1.0,), (2.0,)), 100)
    assert list(driven(plain, controls, 0, 10)) == [(0, 10, plain)]
    assert list(driven(plain, controls, 7, 7)) == []
    found = [(start, end, model.drift(np.array([3.0]), 0.0)[0])
             for start, end, model in driven(steered, controls, -1, 10)]
    assert found == [(-1, 0, 0.0), (0, 5, 3.0), (5, 10, 6.0)]


@pytest.mark.parametrize('fields, name', [
    (((1, 1), ((0.0,), (1.0,))), 'stamps_ns'), (((2, 1), ((0.0,), (1.0,))), 'stamps_ns'),
    (((1, 2), ((0.0,),)), 'values'), (((1, 2), ((0.0,), (1.0, 2.0))), 'values'),
    (((), (), -1), 'hold_ns')])
def test_refuses_what_is_no_control_in_pieces(fields, name):
    with pytest.raises(ValueError, match=f'^{name}: expected .*, got .*$'):
        Controls(*fields)


# Filters


@pytest.mark.parametrize('kind, step, tolerance', [
    # steps of Runge and Kutta, 0.1 s long: (omega h)^4 v h / 120 each, 3e-8 in all
    (ExtendedKalmanFilter, 0.1, 1e-7), (UnscentedKalmanFilter, 0.1, 1e-7),
    # one step for each control: (0.8)^4 2 / 120 = .007, if not cut it would be off by metres
    (ExtendedKalmanFilter, 10.0, 0.01)])
@pytest.mark.parametrize('begin', [-500_000_000, 400_000_000])
def test_a_mean_drives_along_arcs_that_change_where_the_control_does(
        kind, step, tolerance, begin):
    filter_ = kind(UNICYCLE, {}, step)
    belief = filter_.predict(GaussianBelief(START, 1e-18 * np.eye(3)), begin, 3 * SECOND, DRIVE)
    np.testing.assert_allclose(belief.mean(), driven_by_arcs(START, begin, 3 * SECOND),
                               atol=tolerance)


def test_particles_drive_along_arcs_that_change_where_the_control_does():
    filter_ = ParticleFilter(UNICYCLE, {}, 0.001)
    belief = filter_.predict(ParticleBelief(START[:, None], np.zeros(1)), 0, 3 * SECOND, DRIVE)
    # Euler's steps of 1 ms: the error of each is omega v h^2 / 2, after 3 s at most 2e-3
    np.testing.assert_allclose(belief.points[:, 0], driven_by_arcs(START, 0, 3 * SECOND),
                               atol=2e-3)


def test_the_covariance_of_a_driven_mean_is_that_of_the_variational_equation():
    model = unicycle_2d(0.3, 0.2).model
    P0, u = np.diag([0.1, 0.2, 0.05]), (1.2, 0.7)

    def slopes(t, y):
        x, P = y[:3], y[3:].reshape(3, 3)
        F = np.zeros((3, 3))
        F[:2, 2] = -u[0] * np.sin(x[2]), u[0] * np.cos(x[2])
        rate = F @ P + P @ F.T + np.diag([0.09, 0.09, 0.04])
        return np.append([u[0] * np.cos(x[2]), u[0] * np.sin(x[2]), u[1]], rate.ravel())

    exact = solve_ivp(slopes, (0, 1), np.append(START, P0.ravel()),
                      rtol=1e-11, atol=1e-12).y[:, -1]
    found = ExtendedKalmanFilter(model, {}, 0.05).predict(
        GaussianBelief(START, P0), 0, SECOND, Controls((0,), (u,), 2 * SECOND))
    # fourth order: the sixteenth of it with half of the step, 2e-8 here
    np.testing.assert_allclose(found.covariance().ravel(), exact[3:], atol=1e-6)


@pytest.mark.parametrize('filter_', [
    ExtendedKalmanFilter(unicycle_2d().model, {}, 0.1),
    UnscentedKalmanFilter(unicycle_2d().model, {}, 0.1),
    ParticleFilter(unicycle_2d().model, {}, 0.1, particles=20)], ids=lambda f: type(f).__name__)
@given(cuts=st.lists(st.integers(0, 24), max_size=4))
def test_whole_steps_in_any_number_of_calls_give_the_same_bits(filter_, cuts):
    start = filter_.gaussian(START, 0.1 * np.eye(3))
    whole = filter_.predict(start, 0, 2_450_000_000, DRIVE)
    belief, now = start, 0
    for cut in [*sorted(100_000_000 * k for k in cuts), 2_450_000_000]:
        belief, now = filter_.predict(belief, now, cut, DRIVE), cut
    np.testing.assert_array_equal(belief.mean(), whole.mean())
    np.testing.assert_array_equal(belief.covariance(), whole.covariance())


@pytest.mark.parametrize('kind', [ExtendedKalmanFilter, UnscentedKalmanFilter, ParticleFilter])
def test_a_model_without_inputs_moves_as_ever_whatever_the_controls(kind):
    filter_ = kind(ornstein_uhlenbeck().model, {}, 0.1)
    start = filter_.gaussian([1.0], [[0.5]])
    free, steered = (filter_.predict(start, 7, 950_000_000, c) for c in (NO_CONTROLS, DRIVE))
    np.testing.assert_array_equal(free.mean(), steered.mean())
    np.testing.assert_array_equal(free.covariance(), steered.covariance())


@pytest.mark.parametrize('make', [
    lambda model, grid, sensors: DiracFeynmanFilter(model, grid, sensors, KernelSettings(0.1)),
    lambda model, grid, sensors: DiracFeynmanYauFilter(model, grid, sensors, KernelSettings(0.1))])
def test_what_makes_its_kernel_beforehand_refuses_inputs(make):
    grid = Grid((-1.0,) * 3, (1.0,) * 3, (4, 4, 4))
    with pytest.raises(ValueError, match='^model: expected one without inputs.*got.* v, omega$'):
        make(UNICYCLE, grid, {'place': Sensor(lambda x, t: x[:2], np.eye(2))})


def test_a_measured_path_of_a_driven_model_is_that_of_an_undriven_one_beside_it():
    """Oracle: x - m is the undriven process where m' = u - m, and y - Int(m) dt its path."""
    driven_by = Controls((0, 700_000_000), ((2.0,), (-1.0,)), SECOND)
    free = ornstein_uhlenbeck().model
    model = StateModel(('x',), lambda x, u, t: u[0] - x, np.eye(1), inputs=('force',))
    sensors = {'path': Sensor(lambda x, t: x, [[0.3]])}
    both = [ExtendedKalmanBucyFilter(m, sensors, 0.05) for m in (free, model)]
    plain, tracker = (Tracker(f, f.gaussian([0.5], [[0.4]]), 10.0) for f in both)
    stamps = [0, 300_000_000, SECOND, 2_500_000_000]
    for stamp, y in zip(stamps, np.random.default_rng(2).normal(size=4).tolist()):
        m, path = relaxed(stamp / SECOND)
        plain.observe(Measurement(stamp, 'path', (y - path,)))
        tracker.observe(Measurement(stamp, 'path', (y,)))
        tracker.estimate()
    for stamp, u in zip(driven_by.stamps_ns, driven_by.values):
        tracker.control(stamp, u)
    found, expected = tracker.estimate(), plain.estimate()
    # fourth order in steps of 0.05 s: 1e-7 for a rate of 1
    np.testing.assert_allclose(found.belief.mean(), expected.belief.mean() + m, atol=1e-6)
    np.testing.assert_allclose(found.belief.covariance(), expected.belief.covariance(), atol=1e-9)
    assert found.total_log_evidence == pytest.approx(expected.total_log_evidence, abs=1e-5)


def relaxed(t):
    """Return m and its integral where m' = u - m from 0: u is 2, -1 from 0.7 s, 0 from 1.7 s."""
    m = path = 0.0
    for begin, end, u in ((0.0, 0.7, 2.0), (0.7, 1.7, -1.0), (1.7, 99.0, 0.0)):
        h = max(min(t, end) - begin, 0.0)
        path += u * h + (m - u) * (1 - np.exp(-h))
        m = u + (m - u) * np.exp(-h)
    return m, path


# Simulation


def test_a_simulated_path_drives_along_the_arcs_at_every_time_asked_for():
    times = np.array([0.0, 0.25, 1.0, 1.4, 3.0])
    path = simulate(UNICYCLE, START, times, np.random.default_rng(0), 1000, DRIVE)
    for x, t in zip(path, times):
        # Euler's steps of 1.6 ms at most, as with particles
        np.testing.assert_allclose(x, driven_by_arcs(START, 0, round(t * SECOND)), atol=4e-3)


def test_simulated_noise_is_as_strong_as_without_the_cuts():
    # one step of 2 s, cut in four: the noise of the pieces adds up to variances of 2 g
    model = replace(unicycle_2d(0.3, 0.2).model,
                    drift=lambda x, u, t: np.zeros_like(x), drift_jacobian=None)
    x = simulate(model, np.zeros((3, 20_000)), [0.0, 2.0], np.random.default_rng(1), 1, DRIVE)[-1]
    # five standard errors of a sample variance, sqrt(2 / 20000) of it each
    np.testing.assert_allclose(x.var(axis=1), [0.18, 0.18, 0.08], rtol=0.05)


def test_a_path_that_stays_inside_is_driven_too():
    path = simulate_inside(UNICYCLE, lambda rng: START, [0.0, 0.3], np.random.default_rng(0),
                           [-9.0] * 3, [9.0] * 3, 300, controls=DRIVE)
    np.testing.assert_allclose(path[-1], driven_by_arcs(START, 0, 300_000_000), atol=1e-3)


# What no step can follow


ROBOT, YARD = unicycle_2d().model, Grid((-5.0, -5.0, -np.pi), (5.0, 5.0, np.pi), (10, 10, 8),
                                        (False, False, True))


@pytest.mark.parametrize(('u', 'across'), [
    ((0.0, 0.0), False), ((-90.0, 3.0), False), ((120.0, 0.0), True), ((-120.0, 0.0), True),
    ((0.0, 60.0), False), ((0.0, -70.0), True), ((1e308, 1e308), True), ((1e160, 0.0), True)])
def test_a_control_is_too_fast_that_crosses_the_grid_in_a_step(u, across):
    # 10 m and 2 pi in 0.1 s; cos theta is 0.92 at least somewhere
    assert carries_across(ROBOT, YARD, u, 0.0, 0.1) == across


def test_a_drift_that_is_fast_by_itself_does_not_make_a_control_too_fast():
    model = StateModel(('x',), lambda x, u, t: -1e6 * x + u[0], [[1.0]], inputs=('u',))
    line = Grid((-1.0,), (1.0,), (20,))
    assert not carries_across(model, line, (10.0,), 0.0, 0.1)
    assert carries_across(model, line, (21.0,), 0.0, 0.1)
