"""A measured path: what its points do to a belief, whatever the model."""

import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous import (DiracFeynmanYauFilter, ExtendedKalmanBucyFilter, PathBelief,
                                     SCHEMES)
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.tracker import Tracker
import pytest
from scipy.special import logsumexp

SECOND = 1_000_000_000
STEP = 100_000_000

WALK = StateModel(('x',), lambda x, t: np.zeros_like(x), np.eye(1))
CUBE = {'cube': Sensor(lambda x, t: x**3, [[1.0]])}
C = np.array([[0.3, 0.1], [0.1, 0.2]])
SWAY = StateModel(('x',), lambda x, t: -np.sin(x), 1.5 * np.eye(1))
PAIR = {'pair': Sensor(lambda x, t: np.concatenate([x**2 / 2, np.sin(x)]), C)}


def dfy(scheme, model=SWAY, sensors=PAIR, grid=Grid((-2.5,), (2.5,), (25,)), step=0.1, **more):
    return DiracFeynmanYauFilter(model, grid, sensors, KernelSettings(step), scheme, **more)


def kalman_bucy(scheme=None, model=SWAY, sensors=PAIR, **_):
    return ExtendedKalmanBucyFilter(model, sensors, 0.1)


EVERY = [*SCHEMES, 'extended']


def any_filter(name, **more):
    return kalman_bucy(**more) if name == 'extended' else dfy(name, **more)


def track(filter_, belief, points):
    """Yield belief and log evidence after each of (stamp, y)."""
    [name], now = filter_.sensors, points[0][0]
    for stamp, y in points:
        belief, log_evidence = filter_.correct(filter_.predict(belief, now, stamp), y, name, stamp)
        now = stamp
        yield belief, log_evidence


def content(belief):
    """Return the numbers of a belief, for comparing bits."""
    inner = belief.now
    return (inner.density,) if isinstance(inner, GridBelief) else (inner.location, inner.spread)


def assert_same_bits(one, other):
    for a, b in zip(content(one), content(other), strict=True):
        np.testing.assert_array_equal(a, b)


# Against the formulas in plain numbers


def h_of(x):
    return np.stack([x**2 / 2, np.sin(x)])


def square(x):
    return np.einsum('i...,ij,j...->...', h_of(x), np.linalg.inv(C), h_of(x))


def likelihood(dy, x, eps):
    v = dy[:, None] - h_of(x) * eps
    return np.exp(-np.einsum('ik,ij,jk->k', v, np.linalg.inv(C * eps), v) / 2) / np.sqrt(
        np.linalg.det(2 * np.pi * C * eps))


def plainly(scheme, K, x, p, dy, steps):
    """
    Return what is believed, what it starts the next increment with, and the evidence.

    steps: fractions of 0.1 s; x: cells; p: their probabilities.
    """
    eps, whole = 0.1 * sum(steps), p
    moves = [(1 - a) * np.eye(len(x)) + a * K for a in steps]
    if scheme == 'splitting':
        for move in moves:
            whole = move @ whole
        after = likelihood(dy, x, eps) * whole
        return after, after, after.sum()
    if scheme == 'symmetric':
        H = np.stack([x, np.cos(x)])
        spread = 2.25 * np.stack([np.linalg.inv(C) @ np.outer(slope, slope) for slope in H.T])
        half = np.sqrt(likelihood(dy, x, eps))
        whole = np.sqrt(np.linalg.det(np.eye(2) + eps**2 / 4 * spread)) * half * whole
        for move in moves:
            whole = move @ whole
        after = half * whole
        return after, after, after.sum()
    reference = np.exp(-dy @ np.linalg.inv(C * eps) @ dy / 2) / np.sqrt(
        np.linalg.det(2 * np.pi * C * eps))
    middle = square((x[:, None] + x[None, :]) / 2)
    read = whole
    for a, move in zip(steps, moves):
        yau = move * np.exp(-0.1 * a / 2 * middle)
        gain = np.exp(h_of(x).T @ np.linalg.inv(C) @ dy * 0.1 * a / eps)
        whole = yau @ (gain * whole) if scheme == 'post' else gain * (yau @ whole)
        read = yau @ read
    return (read if scheme == 'pre_printed' else whole), whole, reference * whole.sum()


