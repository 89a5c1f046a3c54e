"""A kernel, and what saves work with it: the operator of a filter  [Sensors, section 4.3]."""

from __future__ import annotations

from dataclasses import dataclass
import os
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.composed import composed
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.stored import fingerprint, load_kernel, save_kernel
from pif_ros.core.kernels.tabulated import dirac_feynman
from pif_ros.core.kernels.wavelets import WaveletKernel
from pif_ros.core.models import StateModel
from scipy import sparse

Array = NDArray[np.float64]


class Operator(Protocol):
    """Anything that moves a density (size,) with ``@``, and says how much it stores."""

    @property
    def nnz(self) -> int:
        """Return the number of stored elements."""

    def __matmul__(self, density: Any) -> Any:
        """Return the density after it."""


@dataclass(frozen=True)
class OperatorSettings:
    """
    How a kernel becomes the operator of a filter.

    steps: kernel steps that are composed into one operator; file: where the kernel is kept, to be
    loaded instead of made where it fits, '' for nowhere; wavelet: name of PyWavelets' orthogonal
    wavelet in whose basis the operator is applied, '' for the cells themselves; level: how often
    that basis is halved; threshold: the elements below it are left out.  Raises ValueError for
    what makes no operator.
    """

    steps: int = 1
    file: str = ''
    wavelet: str = ''
    level: int = 2
    threshold: float = 1e-4

    def __post_init__(self) -> None:
        """Refuse what makes no operator."""
        for name, wanted, holds in (
                ('steps', 'a whole number, 1 to 1000', 1 <= self.steps <= 1000),
                ('level', 'a whole number, 1 or more', self.level >= 1),
                ('threshold', 'a number from 0 to below 1', 0 <= self.threshold < 1)):
            if not holds:
                raise ValueError(f'{name}: expected {wanted}, got {getattr(self, name)!r}')


def kernel_of(model: StateModel, grid: Grid, settings: KernelSettings, how: OperatorSettings,
              t: float = 0.0) -> sparse.csr_array:
    """
    Return the kernel of one step, from its file where there is one that fits.

    A file of another kernel, or a damaged one, is refused with ValueError and left as it is; where
    there is no file, one is written.
    """
    if not how.file:
        return dirac_feynman(model, grid, settings, t)
    mark = fingerprint(model, grid, settings, t)
    if os.path.exists(how.file):
        return load_kernel(how.file, mark, grid.size)
    kernel = dirac_feynman(model, grid, settings, t)
    save_kernel(how.file, kernel, mark)
    return kernel


def operator_of(kernel: sparse.csr_array, grid: Grid, settings: KernelSettings,
                how: OperatorSettings) -> Operator:
    """
    Return the operator of how.steps steps of a kernel, pruned to the kernel's tolerance.

    Below a wavelet basis that would be wasted: there it is pruned to ten of the basis' thresholds.
    """
    finest = settings.tolerance
    if how.wavelet:
        finest = min(max(finest, 10 * how.threshold), 0.1)
    whole = composed(kernel, how.steps, finest)
    if not how.wavelet:
        return whole
    return WaveletKernel.make(whole, grid, how.wavelet, how.level, how.threshold)
