"""Smoothing on the grid."""

import itertools

import numpy as np
from oracles import linear_moments
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings, OperatorSettings
from pif_ros.core.models import Sensor, StateModel
from pif_ros.core.smoothing import smooth
from pif_ros.core.tracker import Tracker
import pytest

STEP = 100_000_000


def direct(variance):
    return Sensor(lambda x, t: x, [[variance]])


def gaussian_likelihood(y, h, variance):
    return np.exp(-(y - h)**2 / 2 / variance) / np.sqrt(2 * np.pi * variance)


# Against brute force


FIVE = Grid((-2.5,), (2.5,), (5,))
STEADY = StateModel(('x',), lambda x, t: -np.sin(x), np.eye(1) * 3)
CHANGING = StateModel(('x',), lambda x, t: t - np.sin(x),
                      lambda t: np.array([[3 + np.cos(9 * t)]]), time_dependent=True)
MEASURED = [(2 * STEP, 'square', [1.3]), (int(3.4 * STEP), 'square', [2.0]),
            (int(3.4 * STEP), 'place', [-1.1]), (int(4.4 * STEP), 'place', [0.2])]
#: What the filter does in between: from when, and what share of a step.
MOVES = [(0, 1.0), (STEP, 1.0), (2 * STEP, 1.0), (3 * STEP, 0.4), (int(3.4 * STEP), 1.0)]


@pytest.mark.parametrize('model', [STEADY, CHANGING])
def test_equals_the_sum_over_all_paths_on_five_cells(model):
    filter_ = DiracFeynmanFilter(model, FIVE, {
        'square': Sensor(lambda x, t: x**2, [[0.5]]), 'place': direct(0.7)},
        KernelSettings(0.1), average_cells=False)
    x, prior = FIVE.axes[0], np.array([0.3, 0.1, 0.2, 0.25, 0.15])
    moves = [share * filter_.kernel_at(t).toarray() + (1 - share) * np.eye(5)
             for t, share in MOVES]
    # after how many moves which measurement is made
    seen = {2: gaussian_likelihood(1.3, x**2, 0.5),
            4: gaussian_likelihood(2.0, x**2, 0.5) * gaussian_likelihood(-1.1, x, 0.7),
            5: gaussian_likelihood(0.2, x, 0.7)}
    total = np.zeros((6, 5))
    for path in itertools.product(range(5), repeat=6):
        probability = prior[path[0]]
        for k, move in enumerate(moves):
            probability *= move[path[k + 1], path[k]] * seen.get(k + 1, np.ones(5))[path[k + 1]]
        total[range(6), path] += probability

    found = smooth(filter_, GridBelief(FIVE, prior), MEASURED[::-1], 0, every_step=True)
    assert found.stamps_ns == (0, *(t for t, _ in MOVES[1:]), int(4.4 * STEP))
    for belief, exact in zip(found.beliefs, total):
        # the rounding of some tens of sums and products
        np.testing.assert_allclose(belief.density, exact / exact.sum(), rtol=1e-12)
    assert found.log_evidence == pytest.approx(np.log(total[0].sum()), rel=1e-12)

    fewer = smooth(filter_, GridBelief(FIVE, prior), MEASURED, 0)
    assert fewer.stamps_ns == (0, 2 * STEP, int(3.4 * STEP), int(4.4 * STEP))
    for stamp, belief in zip(fewer.stamps_ns, fewer.beliefs):
        np.testing.assert_array_equal(belief.density, found.at(stamp).density)


def test_a_composed_operator_is_turned_round_as_a_whole():
    sensors, settings = {'place': direct(0.7)}, KernelSettings(0.1, tolerance=1e-12)
    prior = GridBelief(FIVE, np.array([0.3, 0.1, 0.2, 0.25, 0.15]))
    measured = [(int(7.4 * STEP), 'place', [0.2]), (int(11.4 * STEP), 'place', [1.2])]
    plain, composed = (smooth(DiracFeynmanFilter(STEADY, FIVE, sensors, settings,
                                                 operator=OperatorSettings(steps=steps)),
                              prior, measured, 0) for steps in (1, 3))
    for one, other in zip(plain.beliefs, composed.beliefs):
        np.testing.assert_allclose(one.density, other.density, rtol=1e-10)


# Against the Rauch-Tung-Striebel smoother


