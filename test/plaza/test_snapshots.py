"""Densities can be drawn whatever they look like."""

from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure
from matplotlib.image import imread
import numpy as np
from pif_ros.plaza import snapshots
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.snapshots import draw_moments, Moment
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


@pytest.mark.parametrize(('count', 'lowest'), [(2, {0, 1}), (4, {1, 2, 3}), (6, {3, 4, 5})])
def test_the_lowest_of_each_column_has_an_axis_of_x(
        small: Recording, monkeypatch: pytest.MonkeyPatch, count: int, lowest: set[int]) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr(snapshots, 'save', lambda figure, file: drawn.append(figure))
    draw_moments(Path(), small, [moment(small, (-3.0, 20.0, 10.0))] * count)
    panels = [ax for ax in drawn[0].axes if ax.get_title(loc='left') == 'A title']
    assert len(panels) == count
    assert {k for k, ax in enumerate(panels) if ax.get_xlabel() == 'x [m]'} == lowest
    assert {k for k, ax in enumerate(panels)
            if ax.xaxis.get_major_ticks()[0].label1.get_visible()} == lowest


@pytest.mark.parametrize('humps', [
    [(0.0, 0.0, 1.0)], [(0.0, 0.0, 1.0), (30.0, 60.0, 1.0)], [(-60.0, -30.0, 0.1)],
    [(0.0, 0.0, 1.0), (30.0, 60.0, 1.0), (-50.0, 60.0, 1.0)], [(0.0, 0.0, 300.0)]])
def test_humps_of_any_number_and_width_are_drawn(
        tmp_path: Path, small: Recording, humps: list[tuple[float, float, float]]) -> None:
    draw_moments(tmp_path / 'p.png', small, [moment(small, *humps)])
    assert imread(tmp_path / 'p.png').std() > 0.05


def test_a_heading_is_shown_as_far_as_it_is_known(tmp_path: Path, small: Recording) -> None:
    """Oracle: how much of the dial is sky blue: all of it, a quarter, or next to none."""
    plain, blue = moment(small, (-3.0, 20.0, 10.0)), []
    for deviation in (2.0, np.pi / 8.0, 1e-3):
        posed = replace(plain, mean=np.array([*plain.mean, -np.pi / 2.0]),
                        covariance=np.diag([9.0, 4.0, deviation**2]))
        draw_moments(tmp_path / 'p.png', small, [posed])
        pixels = imread(tmp_path / 'p.png')[..., :3]
        sky = np.all(np.abs(pixels - np.array([0x56, 0xB4, 0xE9]) / 255.0) < 0.02, axis=-1)
        blue.append(sky.sum())
    # the white arrow of the true heading covers some of it
    assert blue[1] - blue[2] == pytest.approx(0.25 * (blue[0] - blue[2]), rel=0.2)
