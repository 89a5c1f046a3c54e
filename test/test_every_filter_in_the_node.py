"""Whatever filter.type: the node estimates what the library does, publishes it, and restarts."""

import dataclasses

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
import numpy as np
from numpy.testing import assert_allclose
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros import nanoseconds, Rig, SECOND, stamp_into
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Empty

T = 1_000 * SECOND
TYPES = ('df', 'dfy', 'particle', 'ekf', 'ekf_continuous', 'ukf')
PLANE = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [24, 20], 'prior.mean': [0.5, 0.0], 'prior.covariance_diagonal': [1.0, 0.5],
    'kernel.time_step': 0.05, 'publish.rate': 0.0, 'filter.particles': 2000, 'density.rate': 100.0,
    'measurements.main.topic': 'seen', 'measurements.main.type': 'sensor_msgs/msg/JointState',
    'measurements.main.fields': ['position'], 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.4}
SEEN = [(T + k * 130_000_000, 0.5 + 0.05 * k, 0.1 * k) for k in range(7)]


def message(stamp_ns, *values):
    seen = JointState(position=values)
    stamp_into(seen.header.stamp, stamp_ns)
    return seen


def follow(rig, measurements=SEEN):
    """Measure, and wait after each until it is accounted for."""
    for stamp_ns, *values in measurements:
        before = rig.node.accounts.sources['main'].received
        rig.send('seen', message(stamp_ns, *values))
        rig.handled(before + 1)
    return rig.pose_at(measurements[-1][0])


def bits(value):
    """Return all that a belief is made of, to the last bit."""
    if dataclasses.is_dataclass(value):
        return [bits(getattr(value, field.name)) for field in dataclasses.fields(value)]
    return value.tobytes() if isinstance(value, np.ndarray) else value


def library(kind, measurements=SEEN, **more):
    """Return what the library believes after some measurements."""
    tracker = build_tracker(Config.from_parameters({**PLANE, 'filter.type': kind, **more}))
    for stamp_ns, *values in measurements:
        assert tracker.observe(Measurement(stamp_ns, 'main', tuple(values))) is None
        tracker.estimate()
    return tracker.estimate()


@pytest.fixture(params=TYPES)
def rig(graph, request):
    made = Rig(graph, {**PLANE, 'filter.type': request.param})
    made.kind = request.param
    return made


def test_the_node_believes_to_the_bit_what_the_library_does_and_publishes_it(rig):
    densities, maps = [], []
    rig.hear(Float64MultiArray, '/filter_node/density', densities)
    rig.hear(OccupancyGrid, '/filter_node/density_map', maps,
             QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
    pose = follow(rig)
    expected = library(rig.kind)
    found = rig.node.tracker.estimate()
    assert bits(found.belief) == bits(expected.belief)
    assert found.total_log_evidence == expected.total_log_evidence
    assert nanoseconds(pose.header.stamp) == SEEN[-1][0]
    x, y = expected.belief.mean()
    assert (pose.pose.pose.position.x, pose.pose.pose.position.y) == (x, y)
    covariance = np.reshape(pose.pose.covariance, (6, 6))[:2, :2]
    assert_allclose(covariance, expected.belief.covariance(about=[x, y]), rtol=1e-12)
    rig.graph.until(lambda: densities and maps, 'a density and a map')
    assert [dim.size for dim in densities[-1].layout.dim] == [24, 20]
    assert np.sum(densities[-1].data) * (8 / 24) * (8 / 20) == pytest.approx(1.0, abs=1e-9)
    assert (maps[-1].info.width, max(maps[-1].data)) == (24, 100)
    assert rig.node.faults == 0 and rig.node.accounts.sources['main'].accepted == len(SEEN)


def test_a_late_measurement_is_put_where_it_belongs(rig):
    follow(rig, [SEEN[0], SEEN[1], SEEN[3], SEEN[4]])
    before = rig.node.accounts.sources['main'].accepted
    rig.send('seen', message(*SEEN[2]))
    rig.handled(before + 1)
    rig.graph.until(lambda: not rig.node.tracker.backlog, 'the replay')
    assert bits(rig.node.tracker.estimate().belief) == bits(
        library(rig.kind, SEEN[:5]).belief)


def test_it_restarts_from_a_pose_and_from_nothing(rig):
    follow(rig)
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id = 'map'
    # what was measured at the pose's stamp counts with it
    stamp_into(pose.header.stamp, SEEN[-1][0] + 1)
    pose.pose.pose.position.x, pose.pose.pose.position.y = -2.0, 3.0
    pose.pose.covariance[0], pose.pose.covariance[7] = 0.25, 0.36
    rig.send('initialpose', pose)
    rig.graph.until(lambda: rig.node.accounts.initial_pose.accepted == 1, 'the start')
    belief = rig.node.tracker.estimate().belief
    # the particles' own spread, 2000 of them
    assert_allclose(belief.mean(), [-2.0, 3.0], atol=0.06)
    assert_allclose(belief.covariance(), np.diag([0.25, 0.36]), atol=0.05)
    service = rig.client(Empty, '/reinitialize_global_localization')
    rig.graph.call(service, Empty.Request())
    belief = rig.node.tracker.estimate().belief
    assert_allclose(belief.mean(), [0.0, 1.0], atol=0.25)
    assert_allclose(np.diag(belief.covariance()), 8**2 / 12, rtol=0.1)


def test_a_far_measurement_is_told_as_an_outlier_by_its_own_noise(rig):
    follow(rig)
    stamp = SEEN[-1][0] + 100_000_000
    if rig.kind in ('dfy', 'ekf_continuous'):
        # a path that leaps: 0.1 s of its noise is 0.4 sqrt(0.1) = 0.13
        rig.send('seen', message(stamp, 30.0, 0.5))
    else:
        rig.send('seen', message(stamp, 25.0, 0.5))
    assert 'standard deviations' in rig.line('main', 'measurement')
    assert rig.node.accounts.sources['main'].outliers == 1
    assert rig.node.faults == 0


def test_particles_are_those_of_their_seed():
    one, same, other = (library('particle', **{'filter.seed': seed}).belief for seed in (1, 1, 2))
    assert one.points.tobytes() == same.points.tobytes() != other.points.tobytes()
