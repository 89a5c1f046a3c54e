"""Mutants of the layer that guards the node: most are noticed by the tests."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from concurrent.futures import as_completed, ThreadPoolExecutor
import copy
import os
from pathlib import Path
from queue import SimpleQueue
import re
import shutil
import subprocess
import sys
import tempfile
from typing import Any

from benchmarks.progress import Progress
import numpy as np
from proofs import ROOT
from proofs.witnesses import Witnesses, witnesses

#: The share that must be noticed.
KILLED = 0.8
SEED = 3
#: How many times their usual time, and how many seconds more, tests may take before that counts
#: as noticing.
PATIENCE, LIMIT = 4.0, 20.0
#: So many of the quickest tests are tried first: they notice most, and soon what never ends.
FIRST = 40
#: The modules of the layer, and the tests that are to notice what happens to them.
LAYER = ('inbox', 'listener', 'sources', 'fields', 'start', 'timekeeper', 'accounts', 'verdicts',
         'parameters', 'conversions', 'config/kinds', 'core/guard', 'core/tracker',
         'core/timeline', 'core/steering', 'epoch', 'pace')
TESTS = ('test_filter_node', 'test_control_in_the_node', 'test_accounts_in_the_node',
         'test_gate_in_the_node', 'test_going_on', 'test_filter_bank', 'test_sources',
         'test_fields', 'test_field_writer', 'test_accounts', 'test_verdicts', 'test_parameters',
         'test_conversions', 'test_config', 'test_guard_config', 'test_inbox', 'test_epoch',
         'test_pace', 'test_timekeeper', 'test_lifecycle', 'test_sources_remaining',
         'test_node_remaining', 'test_config_remaining', 'core/test_guard', 'core/test_tracker',
         'core/test_timeline', 'core/test_tracker_controls', 'core/test_tracker_remaining',
         'test_proofs.py::test_a_share_of_what_is_proven_holds[fuzz]')

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
    with tempfile.TemporaryDirectory() as scratch:
        folders: SimpleQueue[Path] = SimpleQueue()
        for worker in range(os.cpu_count() or 1):
            folders.put(_copy(Path(scratch) / str(worker)))
        first = folders.get()
        seen = _Seen(*witnesses(first, [f'test/{test}' if '::' in test else f'test/{test}.py'
                                        for test in TESTS]))
        folders.put(first)
        with ThreadPoolExecutor(os.cpu_count()) as together:
            tried = [together.submit(_survivor, folders, seen, *mutants[k]) for k in chosen]
            for done, each in enumerate(as_completed(tried)):
                progress.show((done + 1) / count)
                if survivor := each.result():
                    survivors.append(survivor)
                    print(survivor, file=sys.stderr, flush=True)
    killed = 1 - len(survivors) / count
    lines = [f'{count} mutants of {len(mutants)}, in {", ".join(LAYER)}: {killed:.1%} noticed',
             *(f'not noticed: {survivor}' for survivor in sorted(survivors))]
    # of a few the share says little
    assert count < 50 or killed >= KILLED, '\n'.join(lines)
    return lines


def _copy(folder: Path) -> Path:
    """Return a copy of what the tests need, in which a mutant may be written."""
    for name in ('pif_ros', 'test', 'proofs', 'benchmarks', 'config'):
        shutil.copytree(ROOT / name, folder / name,
                        ignore=shutil.ignore_patterns('__pycache__'))
    return folder


class _Seen:
    """Which tests can notice a mutant: those that run its line, the quickest first."""

    def __init__(self, witnesses: Witnesses, seconds: dict[str, float]) -> None:
        self._witnesses, self.seconds = witnesses, seconds

    def by(self, module: str, tree: ast.Module, place: ast.AST) -> list[str]:
        """Return the tests that run a place, or a line that names what it sets at import."""
        line, seen = getattr(place, 'lineno', 0), self._witnesses[f'{module}.py']
        found = set().union(*(seen.get(each, set()) for each in _statement(tree, line)))
        return sorted(found or self._of_names(_named_by(tree, line)),
                      key=lambda test: self.seconds[test])

    def _of_names(self, names: set[str]) -> set[str]:
        """Return the tests that run any line of the package which has one of some names."""
        wanted = re.compile(rf'\b({"|".join(map(re.escape, sorted(names)))})\b')
        found: set[str] = set()
        for file, lines in self._witnesses.items():
            text = (ROOT / 'pif_ros' / file).read_text(encoding='utf-8').splitlines()
            found.update(*(tests for line, tests in lines.items()
                           if line and names and wanted.search(text[line - 1])))
        return found


def _statement(tree: ast.Module, line: int) -> range:
    """Return the lines of the innermost statement on a line, without those that it contains."""
    innermost = max(_around(tree, line), key=lambda node: (_first(node), -(node.end_lineno or 0)))
    body = getattr(innermost, 'body', None)
    return range(_first(innermost), max(line, body[0].lineno - 1 if body
                                        else innermost.end_lineno or 0) + 1)


def _around(tree: ast.Module, line: int) -> Iterator[ast.stmt]:
    """Yield the statements on a line, whole ones and parts."""
    for node in ast.walk(tree):
        if isinstance(node, ast.stmt) and _first(node) <= line <= (node.end_lineno or 0):
            yield node


def _first(node: ast.stmt) -> int:
    """Return the first line of a statement, decorators included."""
    return min([node.lineno, *(each.lineno for each in getattr(node, 'decorator_list', ()))])


def _named_by(tree: ast.Module, line: int) -> set[str]:
    """Return the names that a statement gives which runs at import: of values and functions."""
    names: set[str] = set()
    for node in _around(tree, line):
        if isinstance(node, (ast.Assign, ast.AnnAssign)):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names |= {each.id for target in targets for each in ast.walk(target)
                      if isinstance(each, ast.Name)}
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            names.add(node.name)
    return names


def _survivor(folders: SimpleQueue[Path], seen: _Seen, module: str, number: int) -> str | None:
    """Return what a mutant is where no test notices it, tried in a free copy."""
    tree = _tree(ROOT, module)
    place = list(_places(tree))[number]
    before, tests = ast.unparse(place), seen.by(module, tree, place)
    _mutate(place)
    folder = folders.get()
    path = folder / 'pif_ros' / f'{module}.py'
    original = path.read_text(encoding='utf-8')
    try:
        path.write_text(ast.unparse(tree), encoding='utf-8')
        noticed = any(_noticed(folder, some, sum(seen.seconds[test] for test in some))
                      for some in (tests[:FIRST], tests[FIRST:]) if some)
    finally:
        path.write_text(original, encoding='utf-8')
        folders.put(folder)
    return None if noticed else (f'{module}.py, line {getattr(place, "lineno", 0)}: {before} '
                                 f'became {ast.unparse(place)} ({len(tests)} tests)')


def _noticed(folder: Path, tests: list[str], seconds: float) -> bool:
    """Return whether tests fail, or do not end."""
    command = [sys.executable, '-m', 'pytest', '-x', '-q', '-p', 'no:cacheprovider', *tests]
    try:
        done = subprocess.run(command, cwd=folder, timeout=LIMIT + PATIENCE * seconds,
                              capture_output=True,
                              env={**os.environ, 'PYTHONPATH': str(folder),
                                   'ROS_DOMAIN_ID': str(1 + int(folder.name))})
    except subprocess.TimeoutExpired:
        return True
    told = done.stdout.decode() + done.stderr.decode()
    assert done.returncode in (0, 1, 2) or 'ERROR collecting' in told, told
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
        more = value + 1 if value + 1 != value else 2 * value
        node.value = not value if isinstance(value, bool) else more
    elif isinstance(node, ast.UnaryOp):
        # not x becomes x, as not not x
        node.operand = ast.UnaryOp(ast.Not(), copy.deepcopy(node.operand))
    elif isinstance(node, ast.Raise):
        # a line that does nothing
        node.__class__, node.value = ast.Expr, ast.Constant(None)  # type: ignore
