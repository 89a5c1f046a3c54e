"""What holds for all tests: hypothesis is the same every time, and ROS stays on this machine."""

from __future__ import annotations

from collections.abc import Iterator
import os
from pathlib import Path
import tempfile
from typing import TYPE_CHECKING

from hypothesis import settings
import pytest

if TYPE_CHECKING:
    from ros import Graph

settings.register_profile('pif_ros', derandomize=True, deadline=None, max_examples=30,
                          database=None)
settings.load_profile('pif_ros')

# Before any message is imported, and for child processes too.
_LOGS = tempfile.TemporaryDirectory(prefix='pif_ros_log_')
_WORKER = int(os.environ.get('PYTEST_XDIST_WORKER', 'gw0')[2:])
_DOMAIN = 1 + (int(os.environ.get('ROS_DOMAIN_ID') or os.getpid()) - 1 + _WORKER) % 101
os.environ.update({
    'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    'ROS_DOMAIN_ID': str(_DOMAIN),
    'ROS_LOG_DIR': _LOGS.name,
    'ROS_PYTHON_CHECK_FIELDS': '1',
})


@pytest.fixture
def graph(tmp_path: Path) -> Iterator[Graph]:
    """Return a ROS graph of this process, with nobody in it."""
    # here, since the tests of the core run without ROS
    from ros import Graph
    graph = Graph(tmp_path)
    yield graph
    graph.close()
