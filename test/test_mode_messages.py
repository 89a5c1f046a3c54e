"""Modes as messages: what a program reads, and what a person sees in RViz."""

import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
from numpy.testing import assert_allclose
from pif_ros.core.modes import Mode
from pif_ros.mode_messages import (BAR, ellipse, ELLIPSES, markers_message, MASSES, modes_message,
                                   SIGMAS, SMALLEST, THINNEST)
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scipy import stats
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

S = np.array([[2.0, 0.6, 0.1], [0.6, 0.5, 0.0], [0.1, 0.0, 0.3]])
ONE, TWO = Mode(0.75, np.array([1.0, -2.0, 3.0]), S), Mode(0.2, np.array([4.0, 5.0, 6.0]), S / 4)
STAMP = 1_234_567_890


def sent(message):
    """Return a message as it arrives."""
    return deserialize_message(serialize_message(message), type(message))


def drawn(modes=(ONE, TWO), axes=(0, 1, None), shown=0):
    return sent(markers_message(modes, axes, shown, STAMP, 'map')).markers


def along(marker):
    """Return the directions of a marker's own x and y in the frame, as columns."""
    q = marker.pose.orientation
    x, y, z, w = q.x, q.y, q.z, q.w
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0, abs=1e-12)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z)]])


def test_a_row_is_mass_mean_and_covariance_and_the_layout_says_so():
    message = sent(modes_message([ONE, TWO], ['x', 'y', 'theta']))
    rows, columns = message.layout.dim
    assert (rows.size, rows.stride, columns.size, columns.stride) == (2, 26, 13, 13)
    assert rows.label == 'mode, heaviest first'
    assert columns.label == 'mass; mean of x, y, theta; covariance of x, y, theta, row by row'
    data = np.reshape(message.data, (rows.size, columns.size))
    for row, mode in zip(data, (ONE, TWO)):
        assert row[0] == mode.mass
        assert row[1:4].tolist() == mode.mean.tolist()
        assert row[4:].reshape(3, 3).tolist() == mode.covariance.tolist()


def test_no_mode_is_no_row():
    message = sent(modes_message([], ['x']))
    assert [dim.size for dim in message.layout.dim] == [0, 3] and len(message.data) == 0
    assert isinstance(message, Float64MultiArray)


def test_an_ellipse_reaches_as_far_as_95_percent_of_a_gaussian():
    assert stats.chi2(2).cdf(SIGMAS**2) == pytest.approx(0.95, abs=1e-12)


@given(st.floats(-4, 4), st.floats(0.01, 100.0), st.floats(0.1, 1.0))
def test_every_point_of_an_ellipse_is_equally_far_from_its_centre(turn, long, ratio):
    c, s = math.cos(turn), math.sin(turn)
    R = np.array([[c, -s], [s, c]])
    C = R @ np.diag([long**2, (ratio * long)**2]) @ R.T
    marker = drawn([Mode(0.5, np.array([7.0, 8.0]), C)])[0]
    around = np.linspace(0, 2 * np.pi, 17)
    half = np.array([marker.scale.x, marker.scale.y]) / 2
    points = along(marker) @ (half[:, None] * [np.cos(around), np.sin(around)])
    distances = np.einsum('ik,ij,jk->k', points, np.linalg.inv(C), points)
    assert_allclose(distances, SIGMAS**2, rtol=1e-6)
    assert_allclose(half**2, SIGMAS**2 * np.linalg.eigvalsh(C)[::-1], rtol=1e-6)


def test_markers_have_place_stamp_frame_and_the_ids_of_their_rank():
    markers = drawn(axes=(0, 1, 2))
    assert len(markers) == 4
    assert [(m.ns, m.id) for m in markers] == [
        (ELLIPSES, 0), (MASSES, 0), (ELLIPSES, 1), (MASSES, 1)]
    assert [m.type for m in markers] == 2 * [Marker.CYLINDER, Marker.TEXT_VIEW_FACING]
    for marker in markers:
        assert marker.action == Marker.ADD and marker.header.frame_id == 'map'
        assert (marker.header.stamp.sec, marker.header.stamp.nanosec) == (1, 234_567_890)
        assert marker.lifetime.sec == marker.lifetime.nanosec == 0
        along(marker)
    one, mass, two, _ = markers
    assert (one.pose.position.x, one.pose.position.y, one.pose.position.z) == (1.0, -2.0, 3.0)
    assert (two.pose.position.x, two.pose.position.y, two.pose.position.z) == (4.0, 5.0, 6.0)
    assert mass.text == '75 %' and mass.scale.z >= SMALLEST
    assert mass.pose.position.z > one.pose.position.z
    assert 0 < two.color.a < one.color.a < mass.color.a == 1


def test_a_pose_without_height_lies_on_the_ground():
    assert [m.pose.position.z for m in drawn()[::2]] == [0.0, 0.0]


@pytest.mark.parametrize('mass, text', [(0.99991, '100 %'), (1.0, '100 %'), (0.618, '61.8 %'),
                                        (0.05, '5 %'), (0.00123, '0.123 %')])
def test_a_mass_is_read_in_percent(mass, text):
    assert drawn([Mode(mass, ONE.mean, S)])[1].text == text


def test_what_was_shown_before_is_deleted_and_nothing_else():
    markers = drawn(shown=4)
    assert [(m.ns, m.id, m.action) for m in markers[4:]] == [
        (ELLIPSES, 2, Marker.DELETE), (MASSES, 2, Marker.DELETE),
        (ELLIPSES, 3, Marker.DELETE), (MASSES, 3, Marker.DELETE)]
    assert len(drawn(shown=1)) == len(drawn(shown=2)) == 4
    assert isinstance(markers_message([], (0, 1, None), 0, STAMP, 'map'), MarkerArray)
    assert drawn([]) == []


@pytest.mark.parametrize('axes, long, turn', [((0, None, None), 0, 0.0), ((None, 0, 2), 1, 1.0)])
def test_where_x_or_y_is_missing_a_bar_shows_the_other(axes, long, turn):
    marker = drawn([ONE], axes)[0]
    assert_allclose([marker.scale.x, marker.scale.y],
                    [2 * SIGMAS * math.sqrt(2), 2 * BAR * SIGMAS * math.sqrt(2)])
    assert abs(along(marker)[1, 0]) == pytest.approx(turn, abs=1e-12)
    place = marker.pose.position.x, marker.pose.position.y
    assert place[long] == 1.0 and place[1 - long] == 0.0


@pytest.mark.parametrize('C', [np.zeros((2, 2)), np.diag([4.0, 0.0]), np.full((2, 2), 1.0),
                               np.diag([1.0, -1e-17])])
def test_a_mode_without_width_can_still_be_seen(C):
    markers = drawn([Mode(1.0, np.zeros(2), C)])
    assert markers[0].scale.x >= markers[0].scale.y >= THINNEST
    assert markers[1].scale.z >= SMALLEST
    (long, short), turn = ellipse(C)
    assert long >= short > 0 and math.isfinite(turn)
