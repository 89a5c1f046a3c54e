"""A node that answers each measurement with a pose and does nothing in between."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from pif_ros import interface
from pif_ros.process import Signals
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

QUEUE_LENGTH = 1000


class Echo(Node):
    """Takes and gives what the filter's node does, with the same quality of service."""

    def __init__(self) -> None:
        super().__init__('filter_node')
        self._pose = self.create_publisher(
            PoseWithCovarianceStamped, interface.POSE.name, interface.POSE.qos)
        self.create_subscription(Float64MultiArray, 'measurement', self._on_measurement,
                                 interface.measurement_qos(QUEUE_LENGTH))

    def _on_measurement(self, msg: Float64MultiArray) -> None:
        pose = PoseWithCovarianceStamped()
        pose.header.stamp = self.get_clock().now().to_msg()
        pose.header.frame_id = 'map'
        pose.pose.pose.position.x, pose.pose.pose.position.y = msg.data[:2]
        self._pose.publish(pose)


def serve(make: Callable[[], Node]) -> None:
    """Run a node until SIGINT or SIGTERM, in the loop of the filter's node."""
    stopped = Signals()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()
    executor.add_node(make())
    while not stopped():
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == '__main__':
    serve(Echo)
