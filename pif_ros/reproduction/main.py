"""Runs the examples of the papers again: tables and pictures, beside what is printed."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Sequence
import os
from pathlib import Path
import signal
import sys

from pif_ros.process import failed

_NAME = 'reproduce'


def main(args: Sequence[str] | None = None) -> int:
    """Run it: 0 if all went well, 1 where a figure is missed, 2 at bad arguments, 130 stopped."""
    os.environ.setdefault('OMP_NUM_THREADS', '1')
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    wanted = _arguments(args)
    try:
        # imported here, so that the libraries below find that they have one thread each
        from pif_ros.reproduction.catalogue import EXAMPLES, find
        from pif_ros.reproduction.runner import cluster, local
    except ModuleNotFoundError as error:
        return failed(_NAME, f'expected joblib and tqdm to be installed, got {error}', 2)
    if wanted.list:
        for name in EXAMPLES:
            print(f'{name}: {find(name).TITLE} [{find(name).SOURCE}]')
        return 0
    try:
        _check(wanted, EXAMPLES)
        wanted.out.mkdir(parents=True, exist_ok=True)
        workers = local(wanted.jobs) if wanted.backend == 'local' else cluster(wanted.scheduler)
    except (ValueError, OSError) as error:
        return failed(_NAME, str(error), 2)
    try:
        with workers:
            return _run(wanted, list(EXAMPLES) if wanted.all else wanted.examples)
    except KeyboardInterrupt:
        return failed(_NAME, 'stopped', 130)


def _run(wanted: argparse.Namespace, names: Sequence[str]) -> int:
    from pif_ros.reproduction.catalogue import EXAMPLES
    from pif_ros.reproduction.chapter import make
    from pif_ros.reproduction.report import chapter_text, gather
    met = True
    for name in names:
        chapter = make(name, range(wanted.seeds), wanted.quick, wanted.out, wanted.resume)
        print(chapter_text(chapter), flush=True)
        met &= all(h['verdict'] != 'missed' for case in chapter['cases'] for h in case['held'])
    gather(wanted.out, list(EXAMPLES))
    print(f'written: {wanted.out}', file=sys.stderr)
    return 0 if met or wanted.quick else 1


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=_NAME, description=__doc__)
    parser.add_argument('examples', nargs='*', metavar='EXAMPLE', help='names, see --list')
    parser.add_argument('--all', action='store_true', help='all of them')
    parser.add_argument('--list', action='store_true', help='name the examples, and do no more')
    parser.add_argument('--out', type=Path, metavar='DIR', help='folder for what is found')
    parser.add_argument('--seeds', type=int, default=20, metavar='N',
                        help='random seeds 0 to N - 1 for each (default: %(default)s)')
    parser.add_argument('--quick', action='store_true',
                        help='small sizes, which show only that everything runs')
    parser.add_argument('--resume', action='store_true',
                        help='keep what DIR has of the same seeds, sizes and code')
    parser.add_argument('--jobs', type=int, default=-1, metavar='N',
                        help='processes on this machine (default: one for each core)')
    parser.add_argument('--backend', choices=['local', 'dask'], default='local',
                        help='who does the work (default: %(default)s)')
    parser.add_argument('--scheduler', default='', metavar='ADDRESS',
                        help='of the Dask cluster, as tcp://host:8786')
    return parser.parse_args(args)


def _check(wanted: argparse.Namespace, known: Collection[str]) -> None:
    """Raise ValueError for what cannot be run."""
    for name in wanted.examples:
        if name not in known:
            raise ValueError(f'EXAMPLE: expected some of {", ".join(known)}, got {name}')
    if wanted.all == bool(wanted.examples):
        raise ValueError('EXAMPLE: expected names of examples or --all, got '
                         f'{"both" if wanted.all else "neither"}')
    if wanted.out is None:
        raise ValueError('--out: expected a folder for what is found, got none')
    if wanted.seeds < 1:
        raise ValueError(f'--seeds: expected 1 or more, got {wanted.seeds}')
    if wanted.jobs == 0 or wanted.jobs < -1:
        raise ValueError(f'--jobs: expected 1 or more, or -1, got {wanted.jobs}')
    if (wanted.backend == 'dask') != bool(wanted.scheduler):
        raise ValueError('--scheduler: expected the address of a scheduler with --backend dask, '
                         f'got {wanted.scheduler!r} with --backend {wanted.backend}')


if __name__ == '__main__':
    sys.exit(main())
