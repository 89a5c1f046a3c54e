"""
The file in which a state outlasts a restart.

    line 1   pif_ros state 1, the version
    8 bytes  length of the header, the lowest byte first
    32 bytes BLAKE2b of the header
    header   JSON: what the state is of, [name, type, shape] of each array, BLAKE2b of the arrays
    arrays   one after the other in C order, of <f8 or <i8: 64 bits, the lowest byte first

Nothing in it is ever run, and nothing is made of it before its size, its header and both sums are
what they should be.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import contextlib
import fcntl
import hashlib
import json
import math
import os
from pathlib import Path
import re
import secrets
import stat
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.saved import Arrays, Form

MAGIC, VERSION = b'pif_ros state ', b'1\n'
#: The most that a header and a whole file may take, in bytes.
LONGEST_HEADER, LARGEST = 1 << 20, 1 << 30
#: The first line, the length of the header, its sum.
PREAMBLE = len(MAGIC + VERSION) + 8 + 32
#: So much of a value is shown.
SHOWN = 80

Identity = Mapping[str, Any]
#: The file that is there: device, inode, size, time of the last change.
Mark = tuple[int, int, int, int]


class StateRefused(ValueError):
    """A file that is no state, or not one of this filter; a line says why."""


class Header(NamedTuple):
    """What a file says of itself."""

    identity: dict[str, Any]
    arrays: list[tuple[str, str, tuple[int, ...]]]
    digest: str


def write(path: Path, arrays: Mapping[str, NDArray[Any]], identity: Identity) -> Mark:
    """
    Put arrays of <f8 and <i8 in the place of a file, all or nothing; return what is there now.

    Whenever it is interrupted, the file is the old one or the new one, which is on the disk before
    it takes the old one's place.  Of several writers at once the last one's is there in the end.
    What is interrupted leaves NAME.PID.TOKEN.partial, which the next write removes.  Raises
    OSError where it cannot be written, StateRefused where it is too large; the old file is still
    there then.
    """
    header = _encoded(arrays, identity)
    if PREAMBLE + len(header) + sum(array.nbytes for array in arrays.values()) > LARGEST:
        raise StateRefused(f'expected a state of at most {LARGEST} bytes, got a larger one')
    _remove_stale(path)
    partial = path.with_name(f'{path.name}.{os.getpid()}.{secrets.token_hex(4)}.partial')
    handle = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    try:
        with os.fdopen(handle, 'wb') as file:
            _lock(handle)
            file.write(MAGIC + VERSION + len(header).to_bytes(8, 'little') + _sum(header) + header)
            for array in arrays.values():
                file.write(_bytes(array))
            file.flush()
            os.fsync(file.fileno())
            mark = _mark(os.fstat(file.fileno()))
            os.replace(partial, path)
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise
    _sync_folder(path.parent)
    return mark


def read(path: Path, identity: Identity,
         layouts: Sequence[Mapping[str, Form]]) -> tuple[Arrays, Mark]:
    """
    Return the arrays of a file, which are those of one of some layouts, and what is there.

    Raises StateRefused for all else than a sound file of the same identity, OSError where it
    cannot be read.  Takes no more memory than its arrays do, and these are LARGEST at most.
    """
    # a pipe would let wait whoever opens it
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    with os.fdopen(handle, 'rb') as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode):
            raise StateRefused('expected a regular file, got something else')
        if not PREAMBLE <= status.st_size <= LARGEST:
            raise StateRefused(f'expected {PREAMBLE} to {LARGEST} bytes, got {status.st_size}')
        header, used = _read_header(file, status.st_size)
        _check_identity(identity, header.identity)
        _check_layout(header.arrays, layouts)
        if used + 8 * sum(math.prod(shape) for *_, shape in header.arrays) != status.st_size:
            raise StateRefused('expected as many bytes as the arrays have, got '
                               f'{status.st_size - used}')
        return _read_arrays(file, header), _mark(status)


def mark_of(path: Path) -> Mark | None:
    """Return what is at a path, None where nothing is; OSError where that cannot be told."""
    try:
        return _mark(os.stat(path))
    except FileNotFoundError:
        return None


def _remove_stale(path: Path) -> None:
    """Remove what writers of a file left half written; those that still write hold a lock."""
    left = re.compile(rf'{re.escape(path.name)}\.\d+\.[0-9a-f]{{8}}\.partial')
    with contextlib.suppress(OSError):
        for name in filter(left.fullmatch, os.listdir(path.parent)):
            with contextlib.suppress(OSError):
                handle = os.open(path.with_name(name), os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
                with os.fdopen(handle, 'rb'):
                    fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    path.with_name(name).unlink()


def _lock(handle: int) -> None:
    """Tell other writers that this one lives, where files can be locked."""
    with contextlib.suppress(OSError):
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _encoded(arrays: Mapping[str, NDArray[Any]], identity: Identity) -> bytes:
    digest = hashlib.blake2b(digest_size=32)
    for array in arrays.values():
        digest.update(_bytes(array))
    header = {'of': dict(identity), 'blake2b': digest.hexdigest(), 'arrays': [
        [name, array.dtype.newbyteorder('<').str, list(array.shape)]
        for name, array in arrays.items()]}
    encoded = json.dumps(header, allow_nan=False).encode()
    if len(encoded) > LONGEST_HEADER:
        raise StateRefused(f'header: expected at most {LONGEST_HEADER} bytes, got {len(encoded)}')
    return encoded


def _read_header(file: BinaryIO, size: int) -> tuple[Header, int]:
    """Return the header of a file of some size, and where it ends; StateRefused for none."""
    first = file.read(len(MAGIC + VERSION))
    if not first.startswith(MAGIC):
        raise StateRefused(f'expected a file that begins with {MAGIC.decode()!r}, '
                           f'got {first[:len(MAGIC)]!r}')
    if first != MAGIC + VERSION:
        raise StateRefused(f'version: expected {VERSION.decode().strip()}, '
                           f'got {first[len(MAGIC):].strip()!r}')
    length = int.from_bytes(file.read(8), 'little')
    wanted = file.read(32)
    if not 2 <= length <= min(LONGEST_HEADER, size - PREAMBLE):
        raise StateRefused(f'header: expected at most {LONGEST_HEADER} bytes that are there, '
                           f'got {length}')
    encoded = file.read(length)
    if _sum(encoded) != wanted:
        raise StateRefused('header: expected the sum that goes with it, got another')
    return _decoded(encoded), PREAMBLE + length


def _decoded(encoded: bytes) -> Header:
    try:
        tree = json.loads(encoded, parse_int=_whole, parse_constant=_refused)
        identity, digest, arrays = tree['of'], tree['blake2b'], tree['arrays']
        table = [(name, kind, tuple(shape)) for name, kind, shape in arrays]
    except (ValueError, TypeError, KeyError, RecursionError):
        table = None
    if (table is None or not isinstance(identity, dict) or not isinstance(digest, str)
            or not all(isinstance(name, str) and isinstance(kind, str)
                       and all(type(n) is int and 0 <= n <= LARGEST for n in shape)
                       for name, kind, shape in table)):
        raise StateRefused('header: expected identity, arrays and their sum, got something else')
    return Header(identity, table, digest)


def _check_identity(wanted: Identity, found: Identity) -> None:
    """Refuse the state of another filter; the line names the first parameter that differs."""
    for name in {**wanted, **found}:
        if name not in wanted or name not in found or wanted[name] != found[name]:
            raise StateRefused(f'{_short(name, str)}: expected {_value(name, wanted)} as it is '
                               f'now, got a state with {_value(name, found)}')


def _check_layout(arrays: Sequence[tuple[str, str, tuple[int, ...]]],
                  layouts: Sequence[Mapping[str, Form]]) -> None:
    """Refuse other arrays than those of a layout, before there is any."""
    names = [name for name, *_ in arrays]
    for layout in layouts:
        if sorted(layout) == sorted(names):
            break
    else:
        raise StateRefused(f'arrays: expected {len(layouts[0])} of known names, got {len(names)}')
    for name, kind, shape in arrays:
        if not layout[name].allows(kind, shape):
            raise StateRefused(f'{name}: expected {layout[name]}, '
                               f'got {_short(kind, str)} {_short(list(shape))}')


def _read_arrays(file: BinaryIO, header: Header) -> Arrays:
    """Return the arrays, each in memory of its own; StateRefused where their sum is another."""
    arrays, digest = {}, hashlib.blake2b(digest_size=32)
    for name, kind, shape in header.arrays:
        array = np.empty(shape, dtype=kind)
        if file.readinto(_bytes(array)) != array.nbytes:  # type: ignore[attr-defined]
            raise StateRefused(f'{name}: expected {array.nbytes} bytes, got fewer')
        digest.update(_bytes(array))
        arrays[name] = array
    if digest.hexdigest() != header.digest:
        raise StateRefused('arrays: expected the sum that goes with them, got another')
    return arrays


def _bytes(array: NDArray[Any]) -> memoryview:
    """Return the bytes of an array in C order, which are those of the array itself."""
    return array.reshape(-1).view(np.uint8).data


def _sum(encoded: bytes) -> bytes:
    return hashlib.blake2b(encoded, digest_size=32).digest()


def _mark(status: os.stat_result) -> Mark:
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _sync_folder(folder: Path) -> None:
    """Let the disk know of a new name, where folders can be told so."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _whole(digits: str) -> int:
    if len(digits) > 20:
        raise ValueError
    return int(digits)


def _refused(constant: str) -> float:
    raise ValueError


def _value(name: str, identity: Identity) -> str:
    return _short(identity[name]) if name in identity else 'none'


def _short(value: Any, shown: Any = repr) -> str:
    """Return a value as a piece of a line."""
    text = shown(value)
    if not text.isprintable():
        text = repr(text)
    return text if len(text) <= SHOWN else f'{text[:SHOWN]}...'
