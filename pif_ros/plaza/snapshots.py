"""The pictures of densities: what was believed at telling moments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib import rc_context
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Wedge
from matplotlib.path import Path as MarkerPath
from matplotlib.patheffects import withStroke
import numpy as np
from numpy.typing import NDArray
from pif_ros.plaza.looks import ellipses, GREY, INK, ORANGE, room, save, SKY, STYLE
from pif_ros.plaza.recording import Recording
from scipy.ndimage import find_objects, label

_FLOOR = 1e-3
#: The widths of what is enlarged, in metres: the first in which the humps have room.
_ZOOMS = (5.0, 10.0)
_ROOM = 0.8
_SIZE = 0.31
_CORNERS = np.array([(0.67, 0.67), (0.02, 0.67), (0.67, 0.02)])
# A cross that is open in the middle, so that what it marks can be seen.
_CROSS = MarkerPath(
    [(-1, 0), (-0.3, 0), (0.3, 0), (1, 0), (0, -1), (0, -0.3), (0, 0.3), (0, 1)],
    [MarkerPath.MOVETO, MarkerPath.LINETO] * 4)
# White letters and lines, to be seen on any colour.
_OUTLINED, _EDGED = (withStroke(linewidth=w, foreground='black') for w in (2.0, 3.2))


@dataclass(frozen=True, eq=False)
class Moment:
    """
    A published density, and what was known when it was published.

    density: (nx, ny) per square metre, at the centres x (nx,) and y (ny,) in metres; mean (n,)
    and covariance (n, n): the published pose, with its heading where n is 3; heard: the beacons
    of the latest ranges.
    """

    title: str
    stamp_ns: int
    density: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    heard: tuple[int, ...] = ()


def draw_moments(file: Path, recording: Recording, moments: Sequence[Moment]) -> None:
    """Write the densities side by side, three in a row, each with the truth and the pose."""
    rows, legend = -(-len(moments) // 3), _legend(moments[0])
    left, right, low, high = _extent(moments[0])
    panel = 2.43 * (high - low) / (right - left)
    with rc_context(STYLE):
        below = 0.30 * -(-len(legend) // 4)
        height = 0.70 + rows * (panel + 0.33) + below
        figure = Figure(figsize=(9.0, height), layout=room(bottom=below / height))
        axes = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
        for ax, moment in zip(axes.flat, moments):
            image = _draw_moment(ax, recording, moment)
        for ax in axes.flat[len(moments):]:
            ax.set_axis_off()
        # the lowest of each column, below which there may be nothing
        for ax in axes.flat[max(len(moments) - 3, 0):len(moments)]:
            ax.set_xlabel('x [m]')
            ax.tick_params(labelbottom=True)
        for ax in axes[:, 0]:
            ax.set_ylabel('y [m]')
        bar = figure.colorbar(image, ax=axes, shrink=0.6, aspect=36, pad=0.01,
                              ticks=[1e-3, 1e-2, 1e-1, 1.0])
        bar.ax.set_yticklabels(['1/1000', '1/100', '1/10', '1'])
        bar.minorticks_off()
        bar.set_label('density relative to its peak', labelpad=2)
        bar.outline.set_visible(False)
        figure.legend(handles=legend, loc='lower center', ncols=4 if len(legend) == 4 else 3,
                      handletextpad=0.4, columnspacing=1.6)
        save(figure, file)


def _draw_moment(ax: Axes, recording: Recording, moment: Moment) -> AxesImage:
    left, right, low, high = _extent(moment)
    image = _draw_density(ax, moment)
    for beacon, (x, y) in recording.beacons.items():
        ax.plot(x, y, '^', ms=8, mec='black', mew=0.6, clip_on=False, zorder=5,
                mfc=ORANGE if beacon in moment.heard else GREY)
    x, y, heading = recording.truth_at(moment.stamp_ns)
    _mark_truth(ax, x, y, 13.0)
    _draw_zooms(ax, recording, moment, (x, y))
    seconds = float(recording.seconds(moment.stamp_ns))
    if len(moment.mean) > 2:
        _draw_compass(ax, moment, heading)
    ax.text(0.26 if len(moment.mean) > 2 else 0.035, 0.035, f't = {seconds:.1f} s',
            transform=ax.transAxes, color='white', fontweight='bold',
            path_effects=[_OUTLINED])
    ax.set_title(moment.title)
    ax.set(xlim=(left, right), ylim=(low, high), xticks=_round_steps((left, right), 25),
           yticks=_round_steps((low, high), 25))
    ax.label_outer()
    return image


def _draw_zooms(ax: Axes, recording: Recording, moment: Moment,
                truth: tuple[float, float]) -> None:
    """Enlarge the humps, one or two, where they are too small to be seen."""
    spots, width = _small_spots(moment)
    left, right, low, high = _extent(moment)
    size = np.array([right - left, high - low])
    marks = (np.array([truth, *spots, *recording.beacons.values()]) - (left, low)) / size
    free = [c for c in _CORNERS if np.abs(marks - c - _SIZE / 2).max(axis=1).min() > _SIZE / 2]
    for spot in spots[:len(free)]:
        at = (spot - (left, low)) / size
        corner = free.pop(int(np.argmin([np.hypot(*(c + _SIZE / 2 - at)) for c in free])))
        zoom = ax.inset_axes((*corner, _SIZE, _SIZE), xticks=[], yticks=[])
        _draw_density(zoom, moment)
        _mark_truth(zoom, *truth, 13.0)
        reach = np.array([-width, width]) / 2
        zoom.set(xlim=spot[0] + reach, ylim=spot[1] + reach)
        zoom.text(0.5, 0.04, f'{width:.0f} m', transform=zoom.transAxes, ha='center',
                  color='white', fontsize=8.5, path_effects=[_OUTLINED])
        zoom.spines[:].set_color('white')
        zoom.spines[:].set_alpha(0.7)
        ax.indicate_inset_zoom(zoom, edgecolor='white', alpha=0.7)


def _draw_compass(ax: Axes, moment: Moment, truth: float) -> None:
    """Draw which headings the pose allows, two sigma to either side, and the true one."""
    heading = np.degrees(moment.mean[2])
    reach = min(2.0 * np.degrees(np.sqrt(moment.covariance[2, 2])), 180.0)
    dial = ax.inset_axes((0.02, 0.02, 0.22, 0.22), aspect='equal', xlim=(-1.1, 1.1),
                         ylim=(-1.1, 1.1), zorder=4)
    dial.set_axis_off()
    dial.add_patch(Circle((0.0, 0.0), 1.0, fc=INK, ec='white', lw=0.8))
    dial.add_patch(Wedge((0.0, 0.0), 1.0, heading - reach, heading + reach, fc=SKY))
    dial.plot([0.0, np.cos(truth)], [0.0, np.sin(truth)], color='white', lw=1.6,
              path_effects=[_EDGED])


def _small_spots(moment: Moment) -> tuple[list[NDArray[np.float64]], float]:
    """
    Return the centres of the humps, and how wide a piece shows each of them.

    No centre where there are more than two humps, or where one is large.
    """
    labels, count = label(moment.density > 0.1 * moment.density.max())
    spots, size = [], 0.0
    for slices in find_objects(labels):
        x, y = moment.x[slices[0]], moment.y[slices[1]]
        size = max(size, np.ptp(x), np.ptp(y))
        spots.append(np.array([x.mean(), y.mean()]))
    widths = [width for width in _ZOOMS if size <= _ROOM * width]
    return (spots, widths[0]) if widths and count <= 2 else ([], 0.0)


def _draw_density(ax: Axes, moment: Moment) -> AxesImage:
    """Draw the density on a logarithmic scale, and the published 95 % ellipse over it."""
    p = np.maximum(moment.density.T / moment.density.max(), _FLOOR)
    image = ax.imshow(p, origin='lower', extent=_extent(moment), cmap='magma',
                      norm=LogNorm(_FLOOR, 1.0), interpolation='bilinear', aspect='equal')
    ellipses(ax, moment.mean[None, :2], moment.covariance[None, :2, :2], edgecolors=SKY,
             facecolors='none', linewidths=1.5)
    return image


def _mark_truth(ax: Axes, x: float, y: float, size: float) -> None:
    ax.plot(x, y, marker=_CROSS, color='white', ms=size, mew=1.6, zorder=6,
            path_effects=[_EDGED])


def _extent(moment: Moment) -> tuple[float, float, float, float]:
    """Return the outer edges of the cells: left, right, low, high."""
    dx, dy = moment.x[1] - moment.x[0], moment.y[1] - moment.y[0]
    return (float(moment.x[0] - dx / 2), float(moment.x[-1] + dx / 2),
            float(moment.y[0] - dy / 2), float(moment.y[-1] + dy / 2))


def _legend(moment: Moment) -> list[Artist]:
    entries: list[Artist] = [
        Line2D([], [], ls='', marker=_CROSS, ms=13, mew=1.8, color=INK, label='true position'),
        Line2D([], [], color=SKY, lw=1.8, label='95 % ellipse of ~/pose'),
        Line2D([], [], ls='', marker='^', ms=8, mec='black', mew=0.6, mfc=ORANGE,
               label='radio just heard'),
        Line2D([], [], ls='', marker='^', ms=8, mec='black', mew=0.6, mfc=GREY,
               label='other radio')]
    if len(moment.mean) > 2:
        entries += [Line2D([], [], color='white', lw=1.6, path_effects=[_EDGED],
                           label='true heading'),
                    Patch(fc=SKY, label='heading of ~/pose, 2 sigma')]
    return entries


def _round_steps(limits: tuple[float, float], step: int) -> NDArray[np.float64]:
    """Return round numbers between the limits, none so near that it runs into the neighbours'."""
    room = 0.08 * (limits[1] - limits[0])
    return step * np.arange(np.ceil((limits[0] + room) / step),
                            np.floor((limits[1] - room) / step) + 1)
