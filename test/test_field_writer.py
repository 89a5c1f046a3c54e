"""Numbers into messages: what a field_reader reads of them then."""

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from pif_ros.fields import field_reader, field_writer, message_class
import pytest
from rclpy.serialization import deserialize_message, serialize_message


@pytest.mark.parametrize('name, fields, values', [
    ('std_msgs/msg/Float64MultiArray', [], (1.5, -2.0, 1e-300)),
    ('std_msgs/msg/Float64', ['data'], (0.1,)),
    ('sensor_msgs/msg/JointState', ['position'], (1.5, 2.0)),
    ('sensor_msgs/msg/JointState', ['velocity[0]', 'position'], (9.0, 1.5, 2.0)),
    ('sensor_msgs/msg/LaserScan', ['ranges[2]', 'ranges[0]', 'angle_min'], (1.0, 2.0, 0.5)),
    ('sensor_msgs/msg/LaserScan', ['ranges', 'angle_min'], (1.0, 2.0, 0.5)),
    ('geometry_msgs/msg/PointStamped', ['point.z', 'point.x'], (3.0, 1.0)),
    ('geometry_msgs/msg/PoseWithCovarianceStamped', ['pose.covariance[7]'], (4.0,)),
    ('geometry_msgs/msg/PoseWithCovarianceStamped', ['pose.pose.position.y', 'pose.covariance'],
     tuple(map(float, range(37)))),
    ('std_msgs/msg/UInt8MultiArray', ['data'], (3.0, 255.0)),
    ('std_msgs/msg/Int32', ['data'], (-7.0,)),
], ids=str)
def test_what_is_written_is_read_again(name, fields, values):
    kind = message_class(name)
    message = kind()
    field_writer(kind, fields, len(values))(message, values)
    heard = deserialize_message(serialize_message(message), kind)
    assert field_reader(kind, fields)(heard) == values


@pytest.mark.parametrize(('name', 'fields', 'good', 'bad'), [
    ('std_msgs/msg/UInt8', [], (255.4, -0.4), (255.6, -0.6, 1e300, float('nan'))),
    ('std_msgs/msg/Int8MultiArray', [], (127.0, -128.0), (128.0, -129.0, float('inf'))),
    ('std_msgs/msg/UInt64', [], (1e19, 0.0), (1.9e19, -1.0)),
    ('std_msgs/msg/Int64', ['data'], (-2.0**63, 9e18), (2.0**63, -1e19)),
    ('sensor_msgs/msg/LaserScan', ['ranges[2]'], (3.4e38, -3.4e38), (3.5e38, -3.5e38)),
    ('std_msgs/msg/Float64', [], (1e308, float('nan'), float('inf')), ()),
    ('sensor_msgs/msg/Range', ['range'], (0.1, 3.4e38, float('-inf'), float('nan')), (1e39,))])
def test_a_number_that_its_field_cannot_hold_is_refused_by_the_name_of_the_field(
        name, fields, good, bad):
    kind = message_class(name)
    write, message = field_writer(kind, fields, 1), kind()
    for value in good:
        write(message, [value])
        serialize_message(message)
    for value in bad:
        path = (fields or ['data'])[0].replace('[', r'\[')
        with pytest.raises(ValueError, match=f"^expected numbers from .* for '{path}' .*, got "):
            write(message, [value])


def test_nothing_else_is_written():
    message = PoseWithCovarianceStamped()
    message.pose.covariance[0] = 2.0
    field_writer(PoseWithCovarianceStamped, ['pose.covariance[7]'], 1)(message, [3.0])
    assert message.pose.covariance.tolist() == [2.0] + [0.0] * 6 + [3.0] + [0.0] * 28


@pytest.mark.parametrize('name, fields, size, wanted', [
    ('geometry_msgs/msg/PointStamped', ['point.x'], 2, 'fields that hold 2 numbers'),
    ('geometry_msgs/msg/PointStamped', ['point.x', 'point.y'], 1, 'fields that hold 1 numbers'),
    ('sensor_msgs/msg/JointState', ['position', 'velocity'], 3, 'fields that hold 3 numbers'),
    ('geometry_msgs/msg/PoseArray', ['poses[0].position.x'], 1, 'an index at the end of a path'),
    ('std_msgs/msg/Bool', ['data'], 1, 'fields of real or whole numbers'),
    ('std_msgs/msg/ByteMultiArray', ['data'], 1, 'fields of real or whole numbers'),
    ('sensor_msgs/msg/Range', ['rang'], 1, 'fields out of'),
])
def test_fields_that_cannot_hold_just_so_many_numbers_are_refused(name, fields, size, wanted):
    with pytest.raises(ValueError, match=f'^expected {wanted}.* got') as refused:
        field_writer(message_class(name), fields, size)
    assert '\n' not in str(refused.value)


@pytest.mark.parametrize('kind', [f'{sign}Int{bits}' for sign in ('', 'U')
                                  for bits in (8, 16, 32, 64)])
def test_a_whole_number_is_written_up_to_the_ends_of_its_kind(kind):
    message, ends = message_class(f'std_msgs/msg/{kind}'), np.iinfo(kind.lower())
    write = field_writer(message, ['data'], 1)
    for value in (ends.min, ends.max):
        made = message()
        write(made, [value])
        assert made.data == value
    for value in (ends.min - 1, ends.max + 1):
        with pytest.raises(ValueError, match='^expected numbers from .* got'):
            write(message(), [value])
