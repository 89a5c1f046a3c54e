"""A chaotic flow without noise, as the papers of GBEES pose it: nothing smooths what is wrong."""

from __future__ import annotations

from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active import ActiveBelief, ActiveGridFilter, RegionSettings
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel

Array = NDArray[np.float64]

SECOND = 1_000_000_000
MEAN, CELL = np.array([-11.5, -10.0, 9.5]), 0.5
WORLD = Grid((-40.0, -40.0, -60.0), (40.0, 40.0, 60.0), (160, 160, 240))
#: Each third of a unit of time: L1 of GBEES at these cells, and its seconds to the last, compiled
#: from its authors' C with -O3 on a machine like this.
GBEES, GBEES_SECONDS = (0.90, 0.97, 1.33), 1.85
PARTICLES, STEPS = 1_000_000, 100


def run(effort: Effort) -> Table:
    """Return the distance from a simulation of many states, and the time that it takes."""
    progress = Progress('lorenz')
    filter_ = ActiveGridFilter(model(), WORLD, {}, 1.0, region=RegionSettings(finest=0))
    filter_.describe()
    count = effort.scaled(PARTICLES)
    shares = simulated(count)
    found, name = distances(filter_, shares), 'active cells of 0.5'
    times = interleave({name: Contestant(lambda k: predicted(filter_))}, 1,
                       effort.scaled(5, 2), progress)[name]
    rows = [Row.timed(name, 'steps as long as they may be', times, times, name,
                      {f'L1 at {k + 1}/3': found[k] for k in range(3)})]
    rows.append(Row('GBEES', 'cells of 0.5, threshold 5e-6', GBEES_SECONDS, None, None, '',
                    {f'L1 at {k + 1}/3': GBEES[k] for k in range(3)}))
    return Table('Lorenz-63 without noise', rows, (
        f'L1 of the masses in cells of 0.5 to {count:,} simulated states, whose own noise is '
        f'{noise(shares[-1], count):.3f} at the end; seconds for one unit of time.',
        'The figures of GBEES are not measured here: they were measured apart, on a machine like '
        'this one.'), (
        Goal('L1 at 1, of that of GBEES', 0.5, found[2] / GBEES[2]),
        Goal('seconds, of those of GBEES', 1.0, float(np.median(times)) / GBEES_SECONDS)))


def model() -> StateModel:
    """Return dx = 4 (y - x), dy = -y - x z, dz = -z + x y - 48, and no noise."""
    def drift(x: Array, t: float) -> Array:
        return np.stack([4 * (x[1] - x[0]), -x[1] - x[0] * x[2], x[0] * x[1] - x[2] - 48])

    def jacobian(x: Array, t: float) -> Array:
        none, one = np.zeros(x.shape[1:]), np.ones(x.shape[1:])
        return np.array([[-4 * one, 4 * one, none], [-x[2], -one, -x[0]], [x[1], x[0], -one]])

    return StateModel(('x', 'y', 'z'), drift, np.zeros((3, 1)), drift_jacobian=jacobian)


def predicted(filter_: ActiveGridFilter) -> list[ActiveBelief]:
    """Return the beliefs after each third of a unit of time."""
    beliefs = [filter_.gaussian(MEAN, np.eye(3))]
    for k in range(3):
        beliefs.append(filter_.predict(beliefs[-1], k * SECOND // 3, (k + 1) * SECOND // 3))
    return beliefs[1:]


def distances(filter_: ActiveGridFilter, shares: list[Array]) -> list[float]:
    """Return the L1 distance of each prediction from what was simulated."""
    return [float(np.abs(belief.on(WORLD, (0, 1, 2)).density.ravel() * WORLD.cell_volume
                         - share).sum()) for belief, share in zip(predicted(filter_), shares)]


def simulated(count: int) -> list[Array]:
    """Return the shares of some states in the world's cells after each third of a unit of time."""
    f = model().drift
    x, h, shares = np.random.default_rng(0).normal(size=(3, count)) + MEAN[:, None], 1 / 300, []
    for k in range(3 * STEPS):
        a = f(x, 0.0)
        b = f(x + h / 2 * a, 0.0)
        c = f(x + h / 2 * b, 0.0)
        x = x + h / 6 * (a + 2 * b + 2 * c + f(x + h * c, 0.0))
        if (k + 1) % STEPS == 0:
            index = np.floor((x - np.array(WORLD.lower)[:, None]) / CELL).astype(np.intp)
            shares.append(np.bincount(np.ravel_multi_index(tuple(index), WORLD.shape),
                                      minlength=WORLD.size) / count)
    return shares


def noise(share: Array, count: int) -> float:
    """Return the L1 distance that a simulation has from the truth, about."""
    return float(np.sqrt(share * 2 / np.pi / count).sum())
