"""One example from its name to its folder: run, summed up, drawn, written."""

from __future__ import annotations

from collections.abc import Sequence
import hashlib
import json
from pathlib import Path
from typing import Any

import pif_ros
from pif_ros.reproduction.catalogue import find
from pif_ros.reproduction.report import circumstances, RESULTS, write
from pif_ros.reproduction.runner import outcomes
from pif_ros.reproduction.summary import held, plain, rows


def make(name: str, seeds: Sequence[int], quick: bool, out: Path, resume: bool) -> dict[str, Any]:
    """
    Run an example and write its table, numbers and pictures into its folder in out.

    Returns what its results.json holds.  Where that is there already, of the same seeds, sizes and
    code, and may be resumed, nothing is run.
    """
    folder, code = out / name, fingerprint()
    if resume and (found := _found(folder, {'seeds': list(seeds), 'quick': quick, 'code': code})):
        return found
    folder.mkdir(parents=True, exist_ok=True)
    example, command = find(name), _command(name, len(seeds), quick)
    cases, by_case = example.cases(quick), outcomes(name, seeds, quick)
    chapter: dict[str, Any] = {
        'example': name, 'title': example.TITLE, 'source': example.SOURCE, 'seeds': list(seeds),
        'quick': quick, 'code': code, 'made': circumstances(command), 'cases': [], 'pictures': []}
    for case, found_by_seed in zip(cases, by_case):
        made = rows(case, seeds, found_by_seed, command)
        chapter['cases'].append({
            'name': case.name, 'title': case.title, 'printed': case.printed,
            'median': case.median, 'rows': plain(made), 'held': plain(held(case, made)),
            'remarks': list(case.remarks)})
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


def _found(folder: Path, wanted: dict[str, Any]) -> dict[str, Any] | None:
    """Return what a folder has of what is wanted."""
    try:
        chapter: dict[str, Any] = json.loads((folder / RESULTS).read_text())
    except (OSError, ValueError):
        return None
    return chapter if {key: chapter.get(key) for key in wanted} == wanted else None


def _command(name: str, seeds: int, quick: bool) -> str:
    quickly = ' --quick' if quick else ''
    return f'ros2 run pif_ros reproduce {name} --seeds {seeds}{quickly} --out DIR'
