"""The executable simulate: it plays what is wanted to the end, and ends well at a signal."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import dataclasses
import sys
from typing import Any, NoReturn

from pif_ros.process import explain, failed, logs_to_stdout, Signals, strangers, take_down

_NAME = 'simulate'


def main(args: Sequence[str] | None = None) -> int:
    """Simulate: 0 at the end and at a signal, 1 where nobody listens, 2 at what cannot be."""
    stopped = Signals()
    logs_to_stdout()
    arguments = list(sys.argv if args is None else args)
    from pif_ros.simulation_node import Simulator
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    try:
        arguments, given = understood(arguments)
        rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    except (ValueError, FileNotFoundError) as error:
        return failed(_NAME, str(error), 2)
    except Exception as error:  # noqa: B902  RCLError has no public name
        return failed(_NAME, explain(error, arguments), 2)
    executor = SingleThreadedExecutor()
    try:
        node = Simulator(given)
        if not node.told and (line := strangers(arguments, node.get_fully_qualified_name())):
            raise ValueError(line)
        executor.add_node(node)
        node.play(lambda timeout: executor.spin_once(timeout_sec=timeout), stopped)
    except TimeoutError as error:
        return failed(_NAME, str(error), 1)
    except ValueError as error:
        return failed(_NAME, str(error), 2)
    finally:
        take_down(executor)
        rclpy.try_shutdown()
    return 0


def understood(arguments: Sequence[str]) -> tuple[list[str], dict[str, Any]]:
    """
    Return the arguments for ROS, and the settings that stood among the others.

    A named system is its parameter file, before all that ROS is told beside.  Raises ValueError or
    FileNotFoundError in one line.
    """
    from pif_ros.core.systems import SYSTEMS
    from pif_ros.share import find
    from rclpy.utilities import remove_ros_args

    own = remove_ros_args(list(arguments))
    given = vars(_parser().parse_args(own[1:]))
    system = given.pop('system', None)
    if system is None:
        return list(arguments), given
    if system not in SYSTEMS:
        raise ValueError(f'--system: expected one of {", ".join(sorted(SYSTEMS))}, got {system!r}')
    path = find(f'config/{system}.yaml')
    return [arguments[0], '--ros-args', '--params-file', str(path), '--', *arguments[1:]], given


class _Parser(argparse.ArgumentParser):
    """Says in one line what is wrong."""

    def error(self, message: str) -> NoReturn:
        raise ValueError(message)


def _parser() -> argparse.ArgumentParser:
    """Return what reads --system and the settings; what is not given is not there."""
    from pif_ros.scenario import Settings

    parser = _Parser(
        prog=_NAME, argument_default=argparse.SUPPRESS, allow_abbrev=False,
        description='Play a simulation of a system, and what its sensors measure, to a filter '
        'with the same parameters.',
        epilog='Parameters of the filter count here too: --ros-args --params-file FILE')
    parser.add_argument('--system', metavar='NAME', help='a named system, with the parameters of '
                        'its file in the config folder of this package')
    for spec in dataclasses.fields(Settings):
        says = spec.metadata['says'] + (f' [{unit}]' if (unit := spec.metadata['unit']) else '')
        says += f' (default: {_shown(spec.default)})'
        flag, default = f'--{spec.name}', spec.default
        if isinstance(default, bool):
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, help=says)
        elif isinstance(default, tuple):
            parser.add_argument(flag, nargs='+', type=float, help=says)
        else:
            parser.add_argument(flag, type=type(default), help=says)
    return parser


def _shown(default: Any) -> str:
    return str(default) if default or not isinstance(default, tuple) else 'none'


if __name__ == '__main__':
    sys.exit(main())
