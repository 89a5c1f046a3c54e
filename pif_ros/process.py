"""What a node needs to be a good process: a clean end on a signal, one line for a bad start."""

from __future__ import annotations

import atexit
from collections.abc import Callable, Iterator, Mapping, Sequence
import functools
import os
from pathlib import Path
import re
import signal
import sys
from types import FrameType
from typing import Any

import yaml


class Signals:
    """
    Becomes true at SIGINT or SIGTERM; a second one changes nothing.

    To be made before rclpy is imported, so that a signal during the start counts too; rclpy is to
    be initialised with SignalHandlerOptions.NO.  When the interpreter ends it lets go of handlers
    first and of modules then, which takes a while: in that time signals are ignored.
    """

    def __init__(self) -> None:
        """Take over both signals."""
        self._received = False
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._on_signal)
            atexit.register(signal.signal, number, signal.SIG_IGN)

    def __call__(self) -> bool:
        """Return whether the process was told to stop."""
        return self._received

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        self._received = True


def logs_to_stdout() -> None:
    """Keep stderr for what is wrong; to be called before rclpy is initialised."""
    os.environ.setdefault('RCUTILS_LOGGING_USE_STDOUT', '1')
    os.environ.setdefault('RCUTILS_LOGGING_BUFFERED_STREAM', '0')


def take_down(executor: Any) -> None:
    """End who runs callbacks, and then its nodes; their context is to be shut down after that."""
    nodes = executor.get_nodes()
    executor.shutdown()
    for node in nodes:
        node.destroy_node()


def guarded(callback: Callable[..., Any]) -> Callable[..., Any]:
    """
    Keep a node alive whatever one of its callbacks meets.

    The fault is counted in the node's faults and told by its report(kind, text), self's where it
    is the node, else its _node's; a service answers with its response as it was.
    """
    @functools.wraps(callback)
    def run(self: Any, *args: Any) -> Any:
        try:
            return callback(self, *args)
        except Exception as error:  # noqa: B902
            node = getattr(self, '_node', self)
            node.faults += 1
            node.report('fault', f'{callback.__name__}: {type(error).__name__}: {error}')
            return args[-1] if args else None
    return run


def failed(name: str, reason: str, status: int) -> int:
    """Say on stderr in one line why a process cannot go on, and return its exit status."""
    print(f'{name}: {" ".join(reason.split())}', file=sys.stderr)
    return status


def usage(name: str) -> str:
    """Return how a process is to be started that takes arguments of ROS alone."""
    return (f'usage: {name} --ros-args [--params-file FILE] [-p NAME:=VALUE] [-r FROM:=TO]\n\n'
            'All that it does is told by parameters: the README has their table, and the folder '
            'config\na file for each named system.  The first line on stderr says what is wrong '
            'with them.')


def asks_for_help(own: Sequence[str]) -> bool:
    """Return whether help is wanted, by the arguments that are not for ROS; refuse all others."""
    if '-h' in own or '--help' in own:
        return True
    for stray in own:
        if stray != '--':
            raise ValueError(f'expected ROS arguments after --ros-args, got {stray!r}')
    return False


def explain(error: Exception, arguments: Sequence[str]) -> str:
    """Return in one line why ROS did not take its arguments, naming the parameter if it can."""
    for path in params_files(arguments):
        try:
            # rcl takes every document of a file
            trees = list(yaml.safe_load_all(Path(path).read_bytes()))
            wrong = next(filter(None, map(_wrong_list, trees)), None)
        except OSError as fault:
            return f'{path}: expected a readable file, got {fault.strerror}'
        except (yaml.YAMLError, ValueError) as fault:
            return f'{path}: expected YAML, got {" ".join(str(fault).split())}'
        except RecursionError:
            return f'{path}: expected a tree of parameters, got one too deep or within itself'
        if wrong is not None:
            return wrong
    if type(error).__name__ == 'UnknownROSArgsError':
        # of which rclpy has no public name
        return f'expected only ROS arguments after --ros-args, got {str(error).strip("[]")}'
    text = re.sub(r',? at \S*/src/\S+', '', str(error)).splitlines()[0]
    if "'bool'" in text:
        text += " (y, n, on and off are true and false unless in quotes: 'y')"
    return text.replace('failed to initialize rcl: ', '')


def strangers(arguments: Sequence[str], name: str) -> str | None:
    """Return in one line that no parameter file has parameters for a node of this name."""
    try:
        found: set[Any] = {node for tree in trees(arguments) for node in tree}
    except (yaml.YAMLError, RecursionError):
        # what rcl took and this does not may be for any node
        return None
    addressed = found & {name, name.lstrip('/')} or any('*' in str(key) for key in found)
    if addressed or not found:
        return None
    return (f'--params-file: expected parameters for the node {name}, '
            f'got some for {", ".join(map(str, sorted(found)))} only')


def trees(arguments: Sequence[str]) -> Iterator[dict[Any, Any]]:
    """Give what is in the parameter files among a process's arguments; all values are text."""
    for path in params_files(arguments):
        for tree in yaml.load_all(Path(path).read_bytes(), Loader=yaml.BaseLoader):
            if isinstance(tree, dict):
                yield tree


def sections(tree: Mapping[Any, Any], above: str = '') -> Iterator[tuple[str, Any]]:
    """Give the names of all nodes in a tree, and the parameters of each."""
    for name, below in tree.items():
        if name == 'ros__parameters':
            yield above, below
        elif isinstance(below, dict):
            yield from sections(below, f'{above}/{str(name).strip("/")}')


def params_files(arguments: Sequence[str]) -> list[str]:
    """Return the parameter files among a process's arguments."""
    return [after for before, after in zip(arguments, arguments[1:]) if before == '--params-file']


def _wrong_list(tree: object, name: str = '') -> str | None:
    """Return a line for the first list of a YAML tree that a ROS parameter cannot hold."""
    if isinstance(tree, dict):
        lines = (_wrong_list(value, f'{name}.{key}' if name else str(key))
                 for key, value in tree.items())
        return next((line for line in lines if line is not None), None)
    if isinstance(tree, list) and len({type(item) for item in tree}) > 1:
        short = name.split('ros__parameters.')[-1]
        return f'{short}: expected a list of one type (2.0 beside 1.5, not 2), got {tree}'
    if isinstance(tree, list) and any(isinstance(item, (list, dict)) for item in tree):
        return f"{name.split('ros__parameters.')[-1]}: expected a flat list, got {tree}"
    return None
