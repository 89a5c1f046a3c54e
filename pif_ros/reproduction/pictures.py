"""The pictures: densities against simulation, tracks with their bands, densities over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.path_monte_carlo import PathSample
from pif_ros.core.smoothing import Smoothed
from pif_ros.reproduction.looks import (BLUE, framed, GREEN, GREY, INK, legend_on_top, open_sides,
                                        ORANGE, SKY, styled, VERMILION)
from pif_ros.reproduction.records import Record
from pif_ros.reproduction.tracks import Track
from pif_ros.reproduction.transitions import Densities

Array = NDArray[np.float64]

_NANO = 1e-9
#: Below this share of the densest point a density is drawn as none.
_FLOOR = 1e-3
_LINES = (BLUE, VERMILION, GREEN, ORANGE, SKY)


def transition_picture(found: Densities, shown: Mapping[str, str]) -> Figure:
    """Return a row for each entry shown, by its title: its densities over the histograms."""
    with styled():
        figure = framed(9.0, 0.8 + 2.1 * len(shown))
        rows = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, name) in zip(rows, shown.items()):
            _transitions(ax, found, name)
            ax.set(title=title, ylabel='density')
            open_sides(ax)
        seen = np.any([_seen(found.by_entry[name]).any(axis=0) for name in shown.values()], axis=0)
        x = found.grid.axes[0][seen]
        rows[0].set(ylim=(0, None), xlim=(x[0], x[-1]))
        rows[-1].set_xlabel("x''")
        legend_on_top(figure, rows[0], 4)
    return figure


def path_picture(record: Record, labels: Sequence[str], measured: Sequence[str]) -> Figure:
    """Return the sample path and what was measured, a row for each component."""
    count, t = len(labels) + len(measured), record.stamps_ns * _NANO
    with styled():
        figure = framed(9.0, 0.3 + 1.6 * count, 0.0)
        rows = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
        for ax, label, values in zip(rows, labels, record.truth.T):
            ax.plot(t, values, color=INK, lw=0.9)
            ax.set_ylabel(label)
        for ax, label, values in zip(rows[len(labels):], measured, record.measured.T):
            joined = {'lw': 0.9} if record.origin is not None else {'ls': '', 'marker': '.'}
            ax.plot(t, values, color=BLUE, ms=2.5, **joined)
            ax.set_ylabel(label)
        _over_time(rows)
    return figure


def band_picture(record: Record, tracks: Mapping[str, Track], labels: Sequence[str]) -> Figure:
    """
    Return means with their 1 and 2 sigma bands over the truth.

    A row for each track and a column for each state; for many states the other way round.
    """
    truth, n, many = record.truth, len(labels), len(labels) > 2
    margin, low, high = 0.5 * np.ptp(truth, axis=0), truth.min(axis=0), truth.max(axis=0)
    shape, first = ((n, len(tracks)) if many else (len(tracks), n)), next(iter(tracks.values()))
    with styled():
        figure = framed(max(9.0, 4.7 * n) if not many else 11.0, 0.8 + 1.9 * shape[0])
        axes = figure.subplots(*shape, sharex=True, sharey='row' if many else 'col', squeeze=False)
        for row, (name, track) in zip(axes.T if many else axes, tracks.items()):
            t = record.stamps_ns[track.chosen] * _NANO
            for i, ax in enumerate(row):
                _bands(ax, t, track.means[:, i], np.sqrt(track.variances[:, i]))
                ax.plot(t, track.means[:, i], color=BLUE, lw=1.1, label='conditional mean')
                ax.plot(record.stamps_ns * _NANO, truth[:, i], color=INK, lw=0.9, label='truth')
                ax.set(ylim=(low[i] - margin[i], high[i] + margin[i]),
                       ylabel='' if many and track is not first else labels[i])
            row[0].set_title(name)
        for column in axes.T:
            _over_time(column)
        legend_on_top(figure, axes[0, 0], 4)
    return figure


def error_picture(record: Record, truth: Array, tracks: Mapping[str, Track],
                  label: str) -> Figure:
    """Return errors of the first component over their 1 and 2 sigma bands, a row for each."""
    with styled():
        figure = framed(9.0, 0.8 + 1.9 * len(tracks))
        rows = figure.subplots(len(tracks), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (name, track) in zip(rows, tracks.items()):
            t, sigma = record.stamps_ns[track.chosen] * _NANO, np.sqrt(track.variances[:, 0])
            _bands(ax, t, np.zeros(len(t)), sigma)
            ax.plot(t, truth[track.chosen, 0] - track.means[:, 0], color=INK, lw=0.9,
                    label='truth less conditional mean')
            ax.set(title=name, ylabel=label)
        _over_time(rows)
        legend_on_top(figure, rows[0], 3)
    return figure


def intensity_picture(record: Record, films: Mapping[str, tuple[Array, Grid, int]], label: str,
                      limits: tuple[float, float], every: int = 1) -> Figure:
    """
    Return densities over time, the brighter the denser, with the truth on them.

    films: by title the densities (k, cells) of a state, after every so many measurements, the
    grid whose axis they are on, and which axis.
    """
    t = record.stamps_ns * _NANO
    with styled():
        figure = framed(9.0, 0.8 + 2.6 * len(films))
        rows = figure.subplots(len(films), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, (film, grid, axis)) in zip(rows, films.items()):
            peak, span = film.max(axis=1, keepdims=True), every * (t[1] - t[0])
            image = ax.imshow(
                np.maximum(film / peak, _FLOOR).T, origin='lower', aspect='auto', cmap='magma',
                norm=LogNorm(_FLOOR, 1.0), interpolation='nearest',
                extent=(t[0] - span / 2, t[0] + span * (len(film) - 0.5), grid.lower[axis],
                        grid.upper[axis]))
            ax.plot(t, record.truth[:, axis], color=SKY, lw=1.3, label='truth',
                    path_effects=[withStroke(linewidth=2.6, foreground='black')])
            ax.set(title=title, ylabel=label, ylim=limits)
        rows[-1].set(xlabel='time [s]', xlim=(t[0], t[-1]))
        bar = figure.colorbar(image, ax=rows, aspect=36, pad=0.01, ticks=[1e-3, 1e-2, 1e-1, 1.0])
        bar.ax.set_yticklabels(['1/1000', '1/100', '1/10', '1'])
        bar.minorticks_off()
        bar.set_label('density relative to its peak', labelpad=2)
        bar.outline.set_visible(False)
        legend_on_top(figure, rows[0], 1)
    return figure


def marginal_picture(panels: Mapping[str, tuple[Mapping[str, tuple[Array, Array]], float]],
                     label: str) -> Figure:
    """
    Return marginal densities at one moment, a panel side by side for each title.

    A panel: curves by name, coordinates and density, and where the truth is.
    """
    with styled():
        figure = framed(4.6 * max(len(panels), 2), 3.9, 0.6)
        axes = figure.subplots(1, len(panels), squeeze=False)[0]
        for ax, (title, (curves, truth)) in zip(axes, panels.items()):
            for (name, (x, p)), colour in zip(curves.items(), _LINES):
                ax.plot(x, p, color=colour, lw=1.6, label=name)
            ax.axvline(truth, color=INK, lw=1.0, ls=(0, (2, 2)), label='truth')
            ax.set(title=title, xlabel=label, ylabel='density', ylim=(0, None))
            ax.margins(x=0)
            open_sides(ax)
        legend_on_top(figure, axes[0], 3)
    return figure


def cloud_picture(record: Record, clouds: Mapping[str, Array],
                  films: Mapping[str, tuple[Array, Grid]], axis: int, label: str,
                  every: int = 1) -> Figure:
    """
    Return particles (k, n, N) over time, a row for each cloud, with the truth on them.

    films: by title densities of the same state, (k, cells) after each measurement, for the rows
    below, and the grid whose only axis they are on.
    """
    t, count = record.stamps_ns * _NANO, len(clouds) + len(films)
    with styled():
        figure = framed(9.0, 0.8 + 2.4 * count)
        rows = figure.subplots(count, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, cloud) in zip(rows, clouds.items()):
            at = np.repeat(t[::every], cloud.shape[2])
            ax.plot(at, cloud[:, axis].ravel(), 'o', ms=1.2, mew=0, color=BLUE, alpha=0.25,
                    rasterized=True)
            ax.plot([], [], 'o', ms=4, mew=0, color=BLUE, label='particles')
            ax.plot(t, record.truth[:, axis], color=VERMILION, lw=1.1, label='truth')
            ax.set(title=title, ylabel=label)
        limits = rows[0].get_ylim()
        for ax, (title, (film, grid)) in zip(rows[len(clouds):], films.items()):
            share = film / film.max(axis=1, keepdims=True)
            ax.imshow(np.where(share > _FLOOR, share, np.nan).T, origin='lower', aspect='auto',
                      cmap='Blues', norm=LogNorm(_FLOOR, 1.0), interpolation='nearest',
                      extent=(t[0], t[-1], grid.lower[0], grid.upper[0]))
            ax.plot(t, record.truth[:, axis], color=VERMILION, lw=1.1)
            ax.set(title=title, ylabel=label, ylim=limits)
        rows[0].plot([], [], 's', ms=8, color=BLUE, label='density relative to its peak')
        _over_time(rows)
        legend_on_top(figure, rows[0], 3)
    return figure


def paths_picture(record: Record, smoothed: Smoothed, drawn: PathSample, grid: Grid) -> Figure:
    """Return some paths over the smoothed density of the first state, and its marginal halfway."""
    t, middle = np.array(drawn.stamps_ns) * _NANO, len(drawn.stamps_ns) // 2
    cells, edges = grid.select([0]), np.append(grid.axes[0], grid.upper[0]) - grid.spacing[0] / 2
    film = np.array([belief.on(grid, [0]).density for belief in smoothed.beliefs])
    counted = drawn.marginal(drawn.stamps_ns[middle], Grid(
        cells.lower, cells.upper, (cells.shape[0] // 4,)), [0])
    with styled():
        figure = framed(9.0, 3.6)
        left, right = figure.subplots(1, 2, width_ratios=[3, 1], sharey=True)
        left.pcolormesh(t, edges[:-1] + grid.spacing[0] / 2, film.T / film.max(), cmap='Greys',
                        shading='nearest', rasterized=True)
        for k, path in enumerate(drawn.paths[:, -1, :, 0]):
            left.plot(t, path, color=BLUE, lw=0.7, alpha=0.7, label=None if k else 'paths drawn')
        left.plot(t, np.append(record.start[0], record.truth[:, 0]), color=VERMILION, lw=1.4,
                  label='truth')
        left.plot([], [], 's', color=GREY, ms=8, label='density on the grid')
        right.fill_betweenx(counted.grid.axes[0], counted.density, step='mid', color=SKY,
                            alpha=0.5, lw=0, label='paths drawn')
        right.plot(film[middle], grid.axes[0], color=INK, lw=1.0, label='grid')
        shown = np.abs(drawn.paths[..., 0]).max() * 1.1
        left.set(xlabel='time [s]', ylabel=drawn.names[0], ylim=(-shown, shown))
        right.set(title=f't = {t[middle]:g} s', xlabel='density', xlim=(0, None))
        right.legend(loc='lower right')
        open_sides(left)
        open_sides(right)
        legend_on_top(figure, left, 3)
    return figure


def _transitions(ax: Axes, found: Densities, name: str) -> None:
    x, bins, truth = found.grid.axes[0], found.bins.axes[0], found.by_entry[found.truth]
    p = found.by_entry[name]
    for k, start in enumerate(found.starts):
        legend = [None if k else text for text in (
            'simulated paths', found.truth, 'path integral', "starting points x'")]
        ax.fill_between(bins, found.simulated[k], step='mid', color=GREY, lw=0, label=legend[0])
        ax.plot(x, _visible(truth[k]), color=INK, lw=0.9, label=legend[1])
        ax.plot(x, _visible(p[k]), color=BLUE, lw=2.0, ls=(0, (4, 2)), label=legend[2])
        ax.plot([start], [0.0], '^', color=VERMILION, ms=7, clip_on=False, zorder=5, ls='',
                label=legend[3])


def _bands(ax: Axes, t: Any, mean: Array, sigma: Array) -> None:
    ax.fill_between(t, mean - 2 * sigma, mean + 2 * sigma, color=SKY, alpha=0.35, lw=0,
                    label='2 sigma')
    ax.fill_between(t, mean - sigma, mean + sigma, color=BLUE, alpha=0.35, lw=0, label='1 sigma')


def _over_time(rows: Any) -> None:
    for ax in rows:
        ax.margins(x=0)
        open_sides(ax)
    rows[-1].set_xlabel('time [s]')


def _visible(p: Array) -> Array:
    """Return a density, NaN where it is too low to be seen."""
    return np.where(_seen(p), p, np.nan)


def _seen(p: Array) -> NDArray[np.bool_]:
    """Return where a density is high enough to be seen."""
    return np.asarray(p > _FLOOR * p.max())
