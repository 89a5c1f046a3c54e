"""The extended Kalman filter on a recording."""

import numpy as np
from numpy.testing import assert_array_equal
from pif_ros.core.systems import position_2d, range_sensor
from pif_ros.plaza.baseline import extended_kalman_track
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import errors, Track
from pif_ros.plaza.schedule import Span
import synthetic


def run(recording: Recording, history: float = 60.0) -> Track:
    sensors = {beacon: range_sensor(place, synthetic.SIGMA, synthetic.SCALE)
               for beacon, place in recording.beacons.items()}
    start = recording.truth_at(recording.range_stamps_ns[0])[:2]
    return extended_kalman_track(recording, Span(), position_2d(0.7).model, sensors, start,
                                 np.eye(2), history)


def test_gives_one_estimate_per_range_that_is_on_time(small: Recording) -> None:
    on_time = small.range_stamps_ns == small.arrivals_ns
    assert_array_equal(run(small).stamps_ns, small.range_stamps_ns[on_time])


def test_stays_with_the_mower_and_knows_how_well(small: Recording) -> None:
    track = run(small)
    s = errors(track.stamps_ns, track.means, track.covariances,
               small.truth_at(track.stamps_ns))
    assert s.median < 0.7
    assert 0.75 < s.coverage_2_sigma < 0.97


def test_late_ranges_within_the_history_sharpen_what_comes_after(small: Recording) -> None:
    """The first estimate after the late block: with it, the covariance is smaller."""
    with_late, without = run(small), run(small, history=0.0)
    late = small.range_stamps_ns < small.arrivals_ns
    after = int(np.searchsorted(with_late.stamps_ns, small.arrivals_ns[late][0], side='right'))
    volumes = [np.linalg.det(t.covariances[after]) for t in (with_late, without)]
    assert volumes[0] < volumes[1]
