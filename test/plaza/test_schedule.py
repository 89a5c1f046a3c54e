"""What is sent when."""

import numpy as np
from numpy.testing import assert_array_equal
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.schedule import Span, steps
import pytest


def test_every_range_and_every_pose_is_sent_once_in_the_order_of_the_file(
        plaza: Recording) -> None:
    sent = list(steps(plaza))
    assert [i for step in sent for i in step.ranges] == list(range(len(plaza.ranges)))
    assert [i for step in sent for i in step.truths] == list(range(len(plaza.truth_stamps_ns)))


def test_a_range_is_sent_when_it_arrives(plaza: Recording) -> None:
    for step in steps(plaza):
        assert_array_equal(plaza.arrivals_ns[list(step.ranges)], step.stamp_ns)


def test_a_late_block_is_one_burst(plaza: Recording) -> None:
    late = plaza.range_stamps_ns < plaza.arrivals_ns
    for step in steps(plaza):
        in_step = late[list(step.ranges)]
        assert not in_step[:1].any() and in_step[1:].all()


def test_a_pose_of_the_truth_is_never_sent_before_its_time(plaza: Recording) -> None:
    for step in steps(plaza):
        assert all(plaza.truth_stamps_ns[i] <= step.stamp_ns for i in step.truths)


@pytest.mark.parametrize('quiet', [0.1, 1.0])
def test_the_clock_runs_on_in_silence_and_never_back(plaza: Recording, quiet: float) -> None:
    stamps = np.array([step.stamp_ns for step in steps(plaza, quiet=quiet)])
    assert np.diff(stamps).min() > 0
    assert np.diff(stamps).max() <= quiet * 1e9
    assert stamps[0] == plaza.start_ns


def test_a_span_holds_what_arrives_in_it(small: Recording) -> None:
    sent = list(steps(small, Span(start=84.0, duration=10.0)))
    arrivals = small.seconds(small.arrivals_ns)
    inside = np.flatnonzero((arrivals >= 84.0) & (arrivals <= 94.0))
    assert [i for step in sent for i in step.ranges] == inside.tolist()
    assert small.seconds(sent[0].stamp_ns) == 84.0
    assert small.seconds(sent[-1].stamp_ns) == 94.0
    assert all(small.seconds(small.truth_stamps_ns[i]) >= 84.0
               for step in sent for i in step.truths)


def test_refuses_a_span_without_a_range(small: Recording) -> None:
    with pytest.raises(ValueError, match='no range of Plaza1 arrives between 45 s and 55 s'):
        list(steps(small, Span(start=45.0, duration=10.0)))
    with pytest.raises(ValueError, match='between 500 s and the end'):
        list(steps(small, Span(start=500.0)))


def test_odometry_is_sent_once_when_its_interval_ends_and_only_where_it_is_wanted(
        plaza: Recording) -> None:
    sent = list(steps(plaza, odometry=True))
    assert [i for step in sent for i in step.odometry] == list(range(len(plaza.odometry)))
    for step in sent:
        assert_array_equal(plaza.odometry_ends_ns[list(step.odometry)], step.stamp_ns)
    assert not any(step.odometry for step in steps(plaza))


def test_odometry_leaves_all_else_as_it_is(plaza: Recording) -> None:
    def others(odometry: bool) -> list[tuple[int, range, bool]]:
        return [(step.stamp_ns, step.ranges, step.quiet)
                for step in steps(plaza, odometry=odometry) if step.ranges or step.quiet]

    sent = [step.stamp_ns for step in steps(plaza, odometry=True)]
    assert others(True) == others(False)
    assert np.diff(sent).min() > 0


def test_a_step_is_quiet_where_no_range_came_for_so_long(plaza: Recording) -> None:
    arrivals = np.concatenate([[plaza.start_ns - 10**9], plaza.arrivals_ns])
    for step in steps(plaza, odometry=True):
        silence = step.stamp_ns - arrivals[np.searchsorted(arrivals, step.stamp_ns, 'right') - 1]
        assert not step.quiet or silence > 0 and silence % 10**9 == 0
