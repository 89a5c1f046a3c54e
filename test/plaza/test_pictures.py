"""Tracks and errors can be drawn."""

from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.image import imread
import numpy as np
from pif_ros.plaza import pictures
from pif_ros.plaza.pictures import draw_errors, draw_track
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
from pif_ros.plaza.schedule import Span
import pytest


def estimated(recording: Recording, states: int) -> Track:
    """Return the truth with some noise."""
    stamps = np.unique(recording.range_stamps_ns)
    noise = np.random.default_rng(0).normal(size=(len(stamps), states))
    return Track(stamps, recording.truth_at(stamps)[:, :states] + noise,
                 np.tile(np.eye(states), (len(stamps), 1, 1)))


def test_tracks_and_errors_are_drawn(tmp_path: Path, small: Recording) -> None:
    track = estimated(small, 2)
    draw_track(tmp_path / 'track.png', small, track)
    draw_errors(tmp_path / 'errors.png', small, {'one': track, 'other': track})
    for name in ('track.png', 'errors.png'):
        assert imread(tmp_path / name).shape[1] == 1800


def test_a_track_is_held_against_the_truth_of_what_was_played(
        small: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(pictures, 'save', lambda figure, file: drawn.append(figure))
    for span in (Span(), Span(5.0, 20.0)):
        draw_track(Path(), small, estimated(small, 2), span=span)
    whole, part = ({line.get_label(): line.get_xydata() for line in figure.axes[0].lines}
                   ['truth (GPS)'] for figure in drawn)
    np.testing.assert_array_equal(whole, small.truth[:, :2])
    seconds = small.seconds(small.truth_stamps_ns)
    np.testing.assert_array_equal(part, [pose[:2] for pose, at in zip(small.truth, seconds)
                                         if 5.0 <= at <= 25.0])


def test_headings_have_a_row_of_errors_of_their_own(tmp_path: Path, small: Recording) -> None:
    heights = []
    for states in (2, 3):
        draw_errors(tmp_path / 'errors.png', small, {'one': estimated(small, states)})
        heights.append(imread(tmp_path / 'errors.png').shape[0])
    assert heights[1] - heights[0] == pytest.approx(460, abs=1)  # a pixel may be cut off
