"""Messages to arrays and back."""

import itertools
import math
import tracemalloc

from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point, Pose, PoseArray, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion)
from hypothesis import given, strategies as st
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pif_ros import conversions, fields
from pif_ros.config import build_tracker, Config
from pif_ros.core.belief import GridBelief
from pif_ros.core.grid import Grid
from pif_ros.sources import Refused
from pif_ros.start import start_of
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import BatteryState, Imu, JointState, LaserScan
from std_msgs.msg import Byte, ByteMultiArray, Float64, Float64MultiArray, Header, String

STAMP = 1_234_567_890_123_456_789
#: Not symmetric on purpose, so that nothing can be transposed unseen.
COVARIANCE = np.arange(9.0).reshape(3, 3) / 7 + np.eye(3)


def sent(message):
    """Return a message as it comes out at the other end."""
    return deserialize_message(serialize_message(message), type(message))


def filled(*args):
    """Return a pose with the mean and the covariance given."""
    pose = PoseWithCovariance()
    conversions.fill_pose(pose, *args)
    return pose


def some_belief(grid, seed=1):
    """Return a density without any symmetry, of mass 1."""
    return GridBelief(grid, np.random.default_rng(seed).random(grid.shape)).normalised()


def test_messages_check_the_types_of_their_fields_while_this_is_tested():
    with pytest.raises(AssertionError):
        Point(x=1)


# Stamps


@given(st.integers(0, 2**31 * 10**9 - 1))
def test_a_stamp_of_nanoseconds_comes_back_whole(stamp_ns):
    assert conversions.stamp_to_ns(sent(conversions.stamp_from_ns(stamp_ns))) == stamp_ns


def test_a_stamp_is_seconds_and_nanoseconds():
    assert conversions.stamp_from_ns(STAMP) == Time(sec=1_234_567_890, nanosec=123_456_789)
    assert conversions.stamp_to_ns(Time(sec=-2, nanosec=5)) == -1_999_999_995


def test_an_integer_of_numpy_is_a_stamp_too():
    assert conversions.stamp_from_ns(np.int64(STAMP)) == conversions.stamp_from_ns(STAMP)


# Types


@pytest.mark.parametrize(('name', 'kind'), [
    ('std_msgs/msg/Float64MultiArray', Float64MultiArray), ('sensor_msgs/msg/Imu', Imu),
    ('geometry_msgs/msg/PoseWithCovarianceStamped', PoseWithCovarianceStamped)])
def test_an_installed_message_type_is_found(name, kind):
    assert fields.message_class(name) is kind


@pytest.mark.parametrize('name', [
    'os/msg/path', 'os/msg/Path', 'numpy/msg/X', 'pif_ros/msg/Tracker', 'rclpy/msg/Node',
    'std_msgs/msg/Nothing', 'std_msgs/msg/_String', 'std_msgs/Float64', 'std_msgs.msg/Float64',
    'std_srvs/srv/Empty', 'std_srvs/msg/Empty', 'Float64', '', '/', 'std_msgs/msg/',
    '../std_msgs/msg/Float64', 'std_msgs/msg/Float64\n', 'no_such_msgs/msg/Thing',
    'geometry_msgs/msg/Metaclass_Point'])
def test_what_is_no_installed_message_type_is_refused_and_named(name):
    with pytest.raises(ValueError) as refused:
        fields.message_class(name)
    assert str(refused.value).startswith('expected ')
    assert str(refused.value).endswith(f', got {name!r}')


def test_a_header_is_seen_only_where_it_is_one():
    assert fields.has_header(LaserScan)
    assert not fields.has_header(Float64MultiArray)
    assert not fields.has_header(Header)


# Fields


def battery():
    """Return a message with fields of many kinds."""
    return BatteryState(voltage=12.5, present=True, cell_voltage=[4.0, 3.5, 3.25],
                        power_supply_status=2)


