"""A recording for every test, and a ROS context of its own for those that need one."""

from collections.abc import Callable, Iterator
from pathlib import Path

from pif_ros.plaza.player_node import Spin
from pif_ros.plaza.recording import load, Recording
from pif_ros.process import take_down
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
import synthetic


@pytest.fixture(scope='session')
def synthetic_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the file of a small recording that is always the same."""
    return synthetic.write(tmp_path_factory.mktemp('recording') / 'synthetic.mat')


@pytest.fixture(scope='session')
def small(synthetic_file: Path) -> Recording:
    """Return the small recording."""
    return load(path=synthetic_file)


@pytest.fixture(scope='session')
def plaza(synthetic_file: Path) -> Recording:
    """Return Plaza1 where its data are installed, else the small recording."""
    try:
        return load('Plaza1')
    except FileNotFoundError:
        return load(path=synthetic_file)


@pytest.fixture
def spinner() -> Iterator[Callable[..., Spin]]:
    """Return what makes a spin(timeout) for some nodes; they are gone after the test."""
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    executor = SingleThreadedExecutor()

    def make(*nodes: rclpy.node.Node) -> Spin:
        for node in nodes:
            executor.add_node(node)
        return lambda timeout: executor.spin_once(timeout_sec=timeout)

    yield make
    take_down(executor)
    rclpy.try_shutdown()