@pytest.mark.parametrize('scheme', SCHEMES)
def test_equals_the_formulas_in_plain_numbers(scheme):
    filter_ = dfy(scheme, average_cells=False)
    K = dirac_feynman(SWAY, filter_.grid, KernelSettings(0.1)).toarray()
    x, rng = filter_.grid.axes[0], np.random.default_rng(3)
    belief = filter_.gaussian([0.4], [[0.5]])
    p, y, now = belief.density * 0.2, np.zeros(2), SECOND
    belief, _ = filter_.correct(belief, y, 'pair', now)
    for steps in ([1.0], [1.0, 1.0], [0.3], [1.0, 1.0, 0.45], [1.0]):
        dy, now = rng.normal(0, 0.3, size=2), now + round(STEP * sum(steps))
        read, p, evidence = plainly(scheme, K, x, p, dy, steps)
        p, y = p / p.sum(), y + dy
        belief, log_evidence = filter_.correct(belief, y, 'pair', now)
        np.testing.assert_allclose(belief.density, read / read.sum() / 0.2, rtol=1e-9)
        assert log_evidence == pytest.approx(np.log(evidence), rel=1e-9)


@pytest.mark.parametrize('scheme, place, largest', [
    # further out the printed reading looks where the belief has less than 1e-290 of its peak
    ('post', 13.0, 6000), ('pre', 13.0, 6000), ('pre_printed', 11.0, 4000)])
def test_exponents_of_many_thousands_cost_no_digits(scheme, place, largest):
    # the cubic sensor's printed cells and steps
    eps, grid = 0.001, Grid((9.5,), (15,), (550,))
    filter_ = dfy(scheme, WALK, CUBE, grid, eps)
    x, rng = grid.axes[0], np.random.default_rng(2)
    with np.errstate(divide='ignore'):
        log_K = np.log(dirac_feynman(WALK, grid, KernelSettings(eps)).toarray())
    log_yau = log_K - eps / 2 * ((x[:, None] + x[None, :]) / 2)**6
    truth = place + np.cumsum(rng.normal(0, np.sqrt(eps), size=20))
    increments = truth**3 * eps + rng.normal(0, np.sqrt(eps), size=20)
    assert (x**3 * increments.max()).max() > largest and (x**6 * eps / 2).max() > 5000
    belief = filter_.gaussian([place], [[0.01]])
    with np.errstate(divide='ignore'):
        log_p = np.log(belief.density)
    points = [(round(SECOND * eps * k), [y]) for k, y in enumerate(
        np.append(0, np.cumsum(increments)))]
    for dy, (belief, log_evidence) in zip(
            np.append(np.nan, increments), track(filter_, belief, points)):
        if np.isnan(dy):
            continue
        before = logsumexp(log_p)
        if scheme == 'post':
            log_p = read = logsumexp(log_yau + (log_p + x**3 * dy), axis=1)
        else:
            read = logsumexp(log_yau + log_p, axis=1)
            log_p = read + x**3 * dy
            read = log_p if scheme == 'pre' else read
        density = np.exp(read - logsumexp(read)) / 0.01
        np.testing.assert_allclose(belief.density, density, rtol=1e-8, atol=1e-12)
        log_reference = -dy**2 / 2 / eps - np.log(2 * np.pi * eps) / 2
        assert log_evidence == pytest.approx(
            logsumexp(log_p) - before + log_reference, rel=1e-9, abs=1e-6)


# Points of the path


@pytest.mark.parametrize('name', EVERY)
def test_the_first_point_is_the_reference_and_says_nothing(name):
    filter_ = any_filter(name)
    start = filter_.gaussian([0.4], [[0.5]])
    assert start.y is None and start.stamp_ns is None
    later = filter_.predict(start, 0, 2 * STEP)
    first, log_evidence = filter_.correct(later, [3.0, -8.0], 'pair', 2 * STEP)
    assert_same_bits(first, later)
    assert log_evidence == 0
    assert first.y.tolist() == [3.0, -8.0] and first.stamp_ns == 2 * STEP
    # where a path begins does not matter, only how it goes on
    points = [(2 * STEP, np.zeros(2)), (3 * STEP, np.array([0.25, -0.5]))]
    shifted = [(stamp, y + [1024.0, -64.0]) for stamp, y in points]
    for one, other in zip(track(filter_, later, points), track(filter_, later, shifted)):
        assert_same_bits(one[0], other[0])
        assert one[1] == other[1]


