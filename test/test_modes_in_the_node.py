"""The modes that the node tells, whoever listens and whatever the filter."""

from geometry_msgs.msg import PoseWithCovarianceStamped
import numpy as np
from numpy.testing import assert_allclose
from pif_ros import mode_outputs
from pif_ros.config import build_tracker, Config
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Measurement
from pif_ros.mode_outputs import estimate
import pytest
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros import nanoseconds, Rig, SECOND, stamp_into
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from visualization_msgs.msg import Marker, MarkerArray

T = 1_000 * SECOND
MS = 1_000_000
#: A range from the middle of the lower edge leaves an arc, a second from there two places.
YARD = {
    'model.name': 'position_2d', 'model.params.diffusion': 0.1, 'frame_id': 'yard',
    'grid.lower': [-6.0, -6.0], 'grid.upper': [6.0, 6.0], 'grid.shape': [60, 60],
    'prior.type': 'uniform', 'kernel.time_step': 0.1, 'publish.rate': 0.0, 'modes.rate': 1000.0,
    'filter.particles': 4000, 'measurements.names': ['left', 'right']}
for side, x in (('left', -3.0), ('right', 3.0)):
    YARD.update({f'measurements.{side}.{key}': value for key, value in {
        'topic': side, 'type': 'sensor_msgs/msg/JointState', 'fields': ['position[0]'],
        'sensor': 'range', 'params.landmark': [x, 0.0], 'params.sigma': 0.3}.items()})
#: Both masts lie on the x axis: (1, 4) is seen from them as (1, -4) is.
SEEN = [(T, 'left', 32**0.5), (T + 100 * MS, 'right', 20**0.5)]
PLACES = [[1.0, -4.0], [1.0, 4.0]]


def ranged(stamp_ns, value):
    message = JointState(position=[value])
    stamp_into(message.header.stamp, stamp_ns)
    return message


def follow(rig, measurements=SEEN):
    """Measure, and wait after each for its pose."""
    for stamp_ns, source, value in measurements:
        rig.send(source, ranged(stamp_ns, value))
        rig.pose_at(stamp_ns)
    return rig.poses[-1]


def twin(measurements=SEEN, **more):
    """Return what the library believes."""
    tracker = build_tracker(Config.from_parameters({**YARD, **more}))
    for stamp_ns, source, value in measurements:
        assert tracker.observe(Measurement(stamp_ns, source, (value,))) is None
        tracker.estimate()
    return tracker.estimate().belief


def rows(message):
    return np.reshape(message.data, [dim.size for dim in message.layout.dim])


def listen(rig):
    modes, markers = [], []
    rig.hear(Float64MultiArray, f'{rig.name}/modes', modes)
    rig.hear(MarkerArray, f'{rig.name}/markers', markers)
    return modes, markers


def set_estimator(rig, name):
    client = rig.client(SetParameters, '/filter_node/set_parameters')
    [answer] = rig.graph.call(client, SetParameters.Request(parameters=[Parameter(
        name='pose.estimator', value=ParameterValue(
            type=ParameterType.PARAMETER_STRING, string_value=name))])).results
    assert answer.successful


@pytest.fixture
def unhurried(monkeypatch):
    """Let the modes take any share of the time, so that none are left out."""
    monkeypatch.setattr(mode_outputs, 'TAKE', 1e9)


@pytest.mark.usefixtures('unhurried')
@pytest.mark.parametrize('more', [
    {}, {'region.kind': 'active'}, {'filter.type': 'particle'}], ids=['full', 'active', 'cloud'])
def test_a_robot_and_its_ghost_are_two_modes_as_numbers_and_as_ellipses(graph, more):
    rig = Rig(graph, {**YARD, **more})
    modes, markers = listen(rig)
    follow(rig)
    graph.until(lambda: len(modes) == len(markers) == 2, 'modes and markers of both')
    found, belief = rows(modes[-1]), twin(**more)
    assert found.shape == (2, 1 + 2 + 4)
    assert found[0, 0] >= found[1, 0] and 0.99 < found[:, 0].sum() <= 1
    # the noise of the ranges is 0.3, and the humps are curved
    assert_allclose(found[np.argsort(found[:, 2]), 1:3], PLACES, atol=0.3)
    assert found.tolist() == [[m.mass, *m.mean, *m.covariance.ravel()] for m in belief.modes()]
    ellipses = [m for m in markers[-1].markers if m.type == Marker.CYLINDER
                and m.action == Marker.ADD]
    assert [[m.pose.position.x, m.pose.position.y] for m in ellipses] == found[:, 1:3].tolist()
    assert {m.header.frame_id for m in markers[-1].markers} == {'yard'}
    assert {nanoseconds(m.header.stamp) for m in markers[-1].markers} == {SEEN[-1][0]}
    assert rig.node.faults == 0


@pytest.mark.usefixtures('unhurried')
@pytest.mark.parametrize('kind', ['ekf', 'ukf', 'dfy', 'ekf_continuous'])
def test_a_filter_of_any_type_tells_its_modes(graph, kind):
    one = {'measurements.names': ['left'], 'filter.type': kind, 'prior.type': 'gaussian',
           'prior.mean': [1.0, 2.0], 'prior.covariance_diagonal': [1.0, 0.5],
           'measurements.left.sensor': 'range'}
    rig = Rig(graph, {**{k: v for k, v in YARD.items() if '.right.' not in k}, **one,
                      'pose.estimator': 'heaviest_mode'})
    modes, markers = listen(rig)
    pose = follow(rig, SEEN[:1])
    graph.until(lambda: modes and markers, 'modes and markers')
    heaviest = rows(modes[-1])[0]
    assert heaviest[0] > 0.5
    assert [pose.pose.pose.position.x, pose.pose.pose.position.y] == heaviest[1:3].tolist()
    assert np.reshape(pose.pose.covariance, (6, 6))[:2, :2].ravel().tolist() == \
        heaviest[3:].tolist()
    assert rig.node.faults == 0


