"""The tests that speak ROS, 100 times: none fails by chance."""

from __future__ import annotations

import os
import subprocess
import sys
import time

from benchmarks.progress import Progress
from proofs import ROOT

TIMES = 100


def run(share: float = 1.0) -> list[str]:
    """Run them so often, one after the other, each time in another domain."""
    files = [str(file.relative_to(ROOT)) for file in sorted((ROOT / 'test').glob('test_*.py'))
             if 'from ros import' in file.read_text(encoding='utf-8')]
    times, progress = max(round(share * TIMES), 1), Progress('flaky')
    began, passed = time.monotonic(), ''
    for k in range(times):
        done = subprocess.run(
            [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *files], cwd=ROOT,
            env={**os.environ, 'ROS_DOMAIN_ID': str(1 + (os.getpid() + k) % 101)},
            capture_output=True, text=True)
        assert done.returncode == 0, f'run {k + 1} of {times}: {done.stdout[-4000:]}'
        passed = done.stdout.strip().splitlines()[-1]
        progress.show((k + 1) / times)
    return [f'{len(files)} files, {times} times in {time.monotonic() - began:.0f} s, no failure; '
            f'the last: {passed}']
