"""Files that are no state, made from one that is."""

from __future__ import annotations

from collections.abc import Callable
import copy
import json
import math
import os
from pathlib import Path
import pickle
from typing import Any

import numpy as np
from pif_ros import state_file
from pif_ros.config import build_tracker, Config, identity
from pif_ros.core.estimates import Measurement
from pif_ros.keeper import FAILURES, Keeper, PUBLISHED

SECOND = 1_000_000_000
NOW = 2_000 * SECOND
PLANE: dict[str, Any] = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [12, 10], 'prior.mean': [0.5, 0.0], 'prior.covariance_diagonal': [1.0, 0.5],
    'kernel.time_step': 0.1, 'filter.particles': 100, 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.4}
DRIVEN: dict[str, Any] = {
    'model.name': 'unicycle_2d', 'grid.lower': [-4.0, -3.0, -math.pi],
    'grid.upper': [4.0, 5.0, math.pi], 'grid.shape': [12, 10, 8],
    'grid.periodic': [False, False, True], 'prior.mean': [0.5, 0.0, 0.0],
    'prior.covariance_diagonal': [0.2, 0.2, 0.1]}
FILTERS: tuple[dict[str, Any], ...] = (
    {}, {'region.kind': 'active'}, {'filter.type': 'dfy'}, {'filter.type': 'particle'},
    {'filter.type': 'ekf'}, {'filter.type': 'ekf_continuous'}, {'filter.type': 'ukf'}, DRIVEN,
    {**DRIVEN, 'filter.type': 'ekf_continuous'})


class Victim:
    """A tracker with a state file of its own, whose sound bytes are known."""

    def __init__(self, parameters: dict[str, Any], folder: Path) -> None:
        """Measure for a second and save."""
        folder.mkdir()
        self.file = folder / 'state'
        self.trap = folder / 'trap'
        self.config = Config.from_parameters({**PLANE, **parameters, 'state_file': str(self.file)})
        self.tracker = build_tracker(self.config)
        self._keeper = Keeper(self.config, self.tracker, lambda kind, line: None)
        for k in range(12):
            self.tracker.observe(Measurement(1_000 * SECOND + k * SECOND // 7, 'main',
                                             (0.3 + 0.02 * k, 0.1 * k)))
            if self.tracker.filter.model.inputs:
                self.tracker.control(1_000 * SECOND + k * SECOND // 5, (0.1 * k, -0.2))
            self.tracker.estimate()
        self._keeper.save(1_002 * SECOND)
        self._keeper.close(1_002 * SECOND)
        self.sound = self.file.read_bytes()
        self.arrays, _ = state_file.read(self.file, self.identity, self._keeper._layouts())
        self.believed = bits(self.tracker)

    @property
    def identity(self) -> dict[str, Any]:
        """Return what its states are states of."""
        return identity(self.config)

    def written(self, arrays: dict[str, Any], of: dict[str, Any]) -> bytes:
        """Return a file of some arrays and identity, with sums that are right."""
        other = self.file.with_name('other')
        state_file.write(other, arrays, of)
        return other.read_bytes()

    def refusal(self) -> str | None:
        """Return the line with which the file is refused, None where it is not."""
        try:
            self._keeper.load(NOW)
        except FAILURES as error:
            return self._keeper.refusal(error)
        return None

    def try_on(self) -> None:
        """Go on from the file for a second, then be who one was."""
        before, (memory, _) = self.tracker.memory(), self._keeper.load(NOW)
        self.tracker.recall(memory)
        newest = self.tracker.estimate()
        self.tracker.forecast((newest.stamp_ns or 0) + SECOND)
        self.tracker.recall(before)
        self.tracker.estimate()


Damage = Callable[[Victim, np.random.Generator], bytes]


def bits(tracker: Any) -> list[bytes]:
    """Return what a tracker remembers, to the last bit."""
    memory, newest = tracker.memory(), tracker.newest
    return [repr((memory.measurements, memory.controls, memory.anchored)).encode(),
            *(np.asarray(part).tobytes() for belief in (memory.anchor.belief, newest.belief)
              for part in (belief.mean(), belief.covariance(), belief.mass)),
            repr((memory.anchor.stamp_ns, newest.stamp_ns, newest.total_log_evidence)).encode()]


def _flipped(victim: Victim, rng: np.random.Generator) -> bytes:
    data = bytearray(victim.sound)
    for _ in range(rng.integers(1, 4)):
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    return bytes(data) if bytes(data) != victim.sound else _flipped(victim, rng)


def _cut(victim: Victim, rng: np.random.Generator) -> bytes:
    return victim.sound[:rng.integers(len(victim.sound))]


def _longer(victim: Victim, rng: np.random.Generator) -> bytes:
    return victim.sound + rng.bytes(int(rng.integers(1, 100)))


def _torn(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return what a disk leaves that lost a block."""
    data, first = bytearray(victim.sound), int(rng.integers(len(victim.sound)))
    data[first:first + 512] = bytes(len(data[first:first + 512]))
    return bytes(data) if bytes(data) != victim.sound else _torn(victim, rng)


class _Trap:
    """Touches a file where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self._path),)


