"""The executable filter_node."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from pif_ros.process import explain, failed, logs_to_stdout, Signals, strangers


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node until SIGINT or SIGTERM, and return its exit status.

    0: told to stop; 2: parameters that make no filter, named in one line on stderr.
    """
    stopped = Signals()
    logs_to_stdout()
    arguments = list(sys.argv if args is None else args)

    # imported here, so that a signal during the half second that this takes is not lost
    from pif_ros.config import ConfigError
    from pif_ros.filter_node import FilterNode
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: B902  RCLError has no public name
        return failed('filter_node', explain(error, arguments), 2)
    try:
        node = FilterNode()
        if not node.told and (line := strangers(arguments, node.get_fully_qualified_name())):
            raise ConfigError(line)
    except ConfigError as error:
        rclpy.try_shutdown()
        return failed('filter_node', str(error), 2)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stopped():
        try:
            executor.spin_once(timeout_sec=0.1)
        except Exception as error:  # noqa: B902  a peer's request can make rclpy itself raise
            node.report('rclpy', f'rclpy: {type(error).__name__}: {error}')
    node.drain()
    node.get_logger().info(f'stopped; {node.accounts}')
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
