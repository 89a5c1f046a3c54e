"""What a node, and a bank of them, must not do where it begins anew, ends, or looks ahead."""

from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
import pytest
from ros import PLANE, SECOND
from test_accounts_in_the_node import answer, HERE, put, steer, work
from test_filter_node import MS, T
from test_state_in_the_node import YARD

#: A robot just inside the edge of its yard.
EDGE = {**YARD, 'filter.type': 'df', 'publish.rate': 0.0,
        'control.hold': 30.0, 'prior.mean': [7.0, 0.0, 0.0],
        'prior.covariance_diagonal': [0.05, 0.05, 0.001], 'model.params.sigma_position': 0.05}


def told(node):
    """Return the stamps of all poses, and the kinds of all lines, that a node tells from now."""
    poses, lines, publish, report = [], [], node._outputs.publish, node.report
    node._outputs.publish = lambda belief, stamp_ns: (poses.append(stamp_ns),
                                                      publish(belief, stamp_ns))
    node.report = lambda kind, text: (lines.append(kind), report(kind, text))
    return poses, lines


def test_a_forecast_off_the_grid_is_not_published_and_takes_nothing_from_the_belief(graph):
    node, tracker = graph.filter_node(EDGE), build_tracker(Config.from_parameters(EDGE))
    poses, lines = told(node)
    for target in (T, T + 500 * MS):
        steer(node, target, (2.0 if target == T else 0.0, 0.0))
        put(node, target, (7.0, 0.0))
        work(node)
        if target == T:
            node.tell(node.tracker.forecast(T + 100 * MS))
            node.tell(node.tracker.forecast(T + 4 * SECOND))
    tracker.control(T, (2.0, 0.0))
    tracker.control(T + 500 * MS, (0.0, 0.0))
    for stamp_ns in (T, T + 500 * MS):
        tracker.observe(Measurement(stamp_ns, 'main', (7.0, 0.0)))
    assert (poses, lines) == ([T, T + 100 * MS, T + 500 * MS], ['forecast'])
    assert node.restarts == 0
    assert (node.tracker.estimate().belief.mean() == tracker.estimate().belief.mean()).all()


def test_a_belief_that_has_left_the_grid_where_it_was_measured_begins_anew(graph):
    node = graph.filter_node(EDGE)
    poses, lines = told(node)
    steer(node, T, (2.0, 0.0))
    for stamp_ns in (T, T + 4 * SECOND):
        put(node, stamp_ns, (7.0, 0.0))
        work(node)
    assert (poses, node.restarts, node.tracker.stamp_ns) == ([T], 1, None)
    assert 'off the grid' in lines
