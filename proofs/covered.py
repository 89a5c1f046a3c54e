"""The tests, with the lines of the package counted that they run, in all processes."""

from __future__ import annotations

import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile

from proofs import ROOT

#: The share of lines that must be run.
COVERED = 0.95
SETTINGS = """
[run]
source = {root}/pif_ros
parallel = true
data_file = {folder}/data
[report]
exclude_also =
    if TYPE_CHECKING:
    if __name__ == .__main__.:
"""


def run(share: float = 1.0) -> list[str]:
    """Run all tests; or that share of their files, of which nothing is asked but the figure."""
    files = sorted((ROOT / 'test').rglob('test_*.py'))
    chosen = [str(file.relative_to(ROOT)) for file in files[::max(round(1 / share), 1)]]
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder) / 'settings'
        settings.write_text(SETTINGS.format(folder=folder, root=ROOT), encoding='utf-8')
        # what numba compiles is not seen
        env = {**os.environ, 'COVERAGE_PROCESS_START': str(settings)}
        tests = subprocess.run([sys.executable, '-m', 'pytest', '-q', '-n', '2', '--dist',
                                'loadfile', '-p', 'no:cacheprovider', *chosen],
                               cwd=ROOT, env=env, capture_output=True, text=True)
        passed = tests.stdout.strip().splitlines()[-1]
        # to count lines takes time, and what has to be in time may fail for that
        assert tests.returncode in (0, 1), tests.stdout[-4000:]
        rc = f'--rcfile={settings}'
        for command in (['combine', '-q'], ['json', '-q', '-o', f'{folder}/found']):
            subprocess.run([sys.executable, '-m', 'coverage', command[0], rc, *command[1:]],
                           cwd=ROOT, check=True)
        found = json.loads((Path(folder) / 'found').read_text(encoding='utf-8'))
    total = found['totals']['percent_covered'] / 100
    least = sorted((file['summary']['percent_covered'], name)
                   for name, file in found['files'].items())[:8]
    lines = [f'{len(chosen)} files of tests: {total:.1%} of {found["totals"]["num_statements"]} '
             f'lines; {passed}', *(f'{percent:.0f} % of {name}' for percent, name in least)]
    assert share < 1 or total >= COVERED, '\n'.join(lines)
    return lines
