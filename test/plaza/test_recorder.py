"""What a filter publishes, put together again."""

from collections.abc import Callable

from follower import until
from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pif_ros.plaza.player_node import Spin
from pif_ros.plaza.recorder import Density, Recorder
import pytest
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

X, Y = 10.0 + 0.5 * np.arange(4), -3.0 + 2.0 * np.arange(3)


def density_message(values: np.ndarray) -> Float64MultiArray:
    msg = Float64MultiArray(data=values.ravel().tolist())
    for label, size in (('x first=10.0 spacing=0.5 unit=m', 4), ('y first=-3 spacing=2e0', 3)):
        msg.layout.dim.append(MultiArrayDimension(label=label, size=size))
    return msg


def pose_message(stamp_ns: int, mean: np.ndarray) -> PoseWithCovarianceStamped:
    msg = PoseWithCovarianceStamped()
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    msg.pose.pose.position.x, msg.pose.pose.position.y = float(mean[0]), float(mean[1])
    msg.pose.covariance = np.arange(36.0)
    return msg


def test_a_density_is_read_with_its_axes() -> None:
    values = np.random.default_rng(0).random((4, 3))
    density = Density.from_message(density_message(values))
    assert_array_equal(density.values, values)
    assert_array_equal(density.x, X)
    assert_array_equal(density.y, Y)


def test_refuses_a_label_that_tells_no_axis() -> None:
    msg = density_message(np.ones((4, 3)))
    msg.layout.dim[0].label = 'x'
    with pytest.raises(ValueError, match="expected '<axis> first=.*, got 'x'"):
        Density.from_message(msg)


def test_a_density_gets_the_stamp_of_the_pose_that_was_sent_before_it(
        spinner: Callable[..., Spin]) -> None:
    """The poses stand still, and only every other one has a density."""
    rng = np.random.default_rng(2)
    recorder, source = Recorder('/filter', [(0, 10**9)]), Node('source')
    spin = spinner(recorder, source)
    poses = source.create_publisher(PoseWithCovarianceStamped, '/filter/pose', 10)
    densities = source.create_publisher(Float64MultiArray, '/filter/density', 10)
    until(spin, lambda: poses.get_subscription_count() + densities.get_subscription_count() == 2)
    all_values = rng.random((3, 4, 3))
    for k in range(6):
        poses.publish(pose_message(k * 10**8, np.zeros(2)))
        if k % 2:
            densities.publish(density_message(all_values[k // 2]))
    until(spin, lambda: recorder.stamp_ns == 5 * 10**8 and len(recorder.densities()) == 3)
    for k, (stamp, density) in enumerate(recorder.densities()):
        assert stamp == (2 * k + 1) * 10**8
        assert_array_equal(density.values, all_values[k])


def test_of_two_poses_with_one_stamp_the_first_counts(spinner: Callable[..., Spin]) -> None:
    recorder, source = Recorder('/filter', []), Node('source')
    spin = spinner(recorder, source)
    poses = source.create_publisher(PoseWithCovarianceStamped, '/filter/pose', 10)
    until(spin, lambda: poses.get_subscription_count() == 1)
    for stamp, x in ((2, 1.0), (2, 5.0), (1, 7.0), (3, 9.0)):
        poses.publish(pose_message(stamp, np.array([x, 0.0])))
    until(spin, lambda: recorder.stamp_ns == 3)
    track = recorder.track()
    assert_array_equal(track.stamps_ns, [1, 2, 3])
    assert_array_equal(track.means[:, 0], [7.0, 1.0, 9.0])
    assert_array_equal(track.covariances[0], [[0.0, 1.0], [6.0, 7.0]])


@pytest.mark.parametrize('yaw', [0.0, 2.5, -3.1])
def test_the_yaw_of_a_pose_is_its_heading_where_one_is_wanted(
        spinner: Callable[..., Spin], yaw: float) -> None:
    recorder, source = Recorder('/filter', [], heading=True), Node('source')
    spin = spinner(recorder, source)
    poses = source.create_publisher(PoseWithCovarianceStamped, '/filter/pose', 10)
    until(spin, lambda: poses.get_subscription_count() == 1)
    msg = pose_message(1, np.array([3.0, 4.0]))
    msg.pose.pose.orientation.z, msg.pose.pose.orientation.w = np.sin(yaw / 2), np.cos(yaw / 2)
    poses.publish(msg)
    until(spin, lambda: recorder.stamp_ns == 1)
    assert_allclose(recorder.track().means, [[3.0, 4.0, yaw]])
    assert_array_equal(recorder.track().covariances[0],
                       [[0.0, 1.0, 5.0], [6.0, 7.0, 11.0], [30.0, 31.0, 35.0]])


def test_densities_are_listened_to_only_about_when_they_are_wanted(
        spinner: Callable[..., Spin]) -> None:
    recorder, source = Recorder('/filter', [(100 * 10**9, 101 * 10**9)]), Node('source')
    spin = spinner(recorder, source)
    poses = source.create_publisher(PoseWithCovarianceStamped, '/filter/pose', 10)
    densities = source.create_publisher(Float64MultiArray, '/filter/density', 10)
    until(spin, lambda: poses.get_subscription_count() + densities.get_subscription_count() == 2)
    for seconds, listening in ((10, 0), (90, 1), (102, 1), (200, 0)):
        poses.publish(pose_message(seconds * 10**9, np.zeros(2)))
        until(spin, lambda: recorder.stamp_ns == seconds * 10**9)
        until(spin, lambda: densities.get_subscription_count() == listening)
