"""Whether chains have mixed, and how many independent draws they are worth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft, special, stats

Array = NDArray[np.float64]


def split_r_hat(draws: Array, ranked: bool = True) -> Array:
    """
    Return R-hat of chains (chains, draws, ...), shape (...): 1 where all agree.

    The spread of all draws over that within chains, of which each counts as two, an early and a
    late one  [Gelman et al. 2013, Eq. 11.4].  ranked: of the draws' normalised ranks, and of
    those of their distances from the median, whichever is larger, so that it holds without
    moments and sees chains that differ in their spread alone  [Vehtari et al. 2021].
    """
    halves = _split(draws)
    if not ranked:
        return _r_hat(halves)
    distance = np.abs(halves - np.median(halves, axis=(0, 1)))
    return np.maximum(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(distance)))


def effective_sample_size(draws: Array, ranked: bool = False) -> Array:
    """
    Return how many independent draws chains (chains, draws, ...) are worth, shape (...).

    It is that of a mean; ranked: of the draws' normalised ranks, known as the bulk effective
    sample size.  Autocorrelations are summed to the end of Geyer's initial monotone sequence.
    [Vehtari et al. 2021, Eqs. 10 to 13]
    """
    halves = _split(draws)
    shape = halves.shape[2:]
    columns = halves.reshape(len(halves), halves.shape[1], -1)
    return np.array([_effective(_normal_scores(columns[..., j]) if ranked else columns[..., j])
                     for j in range(columns.shape[-1])]).reshape(shape)


def standard_error(draws: Array) -> Array:
    """Return the standard error of the mean of chains (chains, draws, ...), shape (...)."""
    return np.asarray(np.std(draws, axis=(0, 1)) / np.sqrt(effective_sample_size(draws)))


def _effective(x: Array) -> float:
    """Return the effective sample size of one quantity, (chains, draws)."""
    chains, length = x.shape
    covariance = _autocovariance(x)
    within = covariance[:, 0].mean() * length / (length - 1)
    total = within * (length - 1) / length + np.var(x.mean(axis=1), ddof=1)
    if not total > 0:
        return float(x.size)
    # rho_t = 1 - (W - mean of s_t) / var+  [Vehtari et al. 2021, Eq. 10]
    rho = 1 - (within - covariance.mean(axis=0) * length / (length - 1)) / total
    rho[0] = 1.0
    pairs = rho[:length // 2 * 2].reshape(-1, 2).sum(axis=1)
    ended = np.flatnonzero(pairs <= 0)
    pairs = np.minimum.accumulate(pairs[:ended[0]] if len(ended) else pairs)
    time = 2 * pairs.sum() - 1
    # no more than antithetic chains were seen to be worth
    return float(x.size / max(time, 1 / np.log10(x.size)))


def _autocovariance(x: Array) -> Array:
    """Return the autocovariances of rows (chains, draws), by the shift, divided by draws."""
    length = x.shape[1]
    spectrum = fft.rfft(x - x.mean(axis=1, keepdims=True), fft.next_fast_len(2 * length), axis=1)
    return np.asarray(fft.irfft(np.abs(spectrum)**2, fft.next_fast_len(2 * length),
                                axis=1)[:, :length] / length)


def _r_hat(x: Array) -> Array:
    """Return the R-hat of chains (chains, draws, ...) as they are."""
    length = x.shape[1]
    within = np.var(x, axis=1, ddof=1).mean(axis=0)
    between = np.var(x.mean(axis=1), axis=0, ddof=1)
    with np.errstate(divide='ignore', invalid='ignore'):
        ratio = np.sqrt((length - 1) / length + between / within)
    # what never changes agrees with itself
    return np.asarray(np.where((within == 0) & (between == 0), 1.0, ratio))


def _normal_scores(x: Array) -> Array:
    """Return the normal quantiles of the ranks among all (chains, draws)."""
    count = x.shape[0] * x.shape[1]
    rank = stats.rankdata(x.reshape((count,) + x.shape[2:]), axis=0)
    return np.asarray(special.ndtri((rank - 3 / 8) / (count + 1 / 4))).reshape(x.shape)


def _split(draws: Array) -> Array:
    """Return chains (chains, draws, ...) cut in two, (2 chains, draws // 2, ...)."""
    draws = np.asarray(draws, dtype=float)
    if draws.ndim < 2 or draws.shape[1] < 4:
        raise ValueError('draws: expected (chains, draws, ...) with 4 draws or more, got shape '
                         f'{draws.shape}')
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, -half:]])