def poses():
    """Return a message with an array of messages."""
    return PoseArray(poses=[Pose(position=Point(x=float(i), y=10.0 * i)) for i in range(3)])


def covariant():
    """Return a message with an array of a fixed length."""
    return PoseWithCovarianceStamped(pose=PoseWithCovariance(
        pose=Pose(position=Point(x=1.0, y=2.0, z=3.0)), covariance=np.arange(36.0)))


@pytest.mark.parametrize(('message', 'paths', 'values'), [
    (Float64MultiArray(data=[1.0, 2.5]), [], (1.0, 2.5)),
    (Float64(data=3.5), [], (3.5,)),
    (Float64MultiArray(), [], ()),
    (covariant(), ['pose.pose.position.x', 'pose.pose.position.y'], (1.0, 2.0)),
    (covariant(), ['pose.covariance[7]', 'pose.pose.position.z', 'pose.covariance[35]'],
     (7.0, 3.0, 35.0)),
    (covariant(), ['pose.covariance'], tuple(map(float, range(36)))),
    (covariant(), ['header.stamp.sec'], (0.0,)),
    (JointState(position=[1.0, 2.0], velocity=[3.0]), ['velocity', 'position'], (3.0, 1.0, 2.0)),
    (JointState(position=[1.0, 2.0]), ['position[1]'], (2.0,)),
    (poses(), ['poses[2].position.y', 'poses[0].position.x'], (20.0, 0.0)),
    (battery(), ['voltage', 'present', 'power_supply_status', 'cell_voltage[2]'],
     (12.5, 1.0, 2.0, 3.25)),
    (Byte(data=b'\x07'), ['data'], (7.0,)),
    (ByteMultiArray(data=[b'\x07', b'9']), ['data'], (7.0, 57.0)),
    (ByteMultiArray(data=[b'\x07', b'9']), ['data[1]'], (57.0,)),
], ids=lambda value: str(value)[:40] if isinstance(value, list) else None)
def test_fields_are_read_in_the_order_of_their_paths(message, paths, values):
    found = fields.field_reader(type(message), paths)(sent(message))
    assert found == values
    assert all(type(value) is float for value in found)


@pytest.mark.parametrize(('kind', 'path'), [
    (covariant, 'pose.pose.position.w'), (covariant, 'pose'), (covariant, 'pose.pose'),
    (covariant, 'pose.pose.position.x.y'), (covariant, 'pose.pose.position.x[0]'),
    (covariant, 'header.frame_id'), (covariant, 'pose.covariance[-1]'),
    (covariant, 'pose.covariance[a]'), (covariant, 'pose.covariance[0'), (covariant, ''),
    (covariant, '.'), (covariant, 'pose..pose'), (covariant, 'header.__class__'),
    (covariant, 'serialize'), (covariant, 'SLOT_TYPES'), (covariant, 'data'),
    (poses, 'poses'), (poses, 'poses.position.x'), (poses, 'poses[0]'),
    (lambda: String(), 'data'), (lambda: JointState(), 'name'), (lambda: JointState(), 'name[0]'),
], ids=lambda value: value if isinstance(value, str) else '')
def test_a_path_that_is_no_number_is_refused_when_the_node_starts(kind, path):
    with pytest.raises(ValueError, match='expected ') as refused:
        fields.field_reader(type(kind()), [path])
    assert f'got {path!r}' in str(refused.value)


def test_an_index_beyond_an_array_is_the_message_s_fault():
    read = fields.field_reader(JointState, ['position[1]'])
    with pytest.raises(IndexError):
        read(JointState(position=[1.0]))


# Poses


