"""The tests that speak ROS, 100 times: none fails by chance."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
import os
import subprocess
import sys
import time

from benchmarks.progress import Progress
from proofs import ROOT

TIMES = 100


def run(share: float = 1.0) -> list[str]:
    """Run them so often, each time in another domain, as many at a time as there are cores."""
    files = [str(file.relative_to(ROOT)) for file in sorted((ROOT / 'test').glob('test_*.py'))
             if 'from ros import' in file.read_text(encoding='utf-8')]
    times, progress = max(round(share * TIMES), 1), Progress('flaky')
    began, failed, last = time.monotonic(), [], ''
    with ThreadPoolExecutor(os.cpu_count()) as together:
        runs = [together.submit(_run, files, k) for k in range(times)]
        for done, each in enumerate(as_completed(runs)):
            status, told = each.result()
            last = told.strip().splitlines()[-1]
            progress.show((done + 1) / times)
            if status:
                failed += [told[-4000:]]
                print(failed[-1], file=sys.stderr, flush=True)
    lines = [f'{len(files)} files, {times} times in {time.monotonic() - began:.0f} s, '
             f'{len(failed)} failed; the last: {last}', *failed]
    assert not failed, '\n'.join(lines)
    return lines


def _run(files: Sequence[str], number: int) -> tuple[int, str]:
    """Run them once, and return the status and what was told."""
    done = subprocess.run(
        [sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider', *files], cwd=ROOT,
        env={**os.environ, 'ROS_DOMAIN_ID': str(1 + (os.getpid() + number) % 101)},
        capture_output=True, text=True)
    return done.returncode, done.stdout
