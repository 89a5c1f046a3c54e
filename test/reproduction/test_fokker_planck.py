"""The Fokker-Planck reference is what it claims to be."""

import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.systems import double_well, ornstein_uhlenbeck
from pif_ros.reproduction.fokker_planck import fokker_planck, generator, point, sharp_point
from pif_ros.reproduction.transitions import converged
import pytest
from scipy import stats

BOX = (-8.0,), (8.0,)


def errors(cells: int, solve=fokker_planck) -> float:
    """Return the L1 distance to the exact Ornstein-Uhlenbeck density 0.7 s after 1.3."""
    grid = Grid(*BOX, (cells,))
    p = solve(ornstein_uhlenbeck().model, grid, [1.3], 0.7)[0]
    edges = np.linspace(*BOX[0], *BOX[1], cells + 1)
    mass = np.diff(stats.norm.cdf(edges, 1.3 * np.exp(-0.7), np.sqrt((1 - np.exp(-1.4)) / 2)))
    return float(np.abs(p * grid.cell_volume - mass).sum())


def test_converges_to_the_exact_density_at_second_order():
    coarse, fine = errors(200), errors(400)
    assert fine < 2e-3
    # 4 in the limit
    assert 3.5 < coarse / fine < 4.5


def test_two_grids_together_are_better_than_the_finer_one():
    assert errors(200, converged) < 0.2 * errors(400)


def test_mass_neither_comes_nor_goes():
    grid = Grid((-2.0,), (2.0,), (400,))
    G = generator(double_well().model, grid)
    # relative to the diagonal, by which mass moves within the columns
    assert np.abs(G.sum(axis=0)).max() < 1e-12 * np.abs(G.diagonal()).max()
    p = fokker_planck(double_well().model, grid, [-0.7, 0.1], 0.5)
    assert p.sum(axis=1) * grid.cell_volume == pytest.approx(1.0)
    assert p.min() > -1e-12


def test_a_point_keeps_its_place_between_two_cells():
    grid = Grid((0.0,), (1.0,), (10,))
    p = point(grid, 0.33) * grid.cell_volume
    assert p.sum() == pytest.approx(1.0)
    assert p @ grid.axes[0] == pytest.approx(0.33)
    assert np.count_nonzero(p) == 2 and p.min() == 0.0
    p = sharp_point(grid, 0.33) * grid.cell_volume
    assert p @ grid.axes[0] == pytest.approx(0.33)
    assert p @ (grid.axes[0] - 0.33)**2 == pytest.approx(0.0, abs=1e-15)