def test_a_pose_has_states_and_covariances_where_its_axes_say():
    axes = (2, None, 0, None, None, 1)  # x, z and yaw
    pose = filled(np.array([1.5, 0.25, -3.0]), COVARIANCE, axes, 99.0)
    pose = sent(pose)
    assert (pose.pose.position.x, pose.pose.position.y, pose.pose.position.z) == (-3.0, 0.0, 1.5)
    assert_allclose(conversions.angles(pose.pose), [0.0, 0.0, 0.25], atol=1e-15)
    expected = np.diag([0.0, 99.0, 0.0, 99.0, 99.0, 0.0])
    for (i, a), (j, b) in itertools.product([(0, 2), (2, 0), (5, 1)], repeat=2):
        expected[i, j] = COVARIANCE[a, b]
    assert_array_equal(np.array(pose.covariance).reshape(6, 6), expected)


@pytest.mark.parametrize('layout', [np.ascontiguousarray, np.asfortranarray,
                                    lambda a: np.repeat(a, 2, axis=1)[:, ::2]])
def test_a_covariance_is_sent_bitwise_however_it_lies_in_memory(layout):
    full = np.random.default_rng(3).random((6, 6))
    pose = sent(filled(np.zeros(6), layout(full), range(6), 0.0))
    assert np.array(pose.covariance).tobytes() == full.tobytes()


def test_nothing_of_what_a_pose_held_before_is_left_in_it():
    pose = filled(np.array([0.1, 1 / 3, 2.0]), COVARIANCE, (0, 1, 2, None, None, None), 7.0)
    conversions.fill_pose(pose, np.array([0.5]), np.eye(1), (None, 0, None, None, None, None), 0.0)
    again = filled(np.array([0.5]), np.eye(1), (None, 0, None, None, None, None), 0.0)
    assert sent(pose) == sent(again)


def test_a_pose_of_nothing_estimated_is_the_origin_looking_along_x():
    pose = sent(filled(np.array([4.0]), np.eye(1), (None,) * 6, 2.5))
    assert pose.pose == Pose(orientation=Quaternion(w=1.0))
    assert_array_equal(np.array(pose.covariance).reshape(6, 6), 2.5 * np.eye(6))


@given(st.permutations([0, 1, 2, None, None, None]), st.integers(0, 100))
def test_mean_and_covariance_come_back_from_a_pose(axes, seed):
    rng = np.random.default_rng(seed)
    mean, A = rng.uniform(-1, 1, 3), rng.normal(size=(3, 3))
    covariance = A @ A.T
    pose = sent(filled(mean, covariance, axes, 5.0))
    found = conversions.gaussian_from_pose(pose, axes, np.full(3, 9.0), np.eye(3))
    assert_allclose(found[0], mean, rtol=0, atol=1e-12)
    assert_array_equal(found[1], covariance)


def test_states_that_a_pose_does_not_have_keep_what_they_were():
    pose = filled(np.array([1.0, 2.0]), COVARIANCE[:2, :2], (0, 1, None, None, None, None), 0.0)
    before = np.array([7.0, 8.0, 9.0]), np.diag([1.0, 2.0, 3.0]) + 0.5
    copies = [array.copy() for array in before]
    mean, covariance = conversions.gaussian_from_pose(pose, (0, 2, None, None, None, None),
                                                      *before)
    assert mean.tolist() == [1.0, 8.0, 2.0]
    # the state that stays, does not know of the new ones
    assert_array_equal(covariance, [[COVARIANCE[0, 0], 0.0, COVARIANCE[0, 1]],
                                    [0.0, 2.5, 0.0],
                                    [COVARIANCE[1, 0], 0.0, COVARIANCE[1, 1]]])
    for array, copy in zip(before, copies):
        assert_array_equal(array, copy)


HALF_TURN = st.floats(-3.14, 3.14)


@given(HALF_TURN, st.floats(-1.57, 1.57), HALF_TURN)
def test_angles_are_the_inverse_of_the_quaternion(roll, pitch, yaw):
    x, y, z, w = conversions.quaternion(roll, pitch, yaw)
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0, abs=1e-14)
    found = conversions.angles(Pose(orientation=Quaternion(x=x, y=y, z=z, w=w)))
    # near straight up, roll and yaw are hardly to be told apart
    assert_allclose(found, (roll, pitch, yaw), rtol=0, atol=1e-7 if abs(pitch) > 1.5 else 1e-12)


