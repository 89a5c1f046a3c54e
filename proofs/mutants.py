"""Mutants of the layer that guards the node: most are noticed by the tests."""

from __future__ import annotations

import ast
from collections.abc import Iterator
import copy
import os
from pathlib import Path
import shutil
import subprocess
import sys
import tempfile
from typing import Any

from benchmarks.progress import Progress
import numpy as np
from proofs import ROOT

#: The share that must be noticed.
KILLED = 0.8
SEED = 3
#: Seconds after which the tests of a mutant count as noticing it.
LIMIT = 180
_NODE = ['test/test_filter_node.py', 'test/test_control_in_the_node.py']
#: The modules of the layer, and the tests that are to notice what happens to them.
LAYER = {
    'inbox': [*_NODE, 'test/test_filter_bank.py', 'test/test_proofs.py::'
              'test_a_share_of_what_is_proven_holds[fuzz]'],
    'listener': [*_NODE, 'test/test_filter_bank.py'],
    'sources': ['test/test_sources.py', *_NODE],
    'fields': ['test/test_fields.py', 'test/test_field_writer.py', 'test/test_sources.py', *_NODE],
    'start': _NODE,
    'timekeeper': _NODE,
    'accounts': ['test/test_accounts.py', *_NODE],
    'verdicts': ['test/test_verdicts.py', 'test/test_gate_in_the_node.py', *_NODE],
    'parameters': ['test/test_parameters.py', *_NODE],
    'conversions': ['test/test_conversions.py', 'test/test_field_writer.py', *_NODE],
    'config/kinds': ['test/test_parameters.py', 'test/test_config.py'],
    'core/guard': ['test/core/test_guard.py', 'test/test_guard_config.py',
                   'test/test_gate_in_the_node.py'],
    'core/tracker': ['test/core/test_tracker.py', 'test/core/test_tracker_controls.py', *_NODE]}

_COMPARED = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
             ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
             ast.In: ast.NotIn, ast.NotIn: ast.In}
_COMPUTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
_JOINED = {ast.And: ast.Or, ast.Or: ast.And}


def run(share: float = 1.0) -> list[str]:
    """Try all mutants, or a seeded choice of them, and count those that the tests notice."""
    mutants = [(module, k) for module in LAYER
               for k in range(len(list(_places(_tree(ROOT, module)))))]
    rng = np.random.default_rng(SEED)
    count = max(round(share * len(mutants)), 1)
    chosen = sorted(rng.choice(len(mutants), count, replace=False).tolist())
    survivors, progress = [], Progress('mutants')
    with tempfile.TemporaryDirectory() as folder:
        for name in ('pif_ros', 'test', 'proofs', 'benchmarks', 'config'):
            shutil.copytree(ROOT / name, Path(folder) / name,
                            ignore=shutil.ignore_patterns('__pycache__'))
        for done, k in enumerate(chosen):
            survivor = _survivor(Path(folder), *mutants[k])
            survivors += [survivor] if survivor else []
            progress.show((done + 1) / count)
    killed = 1 - len(survivors) / count
    lines = [f'{count} mutants of {len(mutants)}, in {", ".join(LAYER)}: {killed:.0%} noticed',
             *(f'not noticed: {survivor}' for survivor in survivors)]
    # of a few the share says little
    assert count < 50 or killed >= KILLED, '\n'.join(lines)
    return lines


def _survivor(folder: Path, module: str, number: int) -> str | None:
    """Return what a mutant is where its tests do not notice it."""
    tree = _tree(folder, module)
    place = list(_places(tree))[number]
    before = ast.unparse(place)
    _mutate(place)
    path = folder / 'pif_ros' / f'{module}.py'
    original = path.read_text(encoding='utf-8')
    path.write_text(ast.unparse(tree), encoding='utf-8')
    try:
        noticed = _noticed(folder, LAYER[module])
    finally:
        path.write_text(original, encoding='utf-8')
    return None if noticed else (f'{module}.py, line {getattr(place, "lineno", 0)}: '
                                 f'{before} became {ast.unparse(place)}')


def _noticed(folder: Path, tests: list[str]) -> bool:
    """Return whether tests fail, or do not end."""
    command = [sys.executable, '-m', 'pytest', '-x', '-q', '-p', 'no:cacheprovider', *tests]
    try:
        done = subprocess.run(command, cwd=folder, timeout=LIMIT, capture_output=True,
                              env={**os.environ, 'PYTHONPATH': str(folder)})
    except subprocess.TimeoutExpired:
        return True
    assert done.returncode in (0, 1, 2), done.stdout.decode() + done.stderr.decode()
    return done.returncode != 0


def _tree(folder: Path, module: str) -> ast.Module:
    return ast.parse((folder / 'pif_ros' / f'{module}.py').read_text(encoding='utf-8'))


def _places(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield what can be mutated, in the order of the text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Compare) and type(node.ops[0]) in _COMPARED:
            yield node
        elif isinstance(node, (ast.BinOp, ast.AugAssign)) and type(node.op) in _COMPUTED:
            yield node
        elif isinstance(node, (ast.BoolOp, ast.Raise)):
            yield node
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield node
        elif isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
            yield node


def _mutate(node: ast.AST) -> None:
    """Make something else of a place, in the tree that it is in."""
    if isinstance(node, ast.Compare):
        node.ops[0] = _COMPARED[type(node.ops[0])]()
    elif isinstance(node, (ast.BinOp, ast.AugAssign)):
        node.op = _COMPUTED[type(node.op)]()
    elif isinstance(node, ast.BoolOp):
        node.op = _JOINED[type(node.op)]()
    elif isinstance(node, ast.Constant):
        value: Any = node.value
        node.value = not value if isinstance(value, bool) else value + 1
    elif isinstance(node, ast.UnaryOp):
        # not x becomes x, as not not x
        node.operand = ast.UnaryOp(ast.Not(), copy.deepcopy(node.operand))
    elif isinstance(node, ast.Raise):
        # a line that does nothing
        node.__class__, node.value = ast.Expr, ast.Constant(None)  # type: ignore
