"""Run some or all proofs, or a share of each, and print what they show."""

from __future__ import annotations

import argparse
import ast
from importlib import import_module
import os
from pathlib import Path
import random
import sys
import tempfile
import time


def proofs() -> list[str]:
    """Return the names of the proofs: the modules of this package with a run()."""
    return sorted(file.stem for file in Path(__file__).parent.glob('*.py')
                  if any(isinstance(node, ast.FunctionDef) and node.name == 'run'
                         for node in ast.parse(file.read_text(encoding='utf-8')).body))


def main(arguments: list[str] | None = None) -> int:
    """Return 0 where all that was run holds, 1 where something does not."""
    parser = argparse.ArgumentParser(prog='python -m proofs', description=__doc__)
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help=f'{", ".join(proofs())}; all where none is named')
    parser.add_argument('--share', type=float, default=1.0,
                        help='how much of each, 1 for the whole (default: %(default)s)')
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(proofs()))
    if unknown:
        parser.error(f'NAME: expected {", ".join(proofs())}, got {", ".join(unknown)}')
    if not 0 < options.share <= 1:
        parser.error(f'--share: expected more than 0 and at most 1, got {options.share}')
    with tempfile.TemporaryDirectory() as log_folder:
        _keep_ros_to_itself(log_folder)
        held = [_prove(name, options.share) for name in options.names or proofs()]
    return 0 if all(held) else 1


def _prove(name: str, share: float) -> bool:
    """Run a proof, print what it shows, and return whether it holds."""
    began = time.monotonic()
    try:
        lines, held = import_module(f'proofs.{name}').run(share), True
    except AssertionError as failed:
        lines, held = [str(failed) or repr(failed)], False
    word = 'holds' if held else 'DOES NOT HOLD'
    print(f'{name}: {word} (share {share:g}, {time.monotonic() - began:.1f} s)')
    print(*(f'    {line}' for line in lines), sep='\n', flush=True)
    return held


def _keep_ros_to_itself(log_folder: str) -> None:
    """Keep the traffic on this machine and in a domain of its own, and look at every field."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(random.randint(1, 101)))
    os.environ.update({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST', 'ROS_LOG_DIR': log_folder,
                       'ROS_PYTHON_CHECK_FIELDS': '1'})


if __name__ == '__main__':
    sys.exit(main())
