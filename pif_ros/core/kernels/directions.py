"""Correlated noise as independent noises along directions of whole cells."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

Array = NDArray[np.float64]

#: What is less than this share of the noise is rounding.
ROUNDING = 1e-12
#: So many axes may be correlated.
MOST_AXES = 3
#: By what share of the noise variances are enlarged at first.
LEAST_MORE = 1e-9
#: Exchanges until a superbase is obtuse: as many as noise is longer than wide, about.
EXCHANGES = 100


def integer_directions(variance: Array, longest: float = np.inf
                       ) -> tuple[Array, list[tuple[float, tuple[int, ...]]]]:
    """
    Return a covariance (n, n) as noise along the axes (n,) and along other integer directions.

    variance = diag(axes) + sum_k lambda_k v_k v_k^T with lambda_k > 0 and v_k of whole numbers, by
    Selling's decomposition of each group of up to three axes that are correlated.  longest: cells
    of a direction along an axis; where noise would take more, all its variances are
    enlarged alike as far as it needs, by less than (noise / longest)^2 / 2 cells squared, its
    deviation being that of all axes together.  So it is close to a line, and at any correlation
    where it is many cells long on one axis and few on another, whose variance that may exceed.
    Raises ValueError where more than three are correlated, or the directions are hundreds of
    cells long.
    """
    n = len(variance)
    axes, others = np.zeros(n), []
    size = ROUNDING * np.sqrt(np.outer(np.diag(variance), np.diag(variance)))
    correlated = np.abs(variance) > size
    if not correlated[~np.eye(n, dtype=bool)].any():
        return np.diag(variance).copy(), []
    _, group = csgraph.connected_components(sparse.csr_array(correlated))
    for number in range(group.max() + 1):
        members = np.flatnonzero(group == number)
        for strength, direction in _short(variance[np.ix_(members, members)], longest):
            along = np.zeros(n, dtype=int)
            along[members] = direction
            if np.count_nonzero(along) == 1 and np.abs(along).sum() == 1:
                axes += strength * np.abs(along)
            else:
                others.append((strength, tuple(along.tolist())))
    return axes, others


def _short(D: Array, longest: float) -> list[tuple[float, NDArray[np.int64]]]:
    """Return lambda_k and v_k of a matrix whose variances are enlarged until all v_k are short."""
    more = 0.0
    while True:
        wide = D + more * np.eye(len(D))
        try:
            found = _selling(wide)
            if max(int(np.abs(v).max()) for _, v in found) <= longest:
                return found
        except ValueError:
            if np.isinf(longest) or len(D) > MOST_AXES:
                raise
        more = max(LEAST_MORE * float(np.trace(D)), 1.5 * more)


def _selling(D: Array) -> list[tuple[float, NDArray[np.int64]]]:
    """
    Return lambda_k and v_k of a positive semidefinite matrix of up to three rows  [Selling 1874].

    A superbase of n + 1 integer vectors that add up to 0 is changed until it is obtuse, that is
    b_i D b_j <= 0; then D = sum_ij (-b_i D b_j) v_ij v_ij^T, v_ij orthogonal to all the others.
    """
    n = len(D)
    if n == 1:
        return [(float(D[0, 0]), np.ones(1, dtype=int))]
    if n > MOST_AXES:
        raise ValueError(f'noise: expected at most 3 axes that are correlated, got {n}')
    base = np.vstack([np.eye(n, dtype=int), -np.ones(n, dtype=int)])
    nothing = ROUNDING * np.trace(D)
    for _ in range(EXCHANGES):
        products = np.triu(base @ D @ base.T, 1)
        i, j = np.unravel_index(np.argmax(products), products.shape)
        if products[i, j] <= nothing:
            return _strengths(base, D, nothing)
        base = _exchanged(base, int(i), int(j))
    raise ValueError('noise: expected a correlation that moves of some cells have, got '
                     f'{D.tolist()} in cells')


def _strengths(base: NDArray[np.int64], D: Array,
               nothing: float) -> list[tuple[float, NDArray[np.int64]]]:
    """Return lambda_k and v_k of an obtuse superbase."""
    n, found = len(D), []
    for i, j in itertools.combinations(range(n + 1), 2):
        strength = -float(base[i] @ D @ base[j])
        if strength > nothing:
            rest = [base[k] for k in range(n + 1) if k not in (i, j)]
            found.append((strength, _orthogonal(rest)))
    return found


def _exchanged(base: NDArray[np.int64], i: int, j: int) -> NDArray[np.int64]:
    """Return the superbase in which b_i and b_j, at an acute angle, are at an obtuse one."""
    changed = base.copy()
    others = [k for k in range(len(base)) if k not in (i, j)]
    changed[i] = -base[i]
    changed[others] += base[i] if len(others) == 2 else base[i] - base[others] - base[j]
    return changed


def _orthogonal(vectors: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """Return the integer vector orthogonal to one in the plane or two in space."""
    if len(vectors) == 1:
        return np.array([-vectors[0][1], vectors[0][0]])
    return np.cross(vectors[0], vectors[1])
