"""The pictures of a run: the density at telling moments, the track, the errors over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import EllipseCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.path import Path as MarkerPath
from matplotlib.patheffects import withStroke
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.scoring import mahalanobis_squared
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
from scipy.ndimage import find_objects, label

# Okabe and Ito's colours, which colour-blind readers can tell apart.
_SKY, _BLUE, _ORANGE, _VERMILION = '#56B4E9', '#0072B2', '#E69F00', '#D55E00'
_INK, _FAINT, _GREY = '#22272E', '#8A939E', '#C9CED6'
_CHI2_95 = 5.991  # the 95 % point of chi squared with two degrees of freedom
_FLOOR = 1e-3
_ZOOM = np.array([-5.0, 5.0])
_SIZE = 0.31
_CORNERS = np.array([(0.67, 0.67), (0.02, 0.67), (0.67, 0.02)])
# A cross that is open in the middle, so that what it marks can be seen.
_CROSS = MarkerPath(
    [(-1, 0), (-0.3, 0), (0.3, 0), (1, 0), (0, -1), (0, -0.3), (0, 0.3), (0, 1)],
    [MarkerPath.MOVETO, MarkerPath.LINETO] * 4)
_STYLE = {
    'font.size': 10.5, 'axes.titlesize': 11.5, 'axes.titlelocation': 'left',
    'axes.labelcolor': _INK, 'text.color': _INK, 'xtick.color': _INK, 'ytick.color': _INK,
    'axes.edgecolor': _FAINT, 'axes.linewidth': 0.8, 'savefig.facecolor': 'white',
    'legend.frameon': False, 'xtick.major.size': 3.0, 'ytick.major.size': 3.0}


@dataclass(frozen=True, eq=False)
class Moment:
    """
    A published density, and what was known when it was published.

    density: (nx, ny) per square metre, at the centres x (nx,) and y (ny,) in metres; mean (2,)
    and covariance (2, 2): the published pose; heard: the beacons of the latest ranges.
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
    rows = -(-len(moments) // 3)
    left, right, low, high = _extent(moments[0])
    panel = 2.43 * (high - low) / (right - left)
    with rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 1.0 + rows * (panel + 0.33)),
                        layout=_room(bottom=0.055))
        axes = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
        for ax, moment in zip(axes.flat, moments):
            image = _draw_moment(ax, recording, moment)
        for ax in axes.flat[len(moments):]:
            ax.set_axis_off()
        for ax in axes[-1]:
            ax.set_xlabel('x [m]')
        for ax in axes[:, 0]:
            ax.set_ylabel('y [m]')
        bar = figure.colorbar(image, ax=axes, shrink=0.6, aspect=36, pad=0.01,
                              ticks=[1e-3, 1e-2, 1e-1, 1.0])
        bar.ax.set_yticklabels(['1/1000', '1/100', '1/10', '1'])
        bar.minorticks_off()
        bar.set_label('density relative to its peak', labelpad=2)
        bar.outline.set_visible(False)
        figure.legend(handles=_moment_legend(), loc='lower center', ncols=4, handletextpad=0.4,
                      columnspacing=1.6)
        _save(figure, file)


def _draw_moment(ax: Axes, recording: Recording, moment: Moment) -> AxesImage:
    left, right, low, high = _extent(moment)
    image = _draw_density(ax, moment)
    for beacon, (x, y) in recording.beacons.items():
        ax.plot(x, y, '^', ms=8, mec='black', mew=0.6, clip_on=False, zorder=5,
                mfc=_ORANGE if beacon in moment.heard else _GREY)
    x, y, _ = recording.truth_at(moment.stamp_ns)
    _mark_truth(ax, x, y, 13.0)
    _draw_zooms(ax, recording, moment, (x, y))
    seconds = float(recording.seconds(moment.stamp_ns))
    ax.text(0.035, 0.035, f't = {seconds:.1f} s', transform=ax.transAxes, color='white',
            fontweight='bold', path_effects=[withStroke(linewidth=2.0, foreground='black')])
    ax.set_title(moment.title)
    ax.set(xlim=(left, right), ylim=(low, high), xticks=_round_steps((left, right), 25),
           yticks=_round_steps((low, high), 25))
    ax.label_outer()
    return image


