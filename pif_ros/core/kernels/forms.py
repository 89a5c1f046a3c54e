"""Which form of a kernel suits a model on a grid, and how well the grid holds its step."""

from __future__ import annotations

from collections.abc import Callable
import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.directions import integer_directions
from pif_ros.core.kernels.ladder import probes
from pif_ros.core.kernels.lattice import variance_in_cells
from pif_ros.core.kernels.operators import kernel_of, OperatorSettings
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.kernels.split import split_kernel, SplitKernel, symmetric_kernel
from pif_ros.core.kernels.tabulated import dirac_feynman, stored_elements
from pif_ros.core.kernels.tilted import half_width
from pif_ros.core.models import StateModel
from scipy import sparse

Array = NDArray[np.float64]

#: The least noise of a step, in cells, on an axis along which something drifts.  Measured after 50
#: steps on four systems, the L1 to the exact density is .001 to .009 at this deviation, a third of
#: that and less at 0.6, 6 to 12 times that at 0.3, and 60 times and more at 0.1: so little noise
#: cannot make up for the place of the mean between two nodes, which spreads by itself.
LEAST = 0.5
#: The most, in L1, by which the order of the axes may matter in a step; it goes with the square of
#: the step.  Measured after ten steps or so: on `coupled_trigonometric` the split kernel is nearer
#: to the exact density than the tabulated one up to .03 (.0002 to .0008 at .003, .0016 to .0029 at
#: .012, .007 both at .03), on a plain rotation, whose tabulated kernel is the better for being
#: linear, half as near at .009 (.0009 to .0004) and a third at .06 (.007 to .0026).
MOST = 0.02


def chosen_form(model: StateModel, grid: Grid, settings: KernelSettings,
                how: OperatorSettings) -> str:
    """
    Return 'tabulated' or 'split', as the settings have it or as it suits.

    Left to itself it is split where that is possible, the noise is at least LEAST on every axis
    that has a drift, and their order matters by at most MOST: there it is about as near to the
    exact density or nearer, and has the fewer weights.  Raises ValueError where it is asked for
    and cannot be, where macro steps are and cannot be, or for a tabulated one in single precision.
    """
    if settings.macro_error and (model.changes_with_time or how != OperatorSettings()):
        raise ValueError('macro_error: expected 0 where the model changes with time, or with an '
                         f'operator of steps, file or wavelet, got {settings.macro_error!r}')
    hindrance = _hindrance(model, grid, settings, how) if settings.form != 'tabulated' else ''
    if settings.form == 'split':
        if hindrance:
            raise ValueError(f"form: expected 'auto' or 'tabulated' {hindrance}, got 'split'")
        return 'split'
    if settings.form == 'auto' and not hindrance and _is_good(model, grid, settings):
        return 'split'
    if settings.precision != 'double':
        raise ValueError("precision: expected 'double' where the kernel is tabulated, "
                         f'got {settings.precision!r}')
    return 'tabulated'


def step_kernel(model: StateModel, grid: Grid, settings: KernelSettings, how: OperatorSettings,
                form: str, t: float = 0.0) -> sparse.csr_array | SplitKernel:
    """
    Return the kernel of one step from time t in a form, a tabulated one from its file.

    Where noise that changes with time has come to be correlated, it is tabulated in any form.
    """
    if form == 'split' and not (_noise_changes(model)
                                and _is_correlated(model, grid, settings, t)):
        return split_kernel(model, grid, settings, t)
    return kernel_of(model, grid, settings, how, t)


def longer_kernel(model: StateModel, grid: Grid, settings: KernelSettings,
                  form: str) -> sparse.csr_array | SplitKernel:
    """Return the kernel of a step that is taken for several, of second order by itself."""
    make = symmetric_kernel if form == 'split' else dirac_feynman
    return make(model, grid, settings)


def stored_weights(model: StateModel, grid: Grid, settings: KernelSettings, form: str) -> float:
    """
    Return about how many weights a kernel of a form holds, without making it.

    Of a form that is still to be chosen, as many as it holds at least.
    """
    table = stored_elements(model, grid, settings)
    if form == 'tabulated' or form == 'auto' and _hindrance(model, grid, settings,
                                                            OperatorSettings()):
        return table
    along, others = integer_directions(variance_in_cells(model, grid, settings, 0.0)[..., 0])
    nodes = sum(min(2 * half_width(np.array(variance), settings.tolerance) + 1, most)
                for variance, most in [*zip(along, grid.shape),
                                       *((each, max(grid.shape)) for each, _ in others)])
    return float(grid.size * nodes) if form == 'split' else min(table, float(grid.size * nodes))


def step_remarks(model: StateModel, grid: Grid, settings: KernelSettings,
                 kernel: object) -> list[str]:
    """Return a sentence for each axis with too little noise for the cells, and for the order."""
    return _thin(model, grid, settings) + _disordered(grid, settings, kernel)


