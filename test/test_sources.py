"""From a message to a measurement, or to the reason why it is none."""

from geometry_msgs.msg import PointStamped
import numpy as np
from pif_ros.config import ConfigError, ControlConfig, SourceConfig
from pif_ros.core.estimates import Measurement
from pif_ros.core.models import Sensor
from pif_ros.sources import Control, ControlSource, Refused, Source
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState, LaserScan, Range
from std_msgs.msg import Float64MultiArray, UInt8MultiArray

NOW = 1_000_000_000_000
BOTH = Sensor(lambda x, t: x[:2], np.eye(2))
ONE = Sensor(lambda x, t: x[:1], np.eye(1))


def source(kind, *fields, sensor=BOTH, max_ahead=1.0):
    """Return a source of messages of a type."""
    return Source('main', SourceConfig('seen', kind, fields), sensor, max_ahead)


def joints(*position, stamp_ns=NOW):
    """Return a message with a header and any number of values."""
    message = JointState(position=position)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    return message


JOINTS = source('sensor_msgs/msg/JointState', 'position')


def reason(message, of=JOINTS, now=NOW):
    """Return why a message is refused, and the sentence."""
    with pytest.raises(Refused) as refused:
        of.item(message, now)
    return refused.value.reason, str(refused.value)


def test_a_message_without_a_header_is_measured_at_its_arrival():
    plain = source('std_msgs/msg/Float64MultiArray')
    assert plain.item(Float64MultiArray(data=[1.5, -2.0]), NOW) == Measurement(
        NOW, 'main', (1.5, -2.0))


def test_a_message_with_a_header_is_measured_at_its_stamp():
    stamp = NOW - 123_456_789
    assert JOINTS.item(joints(0.25, 3.0, stamp_ns=stamp), NOW) == Measurement(
        stamp, 'main', (0.25, 3.0))


def test_a_stamp_with_more_than_a_second_of_nanoseconds_carries():
    message = joints(0.0, 0.0)
    message.header.stamp.sec, message.header.stamp.nanosec = 10, 2_500_000_000
    assert JOINTS.item(message, NOW).stamp_ns == 12_500_000_000


def test_a_measurement_is_made_of_several_fields_in_the_order_given():
    message = PointStamped()
    message.header.stamp.sec = 7
    message.point.x, message.point.y, message.point.z = 1.0, 2.0, 3.0
    flipped = source('geometry_msgs/msg/PointStamped', 'point.z', 'point.x')
    assert flipped.item(message, NOW).values == (3.0, 1.0)


def test_a_single_precision_value_is_measured_as_it_is():
    message = Range(range=0.1)
    message.header.stamp.sec = 7
    heard = deserialize_message(serialize_message(message), Range)
    seen = source('sensor_msgs/msg/Range', 'range', sensor=ONE).item(heard, NOW)
    assert seen.values == (float(np.float32(0.1)),)


def test_bytes_are_numbers():
    octets = source('std_msgs/msg/UInt8MultiArray')
    assert octets.item(UInt8MultiArray(data=[3, 255]), NOW).values == (3.0, 255.0)


@pytest.mark.parametrize('values', [(), (1.0,), (1.0, 2.0, 3.0)], ids=len)
def test_a_wrong_length_is_refused(values):
    why, sentence = reason(joints(*values))
    assert why == 'wrong length'
    assert sentence == f'expected 2 numbers, got {len(values)}'


def test_an_array_that_is_too_short_for_its_field_is_refused():
    scan = source('sensor_msgs/msg/LaserScan', 'ranges[0]', 'ranges[3]')
    message = LaserScan(ranges=[1.0, 2.0, 3.0])
    message.header.stamp.sec = 7
    why, sentence = reason(message, scan)
    assert why == 'wrong length' and 'too short' in sentence
    message.ranges.append(4.0)
    assert scan.item(message, NOW).values == (1.0, 4.0)


@pytest.mark.parametrize('value', [float('nan'), float('inf'), -float('inf')])
def test_a_value_that_is_not_finite_is_refused_and_shown(value):
    why, sentence = reason(joints(1.0, value))
    assert why == 'not finite'
    assert sentence == f'expected finite numbers, got [1.0, {value!r}]'


@pytest.mark.parametrize('stamp_ns', [0, -1, -5_000_000_000])
def test_a_stamp_that_is_none_is_refused(stamp_ns):
    assert reason(joints(1.0, 2.0, stamp_ns=stamp_ns))[0] == 'no stamp'
    assert JOINTS.item(joints(1.0, 2.0, stamp_ns=1), NOW).stamp_ns == 1


def test_a_stamp_may_be_ahead_of_the_clock_by_so_much_and_no_more():
    ahead = source('sensor_msgs/msg/JointState', 'position', max_ahead=0.25)
    assert ahead.item(joints(1.0, 2.0, stamp_ns=NOW + 250_000_000), NOW)
    why, sentence = reason(joints(1.0, 2.0, stamp_ns=NOW + 251_000_000), ahead)
    assert why == 'from the future' and 'time.max_ahead' in sentence
    assert sentence.endswith('got one 0.251 s after it')
    assert reason(joints(1.0, 2.0, stamp_ns=NOW + 250_000_001), ahead)[0] == why


