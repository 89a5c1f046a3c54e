"""Where the density lives."""

import itertools

from hypothesis import given, strategies as st
import numpy as np
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
import pytest


def test_cells_tile_the_box_and_points_are_their_centres_in_c_order():
    grid = Grid((-1, 10), (2, 12), (3, 4))
    edges = [np.linspace(-1, 2, 4), np.linspace(10, 12, 5)]
    centres = [(edge[1:] + edge[:-1]) / 2 for edge in edges]
    # rounding of numbers of size 10
    np.testing.assert_allclose(grid.points.T, list(itertools.product(*centres)), atol=1e-14)
    assert (grid.ndim, grid.size) == (2, 12)
    assert grid.size * grid.cell_volume == pytest.approx(3 * 2, rel=1e-15)


def test_fields_come_out_as_plain_tuples_and_grids_of_equal_fields_are_equal():
    grid = Grid(np.array([0, 0]), [1, 2], np.array([3, 4]), [0, 1])
    assert grid == Grid((0.0, 0.0), (1.0, 2.0), (3, 4), (False, True))
    assert hash(grid) == hash(Grid((0.0, 0.0), (1.0, 2.0), (3, 4), (False, True)))
    assert {type(v) for v in grid.lower + grid.upper} == {float}
    assert {type(v) for v in grid.shape} == {int}


@pytest.mark.parametrize('width', [1.1e-70, 0.9e70])
def test_the_narrowest_and_the_widest_cells_have_volumes_and_variances(width):
    grid = Grid((0,) * 4, (2 * width,) * 4, (2,) * 4)
    belief = GridBelief.gaussian(grid, [width] * 4, np.eye(4) * width**2)
    assert belief.mass == pytest.approx(1)
    np.testing.assert_allclose(belief.covariance(), np.eye(4) * width**2 / 4, rtol=1e-9,
                               atol=1e-9 * width**2)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(0.1, 100))
def test_wrapped_differences_are_the_shortest_of_all_turns(difference, low, period):
    grid = Grid((low, 0), (low + period, 1), (4, 4), (True, False))
    turn = grid.upper[0] - grid.lower[0]
    wrapped = grid.wrap(np.array([[difference], [difference]]))
    turns = difference + turn * np.arange(-11e3, 11e3)
    # the difference, the turn and their remainder are rounded, up to 1e4 turns of them
    assert abs(wrapped[0, 0]) == pytest.approx(np.abs(turns).min(), abs=1e-8)
    whole = (difference - wrapped[0, 0]) / turn
    assert whole == pytest.approx(round(whole), abs=1e-8)
    assert wrapped[1, 0] == difference


def test_a_periodic_axis_holds_everything_and_another_its_box_with_both_edges():
    grid = Grid((0, 0), (1, 1), (2, 2), (True, False))
    x = np.array([[9.0, -9.0, 0.5, 0.5], [0.0, 1.0, -0.001, 1.001]])
    np.testing.assert_array_equal(grid.contains(x), [True, True, False, False])


def test_selected_axes_stand_in_the_order_given():
    grid = Grid((0, 1, 2), (10, 11, 12), (4, 5, 6), (False, True, False))
    assert grid.select([2, 1]) == Grid((2, 1), (12, 11), (6, 5), (False, True))


@pytest.mark.parametrize('fields, wanted, got', [
    (((), (), ()), 'shape: expected 1 to 4 axes', '0'),
    (((0,) * 5, (1,) * 5, (2,) * 5), 'shape: expected 1 to 4 axes', '5'),
    (((0,), (1, 1), (2, 2)), 'lower: expected 2 values', '1'),
    (((0, 0), (1,), (2, 2)), 'upper: expected 2 values', '1'),
    (((0, 0), (1, 1), (2, 2), (True,)), 'periodic: expected 2 values', '1'),
    (((0, 1), (1, 1), (2, 2)), 'upper: expected finite lower < upper on axis 1', '1 and 1'),
    (((float('nan'),), (1,), (2,)), 'upper: expected finite lower < upper on axis 0', 'nan'),
    (((0,), (float('inf'),), (2,)), 'upper: expected finite lower < upper on axis 0', 'inf'),
    (((0, 0), (1, 1e-200), (2, 40)), 'upper: expected cells from 1e-70 to 1e+70 wide on axis 1',
     '2.5e-202'),
    (((-1e200,), (1e200,), (40,)), 'upper: expected cells from 1e-70 to 1e+70 wide on axis 0',
     '5e+198'),
    (((0, 0), (1, 1), (2, 1)), 'shape: expected at least 2 cells on axis 1', '1'),
    (((0,), (1,), (-3,)), 'shape: expected at least 2 cells on axis 0', '-3'),
    (((0,), (1,), (2.7,)), 'shape: expected', '2.7'),
])
def test_refuses_what_is_no_box_in_one_line_with_what_was_wanted_and_what_came(
        fields, wanted, got):
    with pytest.raises(ValueError) as error:
        Grid(*fields)
    line = str(error.value)
    assert line.startswith(wanted) and got in line.split('got')[1] and '\n' not in line
