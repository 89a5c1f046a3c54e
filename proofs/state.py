"""The state file: 100 kills while it is written, and 1,000 files that are no state."""

from __future__ import annotations

from collections.abc import Iterator
import itertools
import multiprocessing
from pathlib import Path
import resource
import tempfile
import time

import numpy as np
from pif_ros import state_file
from pif_ros.core.saved import Form

from proofs.damage import bits, DAMAGE, FILTERS, fuzzed, Victim

KILLS, DAMAGES, SEED = 100, 1000, 5
#: What is written while it is killed: its number, and as many times the same number.
NUMBER, CELLS = 'number', 1 << 18
LAYOUT = {NUMBER: Form('<i8', (1,)), 'cells': Form('<f8', (CELLS,))}
#: A moment of the writing, in seconds, at which it is killed at the latest.
LATEST = 0.05
#: How much more memory refusing may take than there was, in bytes; the states have a few thousand.
MEMORY = 64e6


def run(share: float = 1.0) -> list[str]:
    """Prove both, or a share of each; AssertionError where one does not hold."""
    with tempfile.TemporaryDirectory() as folder:
        return [killed(max(round(share * KILLS), 4), Path(folder)),
                *damaged(max(round(share * DAMAGES), 2 * len(DAMAGE)), Path(folder))]


# Killed while it writes


def killed(count: int, folder: Path) -> str:
    """Kill so many processes that write a file, and find it whole each time, or none yet."""
    context, rng = multiprocessing.get_context('forkserver'), _seeded('kills')
    path = folder / 'killed'
    context.set_forkserver_preload([__name__])
    within = none = 0
    for k in range(count):
        # every other time there is no file yet, and it is killed at its first
        for partial in _partials(folder):
            partial.unlink(missing_ok=True)
        if k % 2 == 0:
            path.unlink(missing_ok=True)
        known = _number(path)
        writer = context.Process(target=write_for_ever, args=(path, (known or 0) + 1))
        writer.start()
        while not _partials(folder) and _number(path) == known:
            assert writer.is_alive(), 'it ended by itself'
            time.sleep(0.0005)
        time.sleep(rng.uniform(0, LATEST if k % 2 else LATEST / 5))
        writer.kill()
        writer.join()
        assert writer.exitcode == -9, f'it ended by itself: {writer.exitcode}'
        found = _number(path)
        assert found is not None or known is None, 'the file that was there is gone'
        assert (found or 0) >= (known or 0), 'an older file than before'
        none += found is None
        within += bool(_partials(folder))
    return (f'{count} processes were killed while they wrote one file after the other, {within} '
            f'with one half written: {count - none} files, all of them whole, and {none} times '
            'none yet')


def write_for_ever(path: Path, first: int) -> None:
    """Write one file after the other."""
    for number in itertools.count(first):
        arrays = {NUMBER: np.array([number]), 'cells': np.full(CELLS, float(number))}
        state_file.write(path, arrays, {})


def _partials(folder: Path) -> list[Path]:
    """Return what is half written."""
    return list(folder.glob('killed.*.partial'))


def _number(path: Path) -> int | None:
    """Return which file is there, None for none; AssertionError for part of one."""
    try:
        arrays, _ = state_file.read(path, {}, [LAYOUT])
    except FileNotFoundError:
        return None
    except state_file.StateRefused as error:
        raise AssertionError(f'a file that is no state: {error}') from None
    number = int(arrays[NUMBER][0])
    assert np.all(arrays['cells'] == number), 'a file of two writes'
    return number


# Damaged


def damaged(count: int, folder: Path) -> list[str]:
    """Offer so many files that are no state to every filter, and half as many wild ones."""
    victims = [Victim(more, folder / str(k)) for k, more in enumerate(FILTERS)]
    for victim in victims:
        victim.file.write_bytes(victim.sound)
        assert victim.refusal() is None, 'a sound file was refused'
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    lines = [_refused(count, victims), _wild(count // 2, victims)]
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert more < MEMORY, f'{more / 1e6:.0f} MB more were taken'
    return [*lines, f'all of this took {more / 1e6:.1f} MB more than before at most']


def _refused(count: int, victims: list[Victim]) -> str:
    """Offer so many files that are no state: each is refused in a line."""
    rng, kinds = _seeded('damages'), dict.fromkeys(DAMAGE, 0)
    for kind, victim, _ in zip(itertools.cycle(DAMAGE), _shuffled(victims, rng), range(count)):
        data = DAMAGE[kind](victim, rng)
        victim.file.write_bytes(data)
        line = victim.refusal()
        assert line is not None, f'{kind}: it was taken'
        _check_refusal(kind, line, victim, data)
        kinds[kind] += 1
    return (f'{count} damaged files were refused in a line, with nothing touched: '
            + ', '.join(f'{number} {kind}' for kind, number in kinds.items()))


def _wild(count: int, victims: list[Victim]) -> str:
    """Offer so many files with wild numbers and right sums: what is taken can be gone on from."""
    rng, taken = _seeded('wild'), 0
    for victim, _ in zip(_shuffled(victims, rng), range(count)):
        data = fuzzed(victim, rng)
        victim.file.write_bytes(data)
        line = victim.refusal()
        if line is None:
            victim.try_on()
            taken += 1
        _check_refusal('wild', line or '', victim, data)
    return (f'{count} files with wild numbers and right sums: {count - taken} refused, '
            f'{taken} found to be states and gone on from')


def _check_refusal(kind: str, line: str, victim: Victim, data: bytes) -> None:
    assert len(line.splitlines()) < 2 and line.isprintable(), f'{kind}: not a line: {line!r}'
    assert len(line) < 500, f'{kind}: a line of {len(line)} characters'
    assert bits(victim.tracker) == victim.believed, f'{kind}: another belief'
    assert victim.file.read_bytes() == data, f'{kind}: another file'
    assert not victim.trap.exists(), f'{kind}: it was run'


def _shuffled(victims: list[Victim], rng: np.random.Generator) -> Iterator[Victim]:
    """Yield victims for ever."""
    while True:
        yield victims[rng.integers(len(victims))]


def _seeded(what: str) -> np.random.Generator:
    return np.random.default_rng([SEED, *what.encode()])