def test_before_there_is_a_clock_everything_is_refused():
    assert reason(joints(1.0, 2.0), now=None)[0] == 'no clock'


@pytest.mark.parametrize(('numbers', 'publishers', 'lost'), [
    # who is there is asked only where something is missing
    ((5, 6, 7), (None, None, None), (0, 0, 0)), ((5, 9, 10), (None, 1, None), (0, 3, 0)),
    ((5, None, 9), (None, None, None), (0, 0, 0)),
    # another one with the same count, or a smaller one, has left before it was heard
    ((5, 5, 6, 9), (None, 1, 1, 1), (0, 0, 0, 2)), ((5, 2, 3, 9), (None, 1, 1, 1), (0, 0, 0, 5)),
    # as long as there are two nothing can be said
    ((5, 9, 12, 20), (None, 2, 1, 1), (0, 0, 0, 7))])
def test_what_is_missing_in_a_publisher_s_count_was_lost(numbers, publishers, lost):
    heard = source('sensor_msgs/msg/JointState', 'position')
    assert tuple(heard.lost(number, {None: None, 1: lambda: 1, 2: lambda: 2}[there])
                 for number, there in zip(numbers, publishers)) == lost


def test_a_type_that_is_not_installed_is_blamed_on_the_type():
    with pytest.raises(ConfigError, match=r'^measurements\.main\.type: expected .* got '
                                          r"'no_such_msgs/msg/Thing'$"):
        source('no_such_msgs/msg/Thing')


def test_fields_that_a_type_has_not_are_blamed_on_the_fields():
    with pytest.raises(ConfigError, match=r'^measurements\.main\.fields: expected .*position.*, '
                                          r"got 'positon'$"):
        source('sensor_msgs/msg/JointState', 'positon')


def test_a_message_without_a_header_holds_when_it_arrived_not_when_it_was_read():
    plain = source('std_msgs/msg/Float64MultiArray')
    message = Float64MultiArray(data=[1.0, 2.0])
    assert plain.item(message, NOW, NOW - 3_000_000_000).stamp_ns == NOW - 3_000_000_000
    # a clock that was set back in between does not make a stamp from the future
    assert plain.item(message, NOW, NOW + 5).stamp_ns == NOW


@pytest.mark.parametrize('low, high, value, good', [
    (0.0, 0.0, 3.0, True), (0.0, 0.0, -1.0, False), (0.5, 10.0, 0.4, False),
    (0.5, 10.0, 10.5, False), (0.5, 10.0, 10.0, True), (0.0, 10.0, -1.0, False)])
def test_a_range_that_saw_nothing_is_no_measurement(low, high, value, good):
    echo = source('sensor_msgs/msg/Range', 'range', sensor=Sensor(lambda x, t: x, [[1.0]]))
    message = Range(min_range=low, max_range=high, range=value)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(NOW, 10**9)
    if good:
        assert echo.item(message, NOW).values == (value,)
    else:
        why, sentence = reason(message, echo)
        assert why == 'out of range' and f'{value:g}' in sentence


@pytest.mark.parametrize('low, high, values, bad', [
    (0.5, 10.0, (0.5, 10.0), None), (0.5, 10.0, (3.0, 10.5), 10.5), (0.5, 10.0, (0.4, 3.0), 0.4),
    (0.0, 0.0, (3.0, 4.0), None), (0.0, 0.0, (3.0, -1.0), -1.0)])
@pytest.mark.parametrize('paths', [('ranges',), ('ranges[0]', 'ranges[1]')], ids=len)
def test_a_beam_of_a_scan_that_saw_nothing_is_no_measurement(paths, low, high, values, bad):
    scan, message = source('sensor_msgs/msg/LaserScan', *paths), LaserScan(
        range_min=low, range_max=high, ranges=values)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(NOW, 10**9)
    if bad is None:
        assert scan.item(message, NOW).values == values
    else:
        assert reason(message, scan) == (
            'out of range', f'expected a range from {low:g} to {high:g}, got {bad:g}')


def test_a_beam_that_is_not_read_may_have_seen_nothing():
    scan, message = source('sensor_msgs/msg/LaserScan', 'ranges[1]', sensor=ONE), LaserScan(
        range_min=0.5, range_max=10.0, ranges=[99.0, 3.0, 0.0])
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(NOW, 10**9)
    assert scan.item(message, NOW).values == (3.0,)


def test_a_control_is_asked_at_its_time_in_seconds_whether_a_step_can_follow_it():
    asked = []
    drive = ControlSource(ControlConfig('drive', 'sensor_msgs/msg/JointState', ('velocity',)),
                          ('v', 'omega'), 1.0,
                          lambda *given: asked.append(given) or len(asked) > 1)
    message = JointState(velocity=(1.5, 0.2))
    message.header.stamp.sec, message.header.stamp.nanosec = 999, 250_000_000
    assert drive.item(message, NOW) == Control(999_250_000_000, (1.5, 0.2))
    assert asked == [((1.5, 0.2), 999.25)]
    assert reason(message, drive)[0] == 'too fast'
