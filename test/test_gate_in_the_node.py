"""A gate in the node: what it rejects is counted and told, and it never locks the filter out."""

from geometry_msgs.msg import PointStamped
from numpy.testing import assert_allclose
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from ros import PLANE, Rig, SECOND, stamp_into

T, MS = 1_000 * SECOND, 1_000_000
GATED = {**PLANE, 'measurements.main.gate.tail_probability': 1e-4}
SURE = [(T + k * MS, 0.5, -0.5) for k in range(20)]


def message_of(measurement):
    """Return the message of a stamp and a position."""
    message = PointStamped()
    stamp_into(message.header.stamp, measurement[0])
    message.point.x, message.point.y = measurement[1:]
    return message


def follow(rig, measurements):
    """Measure, and wait after each until it is accounted for and a pose has its stamp."""
    for stamp_ns, x, y in measurements:
        account = rig.node.accounts.sources['main']
        before = account.received
        rig.send('fix', message_of((stamp_ns, x, y)))
        rig.handled(before + 1)
        rig.pose_at(stamp_ns)
        assert account.received == account.accepted + account.rejected.total() + account.dropped


def library(measurements):
    """Return the library's estimate after some measurements."""
    tracker = build_tracker(Config.from_parameters(GATED))
    for stamp_ns, *values in measurements:
        tracker.observe(Measurement(stamp_ns, 'main', tuple(values)))
    return tracker.estimate()


def check_same(rig, measurements):
    """Check that the node believes, to the last bit, what the library does."""
    assert (rig.node.tracker.estimate().belief.density.tobytes()
            == library(measurements).belief.density.tobytes())


def test_an_outlier_is_rejected_by_its_gate_counted_and_told(graph):
    rig = Rig(graph, GATED)
    outlier = (T + 30 * MS, 2.5, 3.0)
    follow(rig, [*SURE, outlier])
    rig.line('main', 'rejected', 'as little expected')
    account = rig.node.accounts.sources['main']
    assert (account.accepted, account.rejected['gate'], account.outliers) == (20, 1, 0)
    check_same(rig, [*SURE, outlier])


def test_a_robot_that_was_carried_away_is_found_again(graph):
    rig = Rig(graph, GATED)
    moved = [(T + (30 + k) * MS, -2.0, 2.5) for k in range(12)]
    follow(rig, [*SURE, *moved])
    rig.line('another one was mixed in')
    account = rig.node.accounts.sources['main']
    # four are rejected, and the fifth in a row opens the gate
    assert (account.accepted, account.rejected['gate']) == (28, 4)
    assert_allclose(rig.node.tracker.estimate().belief.mean(), [-2.0, 2.5], atol=0.2)
    watch = rig.node.tracker.newest.watch
    assert watch.recoveries == 1 and not watch.lost
    check_same(rig, [*SURE, *moved])


def test_a_late_measurement_makes_the_accounts_think_better_of_what_came_after_it(graph):
    rig = Rig(graph, GATED)
    moved = [(T + (30 + k) * MS, -2.0, 2.5) for k in range(4)]
    follow(rig, [*SURE, *moved])
    account = rig.node.accounts.sources['main']
    assert account.rejected['gate'] == 4
    late = (T + 25 * MS, -2.0, 2.5)
    rig.send('fix', message_of(late))
    rig.handled(25)
    # now the fifth in a row is the one that came last but one
    graph.until(lambda: not rig.node.inbox.has_work, 'the replay')
    assert (account.accepted, account.rejected['gate']) == (21, 4)
    check_same(rig, [*SURE, late, *moved])