@pytest.mark.parametrize('name', EVERY)
def test_forecasts_leave_no_trace_in_what_a_point_does(name):
    filter_ = any_filter(name)
    start, _ = filter_.correct(filter_.gaussian([0.4], [[0.5]]), [0.0, 0.0], 'pair', 0)
    direct, direct_evidence = filter_.correct(start, [0.1, 0.2], 'pair', 123_456_789)
    carried = start
    for before, after in ((0, 17), (17, STEP), (STEP, 123_456_789)):
        carried = filter_.predict(carried, before, after)
    found, evidence = filter_.correct(carried, [0.1, 0.2], 'pair', 123_456_789)
    assert_same_bits(found, direct)
    assert evidence == direct_evidence


@pytest.mark.parametrize('name', EVERY)
def test_a_forecast_in_whole_steps_is_the_same_however_it_is_cut(name):
    filter_ = any_filter(name)
    start = list(track(filter_, filter_.gaussian([0.4], [[0.5]]),
                       [(0, [0.0, 0.0]), (STEP, [0.1, 0.2])]))[-1][0]
    at_once = filter_.predict(start, STEP, 5 * STEP)
    cut = start
    for k in range(1, 5):
        cut = filter_.predict(cut, k * STEP, (k + 1) * STEP)
    assert_same_bits(at_once, cut)
    assert at_once.stamp_ns == STEP
    with pytest.raises(ValueError, match='^to_ns: expected a stamp from 5 on, got 4$'):
        filter_.predict(start, 5, 4)


@pytest.mark.parametrize('scheme', SCHEMES)
def test_a_forecast_is_the_fokker_planck_equations(scheme):
    filter_ = dfy(scheme)
    start = list(track(filter_, filter_.uniform(), [(0, [0.0, 0.0]), (STEP, [0.1, 0.2])]))[-1][0]
    plain = DiracFeynmanFilter(SWAY, filter_.grid, PAIR, KernelSettings(0.1))
    np.testing.assert_array_equal(filter_.predict(start, STEP, 7 * STEP + 5).density,
                                  plain.predict(start.now, STEP, 7 * STEP + 5).density)


@pytest.mark.parametrize('name', EVERY)
def test_the_same_point_again_says_nothing_and_another_at_its_stamp_is_refused(name):
    filter_ = any_filter(name)
    start = list(track(filter_, filter_.gaussian([0.4], [[0.5]]),
                       [(0, [0.0, 0.0]), (STEP, [0.1, 0.2])]))[-1][0]
    again, log_evidence = filter_.correct(start, [0.1, 0.2], 'pair', STEP)
    assert again is start and log_evidence == 0
    other, log_evidence = filter_.correct(start, [0.1, 0.3], 'pair', STEP)
    assert other is start and log_evidence == -np.inf
    with pytest.raises(ValueError, match='^at_ns: expected a stamp from 100000000 on, the last'):
        filter_.correct(start, [0.1, 0.3], 'pair', STEP - 1)


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('name', EVERY)
def test_a_point_that_is_no_number_is_left_out_of_the_path(name, bad):
    filter_ = any_filter(name)
    start = filter_.gaussian([0.4], [[0.5]])
    for points in ([], [(0, [0.0, 0.0])], [(0, [0.0, 0.0]), (STEP, [0.1, 0.2])]):
        belief = ([(start, 0.0)] + list(track(filter_, start, points or [(0, [bad, 0.0])])))[-1][0]
        after, log_evidence = filter_.correct(belief, [0.1, bad], 'pair', 3 * STEP)
        assert after is belief and log_evidence == -np.inf


@pytest.mark.parametrize('name', EVERY)
def test_late_points_are_put_where_they_belong_to_the_bit(name):
    rng = np.random.default_rng(7)
    stamps = np.cumsum(rng.integers(1, 150_000_000, size=12)).tolist()
    points = [Measurement(stamp, 'pair', tuple(y)) for stamp, y in zip(
        stamps, np.cumsum(rng.normal(0, 0.1, size=(12, 2)), axis=0).tolist())]
    filter_ = any_filter(name)
    in_order, late = (Tracker(filter_, filter_.gaussian([0.4], [[0.5]]), history=10.0)
                      for _ in range(2))
    for point in points:
        in_order.observe(point)
        expected = in_order.estimate()
    for k in rng.permutation(12):
        late.observe(points[k])
        late.forecast(points[k].stamp_ns + 12_345_678)
        found = late.estimate()
    assert_same_bits(found.belief, expected.belief)
    assert found.total_log_evidence == expected.total_log_evidence


