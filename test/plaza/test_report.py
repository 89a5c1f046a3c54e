"""Scores and their table."""

import numpy as np
from numpy.testing import assert_allclose
from pif_ros.plaza.report import errors, table
import pytest

SECONDS = 10**9


def test_scores_are_those_worked_out_by_hand() -> None:
    """
    Oracle: four errors of 1, 2, 3 and 10 m along an axis whose sigma is 2 m.

    Squared distances 0.25, 1, 2.25, 25; the bounds of the ellipses do not count as inside.
    """
    truth = np.array([[1.0, 0.0], [2.0, 0.0], [-3.0, 0.0], [10.0, 0.0]])
    s = errors(np.arange(4) * SECONDS, np.zeros((4, 2)), np.tile(np.diag([4.0, 9.0]), (4, 1, 1)),
               truth, skip=0.0)
    assert s.count == 4
    assert_allclose([s.rmse, s.median, s.maximum], [np.sqrt(114.0 / 4.0), 2.5, 10.0])
    assert_allclose(s.percentile_95, 3.0 + 0.85 * 7.0)
    assert (s.coverage_1_sigma, s.coverage_2_sigma) == (0.25, 0.75)
    assert_allclose(s.nees, 28.5 / 4.0 / 2.0)


def test_the_first_tenth_of_the_time_does_not_count() -> None:
    """Oracle: errors of 100 m before, 1 m after; the stamps are not evenly spaced."""
    t = np.array([0, 1, 2, 9, 10, 50, 99, 100]) * SECONDS
    truth = np.where(t[:, None] < 10 * SECONDS, 100.0, 1.0) * [1.0, 0.0]
    s = errors(t, np.zeros((8, 2)), np.tile(np.eye(2), (8, 1, 1)), truth)
    assert (s.count, s.rmse, s.maximum) == (4, 1.0, 1.0)


def test_an_honest_filter_gets_the_honest_coverage() -> None:
    """Oracle: errors drawn from the covariances that are claimed; four standard errors."""
    rng = np.random.default_rng(3)
    k = 20000
    roots = rng.normal(size=(k, 2, 2))
    P = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(2)
    d = (np.linalg.cholesky(P) @ rng.normal(size=(k, 2, 1)))[..., 0]
    s = errors(np.arange(k), np.zeros((k, 2)), P, d, skip=0.0)
    assert abs(s.coverage_1_sigma - (1 - np.exp(-0.5))) < 4 * np.sqrt(0.25 / k)
    assert abs(s.coverage_2_sigma - (1 - np.exp(-2.0))) < 4 * np.sqrt(0.25 / k)
    assert abs(s.nees - 1.0) < 4 / np.sqrt(k)


def test_the_heading_of_the_truth_does_not_count_in_a_position() -> None:
    s = errors([0], [[1.0, 1.0]], [np.eye(2)], [[1.0, 2.0, 3.0]], skip=0.0)
    assert s.rmse == 1.0


@pytest.mark.parametrize('mean', [np.nan, np.inf])
def test_refuses_to_score_what_is_not_finite(mean: float) -> None:
    with pytest.raises(ValueError, match='expected finite'):
        errors([0], [[mean, 0.0]], [np.eye(2)], [[0.0, 0.0]])
    with pytest.raises(ValueError, match='at least one estimate'):
        errors([], np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)))


def test_the_table_has_a_row_of_its_own_for_each_track() -> None:
    s = errors([0], [[3.0, 4.0]], [np.eye(2)], [[0.0, 0.0]], skip=0.0)
    lines = table({'first': s, 'second': s}).splitlines()
    assert len(lines) == 5
    assert len({line.count('|') for line in lines}) == 1
    assert lines[2] == '| first | 5.00 m | 5.00 m | 5.00 m | 5.0 m | 0.00 | 0.00 | 12.50 |'
