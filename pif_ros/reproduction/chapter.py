"""One example from its name to its folder: run, summed up, drawn, written."""

from __future__ import annotations

from collections.abc import Sequence
import hashlib
from pathlib import Path
from typing import Any

import pif_ros
from pif_ros.reproduction.catalogue import find
from pif_ros.reproduction.report import Chapter, circumstances, FORMAT, read, write
from pif_ros.reproduction.runner import outcomes
from pif_ros.reproduction.summary import held, plain, rows


def make(name: str, seeds: Sequence[int], quick: bool, out: Path, resume: bool) -> Chapter:
    """
    Run an example and write its table, numbers and pictures into its folder in out.

    Returns what its results.json holds.  Where that is there already, of the same seeds, sizes and
    code, and may be resumed, nothing is run.
    """
    folder = out / name
    wanted = {'seeds': list(seeds), 'quick': quick, 'code': fingerprint()}
    found = read(folder) if resume else None
    if found is not None and {key: found[key] for key in wanted} == wanted:
        return found
    folder.mkdir(parents=True, exist_ok=True)
    example, command = find(name), _command(name, len(seeds), quick)
    cases, by_case = example.cases(quick, str(folder)), outcomes(name, seeds, quick)
    chapter: dict[str, Any] = {
        'format': FORMAT, 'example': name, 'title': example.TITLE, 'source': example.SOURCE,
        **wanted, 'made': circumstances(command), 'cases': [], 'pictures': []}
    for case, found_by_seed in zip(cases, by_case):
        made = rows(case, seeds, found_by_seed, command)
        chapter['cases'].append({
            'name': case.name, 'title': case.title, 'printed': case.printed,
            'median': case.median, 'rows': plain(made), 'remarks': list(case.remarks),
            'held': [] if quick else plain(held(case, made))})
    exhibits = {case.name: found_by_seed[0].exhibit for case, found_by_seed in zip(cases, by_case)}
    for file, picture in example.draw(exhibits).items():
        picture.savefig(folder / file, dpi=160)
        chapter['pictures'].append(file)
    write(chapter, folder)
    return chapter


def fingerprint() -> str:
    """Return a digest of this package's code; what other code found is not kept."""
    digest = hashlib.sha256()
    folder = Path(pif_ros.__file__).parent
    for part in ('core', 'reproduction'):
        for file in sorted((folder / part).rglob('*.py')):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _command(name: str, seeds: int, quick: bool) -> str:
    quickly = ' --quick' if quick else ''
    return f'ros2 run pif_ros reproduce {name} --seeds {seeds}{quickly} --out DIR'
