"""Run some or all cases, print their tables, and leave them as Markdown and JSON."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
import sys

from benchmarks.report import Table, write
from benchmarks.timing import Effort

#: Each is a module of this package with run(effort) -> Table.
CASES = ('step', 'build', 'split', 'engine', 'batch', 'plaza', 'lorenz', 'active', 'cost',
         'rivals', 'paths', 'strategies.reuse', 'strategies.extent', 'strategies.significance',
         'strategies.composition', 'strategies.wavelets', 'strategies.inflation', 'node')


def main(arguments: list[str] | None = None) -> int:
    """Return 0 where every goal is met, 1 where one is missed."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks', description=__doc__)
    parser.add_argument('cases', nargs='*', metavar='CASE', default=[],
                        help=f'{", ".join(CASES)}; all where none is named')
    parser.add_argument('--out', type=Path, default=Path('build/benchmarks'), metavar='DIR',
                        help='where results.md and results.json go (default: %(default)s)')
    parser.add_argument('--quick', action='store_true',
                        help='a tenth of the samples, to see that everything runs')
    parser.add_argument('--check', action='store_true',
                        help='hold the reference against a million particles too (minutes)')
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.cases) - set(CASES))
    if unknown:
        parser.error(f'CASE: expected {", ".join(CASES)}, got {", ".join(unknown)}')

    effort = Effort(share=0.1 if options.quick else 1.0, check=options.check)
    tables: list[Table] = []
    for name in options.cases or CASES:
        tables.append(import_module(f'benchmarks.{name}').run(effort))
        print(tables[-1].markdown(), flush=True)
    for path in write(tables, options.out):
        print(f'written: {path}', file=sys.stderr)
    return int(not all(goal.met for table in tables for goal in table.goals))


if __name__ == '__main__':
    sys.exit(main())
