"""What was found, written down: tables for people (Markdown) and for programs (JSON)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from importlib import metadata
import json
import os
from pathlib import Path
import platform
from typing import Any

import numpy as np
from pif_ros.reproduction.study import COLUMNS

PACKAGES = ('pif_ros', 'numpy', 'scipy', 'joblib', 'matplotlib')
RESULTS, TABLE = 'results.json', 'table.md'
#: Goes up with what a chapter holds.
FORMAT = 2

#: A chapter is what results.json of an example holds, a tree of plain values.
Chapter = Mapping[str, Any]


def write(chapter: Chapter, folder: Path) -> None:
    """Write the table of an example, and its figures as numbers, into its folder."""
    (folder / RESULTS).write_text(json.dumps(chapter, indent=1) + '\n')
    (folder / TABLE).write_text(chapter_text(chapter))


def read(folder: Path) -> Chapter | None:
    """Return what an example's folder holds, None where it is nothing of this format."""
    try:
        chapter: Chapter = json.loads((folder / RESULTS).read_text())
    except (OSError, ValueError):
        return None
    return chapter if chapter.get('format') == FORMAT else None


def gather(folder: Path, names: Sequence[str]) -> str:
    """
    Write the table of all examples that are in a folder, and return it.

    Each of the names has a folder of its own in it once it has been run.
    """
    found = (read(folder / name) for name in names)
    chapters = [chapter for chapter in found if chapter is not None]
    text = '\n'.join([overview(chapters), *(
        chapter_text(chapter, f'{chapter["example"]}/') for chapter in chapters)])
    (folder / TABLE).write_text(text)
    (folder / RESULTS).write_text(json.dumps(
        {chapter['example']: chapter for chapter in chapters}, indent=1) + '\n')
    return text


def overview(chapters: Sequence[Chapter]) -> str:
    """Return a table of one line for each case."""
    lines = [['case', 'printed', 'ours, as printed', 'ours, best', 'SIR', 'EKF', 'UKF', 'optimum',
              '1 and 2 sigma, best (optimum)', 'step, best', 'command']]
    for chapter in chapters:
        for case in chapter['cases']:
            rows = {row['role']: row for row in reversed(case['rows'])}
            lines.append(_line(case, rows))
    return '\n'.join([
        '# The examples of the papers\n', _table(lines),
        'Errors: mean and its standard error over the seeds; med., the median. They are root mean '
        'squares, of each component, and for tm-1 to tm-3 L1 distances of transition densities. '
        'All filters of a case have the same data; N seeds are those from 0 to N - 1.\n'])


def chapter_text(chapter: Chapter, folder: str = '') -> str:
    """Return an example's tables, remarks and pictures, which are in a folder, as Markdown."""
    made = chapter['made']
    parts = [f'## {chapter["example"]}: {chapter["title"]} [{chapter["source"]}]\n',
             *(_case_text(case) for case in chapter['cases']),
             *(f'![{Path(name).stem}]({folder}{name})' for name in chapter['pictures']),
             f'\n`{made["command"]}`, {made["date"]}, {made["machine"]}, {made["versions"]}\n']
    return '\n'.join(parts)


def circumstances(command: str) -> dict[str, str]:
    """Return when, where, with what and by which command it was made."""
    return {'command': command, 'machine': f'{_processor()}, {os.cpu_count()} cores',
            'date': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),
            'versions': ', '.join([f'Python {platform.python_version()}', *_versions()])}


def _case_text(case: Mapping[str, Any]) -> str:
    found = list(dict.fromkeys(name for row in case['rows'] for name in row['figures']))
    scores = [*(name for name in COLUMNS if name in found),
              *(name for name in found if name not in COLUMNS)]
    lines = [['', 'settings', *(COLUMNS.get(name, name) for name in scores)]]
    lines += [[row['entry'] + _lost(row), row['setting'],
               *(_figure(name, row['figures'].get(name), case['median']) for name in scores)]
              for row in case['rows']]
    met = sum(h['verdict'] == 'held' for h in case['held'])
    held = [f'Held: {met} of {len(case["held"])} figures are what they are to be.', *(
        f'- {h["verdict"]}: {h["what"]}: {_bounds(h)}, got {_number(h["got"])} ± '
        f'{_number(h["error"])}' for h in case['held'] if h['verdict'] != 'held')]
    held = held if case['held'] else []
    seeds = case['rows'][0]['seeds']
    return '\n'.join([
        f'### {case["name"]}: {case["title"]}\n', f'Printed: {case["printed"]}\n', _table(lines),
        f'Seeds {seeds[0]} to {seeds[-1]}: `{case["rows"][0]["command"]}`\n', *held, '',
        *(f'- {remark}' for remark in case['remarks']), ''])