def _disordered(grid: Grid, settings: KernelSettings, kernel: object) -> list[str]:
    """Return a sentence where it matters in which order a split kernel takes the axes."""
    disorder = _disorder(kernel, grid) if isinstance(kernel, SplitKernel) else 0.0
    if disorder <= MOST:
        return []
    # it goes with the square of short steps, and a little slower with that of long ones
    step = _two_digits(0.9 * settings.time_step * math.sqrt(MOST / disorder), math.floor)
    return [f'kernel.time_step: the order of the axes changes the density by {disorder:.2g} (L1) '
            f'in a step ({MOST:g} wanted); take steps of {step:g} s or less, or kernel.form '
            "'tabulated'"]


def _disorder(kernel: SplitKernel, grid: Grid) -> float:
    """Return how much in L1 the order of the factors matters, most of all on some densities."""
    return max(float(np.abs(kernel @ p - kernel.turned @ p).sum()) * grid.cell_volume
               for p in probes(grid))


def _thin(model: StateModel, grid: Grid, settings: KernelSettings) -> list[str]:
    """Return a sentence for each axis on which a step has too little noise for the cells."""
    if model.multiplicative or settings.noise_inflation or settings.extent:
        return []
    variance = variance_in_cells(model, grid, settings, 0.0)[..., 0]
    deviation = np.sqrt(np.diag(variance))
    return [_remark(model.names[d], float(deviation[d]), settings.time_step,
                    float(grid.spacing[d]))
            for d in _too_thin(model, grid, settings, np.diag(variance))]


def _too_thin(model: StateModel, grid: Grid, settings: KernelSettings,
              variance: Array) -> NDArray[np.intp]:
    """Return the axes along which something drifts with a variance (n,) below LEAST's."""
    drift = np.asarray(model.drift(grid.points, settings.time_step / 2))
    return np.flatnonzero(np.any(drift != 0, axis=1)
                          & (np.sqrt(variance) < LEAST * (1 - 1e-9)))


def _remark(axis: str, deviation: float, eps: float, width: float) -> str:
    if not deviation:
        return (f"kernel.time_step: there is no noise on axis '{axis}' ({LEAST:g} cells per step "
                'wanted), so that drift between two cells spreads by itself')
    return (f"kernel.time_step: the noise moves {deviation:.2g} cells per step on axis '{axis}' "
            f'({LEAST:g} wanted), so that drift between two cells spreads by itself; take steps '
            f'of {_two_digits(eps * (LEAST / deviation)**2, math.ceil):g} s or more, or cells of '
            f'{_two_digits(width * deviation / LEAST, math.floor):g} or less')


def _two_digits(value: float, rounded: Callable[[float], int]) -> float:
    """Return a positive number to two digits, rounded up or down."""
    unit = 10.0**(math.floor(math.log10(value)) - 1)
    return float(f'{rounded(round(value / unit, 6)) * unit:.2g}')


def _is_good(model: StateModel, grid: Grid, settings: KernelSettings) -> bool:
    """Return whether a split kernel, which is possible, is good enough to be taken unasked."""
    along, _ = integer_directions(variance_in_cells(model, grid, settings, 0.0)[..., 0])
    if len(_too_thin(model, grid, settings, along)):
        return False
    try:
        return _disorder(split_kernel(model, grid, settings), grid) <= MOST
    except ValueError:
        # a drift that no kernel can be made of is the tabulated one's to refuse
        return False


def _hindrance(model: StateModel, grid: Grid, settings: KernelSettings,
               how: OperatorSettings) -> str:
    """Return why a kernel cannot be split, '' where it can."""
    for given, spared in ((settings, ('time_step', 'tolerance', 'form', 'macro_error',
                                      'precision')), (how, ())):
        for field in dataclasses.fields(given):
            value = getattr(given, field.name)
            if field.name not in spared and value != field.default:
                return f'with {field.name} = {value!r}'
    for is_so, why in ((model.multiplicative, 'where the noise is multiplicative'),
                       (model.inputs, 'where the model has inputs')):
        if is_so:
            return why
    variance = variance_in_cells(model, grid, settings, 0.0)[..., 0]
    if not np.any(variance - np.diag(np.diag(variance))):
        return ''
    if _noise_changes(model):
        return 'where correlated noise changes with time'
    try:
        along = np.sqrt(integer_directions(variance)[0])
    except ValueError as error:
        return f'where the noise is correlated so ({error})'
    if along.min() < LEAST:
        return (f"where the correlation leaves axis '{model.names[int(np.argmin(along))]}' noise "
                f'of {along.min():.2g} cells per step of its own ({LEAST:g} wanted)')
    return ''


def _noise_changes(model: StateModel) -> bool:
    """Return whether additive noise changes with time."""
    return callable(model.vielbein) or callable(model.noise_covariance)


def _is_correlated(model: StateModel, grid: Grid, settings: KernelSettings, t: float) -> bool:
    """Return whether the noise of a step from time t goes along other directions than the axes."""
    try:
        return bool(integer_directions(variance_in_cells(model, grid, settings, t)[..., 0])[1])
    except ValueError:
        return True