@pytest.mark.parametrize('length', [1e-300, 0.5, 2**0.5, 1e300])
@pytest.mark.parametrize('yaw', [0.0, 0.25, math.pi / 2, -3.0])
def test_the_angles_of_a_quaternion_of_any_length_are_those_of_its_direction(yaw, length):
    found = conversions.angles(Pose(orientation=Quaternion(
        z=length * math.sin(yaw / 2), w=length * math.cos(yaw / 2))))
    assert_allclose(found, (0.0, 0.0, yaw), rtol=0, atol=1e-12)


@pytest.mark.parametrize('sign', [-1, 1])
def test_who_looks_straight_up_or_down_has_a_pitch_however_that_is_rounded(sign):
    for a in np.nextafter(0.5**0.5, [0, 1]).tolist() + [0.5**0.5, 0.7071068, 0.70710677]:
        _, pitch, _ = conversions.angles(Pose(orientation=Quaternion(y=sign * a, w=a)))
        assert pitch == pytest.approx(sign * math.pi / 2, abs=1e-7)


NO_ROTATION = [(0.0, 0.0), (math.nan, 1.0), (math.inf, 0.0)]


@pytest.mark.parametrize(('z', 'w'), NO_ROTATION)
def test_what_is_no_rotation_has_no_angles(z, w):
    assert np.all(np.isnan(conversions.angles(Pose(orientation=Quaternion(z=z, w=w)))))


@pytest.mark.parametrize(('z', 'w'), NO_ROTATION)
def test_an_orientation_that_is_none_is_refused_only_where_a_state_is_an_angle(z, w):
    tracker = build_tracker(Config.from_parameters({
        'model.name': 'unicycle_2d', 'filter.type': 'ekf', 'grid.lower': [-9.0, -9.0, -3.0],
        'grid.upper': [9.0, 9.0, 3.0], 'grid.shape': [9, 9, 9], 'prior.mean': [0.0, 0.0, 0.5],
        'prior.covariance_diagonal': [1.0, 1.0, 0.1], 'measurements.main.sensor': 'position',
        'measurements.main.params.sigma': 0.3}))
    message = PoseWithCovarianceStamped(pose=filled(
        np.array([1.0, 2.0]), np.eye(2), (0, 1, None, None, None, None), 0.25))
    message.pose.pose.orientation = Quaternion(z=z, w=w)
    belief, _ = start_of(message, tracker, (0, 1, *[None] * 4), 'map', STAMP, 0)
    assert_allclose(belief.mean(), [1.0, 2.0, 0.5])
    with pytest.raises(Refused, match='^orientation: expected .*, got ') as refused:
        start_of(message, tracker, (0, 1, None, None, None, 2), 'map', STAMP, 0)
    assert refused.value.reason == 'not finite'
    message.pose.pose.orientation = Quaternion(z=1.0, w=1.0)
    belief, _ = start_of(message, tracker, (0, 1, None, None, None, 2), 'map', STAMP, 0)
    assert_allclose(belief.mean(), [1.0, 2.0, math.pi / 2])


@given(HALF_TURN, HALF_TURN, HALF_TURN)
def test_a_quaternion_turns_as_the_three_rotations_one_after_the_other(roll, pitch, yaw):
    def turn(axis, angle):
        R, (i, j) = np.eye(3), [k for k in range(3) if k != axis]
        s = math.sin(angle) * (-1 if axis == 1 else 1)
        R[i, i] = R[j, j] = math.cos(angle)
        R[i, j], R[j, i] = -s, s
        return R

    x, y, z, w = conversions.quaternion(roll, pitch, yaw)
    v = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])  # v a = (x, y, z) x a
    rotation = np.eye(3) + 2 * w * v + 2 * v @ v
    assert_allclose(rotation, turn(2, yaw) @ turn(1, pitch) @ turn(0, roll), rtol=0, atol=1e-12)


