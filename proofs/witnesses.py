"""Which tests run which lines, and for how long: a test that does not run a line can't see it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
from typing import Any

import coverage
import pytest

#: Lines of modules, by their paths in the package, and the tests that run them.
Witnesses = dict[str, dict[int, set[str]]]


def witnesses(folder: Path, tests: Sequence[str]) -> tuple[Witnesses, dict[str, float]]:
    """Run tests in a copy of the repository; return who runs what, and the seconds of each."""
    with tempfile.TemporaryDirectory() as scratch:
        data, times = Path(scratch) / 'data', Path(scratch) / 'times'
        done = subprocess.run(
            [sys.executable, '-m', 'coverage', 'run', f'--data-file={data}',
             f'--source={folder / "pif_ros"}', '-m', 'proofs.witnesses', str(times), *tests],
            cwd=folder, capture_output=True, text=True,
            env={**os.environ, 'PYTHONPATH': str(folder)})
        assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
        seconds = json.loads(times.read_text(encoding='utf-8'))
        found = coverage.CoverageData(str(data))
        found.read()
        return {str(Path(file).relative_to(folder / 'pif_ros')):
                {line: set(tests) - {''}
                 for line, tests in found.contexts_by_lineno(file).items()}
                for file in found.measured_files()}, seconds


class _Teller:
    """What tells the lines of one test from those of another, and how long each takes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Name the test that runs."""
        running = coverage.Coverage.current()
        assert running is not None
        running.switch_context(item.nodeid)
        yield
        running.switch_context('')

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add what a phase of a test took."""
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration


def _main(times: str, *tests: str) -> Any:
    """Run tests under coverage, and write how long each took."""
    teller = _Teller()
    status = pytest.main(['-q', '-p', 'no:cacheprovider', *tests], plugins=[teller])
    Path(times).write_text(json.dumps(teller.seconds), encoding='utf-8')
    return status


if __name__ == '__main__':
    sys.exit(_main(*sys.argv[1:]))
