"""Chains that feel a share of the measurements only, and exchange their paths  [Geyer 1991]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Exchange:
    """
    Which path each of K shares of the likelihood has afterwards, for each of C chains.

    order: (K, C), among the K paths of the chain; acceptance: (K - 1,), of the exchange between
    neighbours, NaN where none was tried.
    """

    order: NDArray[np.intp]
    acceptance: Array


def first_shares(count: int, least: float) -> Array:
    """Return so many shares of the likelihood from 1 down to the least one, to begin with."""
    if count == 1:
        return np.ones(1)
    # closer where they are small, since the first of what is measured tells the most
    return np.asarray(least + (1 - least) * np.linspace(1, 0, count)**3)


@np.errstate(over='ignore', invalid='ignore')
def exchange(log_likelihoods: Array, shares: Array, odd: bool, rng: Generator) -> Exchange:
    """
    Return an exchange of paths, of log likelihoods (K, C), between neighbouring shares (K,).

    Even and odd pairs take turns, so that paths travel instead of wavering  [Syed et al. 2022].
    """
    count, chains = log_likelihoods.shape
    order = np.tile(np.arange(count)[:, None], (1, chains))
    acceptance = np.full(count - 1, np.nan)
    for i in range(int(odd), count - 1, 2):
        # p_i(x_j) p_j(x_i) / (p_i(x_i) p_j(x_j))
        gain = (shares[i] - shares[i + 1]) * (log_likelihoods[i + 1] - log_likelihoods[i])
        accept = np.nan_to_num(np.exp(np.minimum(gain, 0.0)))
        swap = rng.random(chains) < accept
        order[i], order[i + 1] = np.where(swap, i + 1, i), np.where(swap, i, i + 1)
        acceptance[i] = accept.mean()
    return Exchange(order, acceptance)


def respaced(shares: Array, acceptance: Array) -> Array:
    """
    Return as many shares between the same ends, of which neighbours exchange equally often.

    The rejections add up to a function of the share that hardly depends on the spacing, and the
    new shares lie at equal steps of it  [Syed et al. 2022, section 5].
    """
    barrier = np.concatenate([[0.0], np.cumsum(np.maximum(1 - acceptance, 1e-3))])
    levels = np.linspace(0, barrier[-1], len(shares))
    return np.asarray(np.interp(levels, barrier, shares))
