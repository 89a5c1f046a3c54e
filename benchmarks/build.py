"""How long a kernel takes to make, against one product with it."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks.problem import box, SYSTEM, TIME_STEP
from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio
import numpy as np
from pif_ros.core.kernels import dirac_feynman, KernelSettings

CELLS = (62, 100, 200)
BUILDS = 7
PRODUCTS = 20
MOST = 100.0


def run(effort: Effort) -> Table:
    """Build each kernel several times, in turns with products."""
    rows, goals, progress = [], [], Progress('build: timing')
    kernels = list(_kernels())
    for number, (cells, settings) in enumerate(kernels):
        grid = box(cells)
        K = dirac_feynman(SYSTEM.model, grid, settings)
        p = np.full(grid.size, 1 / grid.size)
        setting = (f'{cells} x {cells}, {settings.weights}, r = {settings.r:g}'
                   + f', {settings.jacobian}' * bool(settings.r))
        samples = interleave(
            {'build': Contestant(lambda k: dirac_feynman(SYSTEM.model, grid, settings)),
             'product': Contestant(lambda k: K @ p, PRODUCTS)},
            1, effort.scaled(BUILDS))
        rows.append(Row.timed('kernel', setting, samples['build'], samples['product'],
                              f'its product, {1e6 * np.median(samples["product"]):.0f} us',
                              {'weights per cell': K.nnz / grid.size}))
        if cells == max(CELLS):
            goals.append(Goal(f'building {setting}, against its product', MOST,
                              ratio(samples['build'], samples['product'])))
        progress.show((number + 1) / len(kernels))
    return Table('Kernel construction, `coupled_trigonometric`', rows, goals=goals)


def _kernels() -> Iterator[tuple[int, KernelSettings]]:
    for cells in CELLS:
        for weights in ('sampled', 'auto'):
            yield cells, KernelSettings(TIME_STEP, r=0.0, weights=weights)
            for jacobian in ('determinant', 'exponential'):
                yield cells, KernelSettings(TIME_STEP, weights=weights, jacobian=jacobian)
