"""What goes in and out of the node: the one table of topics and services."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovariance, PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, qos_profile_services_default, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Empty, Trigger
from visualization_msgs.msg import MarkerArray


@dataclass(frozen=True, eq=False)
class Endpoint:
    """A topic or a service: its name, type and quality of service, and what it is for."""

    name: str
    type: Any  # noqa: A003
    says: str
    qos: QoSProfile = field(default_factory=lambda: qos_profile_services_default)

    @property
    def type_name(self) -> str:
        """Return the type as ROS writes it, such as std_msgs/msg/Float64MultiArray."""
        package, kind = self.type.__module__.split('.')[:2]
        return f'{package}/{kind}/{self.type.__name__}'


def _reliable(depth: int) -> QoSProfile:
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.RELIABLE)


def measurement_qos(depth: int) -> QoSProfile:
    """Return what every source is subscribed with: best effort matches every publisher."""
    return QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)


_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)

POSE = Endpoint('~/pose', PoseWithCovarianceStamped, 'after each correction, and predicted to now '
                'at `publish.rate` between measurements', _reliable(100))
POSE_UNSTAMPED = Endpoint('~/pose_unstamped', PoseWithCovariance, 'the same without header, where '
                          'someone listens', _reliable(100))
DENSITY = Endpoint('~/density', Float64MultiArray, 'the density over `density.axes`, at most at '
                   '`density.rate`, where someone listens; `layout.dim` names each axis with its '
                   'first coordinate, spacing and unit; the sum times the cell volume is 1',
                   _reliable(1))
DENSITY_MAP = Endpoint('~/density_map', OccupancyGrid, 'the marginal over x and y of the pose, '
                       'for RViz and Foxglove: 100 in the densest cell; 4 million cells at most',
                       _LATCHED)
MODES = Endpoint('~/modes', Float64MultiArray, 'one row for each hump of the density, heaviest '
                 'first: its mass, mean and covariance, 32 at most; at most at `modes.rate`, '
                 'where someone listens; `layout.dim` says what is where', _reliable(10))
MARKERS = Endpoint('~/markers', MarkerArray, 'the same for RViz and Foxglove, where x or y of the '
                   'pose is estimated: an ellipse that holds 95 % of a Gaussian (2.45 sigma), and '
                   'its mass', _reliable(10))
DIAGNOSTICS = Endpoint('/diagnostics', DiagnosticArray, 'once a second: the belief (mass, what '
                       'was dropped as negligible, cells, standard deviations) and what became of '
                       "every source's messages", _reliable(10))
PUBLICATIONS = (POSE, POSE_UNSTAMPED, DENSITY, DENSITY_MAP, MODES, MARKERS, DIAGNOSTICS)

INITIAL_POSE = Endpoint('initialpose', PoseWithCovarianceStamped, 'restarts the belief there; '
                        'what was measured from its stamp on, within `time.history`, still '
                        "counts; RViz's 2D Pose Estimate", _reliable(10))
SUBSCRIPTIONS = (INITIAL_POSE,)

RESET = Endpoint('~/reset', Trigger, 'back to the prior; it holds at the next measurement')
GLOBAL = Endpoint('reinitialize_global_localization', Empty, 'uniform over the grid, as nav2 asks '
                  'for it')
SAVE = Endpoint('~/save_state', Trigger, 'saves the state to `state_file` now')
LOAD = Endpoint('~/load_state', Trigger, 'goes on from `state_file`; what is no state of this '
                'filter is refused in a line, and nothing is touched')
SERVICES = (RESET, GLOBAL, SAVE, LOAD)