# Densities


def test_a_density_comes_with_the_coordinates_of_its_axes():
    grid = Grid((-1.0, 10.0, 0.0), (1.0, 16.0, 4.0), (4, 3, 2))
    belief = some_belief(grid)
    message = sent(conversions.density_message(belief, ['x', 'y', 'theta'], ['m', 'm', 'rad']))
    assert [dim.label for dim in message.layout.dim] == [
        'x first=-0.75 spacing=0.5 unit=m', 'y first=11.0 spacing=2.0 unit=m',
        'theta first=1.0 spacing=2.0 unit=rad']
    # as std_msgs/MultiArrayLayout has it: stride[i] is the product of size[i:]
    assert [(dim.size, dim.stride) for dim in message.layout.dim] == [(4, 24), (3, 6), (2, 2)]
    assert message.layout.data_offset == 0
    i, j, k = 3, 1, 0
    assert message.data[i * 6 + j * 2 + k] == pytest.approx(belief.density[i, j, k], rel=1e-15)


def test_a_density_without_units_has_the_unit_one():
    message = conversions.density_message(some_belief(Grid((0,), (1,), (4,))), ['x'], ())
    assert message.layout.dim[0].label.endswith(' unit=1')


@pytest.mark.parametrize('mass', [1.0, 0.125, 1e-200])
def test_a_density_is_scaled_to_mass_one_and_sent_bitwise(mass):
    belief = some_belief(Grid((0, 0), (3, 1), (7, 5)))
    lost = GridBelief(belief.grid, belief.density * mass)
    message = sent(conversions.density_message(lost, ['x', 'y'], ()))
    assert math.fsum(message.data) * 3 / 35 == pytest.approx(1.0, abs=1e-12)
    assert np.array(message.data).tobytes() == (lost.density / lost.mass).tobytes()


def test_a_density_that_is_a_transposed_view_is_sent_in_c_order():
    belief = some_belief(Grid((0, 0), (3, 1), (4, 5))).marginal([1, 0])
    message = sent(conversions.density_message(belief, ['y', 'x'], ()))
    assert_allclose(np.reshape(message.data, (5, 4)), belief.density, rtol=1e-14)


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3), st.integers(2, 9))
def test_the_label_gives_the_coordinates_exactly(low, width, cells):
    grid = Grid((low,), (low + width,), (cells,))
    label = conversions.density_message(some_belief(grid), ['x'], ()).layout.dim[0].label
    words = dict(word.split('=') for word in label.split()[1:])
    assert float(words['first']) == grid.axes[0][0]
    assert float(words['spacing']) == grid.spacing[0]


# Maps


def test_a_map_has_columns_of_x_and_rows_of_y():
    grid = Grid((-2.0, 5.0), (2.0, 11.0), (4, 6))
    density = np.zeros((4, 6))
    density[3, 1], density[0, 5] = 2.0, 1.0
    heard = sent(conversions.map_message(GridBelief(grid, density), STAMP, 'yard'))
    info = heard.info
    assert (info.width, info.height, info.resolution) == (4, 6, 1.0)
    assert (info.origin.position.x, info.origin.position.y) == (-2.0, 5.0)
    assert info.origin.orientation == Quaternion(w=1.0)
    assert conversions.stamp_to_ns(heard.header.stamp) == STAMP
    assert heard.header.frame_id == 'yard'
    expected = np.zeros((6, 4), dtype=int)
    expected[1, 3], expected[5, 0] = 100, 50
    assert_array_equal(np.reshape(heard.data, (6, 4)), expected)


@pytest.mark.parametrize(('upper', 'shape'), [
    ((4.0, 3.0), (4, 12)), ((4.0, 3.0), (8, 3)), ((1.0, 1.0), (5, 7)), ((2.0, 7.0), (3, 4))])
