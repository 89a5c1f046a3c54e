"""How good a track is, and how honest about itself: scores, and their table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.scoring import coverage, honest_coverage, mahalanobis_squared, rmse


@dataclass(frozen=True, eq=False)
class Track:
    """
    Estimates of a position over time, and of a heading where n is 3.

    stamps_ns: (k,); means: (k, n), x and y in metres, heading in radians; covariances: (k, n, n).
    """

    stamps_ns: NDArray[np.int64]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]

    def at(self, chosen: ArrayLike) -> Track:
        """Return the estimates of some places, or where a mask is true."""
        c = np.asarray(chosen)
        return Track(self.stamps_ns[c], self.means[c], self.covariances[c])

    def position(self) -> Track:
        """Return the same without the heading."""
        return Track(self.stamps_ns, self.means[:, :2], self.covariances[:, :2, :2])


@dataclass(frozen=True)
class Scores:
    """
    The errors of a track of `count` estimates, in metres, and how well it knows them.

    coverage_1_sigma, coverage_2_sigma: the share of the truth inside the published ellipses;
    nees: the mean of the squared Mahalanobis distance over the number of dimensions, 1 if honest;
    heading_rmse: in degrees, None where no heading is estimated.
    """

    count: int
    rmse: float
    median: float
    percentile_95: float
    maximum: float
    coverage_1_sigma: float
    coverage_2_sigma: float
    nees: float
    heading_rmse: float | None = None


def errors(track: Track, truth: ArrayLike, skip: float = 0.1) -> Scores:
    """
    Return the scores of a track against the truth (k, 2), or (k, 3) with the heading.

    The first part of the run, the share `skip` of the time, does not count.
    ValueError where nothing is left, or where a number is not finite.
    """
    t = track.stamps_ns
    if len(t) == 0:
        raise ValueError('expected at least one estimate to score, got none')
    kept = t >= t.min() + skip * (t.max() - t.min())
    x, position = np.asarray(truth, dtype=float)[kept], track.position().at(kept)
    P = position.covariances
    d = x[:, :2] - position.means
    if not (np.all(np.isfinite(d)) and np.all(np.isfinite(P))):
        raise ValueError('expected finite means, covariances and truth')
    distance, square = np.linalg.norm(d, axis=1), mahalanobis_squared(d, P)
    return Scores(
        count=len(d), rmse=rmse(d), median=float(np.median(distance)),
        percentile_95=float(np.percentile(distance, 95)), maximum=float(distance.max()),
        coverage_1_sigma=coverage(d, P, 1.0), coverage_2_sigma=coverage(d, P, 2.0),
        nees=float(np.mean(square)) / 2, heading_rmse=_heading_rmse(track.means[kept], x))


def _heading_rmse(means: NDArray[np.float64], truth: NDArray[np.float64]) -> float | None:
    """Return how far off the headings are in degrees, the short way round; None without any."""
    if means.shape[1] < 3:
        return None
    d = means[:, 2] - truth[:, 2]
    return float(np.degrees(rmse(np.angle(np.exp(1j * d))[:, None])))


def table(rows: Mapping[str, Scores]) -> str:
    """Return the scores as a Markdown table, one row per name; headings where there are any."""
    headed = any(s.heading_rmse is not None for s in rows.values())
    lines = ['| Filter | RMSE | median | 95 % | max | in 1 sigma | in 2 sigma | NEES / 2 |'
             + ' heading RMSE |' * headed,
             '|---|---:|---:|---:|---:|---:|---:|---:|' + '---:|' * headed]
    for name, s in rows.items():
        heading = '' if s.heading_rmse is None else f'{s.heading_rmse:.1f} deg'
        lines.append(
            f'| {name} | {s.rmse:.2f} m | {s.median:.2f} m | {s.percentile_95:.2f} m '
            f'| {s.maximum:.1f} m | {s.coverage_1_sigma:.2f} | {s.coverage_2_sigma:.2f} '
            f'| {s.nees:.2f} |' + f' {heading} |' * headed)
    lines.append(
        f'| *an honest filter* | | | | | *{honest_coverage(1.0, 2):.2f}* '
        f'| *{honest_coverage(2.0, 2):.2f}* | *1.00* |' + ' |' * headed)
    return '\n'.join(lines) + '\n'