def _draw_zooms(ax: Axes, recording: Recording, moment: Moment,
                truth: tuple[float, float]) -> None:
    """Enlarge the humps, one or two, where they are too small to be seen."""
    spots = _small_spots(moment)
    left, right, low, high = _extent(moment)
    size = np.array([right - left, high - low])
    marks = (np.array([truth, *spots, *recording.beacons.values()]) - (left, low)) / size
    free = [c for c in _CORNERS if np.abs(marks - c - _SIZE / 2).max(axis=1).min() > _SIZE / 2]
    for spot in spots[:len(free)]:
        at = (spot - (left, low)) / size
        corner = free.pop(int(np.argmin([np.hypot(*(c + _SIZE / 2 - at)) for c in free])))
        zoom = ax.inset_axes((*corner, _SIZE, _SIZE), xticks=[], yticks=[])
        _draw_density(zoom, moment)
        _mark_truth(zoom, *truth, 15.0)
        zoom.set(xlim=spot[0] + _ZOOM, ylim=spot[1] + _ZOOM)
        zoom.text(0.5, 0.04, f'{np.ptp(_ZOOM):.0f} m', transform=zoom.transAxes, ha='center',
                  color='white', fontsize=8.5)
        zoom.spines[:].set(color='white', alpha=0.7)
        ax.indicate_inset_zoom(zoom, edgecolor='white', alpha=0.7)


def _small_spots(moment: Moment) -> list[NDArray[np.float64]]:
    """Return the centres of the humps, none where there are more than two or one is large."""
    labels, count = label(moment.density > 0.1 * moment.density.max())
    if count > 2:
        return []
    spots = []
    for slices in find_objects(labels):
        x, y = moment.x[slices[0]], moment.y[slices[1]]
        if max(np.ptp(x), np.ptp(y)) > 0.8 * np.ptp(_ZOOM):
            return []
        spots.append(np.array([x.mean(), y.mean()]))
    return spots


def _draw_density(ax: Axes, moment: Moment) -> AxesImage:
    """Draw the density on a logarithmic scale, and the published 95 % ellipse over it."""
    p = np.maximum(moment.density.T / moment.density.max(), _FLOOR)
    image = ax.imshow(p, origin='lower', extent=_extent(moment), cmap='magma',
                      norm=LogNorm(_FLOOR, 1.0), interpolation='bilinear', aspect='equal')
    _ellipses(ax, moment.mean[None], moment.covariance[None], edgecolors=_SKY, facecolors='none',
              linewidths=1.5)
    return image


def _mark_truth(ax: Axes, x: float, y: float, size: float) -> None:
    ax.plot(x, y, marker=_CROSS, color='white', ms=size, mew=1.6, zorder=6,
            path_effects=[withStroke(linewidth=3.2, foreground='black')])


def _extent(moment: Moment) -> tuple[float, float, float, float]:
    """Return the outer edges of the cells: left, right, low, high."""
    dx, dy = moment.x[1] - moment.x[0], moment.y[1] - moment.y[0]
    return (float(moment.x[0] - dx / 2), float(moment.x[-1] + dx / 2),
            float(moment.y[0] - dy / 2), float(moment.y[-1] + dy / 2))


def _moment_legend() -> list[Line2D]:
    return [
        Line2D([], [], ls='', marker=_CROSS, ms=13, mew=1.8, color=_INK, label='true position'),
        Line2D([], [], color=_SKY, lw=1.8, label='95 % ellipse of ~/pose'),
        Line2D([], [], ls='', marker='^', ms=8, mec='black', mew=0.6, mfc=_ORANGE,
               label='radio just heard'),
        Line2D([], [], ls='', marker='^', ms=8, mec='black', mew=0.6, mfc=_GREY,
               label='other radio')]


