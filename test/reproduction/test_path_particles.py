"""The particle filter of a measured path is exact as its particles become many."""

import numpy as np
from pif_ros.core.systems import ornstein_uhlenbeck
from pif_ros.reproduction.contenders import gaussian, PathProblem
from pif_ros.reproduction.records import path_recorded
from pif_ros.reproduction.tracks import follow, moments
import pytest

SYSTEM = ornstein_uhlenbeck(sigma_y=0.3)
SENSORS = {'position': SYSTEM.sensors['position']()}
PROBLEM = PathProblem(SYSTEM.model, SENSORS, gaussian([0.0], [[1.0]]))


@pytest.mark.parametrize('interval', [0.02, 0.2])
def test_agrees_with_the_exact_filter_however_far_the_points_are_apart(interval):
    record = path_recorded(SYSTEM.model, SENSORS['position'], 'position', np.array([1.0]),
                           interval * np.arange(21), np.random.default_rng(2), 20)
    tracks = []
    for contender in (PROBLEM.extended(interval), PROBLEM.particles('', '', 20_000, 0.01)):
        filter_, prior = contender.start(0)
        tracks.append(follow(filter_, prior, record, moments, {}))
    exact, particles = tracks
    # 20,000 particles, of which a few thousand carry the weight, and Euler steps of 0.01
    assert np.abs(particles.means - exact.means).max() < 0.04
    assert particles.variances == pytest.approx(exact.variances, rel=0.15)
    assert particles.log_evidence == pytest.approx(exact.log_evidence, abs=0.3)


def test_forecasts_without_the_path_leave_no_trace():
    filter_, prior = PROBLEM.particles('', '', 100, 0.01).start(0)
    begun, _ = filter_.correct(prior, [0.0], 'position', 0)
    ahead = filter_.predict(begun, 0, 50_000_000)
    assert not np.array_equal(ahead.now.points, begun.now.points)
    one, _ = filter_.correct(ahead, [0.1], 'position', 50_000_000)
    other, _ = filter_.correct(begun, [0.1], 'position', 50_000_000)
    assert np.array_equal(one.now.points, other.now.points)


def test_a_measured_path_is_the_integral_of_what_is_seen():
    clear = ornstein_uhlenbeck(sigma_y=1e-6)
    times = 0.1 * np.arange(31)
    record = path_recorded(clear.model, clear.sensors['position'](), 'position', np.array([1.0]),
                           times, np.random.default_rng(0), 50)
    assert record.origin.tolist() == [0.0] and np.array_equal(record.stamps_ns, np.rint(
        times[1:] * 1e9))
    x = np.concatenate([record.start, record.truth[:, 0]])
    integral = np.cumsum((x[1:] + x[:-1]) / 2 * 0.1)
    # between the points the path is a bridge, whose integral scatters by sqrt(0.1^3 / 12)
    assert np.abs(record.measured[:, 0] - integral).max() < 4 * np.sqrt(30 * 0.1**3 / 12)
