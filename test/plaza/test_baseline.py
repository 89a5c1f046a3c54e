"""Any tracker on a recording."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_array_equal
from pif_ros.core.estimates import Measurement
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.systems import position_2d, range_sensor, unicycle_2d
from pif_ros.core.tracker import Tracker
from pif_ros.plaza.baseline import estimates, played
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import errors, Track
from pif_ros.plaza.schedule import Span
import pytest
import synthetic

#: How sure of its start the Kalman filter is: metres and radians.
SURE = np.array([1.0, 1.0, 0.3])


def run(recording: Recording, history: float = 60.0, odometry: bool = False) -> Track:
    model = (unicycle_2d(0.1, 0.02) if odometry else position_2d(0.7)).model
    sensors = {f'beacon_{beacon}': range_sensor(place, synthetic.SIGMA, synthetic.SCALE)
               for beacon, place in recording.beacons.items()}
    ekf = ExtendedKalmanFilter(model, sensors, time_step=1.0)
    start = recording.truth_at(recording.range_stamps_ns[0])[:model.ndim]
    return estimates(recording, Span(), Tracker(
        ekf, ekf.gaussian(start, np.diag(SURE[:model.ndim]**2)), history))


def test_gives_one_estimate_per_range_that_is_on_time(small: Recording) -> None:
    on_time = small.range_stamps_ns == small.arrivals_ns
    assert_array_equal(run(small).stamps_ns, small.range_stamps_ns[on_time])


def test_stays_with_the_mower_and_knows_how_well(small: Recording) -> None:
    track = run(small)
    s = errors(track, small.truth_at(track.stamps_ns))
    assert s.median < 0.7
    assert 0.75 < s.coverage_2_sigma < 0.97


def test_with_odometry_it_knows_better_and_has_the_heading(small: Recording) -> None:
    """What the synthetic odometry says is exact: a few ranges of 0.5 m each settle the rest."""
    track = run(small, odometry=True)
    s = errors(track, small.truth_at(track.stamps_ns))
    assert s.rmse < 0.3 and s.heading_rmse < 3.0
    halted = run(replace(small, odometry=0.0 * small.odometry), odometry=True)
    assert errors(halted, small.truth_at(halted.stamps_ns)).rmse > 2 * s.rmse


def test_late_ranges_within_the_history_sharpen_what_comes_after(small: Recording) -> None:
    """The first estimate after the late block: with it, the covariance is smaller."""
    with_late, without = run(small), run(small, history=0.0)
    late = small.range_stamps_ns < small.arrivals_ns
    after = int(np.searchsorted(with_late.stamps_ns, small.arrivals_ns[late][0], side='right'))
    volumes = [np.linalg.det(t.covariances[after]) for t in (with_late, without)]
    assert volumes[0] < volumes[1]


class Listener:
    """Stands in for a tracker, and notes when what it is given has arrived."""

    def __init__(self, recording: Recording, inputs: tuple[str, ...]) -> None:
        """Know when all of a recording arrives."""
        self.filter = SimpleNamespace(model=SimpleNamespace(inputs=inputs))
        self.heard: list[int] = []
        self._ends = dict(zip(recording.odometry_stamps_ns.tolist(),
                              recording.odometry_ends_ns.tolist()))

    def observe(self, measurement: Measurement) -> None:
        """Take a range, which arrives at its stamp unless later ones have come before."""
        self.heard.append(max([measurement.stamp_ns, *self.heard[-1:]]))

    def control(self, stamp_ns: int, _: np.ndarray) -> None:
        """Take a control, which arrives at the end of its interval."""
        self.heard.append(self._ends[stamp_ns])


@pytest.mark.parametrize(('inputs', 'odometry'), [((), 0), (('speed', 'turn'), 1)])
def test_everything_comes_once_in_the_order_of_arrival(
        small: Recording, inputs: tuple[str, ...], odometry: int) -> None:
    listener = Listener(small, inputs)
    seen = [(stamp, len(listener.heard)) for stamp in played(small, Span(), listener)]
    arrivals = np.concatenate([small.arrivals_ns, small.odometry_ends_ns[:odometry * 10**6]])
    assert listener.heard == sorted(arrivals.tolist())
    # whoever asks at a stamp has been given all that arrived before it, and that range
    assert all(np.sum(arrivals < stamp) < count <= np.sum(arrivals <= stamp)
               for stamp, count in seen)
