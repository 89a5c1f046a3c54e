"""A node that does nothing but answer each point with a pose of the same stamp."""

from __future__ import annotations

from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
from pif_ros import interface
from pif_ros.process import Signals
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions


def main() -> None:
    """Run until SIGINT or SIGTERM, in the loop of the filter's node."""
    stopped = Signals()
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node, executor = rclpy.create_node('empty_node'), SingleThreadedExecutor()
    publisher = node.create_publisher(
        PoseWithCovarianceStamped, interface.POSE.name, interface.POSE.qos)

    def answer(message: PointStamped) -> None:
        publisher.publish(PoseWithCovarianceStamped(header=message.header))

    node.create_subscription(PointStamped, 'fix', answer, interface.measurement_qos(1000))
    executor.add_node(node)
    while not stopped():
        executor.spin_once(timeout_sec=0.1)
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
