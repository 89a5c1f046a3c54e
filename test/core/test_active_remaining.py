"""Where active cells were wrong: a prior of all cells, drifts that bend, seams, wide noise."""

import numpy as np
from pif_ros.core.active import (
    ActiveBelief, ActiveGridFilter, Patch, RegionSettings, Window)
from pif_ros.core.active.focus import focused
from pif_ros.core.grid import Grid
from pif_ros.core.models import StateModel
from pif_ros.core.systems.robots import position_sensor
import pytest

SECOND = 1_000_000_000


def still(n, noise=0.1):
    return StateModel(tuple('xyz'[:n]), lambda x, t: 0 * x, noise * np.eye(n))


def test_a_prior_of_all_cells_is_focused_as_any_other():
    world, sigma, y = Grid((-50, -50), (50, 50), (100, 100)), 0.1, [3.13, -7.2]
    filter_ = ActiveGridFilter(still(2), world, {'position': position_sensor(sigma)}, 1.0)
    belief, log_evidence = filter_.correct(filter_.uniform(), y, 'position', 0)
    assert log_evidence == pytest.approx(-np.log(100**2), abs=0.005)
    np.testing.assert_allclose(belief.mean(), y, atol=0.02 * sigma)
    np.testing.assert_allclose(np.sqrt(np.diag(belief.covariance())), sigma, rtol=0.05)


def test_focused_cells_are_hardly_more_than_the_world_has():
    # a stripe from corner to corner, in several parts, of which not all can be halved
    world = Grid((-30, -30), (30, 30), (100, 100))
    x, y = np.meshgrid(*world.axes, indexing='ij')
    prior, posterior = (
        ActiveBelief(world, (Patch(Window.whole(world), p),)).normalised()
        for p in (np.ones_like(x), np.exp(-0.5 * ((x - y - 0.3) / 0.4)**2)))
    finer = focused(prior, posterior, RegionSettings())
    assert 0.8 * world.size < finer.size < 1.05 * world.size