@pytest.mark.parametrize('name', EVERY)
def test_a_path_of_an_angle_goes_on_across_the_cut(name):
    # the rate of a turn, measured as the angle turned
    [path] = [Sensor(lambda x, t: x, [[0.01]], angular=(True,))]
    filter_ = any_filter(name, sensors={'angle': path})
    angles = np.cumsum(np.append(3.0, np.full(6, 0.09)))
    folded = (angles + np.pi) % (2 * np.pi) - np.pi
    plain, cut = (list(track(filter_, filter_.gaussian([0.4], [[0.5]]), [
        (k * STEP, [y]) for k, y in enumerate(ys)])) for ys in (angles, folded))
    for (one, log_one), (other, log_other) in zip(plain, cut):
        np.testing.assert_allclose(one.mean(), other.mean(), atol=1e-12)
        assert log_one == pytest.approx(log_other, abs=1e-9)


# What cannot be


@pytest.mark.parametrize('size', [1.0, 30.0, 1e3, 1e8, 1e150])
@pytest.mark.parametrize('scheme', SCHEMES)
def test_after_an_outlier_the_belief_is_finite_and_finds_back(scheme, size):
    filter_ = dfy(scheme, WALK, CUBE, Grid((-15,), (15,), (300,)), 0.01)
    rng = np.random.default_rng(1)
    belief, _ = filter_.correct(filter_.gaussian([0.0], [[0.01]]), [0.0], 'cube', 0)
    y, now, last = 0.0, 0, 0.0
    for sign in (1, -1, 1):
        y, now = y + sign * size, now + SECOND // 100
        belief, log_evidence = filter_.correct(filter_.predict(belief, now - SECOND // 100, now),
                                               [y], 'cube', now)
        assert np.all(np.isfinite(belief.density)) and np.all(belief.density >= 0)
        assert belief.mass == pytest.approx(1, abs=1e-9)
        assert not np.isnan(log_evidence) and log_evidence < 10
        last = log_evidence
    # |dy - h eps|^2 / (2 C eps) with |h eps| up to 34
    assert last < -(max(size - 68, 0))**2
    for k in range(1000):
        now += SECOND // 100
        y = rng.normal(0, 0.1) if k == 0 else y + rng.normal(0, 0.1)
        belief, log_evidence = filter_.correct(belief, [y], 'cube', now)
    assert abs(belief.mean()[0]) < 3
    assert log_evidence > -10


@pytest.mark.parametrize('scheme', SCHEMES)
def test_cells_where_the_sensor_is_undefined_are_excluded(scheme):
    def root(x, t):
        with np.errstate(invalid='ignore'):
            return np.sqrt(x)

    filter_ = dfy(scheme, WALK, {'root': Sensor(root, [[0.1]])}, Grid((-4,), (4,), (80,)))
    # undefined half of the way for moves to and from below, too
    steps = list(track(filter_, filter_.gaussian([1.0], [[1.0]]), [
        (k * STEP, [0.1 * k]) for k in range(6)]))
    belief, log_evidence = steps[-1]
    assert np.isfinite(log_evidence) and belief.mass == pytest.approx(1, abs=1e-9)
    x = filter_.grid.axes[0]
    # the post-measurement form believes what a step makes of the last cells
    assert belief.density[x < -1].sum() < 1e-3 * belief.density.sum()
    if scheme not in ('post', 'pre_printed'):
        assert np.all(belief.density[x < 0] == 0)


@pytest.mark.parametrize('scheme', SCHEMES)
def test_a_point_that_no_cell_allows_leaves_the_belief_and_the_reference(scheme):
    filter_ = dfy(scheme, WALK, {'none': Sensor(lambda x, t: np.full_like(x, np.nan), [[1.0]])})
    belief, _ = filter_.correct(filter_.gaussian([0.0], [[0.1]]), [0.0], 'none', 0)
    after, log_evidence = filter_.correct(belief, [0.1], 'none', STEP)
    assert after is belief and log_evidence == -np.inf


# Noise, time, senses


@pytest.mark.parametrize('name', EVERY)
def test_a_path_in_other_units_says_the_same(name):
    A = np.array([[2.0, 0.5], [-1.0, 3.0]])
    turned = {'pair': Sensor(lambda x, t: np.tensordot(A, h_of(x[0]), 1), A @ C @ A.T)}
    ys = np.cumsum(np.random.default_rng(6).normal(0, 0.3, size=(8, 2)), axis=0)
    one, other = any_filter(name), any_filter(name, sensors=turned)
    start = one.gaussian([0.4], [[0.5]])
    points = [(k * STEP, y) for k, y in enumerate(ys)]
    for k, (a, b) in enumerate(zip(track(one, start, points), track(
            other, start, [(stamp, A @ y) for stamp, y in points]))):
        np.testing.assert_allclose(a[0].mean(), b[0].mean(), rtol=1e-6)
        np.testing.assert_allclose(a[0].covariance(), b[0].covariance(), rtol=1e-6)
        # densities of dy and of A dy
        assert a[1] - b[1] == pytest.approx(np.log(abs(np.linalg.det(A))) if k else 0, abs=1e-6)


@pytest.mark.parametrize('scheme', SCHEMES)
def test_a_step_that_is_no_whole_number_of_nanoseconds_goes_as_far_as_its_time(scheme):
    # 1 m/ns, and a path that says nothing of it
    drifting = StateModel(('x',), lambda x, t: 0 * x + 1e9, [[3e4]])
    nothing = {'nothing': Sensor(lambda x, t: 0 * x, [[1.0]])}
    filter_ = dfy(scheme, drifting, nothing, Grid((0,), (100,), (200,)), 1.5e-9)
    start = filter_.gaussian([20.0], [[4.0]])
    *_, (last, _) = track(filter_, start, [(0, [0.0]), (24, [0.0]), (48, [0.0])])
    assert last.mean()[0] - start.mean()[0] == pytest.approx(48, abs=1e-3)


@pytest.mark.parametrize('name', EVERY)
@pytest.mark.parametrize('unit', [1e-3, 1e-6])
def test_states_in_other_units_are_the_same(name, unit):
    def moments(unit):
        well = StateModel(('x',), lambda x, t: x - x**3 / unit**2, [[0.6 * unit]])
        cube = {'cube': Sensor(lambda x, t: (x / unit)**3, [[0.1]])}
        filter_ = any_filter(name, model=well, sensors=cube, **(
            {} if name == 'extended' else {'grid': Grid((-2 * unit,), (2 * unit,), (60,))}))
        points = [(k * STEP, [0.05 * k]) for k in range(5)]
        start = filter_.gaussian([0.5 * unit], [[(0.3 * unit)**2]])
        return [(belief.mean()[0] / unit, belief.covariance()[0, 0] / unit**2, log_evidence)
                for belief, log_evidence in track(filter_, start, points)]

    np.testing.assert_allclose(moments(unit), moments(1.0), rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize('name, start_ns, tolerance', [
    # h moves on by 0.02 in a step: taken at one end instead of at both, that is half of it, which
    # in 0.4 s shifts the mean by more than 1e-3
    ('symmetric', 40 * SECOND, 4e-4), ('extended', 40 * SECOND, 1e-9),
    ('splitting', 40 * SECOND, 8e-3),
    # where h is far from 0 these are poor: h dy at one end does not meet h^2 half way
    ('post', 0, 8e-3), ('pre', 0, 8e-3)])
def test_a_slope_that_changes_with_time_is_asked_at_its_time(name, start_ns, tolerance):
    # x + t is the path of x, and t^2 / 2
    one, other = (any_filter(name, step=0.02, sensors={'s': sensor}) for sensor in (
        Sensor(lambda x, t: x, [[0.2]]),
        Sensor(lambda x, t: x + t, [[0.2]], time_dependent=True)))
    start = one.gaussian([0.4], [[0.5]])
    stamps = start_ns + np.arange(20) * (SECOND // 50)
    ys, t = np.cumsum(np.random.default_rng(6).normal(0, 0.06, size=20)), stamps / SECOND
    steps = zip(track(one, start, list(zip(stamps.tolist(), ys[:, None]))),
                track(other, start, list(zip(stamps.tolist(), (ys + t**2 / 2)[:, None]))))
    for (a, log_a), (b, log_b) in steps:
        np.testing.assert_allclose(a.mean(), b.mean(), atol=tolerance)
        assert log_a == pytest.approx(log_b, abs=3 * tolerance)


@pytest.mark.parametrize('name', EVERY)
def test_noise_that_changes_with_time_is_asked_at_its_time(name):
    def noise(t):
        return np.array([[0.2 if 39 < t < 42 else 7.0]])

    one, other = (any_filter(name, sensors={'s': Sensor(lambda x, t: x, C)})
                  for C in ([[0.2]], noise))
    points = [(40 * SECOND + k * STEP, [0.1 * k * k]) for k in range(10)]
    start = one.gaussian([0.4], [[0.5]])
    for (a, log_a), (b, log_b) in zip(track(one, start, points), track(other, start, points)):
        np.testing.assert_allclose(a.mean(), b.mean(), rtol=1e-9)
        assert log_a == pytest.approx(log_b, rel=1e-9)


def test_the_extended_filter_takes_multiplicative_noise_in_its_sense():
    ito = StateModel(('x',), lambda x, t: 0.1 * x, lambda x, t: 0.3 * x[None],
                     multiplicative=True)
    stratonovich = StateModel(('x',), lambda x, t: (0.1 - 0.045) * x, lambda x, t: 0.3 * x[None],
                              multiplicative=True, s=0.5)
    sensors = {'s': Sensor(lambda x, t: x, [[0.02]])}
    points = [(k * STEP, [0.12 * k]) for k in range(10)]
    for (a, log_a), (b, log_b) in zip(*(track(
            kalman_bucy(model=model, sensors=sensors), PathBelief.before_the_path(
                kalman_bucy(model=model, sensors=sensors).gaussian([1.0], [[0.01]]).now), points)
            for model in (ito, stratonovich))):
        np.testing.assert_allclose(a.mean(), b.mean(), rtol=1e-6)
        np.testing.assert_allclose(a.covariance(), b.covariance(), rtol=1e-6)
        assert log_a == pytest.approx(log_b, abs=1e-6)


# Refusals


@pytest.mark.parametrize('kind', [dfy, kalman_bucy])
@pytest.mark.parametrize('sensors, given', [({}, '0$'), (PAIR | CUBE, r'2 \(pair, cube\)$')])
def test_refuses_all_but_one_sensor(kind, sensors, given):
    with pytest.raises(ValueError, match='^sensors: expected exactly one, .* got ' + given):
        kind('symmetric', sensors=sensors)


def test_refuses_a_scheme_that_is_none_and_a_grid_that_does_not_fit():
    with pytest.raises(ValueError, match="^scheme: expected one of symmetric, .* got 'euler'$"):
        dfy('euler')
    with pytest.raises(ValueError, match='^grid: expected 1 axes, .* got 2$'):
        dfy('symmetric', grid=Grid((0, 0), (1, 1), (4, 4)))


def test_describes_itself_and_says_where_the_grid_is_too_coarse():
    assert 'post' in dfy('post').describe() and '25 cells' in dfy('post').describe()
    assert not dfy('symmetric').remarks()
    [remark] = dfy('symmetric', sensors={'fine': Sensor(lambda x, t: x, [[1e-6]])}).remarks()
    # 0.2 0.1 / sqrt(1e-6 0.1) = 63
    assert "'fine'" in remark and '63' in remark


@pytest.mark.parametrize('name', EVERY)
def test_a_belief_of_a_path_reads_as_what_is_believed_now(name):
    filter_ = any_filter(name)
    belief = filter_.predict(list(track(filter_, filter_.gaussian([0.4], [[0.5]]), [
        (0, [0.0, 0.0]), (STEP, [0.1, 0.2])]))[-1][0], STEP, 3 * STEP)
    for read in (lambda b: b.mean(), lambda b: b.mode(), lambda b: b.covariance(),
                 lambda b: b.covariance([0.1]), lambda b: b.mass):
        np.testing.assert_array_equal(read(belief), read(belief.now))
    grid = Grid((-2.5,), (2.5,), (25,))
    np.testing.assert_array_equal(belief.on(grid, [0]).density, belief.now.on(grid, [0]).density)
