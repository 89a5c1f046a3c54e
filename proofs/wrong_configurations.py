"""Wrong configurations, each a process: status 2 in three seconds, one line that names it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import tempfile
from typing import Any

from benchmarks.progress import Progress
from ros import executable, write_parameters
from test_config import WRONG
from test_executable import WRONG as WRONG_FILES

#: Seconds that a refusal may take.
LIMIT = 3.0


def run(share: float = 1.0) -> list[str]:
    """Start the node with each, or an even choice of them, and look at how it ends."""
    cases = [*(_of_values(*case.values) for case in WRONG),
             *((name, text, ['filter_node: ', *words])
               for name, (text, words) in WRONG_FILES.items())]
    chosen = cases[::max(round(1 / share), 1)]
    progress, took = Progress('wrong configurations'), []
    for k, (name, content, words) in enumerate(chosen):
        with tempfile.TemporaryDirectory() as folder:
            took.append(_refusal(Path(folder), name, content, words))
        progress.show((k + 1) / len(chosen))
    return [f'{len(chosen)} wrong configurations of {len(cases)}: each is refused with status 2 '
            f'and one line on stderr that names the parameter; {max(took):.2f} s at most']


def _of_values(given: Mapping[str, Any], parameter: str, wanted: tuple[str, ...],
               got: str) -> tuple[str, Mapping[str, Any], list[str]]:
    """Return a configuration by parameters, and what its line must say."""
    return parameter, given, [parameter, 'expected ', *wanted]


def _refusal(folder: Path, name: str, content: Any, words: list[str]) -> float:
    """Return how many seconds it took to refuse a configuration, as it must be refused."""
    path = folder / 'parameters.yaml'
    if isinstance(content, str):
        path.write_text(content, encoding='utf-8')
    elif content is not None:
        write_parameters(path, content)
    with executable(folder, '--params-file', str(path)) as node:
        status, wall, busy = node.end()
        lines, output = node.stderr.splitlines(), node.stdout
    assert status == 2, f'{name}: status {status}: {lines}'
    assert len(lines) == 1, f'{name}: {len(lines)} lines on stderr: {lines}'
    missing = [word for word in words if word not in lines[0]]
    # what ROS itself does not read is told without the value
    assert not missing, f'{name}: {missing} not in {lines[0]!r}'
    assert 'Traceback' not in output, f'{name}: {output}'
    # where others keep the machine busy, what counts is its own time
    took = min(wall, busy)
    assert took < LIMIT, f'{name}: {took:.1f} s'
    return took
