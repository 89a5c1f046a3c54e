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
    Estimates of a position over time.

    stamps_ns: (k,); means: (k, 2) in metres; covariances: (k, 2, 2) in square metres.
    """

    stamps_ns: NDArray[np.int64]
    means: NDArray[np.float64]
    covariances: NDArray[np.float64]


@dataclass(frozen=True)
class Scores:
    """
    The errors of a track of `count` estimates, in metres, and how well it knows them.

    coverage_1_sigma, coverage_2_sigma: the share of the truth inside the published ellipses;
    nees: the mean of the squared Mahalanobis distance over the number of dimensions, 1 if honest.
    """

    count: int
    rmse: float
    median: float
    percentile_95: float
    maximum: float
    coverage_1_sigma: float
    coverage_2_sigma: float
    nees: float


def errors(stamps_ns: ArrayLike, means: ArrayLike, covariances: ArrayLike, truth: ArrayLike,
           skip: float = 0.1) -> Scores:
    """
    Return the scores of means (k, n) with covariances (k, n, n) against the truth (k, >= n).

    The first part of the run, the share `skip` of the time, does not count.
    ValueError where nothing is left, or where a number is not finite.
    """
    t = np.asarray(stamps_ns, dtype=np.int64)
    if len(t) == 0:
        raise ValueError('expected at least one estimate to score, got none')
    kept = t >= t.min() + skip * (t.max() - t.min())
    m = np.asarray(means, dtype=float)[kept]
    P = np.asarray(covariances, dtype=float)[kept]
    d = np.asarray(truth, dtype=float)[kept][:, :m.shape[1]] - m
    if not (np.all(np.isfinite(d)) and np.all(np.isfinite(P))):
        raise ValueError('expected finite means, covariances and truth')
    distance, square = np.linalg.norm(d, axis=1), mahalanobis_squared(d, P)
    return Scores(
        count=len(d), rmse=rmse(d), median=float(np.median(distance)),
        percentile_95=float(np.percentile(distance, 95)), maximum=float(distance.max()),
        coverage_1_sigma=coverage(d, P, 1.0), coverage_2_sigma=coverage(d, P, 2.0),
        nees=float(np.mean(square)) / m.shape[1])


def table(rows: Mapping[str, Scores]) -> str:
    """Return the scores as a Markdown table, one row per name."""
    lines = [
        '| Filter | RMSE | median | 95 % | max | in 1 sigma | in 2 sigma | NEES / 2 |',
        '|---|---:|---:|---:|---:|---:|---:|---:|']
    for name, s in rows.items():
        lines.append(
            f'| {name} | {s.rmse:.2f} m | {s.median:.2f} m | {s.percentile_95:.2f} m '
            f'| {s.maximum:.1f} m | {s.coverage_1_sigma:.2f} | {s.coverage_2_sigma:.2f} '
            f'| {s.nees:.2f} |')
    lines.append(
        f'| *an honest filter* | | | | | *{honest_coverage(1.0, 2):.2f}* '
        f'| *{honest_coverage(2.0, 2):.2f}* | *1.00* |')
    return '\n'.join(lines) + '\n'
