"""The tests that speak ROS, 100 times: none fails by chance."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import as_completed, ThreadPoolExecutor
import os
import re
import subprocess
import sys
import time

from benchmarks.progress import Progress
from proofs import ROOT

TIMES = 100
#: What a test imports that speaks ROS.
SPEAKS = re.compile('^from (ros|follower) import', re.MULTILINE)
#: Seconds after which a run is taken to hang; a test that does says before where each thread is.
LIMIT = 1800.0


def run(share: float = 1.0) -> list[str]:
    """Run them so often, each time in another domain, as many at a time as there are cores."""
    files = [str(file.relative_to(ROOT)) for file in sorted((ROOT / 'test').rglob('test_*.py'))
             if SPEAKS.search(file.read_text(encoding='utf-8'))]
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
        ['timeout', str(LIMIT), sys.executable, '-m', 'pytest', '-q', '-p', 'no:cacheprovider',
         *files], cwd=ROOT,
        env={**os.environ, 'ROS_DOMAIN_ID': str(1 + (os.getpid() + number) % 101)},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.returncode, done.stdout
