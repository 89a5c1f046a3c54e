"""A node that does nothing but answer each point with a pose of the same stamp."""

from __future__ import annotations

from benchmarks.echo import QUEUE_LENGTH, serve
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from pif_ros import interface
from rclpy.node import Node


class EmptyNode(Node):
    """Takes points and gives poses as the filter's node does, and has nothing to work on."""

    def __init__(self) -> None:
        super().__init__('empty_node')
        self._pose = self.create_publisher(
            PoseWithCovarianceStamped, interface.POSE.name, interface.POSE.qos)
        self.create_subscription(PointStamped, 'fix', self._on_point,
                                 interface.measurement_qos(QUEUE_LENGTH))

    def _on_point(self, message: PointStamped) -> None:
        self._pose.publish(PoseWithCovarianceStamped(header=message.header))


if __name__ == '__main__':
    serve(EmptyNode)
