"""Which poses are scored, and which densities are shown."""

import numpy as np
from numpy.testing import assert_array_equal
from pif_ros.plaza.evaluation import corrected, forecasts, moments, Run, scores
from pif_ros.plaza.moments import Wanted
from pif_ros.plaza.recorder import Density
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
import pytest


def track(stamps_ns: np.ndarray) -> Track:
    """Return estimates of nothing at some stamps."""
    k = len(stamps_ns)
    return Track(np.asarray(stamps_ns), np.zeros((k, 2)), np.tile(np.eye(2), (k, 1, 1)))


@pytest.fixture
def run(small: Recording) -> Run:
    """Return a run with a pose at every range, one between any two, and some in the silence."""
    heard = np.unique(small.range_stamps_ns)
    silent = small.start_ns + np.arange(41, 80) * 10**9
    stamps = np.unique(np.concatenate([heard, heard - 1, silent]))
    density = Density(np.ones((2, 3)), np.arange(2.0), np.arange(3.0))
    return Run(small, {'ranges': len(heard)}, {}, track(stamps), [(int(heard[0]), density)])


def test_only_poses_that_have_seen_the_range_of_their_stamp_are_corrections(run: Run) -> None:
    assert_array_equal(corrected(run).stamps_ns, np.unique(run.recording.range_stamps_ns))


def test_forecasts_are_the_poses_after_ten_seconds_of_silence(run: Run) -> None:
    """The last range before the silence is at 39.75 s, the first after it at 80 s."""
    seconds = run.recording.seconds(forecasts(run).stamps_ns)
    assert_array_equal(np.round(seconds, 6), [*np.arange(50.0, 80.0), 80.0])


def test_tracks_are_compared_at_the_stamps_that_they_have_in_common(small: Recording) -> None:
    stamps = np.unique(small.range_stamps_ns)
    found = scores(small, {'one': track(stamps[::2]), 'other': track(stamps[::3])}, skip=0.0)
    assert found['one'] == found['other']
    assert found['one'].count == len(stamps[::6])


def test_a_moment_is_shown_with_the_pose_of_its_density(run: Run) -> None:
    stamp = run.densities[0][0]
    shown = moments(run, [Wanted('here', stamp, stamp, (5,)), Wanted('nowhere', 1, 2),
                          Wanted('before', stamp - 1, stamp + 1, (6,))])
    assert [(m.title, m.stamp_ns, m.heard) for m in shown] == [
        ('here', stamp, (5,)), ('before', stamp, ())]
    assert_array_equal(shown[0].covariance, np.eye(2))
