"""Tables of what was measured, for people (Markdown) and for programs (JSON)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import datetime, timezone
from importlib import metadata
import json
import os
from pathlib import Path
import platform
import sys

from benchmarks.timing import ratio, Samples
import numpy as np

PACKAGES = ('numpy', 'scipy', 'stonesoup', 'particles', 'filterpy', 'PyWavelets', 'numba', 'rclpy')


@dataclass(frozen=True)
class Row:
    """
    One line of a table.

    median_s, p99_s: seconds per run, None where nothing was timed; ratio: how many times as long
    as the row named base, measured in turns with it; accuracy: figures by the name of their
    column.
    """

    name: str
    setting: str
    median_s: float | None = None
    p99_s: float | None = None
    ratio: float | None = None
    base: str = ''
    accuracy: Mapping[str, float | None] = field(default_factory=dict)

    @classmethod
    def timed(cls, name: str, setting: str, samples: Samples, base: Samples, base_name: str,
              accuracy: Mapping[str, float | None] | None = None) -> Row:
        """Return the row of some samples beside those of their base."""
        return cls(name, setting, float(np.median(samples)),
                   float(np.percentile(samples, 99)), ratio(samples, base), base_name,
                   accuracy or {})


@dataclass(frozen=True)
class Goal:
    """What a figure is to stay at or below."""

    what: str
    at_most: float
    got: float

    @property
    def met(self) -> bool:
        """Return whether it does."""
        return self.got <= self.at_most


@dataclass(frozen=True)
class Table:
    """What a case returns: rows, the goals they are held against, and what must be known."""

    title: str
    rows: Sequence[Row]
    notes: Sequence[str] = ()
    goals: Sequence[Goal] = ()

    def markdown(self) -> str:
        """Return the table, its goals and its notes."""
        columns = list(dict.fromkeys(name for row in self.rows for name in row.accuracy))
        lines = [['', 'setting', 'median', 'p99', 'ratio', 'to', *columns]]
        lines += [[row.name, row.setting, duration(row.median_s), duration(row.p99_s),
                   figure(row.ratio), row.base,
                   *(figure(row.accuracy.get(name)) for name in columns)] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(*lines)]
        text = ['| ' + ' | '.join(map(str.ljust, line, widths)) + ' |' for line in lines]
        text.insert(1, '|' + '|'.join('-' * (width + 2) for width in widths) + '|')
        goals = [f'- {goal.what}: at most {figure(goal.at_most)}, got {figure(goal.got)}'
                 f'{"" if goal.met else ", MISSED"}' for goal in self.goals]
        parts = [[f'## {self.title}'], text, goals, [f'- {note}' for note in self.notes]]
        return '\n\n'.join('\n'.join(part) for part in parts if part) + '\n'


def write(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Write results.md and results.json, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    facts = circumstances()
    text, data = folder / 'results.md', folder / 'results.json'
    head = '\n'.join(f'- {name}: {value}' for name, value in facts.items())
    text.write_text('\n'.join(['# Benchmarks\n', head + '\n',
                               *(table.markdown() for table in tables)]))
    data.write_text(json.dumps({**facts, 'tables': [asdict(table) for table in tables]},
                               indent=2) + '\n')
    return [text, data]


def circumstances() -> dict[str, str]:
    """Return when, where, with what and by which command it was measured."""
    return {'date': datetime.now(timezone.utc).strftime('%Y-%m-%d %H:%M UTC'),
            'command': ' '.join(['python', '-m', 'benchmarks', *sys.argv[1:]]),
            'machine': f'{_processor()}, {os.cpu_count()} cores',
            'load': ' '.join(f'{load:.1f}' for load in os.getloadavg())
                    + ' (processes in the last 1, 5, 15 minutes)',
            'threads': 'one per library',
            'versions': ', '.join([f'Python {platform.python_version()}', *_versions()])}


def duration(seconds: float | None) -> str:
    """Return a time in the unit that suits it, three digits."""
    if seconds is None:
        return ''
    for unit, size in (('s', 1.0), ('ms', 1e-3), ('us', 1e-6)):
        if seconds >= size:
            break
    return f'{figure(seconds / size)} {unit}'


def figure(value: float | None) -> str:
    """Return three significant digits without an exponent; nothing for None."""
    if value is None:
        return ''
    digits = 2 - int(np.floor(np.log10(abs(value)))) if value else 0
    return f'{value:.{min(max(digits, 0), 5)}f}'


def _versions() -> list[str]:
    found = []
    for name in PACKAGES:
        try:
            found.append(f'{name} {metadata.version(name)}')
        except metadata.PackageNotFoundError:
            found.append(f'{name} not there')
    return found


def _processor() -> str:
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:
        return platform.processor()
    facts = dict(line.split(':', 1) for line in lines if ':' in line)
    facts = {name.strip(): value.strip() for name, value in facts.items()}
    return (f'{facts.get("model name", platform.processor())} '
            f'(family {facts.get("cpu family", "?")}, model {facts.get("model", "?")})')
