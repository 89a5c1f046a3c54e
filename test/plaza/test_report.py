"""Scores and their table."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from pif_ros.plaza.report import errors, Scores, table, Track
import pytest

SECONDS = 10**9


def scores(stamps: np.ndarray, means: np.ndarray, covariances: np.ndarray, truth: np.ndarray,
           skip: float = 0.1) -> Scores:
    """Return the scores of estimates against the truth."""
    return errors(Track(np.array(stamps), np.array(means), np.array(covariances)), truth, skip)


def test_scores_are_those_worked_out_by_hand() -> None:
    """
    Oracle: four errors of 1, 2, 3 and 10 m along an axis whose sigma is 2 m.

    Squared distances 0.25, 1, 2.25, 25; the bounds of the ellipses do not count as inside.
    """
    truth = np.array([[1.0, 0.0], [2.0, 0.0], [-3.0, 0.0], [10.0, 0.0]])
    s = scores(np.arange(4) * SECONDS, np.zeros((4, 2)), np.tile(np.diag([4.0, 9.0]), (4, 1, 1)),
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
    s = scores(t, np.zeros((8, 2)), np.tile(np.eye(2), (8, 1, 1)), truth)
    assert (s.count, s.rmse, s.maximum) == (4, 1.0, 1.0)


def test_an_honest_filter_gets_the_honest_coverage() -> None:
    """Oracle: errors drawn from the covariances that are claimed; four standard errors."""
    rng = np.random.default_rng(3)
    k = 20000
    roots = rng.normal(size=(k, 2, 2))
    P = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(2)
    d = (np.linalg.cholesky(P) @ rng.normal(size=(k, 2, 1)))[..., 0]
    s = scores(np.arange(k), np.zeros((k, 2)), P, d, skip=0.0)
    assert abs(s.coverage_1_sigma - (1 - np.exp(-0.5))) < 4 * np.sqrt(0.25 / k)
    assert abs(s.coverage_2_sigma - (1 - np.exp(-2.0))) < 4 * np.sqrt(0.25 / k)
    assert abs(s.nees - 1.0) < 4 / np.sqrt(k)


def test_the_heading_of_the_truth_does_not_count_in_a_position() -> None:
    s = scores([0], [[1.0, 1.0]], [np.eye(2)], [[1.0, 2.0, 3.0]], skip=0.0)
    assert s.rmse == 1.0 and s.heading_rmse is None


def test_headings_are_off_the_short_way_round_whatever_the_turns_of_the_truth() -> None:
    """Oracle: errors of 10, -10, 20 and 20 degrees; their root mean square is sqrt(250)."""
    truth = np.column_stack([np.zeros((4, 2)), np.radians([175.0, -175.0, 720.0, 90.0])])
    means = np.column_stack([np.zeros((4, 2)), np.radians([-175.0, 175.0, 20.0, 110.0])])
    s = scores(np.arange(4), means, np.tile(np.eye(3), (4, 1, 1)), truth, skip=0.0)
    assert_allclose(s.heading_rmse, np.sqrt(250.0))
    assert s.rmse == 0.0


def test_the_position_of_a_pose_is_scored_as_that_of_a_track_without_heading() -> None:
    rng = np.random.default_rng(5)
    roots, truth = rng.normal(size=(9, 3, 3)), rng.normal(size=(9, 3))
    P = roots @ roots.transpose(0, 2, 1)
    pose = scores(np.arange(9), np.zeros((9, 3)), P, truth)
    plain = scores(np.arange(9), np.zeros((9, 2)), P[:, :2, :2], truth)
    assert replace(pose, heading_rmse=None) == plain


@pytest.mark.parametrize('mean', [np.nan, np.inf])
def test_refuses_to_score_what_is_not_finite(mean: float) -> None:
    with pytest.raises(ValueError, match='expected finite'):
        scores([0], [[mean, 0.0]], [np.eye(2)], [[0.0, 0.0]])
    with pytest.raises(ValueError, match='at least one estimate'):
        scores([], np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros((0, 2)))


def test_the_table_has_a_row_of_its_own_for_each_track() -> None:
    s = scores([0], [[3.0, 4.0]], [np.eye(2)], [[0.0, 0.0]], skip=0.0)
    lines = table({'first': s, 'second': s}).splitlines()
    assert len(lines) == 5
    assert len({line.count('|') for line in lines}) == 1
    assert lines[2] == '| first | 5.00 m | 5.00 m | 5.00 m | 5.0 m | 0.00 | 0.00 | 12.50 |'


def test_the_table_tells_of_headings_where_there_are_any() -> None:
    with_heading = scores([0], np.zeros((1, 3)), [np.eye(3)], [[3.0, 4.0, 0.1]], skip=0.0)
    without = replace(with_heading, heading_rmse=None)
    lines = table({'with': with_heading, 'without': without}).splitlines()
    assert len({line.count('|') for line in lines}) == 1
    assert lines[0].endswith('| heading RMSE |')
    assert lines[2].endswith('| 5.7 deg |') and lines[3].endswith('| 12.50 |  |')
