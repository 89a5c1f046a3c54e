"""The pictures can be drawn from anything that a run can bring."""

from pathlib import Path

from matplotlib.image import imread
import numpy as np
from pif_ros.plaza.pictures import draw_errors, draw_moments, draw_track, Moment
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
import pytest

X, Y = np.arange(-60.0, 40.0, 1.0), np.arange(-30.0, 70.0, 1.0)


def moment(recording: Recording, *humps: tuple[float, float, float]) -> Moment:
    """Return a density of humps at x and y with a width."""
    density = sum(np.exp(-0.5 * ((X[:, None] - x)**2 + (Y - y)**2) / s**2) for x, y, s in humps)
    return Moment('A title', recording.start_ns, density / density.sum(), X, Y,
                  np.array(humps[0][:2]), np.diag([9.0, 4.0]), (5,))


@pytest.mark.parametrize('count', [1, 3, 4, 6])
def test_moments_are_drawn_three_in_a_row(tmp_path: Path, small: Recording, count: int) -> None:
    draw_moments(tmp_path / 'p.png', small, [moment(small, (-3.0, 20.0, 10.0))] * count)
    height, width = imread(tmp_path / 'p.png').shape[:2]
    assert width == 1800
    assert (height > 0.5 * width) == (count > 3)


@pytest.mark.parametrize('humps', [
    [(0.0, 0.0, 1.0)], [(0.0, 0.0, 1.0), (30.0, 60.0, 1.0)], [(-60.0, -30.0, 0.1)],
    [(0.0, 0.0, 1.0), (30.0, 60.0, 1.0), (-50.0, 60.0, 1.0)], [(0.0, 0.0, 300.0)]])
def test_humps_of_any_number_and_width_are_drawn(
        tmp_path: Path, small: Recording, humps: list[tuple[float, float, float]]) -> None:
    draw_moments(tmp_path / 'p.png', small, [moment(small, *humps)])
    assert imread(tmp_path / 'p.png').std() > 0.05


def test_tracks_and_errors_are_drawn(tmp_path: Path, small: Recording) -> None:
    stamps = np.unique(small.range_stamps_ns)
    noise = np.random.default_rng(0).normal(size=(len(stamps), 2))
    track = Track(stamps, small.truth_at(stamps)[:, :2] + noise,
                  np.tile(np.eye(2), (len(stamps), 1, 1)))
    draw_track(tmp_path / 'track.png', small, track)
    draw_errors(tmp_path / 'errors.png', small, {'one': track, 'other': track})
    for name in ('track.png', 'errors.png'):
        assert imread(tmp_path / name).shape[1] == 1800
