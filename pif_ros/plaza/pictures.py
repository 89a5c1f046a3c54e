"""The pictures of a run: the track, and the errors over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.scoring import mahalanobis_squared
from pif_ros.plaza.looks import (BLUE, ellipses, GREY, INK, ORANGE, room, save, SKY, STYLE,
                                 VERMILION)
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Track
from pif_ros.plaza.schedule import Span


def draw_track(file: Path, recording: Recording, track: Track, every: float = 30.0,
               span: Span = Span()) -> None:
    """
    Write the estimates over the true track of a span, with a 95 % ellipse every so many seconds.

    The first such time passes without one: the ellipse is as wide as the prior.
    """
    first, last = span.limits_ns(recording)
    played = (recording.truth_stamps_ns >= first) & (recording.truth_stamps_ns <= last)
    truth = recording.truth[played, :2]
    with rc_context(STYLE):
        figure = Figure(figsize=(9.0, 7.9), layout=room(top=0.06))
        ax = figure.subplots()
        chosen = _every(track.stamps_ns, round(every * 1e9))[1:]
        ellipses(ax, track.means[chosen], track.covariances[chosen], edgecolors=ORANGE,
                 facecolors=ORANGE + '30', linewidths=1.0, zorder=1)
        ax.plot(*truth.T, color=INK, lw=0.9, zorder=2, label='truth (GPS)')
        ax.plot(*track.means.T, 'o', color=BLUE, ms=2.2, mew=0, alpha=0.75, zorder=3,
                label='estimate, one per range')
        ax.plot([], [], 'o', ms=4.5, mec=ORANGE, mfc=ORANGE + '30',
                label=f'its 95 % ellipse, every {every:g} s')
        for beacon, (x, y) in recording.beacons.items():
            ax.plot(x, y, '^', ms=11, mec='black', mew=0.7, mfc=GREY, zorder=4)
            ax.annotate(f'beacon {beacon}', (x, y), xytext=(0, -17), ha='center',
                        textcoords='offset points')
        everything = np.concatenate([truth, np.array(list(recording.beacons.values()))])
        (left, low), (right, high) = everything.min(axis=0) - 6.0, everything.max(axis=0) + 6.0
        ax.set(xlim=(left, right), ylim=(low, high), aspect='equal', xlabel='x [m]',
               ylabel='y [m]')
        ax.spines[['top', 'right']].set_visible(False)
        _legend(figure, ax, 3)
        save(figure, file)


def draw_errors(file: Path, recording: Recording, tracks: Mapping[str, Track]) -> None:
    """
    Write the distance to the truth over time, one row per track, over what the track believed.

    The bands reach as far as the one and two sigma ellipses do in the direction of the error, so
    that a point is inside a band where the truth is inside that ellipse.  Below, where the first
    track has a heading, a row of its errors.
    """
    name, first = next(iter(tracks.items()))
    turned = first.means.shape[1] > 2
    with rc_context(STYLE):
        rows = len(tracks) + turned
        figure = Figure(figsize=(9.0, 0.8 + 2.3 * rows), layout=room(top=0.18 / (0.5 + rows)))
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        tops = [_draw_position_errors(ax, recording, name, track)
                for ax, (name, track) in zip(axes, tracks.items())]
        for ax in axes[:len(tracks)]:
            ax.set(ylim=(0.0, max(tops)), ylabel='error [m]')
        if turned:
            top = _draw_heading_errors(axes[-1], recording, f'heading of the {name}', first)
            axes[-1].set(ylim=(0.0, top), ylabel='error [degrees]')
        axes[-1].set_xlabel('time since the start [s]')
        _legend(figure, axes[0], 4)
        save(figure, file)


def _draw_position_errors(ax: Axes, recording: Recording, title: str, track: Track) -> float:
    """Draw one track's row and return the height that it asks for."""
    p = track.position()
    d = recording.truth_at(p.stamps_ns)[:, :2] - p.means
    e, m = np.linalg.norm(d, axis=1), np.sqrt(mahalanobis_squared(d, p.covariances))
    return _draw_errors(ax, recording, title, p.stamps_ns, e, e / np.maximum(m, 1e-9))


def _draw_heading_errors(ax: Axes, recording: Recording, title: str, track: Track) -> float:
    """Draw the row of a track's headings, the short way round, and return its height."""
    d = recording.truth_at(track.stamps_ns)[:, 2] - track.means[:, 2]
    e = np.abs(np.angle(np.exp(1j * d)))
    return _draw_errors(ax, recording, title, track.stamps_ns, np.degrees(e),
                        np.degrees(np.sqrt(track.covariances[:, 2, 2])))


def _draw_errors(ax: Axes, recording: Recording, title: str, stamps_ns: NDArray[np.int64],
                 e: NDArray[np.float64], sigma: NDArray[np.float64]) -> float:
    """Draw errors over bands of one and two sigma; return a height that leaves out the start."""
    t, inside = recording.seconds(stamps_ns), e < 2.0 * sigma
    silent = np.flatnonzero(np.diff(t) > 10.0) + 1
    at, reach = np.insert(t, silent, np.nan), np.insert(sigma, silent, np.nan)
    ax.fill_between(at, 0.0, 2 * reach, color=SKY, alpha=0.35, lw=0, label='2 sigma')
    ax.fill_between(at, 0.0, reach, color=BLUE, alpha=0.40, lw=0, label='1 sigma')
    ax.plot(t[inside], e[inside], 'o', color=INK, ms=1.8, mew=0, label='error')
    ax.plot(t[~inside], e[~inside], 'o', color=VERMILION, ms=2.2, mew=0,
            label='error outside 2 sigma')
    ax.set_title(title)
    ax.spines[['top', 'right']].set_visible(False)
    ax.margins(x=0.0)
    return 1.1 * float(e[t > t[0] + 0.1 * np.ptp(t)].max())


def _legend(figure: Figure, ax: Axes, columns: int) -> None:
    """Name above the figure what an axes shows, small markers large enough to tell apart."""
    figure.legend(*ax.get_legend_handles_labels(), loc='upper center', ncols=columns,
                  markerscale=2.5)


def _every(stamps_ns: NDArray[np.int64], interval_ns: int) -> NDArray[np.intp]:
    """Return the position of the first stamp in each interval."""
    return np.unique((stamps_ns - stamps_ns[0]) // interval_ns, return_index=True)[1]
