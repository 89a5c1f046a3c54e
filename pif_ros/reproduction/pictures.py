"""The pictures: densities against simulation, tracks with their bands, densities over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.reproduction.looks import (BLUE, framed, GREEN, GREY, INK, legend_on_top, open_sides,
                                        ORANGE, SKY, styled, VERMILION)
from pif_ros.reproduction.records import Record
from pif_ros.reproduction.tracks import Track
from pif_ros.reproduction.transitions import Densities, REFERENCE

Array = NDArray[np.float64]

_NANO = 1e-9
_FLOOR = 1e-3
_LINES = (BLUE, VERMILION, GREEN, ORANGE, SKY)


def transition_picture(found: Densities, shown: Mapping[str, str]) -> Figure:
    """Return a row for each entry shown, by its title: its densities over the histograms."""
    with styled():
        figure = framed(9.0, 0.8 + 2.1 * len(shown))
        rows = figure.subplots(len(shown), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        x, bins = found.grid.axes[0], found.bins.axes[0]
        for ax, (title, name) in zip(rows, shown.items()):
            for k in range(len(found.starts)):
                ax.fill_between(bins, found.simulated[k], step='mid', color=GREY, lw=0,
                                label=None if k else 'simulated paths')
                ax.plot(x, found.by_entry[REFERENCE.name][k], color=INK, lw=0.9,
                        label=None if k else 'Fokker-Planck equation')
                ax.plot(x, found.by_entry[name][k], color=BLUE, lw=2.0, ls=(0, (4, 2)),
                        label=None if k else 'path integral')
                ax.plot([found.starts[k]], [0.0], '^', color=VERMILION, ms=7, clip_on=False,
                        zorder=5, ls='', label=None if k else "starting points x'")
            ax.set(title=title, ylabel='density')
            open_sides(ax)
        rows[0].set(ylim=(0, None), xlim=_where(x, found))
        rows[-1].set_xlabel("x''")
        legend_on_top(figure, rows[0], 4)
    return figure


def path_picture(record: Record, labels: Sequence[str], measured: Sequence[str]) -> Figure:
    """Return the sample path and what was measured, a row for each component."""
    count = len(labels) + len(measured)
    with styled():
        figure = framed(9.0, 0.3 + 1.5 * count, 0.0)
        rows = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
        t = record.stamps_ns * _NANO
        for ax, label, values in zip(rows, labels, record.truth.T):
            ax.plot(t, values, color=INK, lw=0.9)
            ax.set_ylabel(label)
        for ax, label, values in zip(rows[len(labels):], measured, record.measured.T):
            ax.plot(t, values, '.', color=BLUE, ms=2.0)
            ax.set_ylabel(label)
        _over_time(rows, t)
    return figure


def band_picture(truth: Array, stamps_ns: NDArray[np.int64], tracks: Mapping[str, Track],
                 labels: Sequence[str], limits: Sequence[tuple[float, float]]) -> Figure:
    """Return means with their 1 and 2 sigma bands over the truth, a row for each track."""
    with styled():
        figure = framed(4.6 * len(labels) if len(labels) > 1 else 9.0, 0.7 + 1.8 * len(tracks))
        axes = figure.subplots(len(tracks), len(labels), sharex=True, sharey='col', squeeze=False)
        t = stamps_ns * _NANO
        for row, (name, track) in zip(axes, tracks.items()):
            for i, ax in enumerate(row):
                _bands(ax, t, track.means[:, i], np.sqrt(track.variances[:, i]), truth[:, i])
                ax.set(ylabel=labels[i], ylim=limits[i])
            row[0].set_title(name)
        for column in axes.T:
            _over_time(column, t)
        legend_on_top(figure, axes[0, 0], 4)
    return figure


def intensity_picture(record: Record, films: Mapping[str, Array], grid: Grid, axis: int,
                      label: str, every: int = 1) -> Figure:
    """Return densities over time, the darker the denser, with the truth on them."""
    t = record.stamps_ns * _NANO
    with styled():
        figure = framed(9.0, 0.6 + 2.6 * len(films))
        rows = figure.subplots(len(films), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, film) in zip(rows, films.items()):
            peak = film.max(axis=1, keepdims=True)
            image = ax.imshow(
                np.maximum(film / peak, _FLOOR).T, origin='lower', aspect='auto', cmap='magma',
                norm=LogNorm(_FLOOR, 1.0), interpolation='nearest',
                extent=(t[0], t[-1] + t[0], grid.lower[axis], grid.upper[axis]))
            ax.plot(t, record.truth[:, axis], color=SKY, lw=1.0, label='truth')
            ax.set(title=title, ylabel=label)
        rows[-1].set_xlabel('time [s]')
        bar = figure.colorbar(image, ax=rows, aspect=36, pad=0.01, ticks=[1e-3, 1e-2, 1e-1, 1.0])
        bar.ax.set_yticklabels(['1/1000', '1/100', '1/10', '1'])
        bar.minorticks_off()
        bar.set_label('density relative to its peak', labelpad=2)
        bar.outline.set_visible(False)
        legend_on_top(figure, rows[0], 1)
    return figure


def marginal_picture(curves: Mapping[str, Array], grid: Grid, axis: int, label: str, title: str,
                     truth: float) -> Figure:
    """Return marginal densities at one moment, and where the truth is."""
    with styled():
        figure = framed(9.0, 3.6, 0.55)
        ax = figure.subplots()
        for (name, p), colour in zip(curves.items(), _LINES):
            ax.plot(grid.axes[axis], p, color=colour, lw=1.6, label=name)
        ax.axvline(truth, color=INK, lw=1.0, ls=(0, (2, 2)), label='truth')
        ax.set(title=title, xlabel=label, ylabel='density', ylim=(0, None))
        ax.margins(x=0)
        open_sides(ax)
        legend_on_top(figure, ax, 3)
    return figure


def cloud_picture(record: Record, clouds: Mapping[str, Array], axis: int, label: str,
                  every: int = 1) -> Figure:
    """Return particles (K, n, N) over time, a row for each cloud, with the truth on them."""
    t = record.stamps_ns * _NANO
    with styled():
        figure = framed(9.0, 0.6 + 2.4 * len(clouds))
        rows = figure.subplots(len(clouds), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        for ax, (title, cloud) in zip(rows, clouds.items()):
            at = np.repeat(t[::every], cloud.shape[2])
            ax.plot(at, cloud[:, axis].ravel(), ',', color=BLUE, alpha=0.35, rasterized=True)
            ax.plot([], [], 'o', ms=3, color=BLUE, label='particles')
            ax.plot(t, record.truth[:, axis], color=VERMILION, lw=1.0, label='truth')
            ax.set(title=title, ylabel=label)
        _over_time(rows, t)
        legend_on_top(figure, rows[0], 2)
    return figure


def _bands(ax: Axes, t: Array, mean: Array, sigma: Array, truth: Array) -> None:
    ax.fill_between(t, mean - 2 * sigma, mean + 2 * sigma, color=SKY, alpha=0.35, lw=0,
                    label='2 sigma')
    ax.fill_between(t, mean - sigma, mean + sigma, color=BLUE, alpha=0.35, lw=0, label='1 sigma')
    ax.plot(t, mean, color=BLUE, lw=1.1, label='conditional mean')
    ax.plot(t, truth, color=INK, lw=0.9, label='truth')


def _over_time(rows: Sequence[Axes], t: Array) -> None:
    for ax in rows:
        ax.margins(x=0)
        open_sides(ax)
    rows[-1].set_xlabel('time [s]')


def _where(x: Array, found: Densities) -> tuple[float, float]:
    """Return where there is a density to be seen."""
    seen = np.flatnonzero(found.by_entry[REFERENCE.name].max(axis=0) > 1e-3)
    return float(x[seen[0]]), float(x[seen[-1]])
