"""Whether a message says of itself that its numbers are worth nothing."""

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from pif_ros.fields import check_count, covariances, doubter, ranger
import pytest
from sensor_msgs.msg import Imu, JointState, NavSatFix, Range

POSE = ['pose.pose.position.x', 'pose.pose.position.y']


@pytest.mark.parametrize('made, paths, field', [
    (PoseWithCovarianceStamped, POSE, 'pose.covariance'),
    (Imu, ['angular_velocity.z'], 'angular_velocity_covariance'),
    (Imu, ['linear_acceleration.x'], 'linear_acceleration_covariance'),
    (NavSatFix, ['latitude', 'longitude'], 'position_covariance')])
@pytest.mark.parametrize('bad', [float('nan'), float('inf'), -1.0])
def test_a_covariance_that_is_none_is_told_by_its_place(made, paths, field, bad):
    wrong, message = doubter(made, paths), made()
    assert wrong(message) == ''
    holder, *_, name = [message, *field.split('.')]
    for part in field.split('.')[:-1]:
        holder = getattr(holder, part)
    getattr(holder, name)[0] = bad
    assert wrong(message).startswith(f'{field}: expected finite numbers and no variance below 0')


@pytest.mark.parametrize('index, bad', [(7, -0.1), (35, float('nan')), (1, float('inf'))])
def test_every_variance_counts_and_of_the_rest_that_it_is_a_number(index, bad):
    wrong, message = doubter(PoseWithCovarianceStamped, POSE), PoseWithCovarianceStamped()
    message.pose.covariance[1] = message.pose.covariance[6] = -0.5
    assert wrong(message) == ''
    message.pose.covariance[index] = bad
    assert wrong(message)


@pytest.mark.parametrize('made, paths', [
    (PointStamped, ['point.x']), (JointState, ['position']), (Imu, ['orientation_covariance']),
    (PoseWithCovarianceStamped, ['pose.covariance[7]'])])
def test_what_has_no_covariance_or_is_one_is_not_doubted(made, paths):
    message = made()
    if made is Imu:
        message.orientation_covariance[0] = -1.0
    if made is PoseWithCovarianceStamped:
        message.pose.covariance[0] = -1.0
    assert doubter(made, paths)(message) == ''


def test_the_covariance_of_another_part_of_the_message_does_not_matter():
    message = Imu()
    message.orientation_covariance[0] = -1.0
    assert doubter(Imu, ['angular_velocity.z'])(message) == ''


def of_another_package(**fields):
    """Return a class of messages called Range, with some fields."""
    return type('Range', (), {
        '__init__': lambda self, **values: self.__dict__.update(values),
        'get_fields_and_field_types': classmethod(lambda cls: fields)})


@pytest.mark.parametrize(('fields', 'told'), [
    ({'range': 'float'}, False), ({'range': 'float', 'min_range': 'float'}, False),
    ({'range': 'float', 'min_range': 'float', 'max_range': 'float'}, True)])
def test_a_range_is_held_to_its_limits_where_it_has_some(fields, told):
    message = of_another_package(**fields)
    beyond = ranger(message, ['range'])
    assert bool(beyond(message(range=9.0, min_range=0.1, max_range=4.0))) is told
    assert not beyond(message(range=3.0, min_range=0.1, max_range=4.0))


@pytest.mark.parametrize(('value', 'is_beyond'), [(0.0, False), (1e9, False), (-1e-9, True)])
def test_without_limits_a_range_is_not_below_0(value, is_beyond):
    message = Range(min_range=0.0, max_range=0.0, range=value)
    assert bool(ranger(Range, ['range'])(message)) is is_beyond


@pytest.mark.parametrize('other', [{'weights': 'double[9]'}, {'place_covariance': 'string'}])
def test_only_numbers_that_are_called_so_are_a_covariance(other):
    assert covariances(of_another_package(place='double', **other), ['place']) == ()


@pytest.mark.parametrize('size', [0, 1, 3, 4])
def test_a_bounded_array_holds_no_more_than_it_may(size):
    message = of_another_package(sides='sequence<double, 3>')
    if size <= 3:
        check_count(message, ['sides'], size)
    else:
        with pytest.raises(ValueError, match='^expected fields that hold 4 numbers, got'):
            check_count(message, ['sides'], size)
