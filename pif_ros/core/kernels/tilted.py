"""Gaussians on the whole numbers, with exactly the mass, mean and variance that are wanted."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.kernels.lattice import reach
from pif_ros.core.kernels.thin import three_point

Array = NDArray[np.float64]

#: Below this variance, in cells, five nodes with a Gaussian's first four moments are the nearer to
#: it, above it the tilted Gaussian is: measured on four systems after 50 steps, the L1 of five
#: nodes is a half to a tenth of the other's at a deviation of 0.6, and about the same at 0.75.
NARROW = 0.49
#: Below this one it is three nodes: few means have a use for more, and nothing is gained.
NARROWEST = 0.3
#: The weights of the nodes -2 to 2 by their moments 0 to 4.
FOUR_MOMENTS = np.linalg.inv(np.arange(-2, 3.0)**np.arange(5)[:, None])
#: The second moment of equal weights on all nodes is so many times what is wanted at least: the
#: tilted Gaussian is a hump then, however much of the tails is left out.
ROOM = 1.5
#: What the moments may lack before the last step, which is taken in the weights themselves.
SETTLED = 1e-3
#: Two are needed at NARROW, one where it is wider.
ITERATIONS = 25


def half_width(variance: Array, tolerance: float) -> int:
    """Return how many nodes on either side of the one next to the mean some variances need."""
    widest = float(variance.max())
    if widest < NARROW:
        return 1 if widest < NARROWEST else 2
    # half (half + 1) / 3 >= ROOM (v + m^2), with m of half a cell
    least = math.sqrt(3 * ROOM * (widest + 0.25) + 0.25)
    return max(1, math.ceil(max(reach(tolerance, 1) * math.sqrt(widest), least) - 0.5))


def lattice_weights(mean: Array, variance: Array, half: int) -> Array:
    """
    Return weights on the nodes -half to half with a mean and a variance, (2 half + 1, N).

    mean: (N,), at most half a node from 0; variance: (N,).  Where the variance is at least NARROW
    the weights are exp(b k + c k^2) / sum, elsewhere those of five nodes or three; where it is
    less than weights with this mean can have, these are on the two nodes beside the mean and as
    narrow as can be.
    """
    nodes = np.arange(-half, half + 1.0)
    wide = variance >= NARROW
    if wide.all():
        return _tilted(mean, variance, nodes)
    w = np.zeros((len(nodes), len(mean)))
    w[:, ~wide] = _few(mean[~wide], variance[~wide], nodes)
    if wide.any():
        w[:, wide] = _tilted(mean[wide], variance[wide], nodes)
    return w


def _few(mean: Array, variance: Array, nodes: Array) -> Array:
    """
    Return the weights of five nodes with a Gaussian's first four moments, or as near as can be.

    From a variance of 1/3 on they can be had.  Where some would be negative it is as much of them
    as there can be, and three nodes besides; all have the right mean and variance, and so has the
    mixture.
    """
    # the second moment about node 0, at least that of the two nodes beside the mean
    second = np.maximum(variance + mean**2, np.abs(mean))
    w = three_point(nodes[:, None], mean, second)
    if len(nodes) < 5:
        return w
    # E k^3 = m^3 + 3 m v, E k^4 = m^4 + 6 m^2 v + 3 v^2
    third, fourth = mean * (3 * second - 2 * mean**2), 3 * second**2 - 2 * mean**4
    five = FOUR_MOMENTS @ np.stack([np.ones_like(mean), mean, second, third, fourth])
    three = w[len(nodes) // 2 - 2:len(nodes) // 2 + 3]
    share = np.min(np.divide(three, three - five, out=np.ones_like(five), where=five < 0), axis=0)
    three += share * (five - three)
    return np.maximum(w, 0.0, out=w)


def _tilted(mean: Array, variance: Array, nodes: Array) -> Array:
    """
    Return exp(b k + c k^2) / sum with a mean and a variance, (K, N).

    b and c minimise log sum_k exp(b k + c k^2) - b mean - c (variance + mean^2), which is convex:
    Newton's iteration, from the Gaussian.  The last step is linear in the weights and so leaves
    nothing.
    """
    second = variance + mean * mean
    b, c = mean / variance, -0.5 / variance
    powers = nodes ** np.arange(5)[:, None]
    for _ in range(ITERATIONS):
        w = _lattice_gaussian(b, c, len(nodes) // 2)
        mass, *sums = powers @ w
        m1, m2, m3, m4 = (total / mass for total in sums)
        lacks1, lacks2 = mean - m1, second - m2
        v11, v12, v22 = m2 - m1 * m1, m3 - m1 * m2, m4 - m2 * m2
        determinant = v11 * v22 - v12 * v12
        db = (v22 * lacks1 - v12 * lacks2) / determinant
        dc = (v11 * lacks2 - v12 * lacks1) / determinant
        if np.all(np.abs(lacks1) <= SETTLED) and np.all(np.abs(lacks2) <= SETTLED * second):
            break
        b, c = b + db, c + dc
    # exp(db k + dc k^2) to first order about the moments, which keeps the mass
    w *= powers[:3].T @ (np.stack([1 - db * m1 - dc * m2, db, dc]) / mass)
    return w


def _lattice_gaussian(b: Array, c: Array, half: int) -> Array:
    """Return exp(b k + c k^2) for k = -half to half, shape (2 half + 1, N)."""
    w = np.empty((2 * half + 1, len(b)))
    w[half] = 1.0
    up, down, bend = np.exp(c + b), np.exp(c - b), np.exp(2 * c)
    for k in range(half):
        # the quotients of neighbours are geometric: exp(b + (2 k + 1) c)
        np.multiply(w[half + k], up, out=w[half + k + 1])
        np.multiply(w[half - k], down, out=w[half - k - 1])
        up *= bend
        down *= bend
    return w