def _line(case: Mapping[str, Any], rows: Mapping[str, Any]) -> list[str]:
    """Return the line of a case in the overview, from the first row of each role."""
    first = case['rows'][0]
    score = 'rmse' if 'rmse' in first['figures'] else 'L1'

    def error(role: str) -> str:
        row = rows.get(role)
        figure = '' if row is None else _figure(score, row['figures'][score], case['median'])
        return '' if row is None else figure + _lost(row)

    def share(role: str, score: str) -> str:
        return _number(rows[role]['figures'][score]['mean'])

    covered = ', '.join(f'{share("best", part)} ({share("optimum", part)})'
                        for part in ('coverage_1', 'coverage_2') if part in first['figures'])
    command = first['command'].removeprefix('ros2 run pif_ros ').removesuffix(' --out DIR')
    return [case['name'], case['printed'],
            *(error(role) for role in ('printed', 'best', 'sir', 'ekf', 'ukf', 'optimum')),
            covered, _figure('step_s', rows['best']['figures'].get('step_s'), False),
            f'`{command}`']


def _figure(score: str, figure: Mapping[str, Any] | None, median: bool) -> str:
    """Return a figure as a cell of a table, with its median where that is asked for."""
    if figure is None or figure['mean'] is None:
        return ''
    if score == 'step_s':
        return _duration(figure['median'])
    if score == 'start_s':
        return _duration(max(figure['values']))
    error = figure['standard_error']
    text = _number(figure['mean']) + (f' ± {_number(error)}' if error and error >= 5e-5 else '')
    return text + (f', med. {_number(figure["median"])}'
                   if median and score in ('rmse', 'to_optimum') else '')


def _lost(row: Mapping[str, Any]) -> str:
    return f' (lost in {len(row["lost"])} of {len(row["seeds"])})' if row['lost'] else ''


def _bounds(held: Mapping[str, Any]) -> str:
    bounds = [f'{word} {_number(held[side])}' for word, side in (
        ('at least', 'low'), ('at most', 'high')) if held[side] is not None]
    return ', '.join(bounds)


def _table(lines: list[list[str]]) -> str:
    """Return lines of cells as a Markdown table, the first its head."""
    widths = [max(map(len, column)) for column in zip(*lines)]
    text = ['| ' + ' | '.join(map(str.ljust, line, widths)) + ' |' for line in lines]
    text.insert(1, '|' + '|'.join('-' * (width + 2) for width in widths) + '|')
    return '\n'.join(text) + '\n'


def _number(value: float | None) -> str:
    """Return three significant digits without an exponent."""
    if value is None:
        return 'none'
    if abs(value) >= 1e5:
        return f'{value:.1e}'
    rounded = float(f'{value:.3g}')
    digits = 2 - int(np.floor(np.log10(abs(rounded)))) if rounded else 0
    return f'{value:.{min(max(digits, 0), 4)}f}'


def _duration(seconds: float) -> str:
    """Return a time in the unit that suits it."""
    for unit, size in (('s', 1.0), ('ms', 1e-3), ('us', 1e-6)):
        if seconds >= size:
            break
    return f'{_number(seconds / size)} {unit}'


def _versions() -> list[str]:
    found = []
    for name in PACKAGES:
        try:
            found.append(f'{name} {metadata.version(name)}')
        except metadata.PackageNotFoundError:
            continue
    return found


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.split(':', 1)[1].strip() for line in lines if line.startswith('model name')]
    return names[0] if names else platform.processor()
