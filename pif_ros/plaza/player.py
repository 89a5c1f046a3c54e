"""The process plaza_player: it starts the node, plays to the end, and ends well at a signal."""

from __future__ import annotations

from collections.abc import Sequence
import sys

from pif_ros.process import explain, failed, logs_to_stdout, Signals, take_down

_NAME = 'plaza_player'


def main(args: Sequence[str] | None = None) -> int:
    """Play: 0 at the end and at a signal, 1 where nobody follows, 2 at what cannot be played."""
    stopped = Signals()
    logs_to_stdout()
    arguments = list(sys.argv if args is None else args)
    from pif_ros.plaza.player_node import Player
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: B902  RCLError has no public name
        return failed(_NAME, explain(error, arguments), 2)
    executor = SingleThreadedExecutor()
    try:
        player = Player()
        executor.add_node(player)
        player.play(lambda timeout: executor.spin_once(timeout_sec=timeout), stopped)
    except TimeoutError as error:
        return failed(_NAME, str(error), 1)
    except (ValueError, OSError) as error:
        return failed(_NAME, str(error), 2)
    finally:
        take_down(executor)
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
