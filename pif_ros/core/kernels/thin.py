"""
Weights that keep mass, mean and covariance of a step however thin its noise is.

Of thin noise that is correlated the variance is larger on the axes that lean on others: a mean
between two nodes spreads by itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.lattice import box, Integers, reach, whole_cells
from pif_ros.core.kernels.moments import StepMoments
from pif_ros.core.kernels.settings import KernelSettings

Array = NDArray[np.float64]

#: Thinner than this, in cells per step, a Gaussian sampled at the nodes has a wrong variance.
THIN = 0.7


class MomentStencil:
    """
    Weights with the step's mean and covariance, for noise of any width, none included.

    The step's Gaussian is taken apart into one axis given the ones before it, x = m + L y with L
    unit lower triangular and y independent, the widest of what is left first.  Each axis is laid
    onto its nodes by weights with the right mean and variance: a sampled Gaussian where it is
    wide, three nodes where it is thin, and where even the thinnest weights with this mean are too
    wide (a mean between two nodes spreads by itself), the two nodes beside it.
    """

    def __init__(self, grid: Grid, settings: KernelSettings, step: StepMoments,
                 cells: Integers) -> None:
        dx = grid.spacing
        spread = step.covariance / np.outer(dx, dx)[..., None]
        order = _widest_first(spread[..., cells].mean(axis=2))
        self._lower, self._variance = _unit_triangular(spread[order][:, order])
        self.shift = whole_cells(step.mean / dx[:, None])
        self._rest = (step.mean / dx[:, None] - self.shift)[order]
        self._leans = bool(np.any(self._lower[..., cells] != np.eye(grid.ndim)[..., None]))
        self._order = order
        self._half = self._half_widths(reach(settings.tolerance, 1), cells)
        self.offsets = np.empty((grid.ndim, np.prod(2 * self._half + 1)), dtype=int)
        self.offsets[order] = box(self._half)

    def weights(self, cells: Integers) -> tuple[Array, Integers | None]:
        """Return what each move weighs, exact in mass and thin means, and where moves lean."""
        w: Array = np.ones(len(cells))
        y: list[Array] = []
        nearest: list[Array] = []
        for d, half in enumerate(self._half):
            # one axis of the array for each axis of the grid so far, and one for its nodes
            shape = (len(cells),) + (1,) * (d + 1)
            mean = self._rest[d, cells].reshape(shape)
            for j in range(d):
                y[j] = y[j][..., None]
                nearest[j] = nearest[j][..., None]
                mean = mean + self._lower[d, j, cells].reshape(shape) * y[j]
            nearest.append(np.rint(mean) if d and self._leans else np.zeros(shape))
            nodes = nearest[d] + np.arange(-half, half + 1)
            wanted = self._variance[d, cells].reshape(shape)
            w_d, variance = _node_weights(nodes, mean, wanted)
            w = w[..., None] * w_d
            # where the nodes spread more than they should, later axes lean on them less
            lean = np.divide(wanted, variance, out=np.zeros_like(variance), where=variance > 0)
            y.append((nodes - mean) * lean)
        if not self._leans:
            return w.reshape(len(cells), -1), None
        leans = np.empty((len(nearest), len(cells), self.offsets.shape[1]), dtype=int)
        for axis, by in zip(self._order, nearest):
            leans[axis] = np.broadcast_to(by, w.shape).reshape(len(cells), -1)
        return w.reshape(len(cells), -1), leans

    def _half_widths(self, radius: float, cells: Integers) -> Integers:
        """Return how many nodes each axis needs on either side of the nearest to its mean."""
        widest = self._variance[:, cells].max(axis=1)
        return np.where(widest < THIN**2, 1,
                        np.ceil(radius * np.sqrt(widest)).astype(int) + 1)


def three_point(position: Array, offset: Array, second: Array) -> Array:
    """Return the weights of the nodes -1, 0, 1 at a position with a mean and a second moment."""
    return np.where(position == 0, 1 - second,
                    np.where(np.abs(position) == 1, (second + position * offset) / 2, 0.0))


def _node_weights(nodes: Array, mean: Array, variance: Array) -> tuple[Array, Array]:
    """Return weights on nodes with a mean and, where it can be, a variance; and that variance."""
    nearest = np.rint(mean)
    offset, position = mean - nearest, nodes - nearest
    # second moment about the nearest node, at least that of the two nodes beside the mean
    second = np.maximum(variance + offset**2, np.abs(offset))
    thin = three_point(position, offset, second)
    is_thin = variance < THIN**2
    if np.all(is_thin):
        return thin, second - offset**2
    wide = np.exp(-(nodes - mean)**2 / (2 * np.maximum(variance, THIN**2)))
    wide /= wide.sum(axis=-1, keepdims=True)
    return np.where(is_thin, thin, wide), np.where(is_thin, second - offset**2, variance)


def _widest_first(covariance: Array) -> Integers:
    """Return the axes in the order in which each has the most variance left, the former given."""
    left = covariance.copy()
    order: list[int] = []
    for _ in range(len(left)):
        variance = np.diagonal(left).copy()
        variance[order] = -1.0
        widest = int(np.argmax(variance))
        order.append(widest)
        if variance[widest] > 0:
            left = left - np.outer(left[widest], left[widest]) / left[widest, widest]
    return np.array(order)


def _unit_triangular(spread: Array) -> tuple[Array, Array]:
    """Return L (n, n, N), unit lower triangular, and D (n, N) with spread = L D L^T."""
    n = len(spread)
    L = np.zeros(spread.shape)
    D = np.zeros(spread.shape[1:])
    floor = 1e-12 * np.einsum('iik->k', spread)
    for j in range(n):
        D[j] = spread[j, j] - sum(L[j, k]**2 * D[k] for k in range(j))
        D[j] = np.where(D[j] > floor, D[j], 0.0)
        L[j, j] = 1.0
        for i in range(j + 1, n):
            rest = spread[i, j] - sum(L[i, k] * L[j, k] * D[k] for k in range(j))
            L[i, j] = np.divide(rest, D[j], out=np.zeros_like(rest), where=D[j] > 0)
    return L, D
