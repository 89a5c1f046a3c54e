"""
Densities in single precision, on their way through a kernel.

A single number has 7 digits and goes down to 1e-38, from where on each costs as much as a hundred
others.  So densities move as shares of the densest, and what is too little of it is none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pif_ros.core import compiler
from pif_ros.core.kernels import loops

Array = NDArray[np.float64]

#: Less than this share of the densest cell's density is none; times the smallest weight of a
#: Gaussian's tail it can still be told.  A cloud of a million cells loses 1e-19 of its mass.
LEAST_SHARE = 1e-25


def narrow(density: Array) -> tuple[NDArray[np.float32], Array | float]:
    """Return densities (size,) or (size, targets) as shares of the densest, and the densest."""
    if density.ndim == 1 and compiler.is_available():
        return loops.narrow(density, LEAST_SHARE)
    densest = np.abs(density).max(axis=0)
    shares = density * (1 / np.where(densest > 0, densest, 1.0))
    shares *= np.abs(shares) > LEAST_SHARE
    return shares.astype(np.float32), densest


def widen(shares: NDArray[np.float32], densest: Array | float) -> Array:
    """Return densities from shares of the densest."""
    return np.multiply(shares, densest, dtype=float)
