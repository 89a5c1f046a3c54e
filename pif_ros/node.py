"""The executable filter_node."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import sys
from typing import Any

from pif_ros.process import (asks_for_help, explain, failed, logs_to_stdout, Signals,
                             strangers, take_down, usage)


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the node until SIGINT or SIGTERM, and return its exit status.

    0: told to stop, or how to use it; 2: parameters that make no filter, or arguments that are
    not for ROS, named in one line on stderr.
    """
    return run('filter_node', _filter_node, args)


def run(name: str, make: Callable[[Sequence[str]], Sequence[Any]],
        args: Sequence[str] | None) -> int:
    """
    Run nodes in a process of that name as main() does.

    make: what gives them, once ROS is up, from the process' arguments; the first has accounts, and
    can be finished.
    """
    stopped = Signals()
    logs_to_stdout()
    arguments = list(sys.argv if args is None else args)

    # imported here, so that a signal during the half second that this takes is not lost
    from pif_ros.config import ConfigError
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions
    from rclpy.utilities import remove_ros_args

    try:
        if asks_for_help(remove_ros_args(arguments)[1:]):
            print(usage(name))
            return 0
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except ValueError as error:
        return failed(name, str(error), 2)
    except Exception as error:  # noqa: B902  RCLError has no public name
        return failed(name, explain(error, arguments), 2)
    try:
        nodes = make(arguments)
    except ConfigError as error:
        rclpy.try_shutdown()
        return failed(name, str(error), 2)
    executor = SingleThreadedExecutor()
    for node in nodes:
        executor.add_node(node)
    first = nodes[0]
    while not stopped():
        try:
            executor.spin_once(timeout_sec=0.1)
        except Exception as error:  # noqa: B902  a peer's request can make rclpy itself raise
            first.report('rclpy', f'rclpy: {type(error).__name__}: {error}')
    try:
        first.finish()
    except Exception as error:  # noqa: B902  a model can raise here too
        first.report('fault', f'finish: {type(error).__name__}: {error}')
    first.get_logger().info(f'stopped; {first.accounts}')
    take_down(executor)
    rclpy.try_shutdown()
    return 0


def _filter_node(arguments: Sequence[str]) -> list[Any]:
    from pif_ros.config import ConfigError
    from pif_ros.filter_node import FilterNode

    node = FilterNode()
    if not node.told and (line := strangers(arguments, node.get_fully_qualified_name())):
        raise ConfigError(line)
    return [node]


if __name__ == '__main__':
    sys.exit(main())
