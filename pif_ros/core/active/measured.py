"""What a measurement makes of a belief: Bayes' rule on the cells that are kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active.belief import ActiveBelief, Patch
from pif_ros.core.active.window import RolledGrid
from pif_ros.core.grid import Grid
from pif_ros.core.likelihood import GridLikelihood
from pif_ros.core.models import Sensor
from pif_ros.core.posterior import UNSAFE

Array = NDArray[np.float64]


def corrected(belief: ActiveBelief, y: Array, sensor: Sensor, t: float,
              average_cells: bool) -> tuple[ActiveBelief, float]:
    """
    Return p(y | x) p(x) / p(y) cell by cell, and log p(y)  [Sensors, Eq. 27].

    Where no cell allows the measurement y, the belief as it was and -inf.  t: seconds;
    average_cells: whether a likelihood narrower than a cell is averaged over it.
    """
    log_l = [_log_likelihood(patch, belief.base, y, sensor, t, average_cells)
             for patch in belief.patches]
    joint, peak = _product([patch.density for patch in belief.patches], log_l)
    if peak == -np.inf:
        return belief, -np.inf
    evidence = sum(float(q.sum() * patch.window.spacing.prod())
                   for q, patch in zip(joint, belief.patches))
    patches = tuple(Patch(patch.window, q / evidence) for q, patch in zip(joint, belief.patches))
    return ActiveBelief(belief.base, patches), peak + float(np.log(evidence))


@np.errstate(all='ignore')
def _log_likelihood(patch: Patch, world: Grid, y: Array, sensor: Sensor, t: float,
                    average_cells: bool) -> Array:
    """Return log p(y | x), a shape that broadcasts to the patch's; -inf where undefined."""
    seen, grid, p = sensor.states, patch.window.grid, patch.density
    unseen = tuple(i for i in range(grid.ndim) if seen is not None and i not in seen)
    if unseen:
        # two cells stand for all of an axis that the sensor does not see
        shape = tuple(2 if i in unseen else count for i, count in enumerate(grid.shape))
        grid = Grid(grid.lower, grid.upper, shape, grid.periodic)
        p = np.broadcast_to(p.max(axis=unseen, keepdims=True), shape)
    grid = RolledGrid.of(grid, world)
    likelihood = GridLikelihood(grid, sensor, average_cells, once=True)
    log_l = likelihood.log(y, p.ravel(), t).reshape(grid.shape)
    one = tuple(slice(0, 1) if i in unseen else slice(None) for i in range(grid.ndim))
    return np.where(np.isnan(log_l[one]), -np.inf, log_l[one])


@np.errstate(all='ignore')
def _product(p: Sequence[Array], log_l: Sequence[Array]) -> tuple[list[Array], float]:
    """Return p exp(log_l - peak), and the peak; with logs of p too where it would underflow."""
    peak = max((float(part.max()) for part in log_l), default=-np.inf)
    if np.isfinite(peak):
        joint = [density * np.exp(part - peak) for density, part in zip(p, log_l)]
        if sum(float(q.sum()) for q in joint) > UNSAFE:
            return joint, peak
    log_joint = [np.log(density) + part for density, part in zip(p, log_l)]
    peak = max((float(part.max()) for part in log_joint), default=-np.inf)
    return [np.exp(part - peak) for part in log_joint], peak