def _pickled(victim: Victim, rng: np.random.Generator) -> bytes:
    data = pickle.dumps(_Trap(victim.trap), protocol=int(rng.integers(6)))
    if rng.random() < 0.5:
        return data
    # where a header is expected
    return _with_header(data, b'')


def _foreign(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return a file of another kind."""
    other = victim.file.with_name('other.npz')
    np.savez(other, density=np.array([_Trap(victim.trap)], dtype=object))
    kinds = [b'', b'\0' * 300, rng.bytes(300), other.read_bytes(), b'{"of": {}}', b'pif_ros state',
             b'#!/bin/sh\ntouch trap\n', state_file.MAGIC + state_file.VERSION]
    return kinds[rng.integers(len(kinds))]


def _of_another_version(victim: Victim, rng: np.random.Generator) -> bytes:
    versions = [b'2', b'0', b'9', b'\n', b'\xff', b'A', b' ']
    return (state_file.MAGIC + versions[rng.integers(len(versions))] + b'\n'
            + victim.sound[len(state_file.MAGIC) + 2:])


def _with_header(header: bytes, arrays: bytes) -> bytes:
    """Return a file with a header whose sum is right."""
    return (state_file.MAGIC + state_file.VERSION + len(header).to_bytes(8, 'little')
            + state_file._sum(header) + header + arrays)


def _parts(victim: Victim) -> tuple[dict[str, Any], bytes]:
    """Return the header of the sound file, and its arrays."""
    start = state_file.PREAMBLE
    length = int.from_bytes(victim.sound[start - 40:start - 32], 'little')
    return json.loads(victim.sound[start:start + length]), victim.sound[start + length:]


def _forged(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return a file whose header tells of other arrays than there are."""
    header, arrays = _parts(victim)
    table = header['arrays']
    entry = table[rng.integers(len(table))]
    size = math.prod(entry[2])
    wrong = [[], [-1], [-size], [1 << 40], [1 << 29, 1 << 29], [1 << 63, 1 << 63], [10**19],
             [size + 1], [0.5], [True, True, True], ['8'], [[1]], [None], [1] * 40, 'ab', None, 8,
             [0, 1 << 30, 1 << 30], [2] * 64]
    kinds = ['O', '|O', '>f8', '<f4', '<c16', 'V8', '<U2', '<f8,<f8', 'f8', 'object', 'S8', 8,
             None, '__import__("os")', '<M8[ns]']
    way = rng.integers(6)
    if way < 3:
        entry[2] = wrong[rng.integers(len(wrong))]
    elif way == 3:
        entry[1] = kinds[rng.integers(len(kinds))]
    elif way == 4:
        entry[0] = ['', 'x' * 5000, 'a\nb', '\x1b[31m', '../../etc/passwd', 7][rng.integers(6)]
    else:
        table.append(copy.deepcopy(entry))
    return _with_header(json.dumps(header).encode(), arrays)


def _bomb(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return a file whose header is no table at all, and large where that may hurt."""
    bombs = [b'[' * 500_000, b'{"a":' * 200_000, b'9' * 1_000_000, b'"' + b'\\' * 999_999,
             b'{"of": {}, "blake2b": "", "arrays": [[]]}', b'{"of": [], "blake2b": 3}', b'null',
             b'{"of": {}, "blake2b": "", "arrays": [' + b'["a", "<f8", [1]],' * 50_000 + b'0]}',
             b'{"of": NaN}', b'1e99999', b'\xff\xfe\xfd', b'\0' * 1000, b'[]', b'""']
    header = bombs[rng.integers(len(bombs))]
    if rng.random() < 0.2:
        return (state_file.MAGIC + state_file.VERSION + b'\xff' * 8 + state_file._sum(header)
                + header)
    return _with_header(header, b'\0' * 64)


def _of_another(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return the state of another filter, or the same arrays said to be another's."""
    of = victim.identity
    name = list(of)[rng.integers(len(of))]
    way = rng.integers(4)
    if way == 0:
        of[name] = [of[name], 'x', 1]
    elif way == 1:
        of[name] = 'line\nof\r\x1b[2Jmany' * 500
    elif way == 2:
        del of[name]
    else:
        of['x' * int(rng.integers(1, 2000)) + '\n'] = 1
    return victim.written(victim.arrays, of)


def _impossible(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return a file that is right in all but a number, which no state can have."""
    arrays = {name: array.copy() for name, array in victim.arrays.items()}
    stamps, values = arrays['measurements.stamps_ns'], arrays['measurements.values']
    # but the path's own values, which may be anything, and weights, of which some may be none
    belief = [name for name, a in arrays.items() if name.startswith('belief.')
              and a.dtype == '<f8' and a.size and not name.endswith(('.y', '.log_weights'))]
    array = arrays[belief[rng.integers(len(belief))]]
    way = rng.integers(8)
    if way == 0:
        array.flat[rng.integers(array.size)] = [math.inf, math.nan][rng.integers(2)]
    elif way == 1:
        array.flat[:] = 1e300
    elif way == 2:
        values[rng.integers(values.size)] = [math.nan, math.inf][rng.integers(2)]
    elif way == 3:
        stamps[[0, -1]] = stamps[[-1, 0]]
    elif way == 4:
        arrays['measurements.sources'][0] = [-1, 1, 2**62, -2**63][rng.integers(4)]
    elif way == 5:
        stamps[0] = -2**63
    elif way == 6:
        arrays['anchor.total_log_evidence'][0] = math.nan
    else:
        # a state from a time to come
        arrays[PUBLISHED][0] = [2 * NOW, 2**63 - 1][rng.integers(2)]
    return victim.written(arrays, victim.identity)


def fuzzed(victim: Victim, rng: np.random.Generator) -> bytes:
    """Return a file with right sums and some numbers that are anything."""
    arrays = {name: array.copy() for name, array in victim.arrays.items()}
    for array in arrays.values():
        if array.size and rng.random() < 0.2:
            for _ in range(rng.integers(1, 5)):
                wild = np.frombuffer(rng.bytes(8), dtype=array.dtype)[0]
                tame = [0, -1, 1, 2, 21, 2**31, 2**62][rng.integers(7)]
                array.flat[rng.integers(array.size)] = wild if rng.random() < 0.5 else tame
    return victim.written(arrays, victim.identity)


DAMAGE: dict[str, Damage] = {
    'with flipped bits': _flipped, 'cut short': _cut, 'too long': _longer,
    'with a lost block': _torn, 'pickles': _pickled, 'of another kind': _foreign,
    'of other versions': _of_another_version, 'with forged arrays': _forged,
    'with headers that are bombs': _bomb, 'of other filters': _of_another,
    'with impossible numbers': _impossible}