def test_a_map_of_unequal_spacings_shows_everything_where_it_is(upper, shape):
    grid = Grid((0.0, 0.0), upper, shape)
    belief = some_belief(grid)
    heard = sent(conversions.map_message(belief, STAMP, 'map'))
    info = heard.info
    assert info.resolution == pytest.approx(min(grid.spacing), rel=1e-6)
    shown = np.reshape(heard.data, (info.height, info.width))
    assert shown.max() == 100
    # the map ends within half of its cells of where the grid does
    assert abs(info.width * info.resolution - upper[0]) <= info.resolution / 2 + 1e-6
    assert abs(info.height * info.resolution - upper[1]) <= info.resolution / 2 + 1e-6
    x = np.arange(info.width) * info.resolution + info.resolution / 2
    y = np.arange(info.height) * info.resolution + info.resolution / 2
    share = np.rint(100 * belief.density / belief.density.max())
    for row, column in itertools.product(range(info.height), range(info.width)):
        i = min(int(x[column] / grid.spacing[0] + 1e-4), shape[0] - 1)
        j = min(int(y[row] / grid.spacing[1] + 1e-4), shape[1] - 1)
        assert shown[row, column] == share[i, j]


@pytest.mark.parametrize(('upper', 'shape'), [
    ((5000.0, 1.0), (100, 100)), ((1.0, 7e5), (50, 7)), ((1e9, 1.0), (3, 4)),
    ((3.0, 2.0), (3000, 2000)), ((1e30, 1e-5), (4, 4))])
def test_a_map_has_four_million_cells_at_most_of_the_mean_density(upper, shape):
    grid = Grid((0.0, 0.0), upper, shape)
    belief = some_belief(grid)
    tracemalloc.start()
    message = conversions.map_message(belief, STAMP, 'map')
    info, data = message.info, message.data
    assert tracemalloc.get_traced_memory()[1] < 400_000_000
    tracemalloc.stop()
    assert info.width * info.height == len(data) <= 4_000_000
    shown = np.reshape(data, (info.height, info.width))
    assert shown.max() == 100 and shown.min() >= 0
    # the mass left of a column, or below a row, is what is shown there
    for axis, count in ((0, info.width), (1, info.height)):
        mass = np.append(0.0, np.cumsum(belief.density.sum(axis=1 - axis)))
        places = np.linspace(0, count, 6).round()
        left = np.interp(places * info.resolution, np.linspace(0, upper[axis], shape[axis] + 1),
                         mass / mass[-1])
        of_the_map = np.append(0.0, np.cumsum(shown.sum(axis=axis, dtype=float)))
        assert_allclose(of_the_map[places.astype(int)] / of_the_map[-1], left / left[-1],
                        atol=0.03)
        # it ends within half of its cells of where the grid does
        assert abs(count * info.resolution - upper[axis]) <= max(
            info.resolution / 2, info.resolution - upper[axis]) * (1 + 1e-6)


def test_a_narrow_peak_is_seen_in_a_map_of_wider_cells():
    grid = Grid((0.0, 0.0), (3.0, 3.0), (3000, 3000))
    density = np.zeros((3000, 3000))
    density[1700, 401] = 1.0
    heard = conversions.map_message(GridBelief(grid, density), STAMP, 'map')
    assert np.flatnonzero(heard.data).tolist() == [200 * heard.info.width + 850]
    assert (heard.info.width, heard.info.height) == (1500, 1500)
    assert heard.info.resolution == pytest.approx(0.002)


def test_a_map_is_all_bytes_from_0_to_100():
    heard = sent(conversions.map_message(some_belief(Grid((0, 0), (5, 4), (50, 40))), 0, 'map'))
    assert isinstance(heard, OccupancyGrid)
    assert heard.data.typecode == 'b' and len(heard.data) == 2000
    assert min(heard.data) >= 0 and max(heard.data) == 100