def draw_track(file: Path, recording: Recording, track: Track, every: float = 30.0) -> None:
    """
    Write the estimates over the true track, with a 95 % ellipse every so many seconds.

    The first such time passes without one: the ellipse is as wide as the prior.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 7.9), layout=_room(top=0.06))
        ax = figure.subplots()
        chosen = _every(track.stamps_ns, round(every * 1e9))[1:]
        _ellipses(ax, track.means[chosen], track.covariances[chosen], edgecolors=_ORANGE,
                  facecolors=_ORANGE + '30', linewidths=1.0, zorder=1)
        ax.plot(*recording.truth[:, :2].T, color=_INK, lw=0.9, zorder=2, label='truth (GPS)')
        ax.plot(*track.means.T, 'o', color=_BLUE, ms=2.2, mew=0, alpha=0.75, zorder=3,
                label='estimate, one per range')
        ax.plot([], [], 'o', ms=4.5, mec=_ORANGE, mfc=_ORANGE + '30',
                label=f'its 95 % ellipse, every {every:g} s')
        for beacon, (x, y) in recording.beacons.items():
            ax.plot(x, y, '^', ms=11, mec='black', mew=0.7, mfc=_GREY, zorder=4)
            ax.annotate(f'beacon {beacon}', (x, y), xytext=(0, -17), ha='center',
                        textcoords='offset points')
        everything = np.concatenate(
            [recording.truth[:, :2], np.array(list(recording.beacons.values()))])
        (left, low), (right, high) = everything.min(axis=0) - 6.0, everything.max(axis=0) + 6.0
        ax.set(xlim=(left, right), ylim=(low, high), aspect='equal', xlabel='x [m]',
               ylabel='y [m]')
        ax.spines[['top', 'right']].set_visible(False)
        _legend(figure, ax, 3)
        _save(figure, file)


def draw_errors(file: Path, recording: Recording, tracks: Mapping[str, Track]) -> None:
    """
    Write the distance to the truth over time, one row per track, over what the track believed.

    The bands reach as far as the one and two sigma ellipses do in the direction of the error, so
    that a point is inside a band where the truth is inside that ellipse.
    """
    with rc_context(_STYLE):
        figure = Figure(figsize=(9.0, 0.8 + 2.3 * len(tracks)), layout=_room(top=0.06))
        axes = figure.subplots(len(tracks), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        top = 0.0
        for ax, (name, track) in zip(axes, tracks.items()):
            top = max(top, _draw_errors(ax, recording, name, track))
        axes[0].set(ylim=(0.0, top))
        axes[-1].set_xlabel('time since the start [s]')
        _legend(figure, axes[0], 4)
        _save(figure, file)


def _draw_errors(ax: Axes, recording: Recording, name: str, track: Track) -> float:
    """Draw one track's row and return the height that it asks for."""
    t = recording.seconds(track.stamps_ns)
    d = recording.truth_at(track.stamps_ns)[:, :2] - track.means
    e, m = np.linalg.norm(d, axis=1), np.sqrt(mahalanobis_squared(d, track.covariances))
    sigma = e / np.maximum(m, 1e-9)
    silent = np.flatnonzero(np.diff(t) > 10.0) + 1
    at, reach = np.insert(t, silent, np.nan), np.insert(sigma, silent, np.nan)
    ax.fill_between(at, 0.0, 2 * reach, color=_SKY, alpha=0.35, lw=0, label='2 sigma')
    ax.fill_between(at, 0.0, reach, color=_BLUE, alpha=0.40, lw=0, label='1 sigma')
    inside = m < 2.0
    ax.plot(t[inside], e[inside], 'o', color=_INK, ms=1.8, mew=0, label='error')
    ax.plot(t[~inside], e[~inside], 'o', color=_VERMILION, ms=2.2, mew=0,
            label='error outside 2 sigma')
    ax.set(title=name, ylabel='error [m]')
    ax.spines[['top', 'right']].set_visible(False)
    ax.margins(x=0.0)
    return 1.1 * float(e[t > t[0] + 0.1 * np.ptp(t)].max())


def _room(bottom: float = 0.0, top: float = 0.0) -> ConstrainedLayoutEngine:
    """Return a layout that leaves shares of the figure's height free for a legend."""
    return ConstrainedLayoutEngine(rect=(0.0, bottom, 1.0, 1.0 - bottom - top))


def _legend(figure: Figure, ax: Axes, columns: int) -> None:
    """Name above the figure what an axes shows, small markers large enough to tell apart."""
    figure.legend(*ax.get_legend_handles_labels(), loc='upper center', ncols=columns,
                  markerscale=2.5)


def _ellipses(ax: Axes, means: NDArray[np.float64], covariances: NDArray[np.float64],
              **looks: object) -> None:
    """Draw the 95 % ellipses of means (k, 2) with covariances (k, 2, 2)."""
    variances, directions = np.linalg.eigh(covariances)
    short, long = 2.0 * np.sqrt(_CHI2_95 * np.maximum(variances, 0.0)).T
    angles = np.degrees(np.arctan2(directions[:, 1, 1], directions[:, 0, 1]))
    ax.add_collection(EllipseCollection(
        long, short, angles, units='xy', offsets=means, offset_transform=ax.transData, **looks))


def _every(stamps_ns: NDArray[np.int64], interval_ns: int) -> NDArray[np.intp]:
    """Return the position of the first stamp in each interval."""
    return np.unique((stamps_ns - stamps_ns[0]) // interval_ns, return_index=True)[1]


def _round_steps(limits: tuple[float, float], step: int) -> NDArray[np.float64]:
    """Return round numbers between the limits, none so near that it runs into the neighbours'."""
    room = 0.08 * (limits[1] - limits[0])
    return step * np.arange(np.ceil((limits[0] + room) / step),
                            np.floor((limits[1] - room) / step) + 1)


def _save(figure: Figure, file: Path) -> None:
    FigureCanvasAgg(figure)
    figure.savefig(file, dpi=200)
