"""How a kernel is made."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np


@dataclass(frozen=True)
class KernelSettings:
    """
    How a kernel is made.

    time_step: seconds; r: where between x' and x'' the drift is taken, 0 to 1; jacobian:
    'determinant' for |det(1 - r eps df/dx)|, 'exponential' for its printed expansion
    exp(-r eps div f); extent: largest move in cells on each axis, 0 for as wide as the kernel
    needs; weights: 'sampled' takes the density at the cell centres, 'moments' keeps mass, mean and
    covariance however thin the noise is against a cell (where it is correlated and thin, some
    variances come out far too large), 'auto' chooses by the noise; tolerance: the share of
    a Gaussian's tail that is left out; noise_inflation: alpha of the papers' way with
    thin noise, which takes g = alpha dx on each axis for the model's own, 0 for none; form:
    'tabulated' for a weight per pair of cells, 'split' for an operator per axis, which has no use
    for the settings from r to noise_inflation but the tolerance, 'auto' for whichever suits model,
    grid and these settings; macro_error: how far in L1 a step of twice the length may be from two
    steps, to be taken for them, 0 for none; precision: 'double' or 'single', in which the weights
    of a split kernel are kept and densities move.  Raises ValueError for what makes no kernel.
    """

    time_step: float
    r: float = 0.5
    jacobian: str = 'determinant'
    extent: int = 0
    weights: str = 'auto'
    tolerance: float = 1e-5
    noise_inflation: float = 0.0
    form: str = 'tabulated'
    macro_error: float = 0.0
    precision: str = 'double'

    def __post_init__(self) -> None:
        """Refuse what makes no kernel."""
        for name, wanted, holds in (
                ('time_step', 'a nanosecond or more, in seconds',
                 1e-9 <= self.time_step < math.inf),
                ('r', 'a number from 0 to 1', 0 <= self.r <= 1),
                ('jacobian', "'determinant' or 'exponential'",
                 self.jacobian in ('determinant', 'exponential')),
                ('extent', 'a number of cells, 0 or more', self.extent >= 0),
                ('weights', "'auto', 'sampled' or 'moments'",
                 self.weights in ('auto', 'sampled', 'moments')),
                ('tolerance', 'a number from 1e-12 to 0.1', 1e-12 <= self.tolerance <= 0.1),
                ('noise_inflation', 'a number, 0 or more',
                 0 <= self.noise_inflation < math.inf),
                ('form', "'auto', 'tabulated' or 'split'",
                 self.form in ('auto', 'tabulated', 'split')),
                ('macro_error', 'a number from 0 to below 1', 0 <= self.macro_error < 1),
                ('precision', "'double' or 'single'", self.precision in ('double', 'single'))):
            if not holds:
                raise ValueError(f'{name}: expected {wanted}, got {getattr(self, name)!r}')

    @property
    def dtype(self) -> np.dtype[np.floating]:
        """Return the type of a split kernel's weights."""
        return np.dtype(np.float32 if self.precision == 'single' else np.float64)