F = np.array([[-0.6, 0.8], [-0.5, -0.2]])
E = np.array([[0.5, 0.2, 0.1], [0.1, 0.4, -0.2]])
Q = np.array([[1.0, 0.3, 0.1], [0.3, 0.8, -0.2], [0.1, -0.2, 1.2]])
H, R = np.array([[1.0, -0.5]]), np.array([[0.2]])


def rauch_tung_striebel(m, P, measurements):
    """Return means and covariances, the prior's first, of (seconds since the last, y) each."""
    forward = [(m, P, None, None, None)]
    for seconds, y in measurements:
        A, noise = linear_moments(F, E @ Q @ E.T, seconds)
        m_next, P_next = A @ m, A @ P @ A.T + noise
        gain = P_next @ H.T @ np.linalg.inv(H @ P_next @ H.T + R)
        forward.append((m_next + gain @ (y - H @ m_next), P_next - gain @ H @ P_next,
                        A, m_next, P_next))
        m, P = forward[-1][:2]
    found = [(m, P)]
    for (m_k, P_k, *_), (_, _, A, m_next, P_next) in zip(forward[-2::-1], forward[:0:-1]):
        back = P_k @ A.T @ np.linalg.inv(P_next)
        m, P = m_k + back @ (m - m_next), P_k + back @ (P - P_next) @ back.T
        found.append((m, P))
    return found[::-1]


def test_equals_the_rauch_tung_striebel_smoother_when_linear_and_gaussian():
    rng = np.random.default_rng(4)
    gaps, ys = rng.integers(1, 5, size=8), rng.normal(0, 0.7, size=(8, 1))
    model = StateModel(('x1', 'x2'), lambda x, t: np.tensordot(F, x, 1), E, Q)
    filter_ = DiracFeynmanFilter(
        model, Grid((-3.5, -3.5), (3.5, 3.5), (80, 80)),
        {'s': Sensor(lambda x, t: np.tensordot(H, x, 1), R)}, KernelSettings(0.05, tolerance=1e-8))
    mean, covariance = np.array([0.5, -0.3]), np.array([[0.2, 0.1], [0.1, 0.15]])
    stamps = np.cumsum(gaps) * STEP
    found = smooth(filter_, GridBelief.gaussian(filter_.grid, mean, covariance),
                   [(int(t), 's', y) for t, y in zip(stamps, ys)], 0)
    exact = rauch_tung_striebel(mean, covariance, list(zip(gaps / 10, ys)))
    for belief, (m, P) in zip(found.beliefs, exact):
        # what is left is the second order of the step: (0.05)^2 / 12 = 2e-4 and less
        np.testing.assert_allclose(belief.mean(), m, atol=2e-4)
        np.testing.assert_allclose(belief.covariance(), P, atol=2e-4)
    np.testing.assert_allclose(found.means(), [m for m, _ in exact], atol=2e-4)


# Laws


OU = DiracFeynmanFilter(StateModel(('x',), lambda x, t: -x, np.eye(1)),
                        Grid((-6,), (6,), (120,)), {'place': direct(0.25)}, KernelSettings(0.1))
PRIOR = GridBelief.gaussian(OU.grid, [0.5], [[0.5]])


def test_the_last_is_what_the_filter_believes_and_the_evidence_is_the_trackers():
    rng = np.random.default_rng(0)
    measured = [Measurement(int(t), 'place', (y,)) for t, y in zip(
        np.sort(rng.integers(0, 5 * STEP, size=9)), rng.normal(size=9))]
    tracker = Tracker(OU, PRIOR, history=10.0)
    for measurement in measured:
        tracker.observe(measurement)
    estimate, found = tracker.estimate(), smooth(OU, PRIOR, measured)
    np.testing.assert_array_equal(found.beliefs[-1].density, estimate.belief.density)
    assert found.stamps_ns[0] == measured[0].stamp_ns
    assert found.log_evidence == estimate.total_log_evidence


def test_later_measurements_are_seen_before_they_are_made():
    found = smooth(OU, PRIOR, [(5 * STEP, 'place', [2.0])], 0, every_step=True)
    means = found.means()[:, 0]
    assert means[0] > PRIOR.mean()[0] + 0.1
    assert np.all(np.diff(means) > 0)