@pytest.mark.usefixtures('unhurried')
def test_markers_of_modes_that_are_gone_are_deleted(graph):
    rig = Rig(graph, YARD)
    _, markers = listen(rig)
    follow(rig)
    graph.until(lambda: len(markers) == 2, 'markers of two')
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id = 'yard'
    stamp_into(pose.header.stamp, T + 200 * MS)
    pose.pose.pose.position.x, pose.pose.pose.position.y = PLACES[0]
    pose.pose.covariance[0] = pose.pose.covariance[7] = 0.3
    rig.send('initialpose', pose)
    graph.until(lambda: len(markers) == 3, 'markers of one')
    actions = {(m.ns, m.id): m.action for m in markers[-1].markers}
    assert actions == {('modes', 0): Marker.ADD, ('masses', 0): Marker.ADD,
                       ('modes', 1): Marker.DELETE, ('masses', 1): Marker.DELETE}


def test_each_estimator_brings_its_own_covariance_and_may_be_changed_while_running(graph):
    rig = Rig(graph, YARD)
    follow(rig, SEEN[:1])
    stamp_ns, found = T, {}
    for name in ('mean', 'mode', 'heaviest_mode'):
        set_estimator(rig, name)
        stamp_ns += 100 * MS
        pose = follow(rig, [(stamp_ns, 'right', 20**0.5)])
        belief = rig.node.tracker.estimate().belief
        point = [pose.pose.pose.position.x, pose.pose.pose.position.y]
        covariance = np.reshape(pose.pose.covariance, (6, 6))[:2, :2]
        found[name] = point, covariance
        if name == 'heaviest_mode':
            [mode, _] = belief.modes()
            assert point == mode.mean.tolist()
            assert covariance.tolist() == mode.covariance.tolist()
        else:
            assert point == getattr(belief, name)().tolist()
            assert_allclose(covariance, belief.covariance(about=point), rtol=1e-12)
    # between both places, on one of them as if the other were not, and of one of them alone
    (mean, C), (mode, D), (heaviest, E) = found.values()
    assert abs(mean[1]) < 0.5 and C[1, 1] == pytest.approx(16, rel=0.1)
    assert abs(mode[1]) == pytest.approx(4, abs=0.4) and D[1, 1] == pytest.approx(32, rel=0.2)
    assert abs(heaviest[1]) == pytest.approx(4, abs=0.3) and E[1, 1] < 0.3


def test_nobody_listens_and_no_mode_is_looked_for(graph, monkeypatch):
    looked = []
    monkeypatch.setattr(GridBelief, 'modes', lambda *_: looked.append(1))
    rig = Rig(graph, YARD)
    follow(rig)
    assert not looked and rig.node.faults == 0


@pytest.mark.usefixtures('unhurried')
@pytest.mark.parametrize('rate, count', [(0.0, 0), (1000.0, 6), (5.0, 3)])
def test_modes_go_out_as_often_as_their_rate_says_by_the_stamps(graph, rate, count):
    rig = Rig(graph, {**YARD, 'modes.rate': rate})
    modes, markers = listen(rig)
    follow(rig, [(T + k * 100 * MS, 'left', 5.0) for k in range(6)])
    graph.until(lambda: len(modes) >= count and len(markers) >= count, 'modes and markers')
    follow(rig, [(T + 510 * MS, 'right', 5.0)] if rate < 1000 else [])
    assert len(modes) == len(markers) == count


def test_a_state_on_a_line_is_drawn_along_x(graph):
    rig = Rig(graph, {
        'model.name': 'sine_cubic_drift', 'grid.lower': [-4.0], 'grid.upper': [4.0],
        'grid.shape': [80], 'prior.mean': [0.5], 'prior.covariance_diagonal': [0.2],
        'publish.rate': 0.0, 'measurements.main.topic': 'left',
        'measurements.main.type': 'sensor_msgs/msg/JointState',
        'measurements.main.fields': ['position']})
    modes, markers = listen(rig)
    follow(rig, [(T, 'left', 0.25)])
    graph.until(lambda: modes and markers, 'modes and markers')
    marker = markers[-1].markers[0]
    assert marker.pose.position.x == modes[-1].data[1] and marker.pose.position.y == 0.0
    assert marker.scale.x == pytest.approx(10 * marker.scale.y)


def test_where_neither_x_nor_y_is_estimated_there_are_no_markers(graph):
    rig = Rig(graph, {**YARD, 'pose.axes': ['', '', 'x', 'y']})
    modes = []
    rig.hear(Float64MultiArray, '/filter_node/modes', modes)
    follow(rig)
    graph.until(lambda: modes, 'modes')
    assert rig.peer.count_publishers('/filter_node/markers') == 0


def test_the_pose_of_the_heaviest_mode_has_the_moments_that_a_sum_over_its_half_has():
    belief = twin()
    point, covariance = estimate(belief, 'heaviest_mode', 0.95)
    w = belief.density.ravel() * (belief.grid.points[1] * np.sign(point[1]) > 0)
    w /= w.sum()
    mean = belief.grid.points @ w
    d = belief.grid.points - mean[:, None]
    # 1e-4 of the mass, which lies up to 4 away along the arcs, is left out
    assert_allclose(point, mean, atol=1e-3)
    assert_allclose(covariance, (d * w) @ d.T, atol=5e-3)