@pytest.mark.parametrize('y', [20.0, -60.0, 1e4])
def test_after_an_outlier_all_is_finite_with_mass_one(y):
    found = smooth(OU, PRIOR, [(STEP, 'place', [0.3]), (2 * STEP, 'place', [y]),
                               (9 * STEP, 'place', [0.1])], 0)
    for belief in found.beliefs:
        assert np.all(np.isfinite(belief.density)) and np.all(belief.density >= 0)
        assert belief.mass == pytest.approx(1, abs=1e-12)
    # towards it, as far as the box goes
    assert np.sign(found.at(2 * STEP).mean()[0]) == np.sign(y)


def test_a_measurement_that_no_cell_allows_says_nothing():
    measured = [(STEP, 'place', [0.3]), (4 * STEP, 'place', [0.1])]
    plain = smooth(OU, PRIOR, measured, 0)
    found = smooth(OU, PRIOR, [*measured, (2 * STEP, 'place', [1e200])], 0)
    assert found.log_evidence == pytest.approx(plain.log_evidence, rel=1e-12)
    for stamp, belief in zip(plain.stamps_ns, plain.beliefs):
        np.testing.assert_allclose(found.at(stamp).density, belief.density, rtol=1e-9, atol=1e-12)


# Refusals


@pytest.mark.parametrize('every_step', [False, True])
def test_once_all_has_left_the_grid_what_was_before_is_what_was_measured_until_then(every_step):
    grid = Grid((0,), (10,), (50,))
    drifting = StateModel(('x',), lambda x, t: 0 * x + 20, np.eye(1) * 0.3)
    filter_ = DiracFeynmanFilter(drifting, grid, {'place': direct(1.0)}, KernelSettings(0.1))
    prior = filter_.gaussian([3], [[0.5]])
    seen, unseen = (STEP, 'place', [5.0]), [(t * STEP, 'place', [5.0]) for t in (20, 25)]
    assert filter_.predict(prior, 0, 20 * STEP).mass == 0
    found = smooth(filter_, prior, [seen, *unseen], 0, every_step)
    until = smooth(filter_, prior, [seen], 0)
    for stamp, belief in zip(until.stamps_ns, until.beliefs):
        np.testing.assert_allclose(found.at(stamp).density, belief.density, rtol=1e-12)
    for stamp in (20 * STEP, 25 * STEP):
        assert not found.at(stamp).density.any()
    assert all(np.all(np.isfinite(belief.density)) for belief in found.beliefs)
    assert found.log_evidence == pytest.approx(until.log_evidence, rel=1e-12)


@pytest.mark.parametrize('call, line', [
    (lambda: smooth(OU, PRIOR, []), 'measurements: expected at least one, got none'),
    (lambda: smooth(OU, PRIOR, [(3, 'place', [0.0])], 4),
     'measurements: expected stamps from 4 on, that of the prior, got 3'),
    (lambda: smooth(OU, PRIOR, [(0, 'place', [0.0]), (0.01, 'place', [0.0])]),
     'measurements: expected stamps in whole nanoseconds, an int each, got 0.01'),
    (lambda: smooth(OU, PRIOR, [(1.0, 'place', [0.0])]),
     'measurements: expected stamps in whole nanoseconds, an int each, got 1.0'),
    (lambda: smooth(OU, PRIOR, [(3, 'palce', [0.0])]),
     'measurements: expected sources place, got palce'),
    (lambda: smooth(OU, PRIOR, [(3, 'place', [0.0, 1.0])]),
     'measurements: expected 1 finite values of place, got [0.0, 1.0]'),
    (lambda: smooth(OU, PRIOR, [Measurement(3, 'place', (np.nan,))]),
     'measurements: expected 1 finite values of place, got [nan]'),
    (lambda: smooth(OU, PRIOR, [(3, 'place', [0.0])]).at(4),
     'stamp_ns: expected one of the 1 smoothed stamps, got 4'),
    (lambda: smooth(DiracFeynmanFilter(OU.model, OU.grid, OU.sensors, OU.kernel,
                                       operator=OperatorSettings(wavelet='db2')), PRIOR, []),
     'filter_: expected an operator on the cells, got one in the wavelet basis db2'),
])
def test_refuses_in_one_line_with_what_was_wanted_and_what_came(call, line):
    with pytest.raises(ValueError) as error:
        call()
    assert str(error.value) == line
