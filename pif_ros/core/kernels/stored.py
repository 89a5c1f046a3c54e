"""Kernels kept in files: made once, used again under any sensor  [Sensors, sections 4.3, 5.3]."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
import hashlib
import os
from pathlib import Path
import secrets
import stat
import struct
from typing import BinaryIO
import zlib

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.grid import Grid
from pif_ros.core.kernels.settings import KernelSettings
from pif_ros.core.models import StateModel
from scipy import sparse

Array = NDArray[np.float64]

MAGIC = b'PIF-KERN'
#: Goes up with the layout of the file, and with what a kernel of the same settings is.
VERSION = 3
#: Magic, version, bytes of an index, fingerprint, cells, weights, and the payload's checksum; the
#: checksum of all these follows.  Then come CSR's row pointers, columns and weights, all little
#: endian.
HEADER = struct.Struct('<8sII64sQQI')
CHECKSUM = struct.Struct('<I')
#: A value counts to so many bits: the last digits of a sine are the processor's, not the model's.
BITS = 26
#: Settings that a tabulated kernel does not depend on.
FREE = ('form', 'macro_error', 'precision')
#: A smaller value, in cells and steps, is the rounding of a nought.
NOTHING = 1e-12
#: Cells past the edge, on each side, at which a model is looked at closely.
BESIDE = 2
#: How many times as wide as the world is what is looked at besides.
AROUND = 1.5


def fingerprint(model: StateModel, grid: Grid, settings: KernelSettings, t: float = 0.0) -> str:
    """
    Return what identifies the kernel of a step from time t: 64 hexadecimal digits.

    Models are functions, so they are told apart by their values, at several places of each cell
    and past the edges: drift, vielbein and their derivatives as far as they are given, and the
    noise, all of them in cells per step, so that the units play no part.  Nor does any sensor.
    """
    digest = hashlib.sha256(repr((
        VERSION, grid.lower, grid.upper, grid.shape, grid.periodic, float(model.s),
        [(name, float(value) if isinstance(value, (int, float)) else value)
         for name, value in sorted(asdict(settings).items()) if name not in FREE])).encode())
    tau = t + settings.r * settings.time_step
    for x in _places(grid):
        with np.errstate(all='ignore'):
            for values in _values(model, x, tau, grid.spacing, settings.time_step):
                digest.update(_digits(values))
    return digest.hexdigest()


def save_kernel(path: str | os.PathLike[str], kernel: sparse.csr_array,
                fingerprint: str) -> None:
    """
    Write a kernel to a file, whole or not at all.

    Raises ValueError for what is no kernel or no fingerprint, OSError where the file cannot be
    written.
    """
    rows, columns = kernel.shape
    index = np.dtype(f'<i{np.result_type(kernel.indptr, kernel.indices).itemsize}')
    arrays = [np.ascontiguousarray(kernel.indptr, index),
              np.ascontiguousarray(kernel.indices, index),
              np.ascontiguousarray(kernel.data, '<f8')]
    flaw = f'{rows} x {columns} of them' if rows != columns else _flaw(rows, *arrays)
    if flaw:
        raise ValueError(f'kernel: expected weights from cells to cells, got {flaw}')
    checksum = 0
    for array in arrays:
        checksum = zlib.crc32(_raw(array), checksum)
    head = HEADER.pack(MAGIC, VERSION, index.itemsize, _plain(fingerprint), rows,
                       len(arrays[2]), checksum)
    _write(Path(path), [head, CHECKSUM.pack(zlib.crc32(head)), *map(_raw, arrays)])


def load_kernel(path: str | os.PathLike[str], fingerprint: str, size: int) -> sparse.csr_array:
    """
    Return the kernel (size, size) of a file, bit for bit as it was saved.

    Raises ValueError for a file that is damaged, none of ours, or of another fingerprint or size,
    before it takes more memory than a kernel of this size, or than the file has bytes; OSError
    where there is no file or it cannot be read.
    """
    path, wanted = Path(path), _plain(fingerprint)
    # opened or not: a pipe would wait, a device never end
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError(f'{path}: expected a stored kernel, got no regular file')
    with open(path, 'rb') as file:
        index, weights, checksum = _read_header(file, path, wanted, size)
        arrays = [np.empty(size + 1, index), np.empty(weights, index), np.empty(weights, '<f8')]
        found = 0
        for array in arrays:
            if file.readinto(_raw(array)) != array.nbytes:
                raise ValueError(f'{path}: expected {array.nbytes} bytes more, got the end')
            found = zlib.crc32(_raw(array), found)
    if found != checksum:
        raise ValueError(f'{path}: expected the checksum {checksum:08x}, got {found:08x}: '
                         'the file is damaged')
    flaw = _flaw(size, *arrays)
    if flaw:
        raise ValueError(f'{path}: expected a kernel of {size} cells, got {flaw}')
    pointers, columns, data = arrays
    return sparse.csr_array((data.astype(float, copy=False), columns, pointers),
                            shape=(size, size))


def _places(grid: Grid) -> Iterator[Array]:
    """
    Give states (n, size) at a time: centres, corners and midpoints of the cells, and odd places.

    The odd places are those of wider worlds of as many cells: a step from the edge looks past it.
    """
    dx, shape = grid.spacing[:, None], np.array(grid.shape)[:, None]
    for part in (0.0, -0.5, *0.5 * np.eye(grid.ndim)[:, :, None]):
        yield grid.points + part * dx
    # the fractions of multiples of an irrational number fill the cell evenly
    odd = np.arange(grid.size) * np.sqrt([[2.0], [3.0], [5.0], [7.0]])[:grid.ndim] % 1 - 0.5
    middle = np.array(grid.lower)[:, None] + shape * dx / 2
    for wider in (1 + 2 * BESIDE / shape, AROUND):
        yield middle + wider * (grid.points + odd * dx - middle)


def _values(model: StateModel, x: Array, t: float, spacing: Array,
            eps: float) -> Iterator[Array]:
    """Give all that a kernel asks a model at states (n, N), in cells per step of eps seconds."""
    cells = 1 / spacing
    yield eps * _scaled(model.drift(x, t), cells)
    if model.drift_jacobian is not None:
        yield eps * _scaled(model.jacobian(x, t), cells, spacing)
    if not model.multiplicative:
        yield eps * _scaled(model.diffusion(t), cells, cells)
        return
    Q = model.noise(t)
    size = np.sqrt(np.diag(Q))
    size[size == 0] = 1.0
    yield _scaled(Q, 1 / size, 1 / size)
    size *= np.sqrt(eps)
    yield _scaled(model.vielbein_at(x, t), cells, size)
    if model.vielbein_jacobian is not None:
        yield _scaled(model.vielbein_jacobian_at(x, t), cells, size, spacing)


def _scaled(values: Array, *scales: Array) -> Array:
    """Return values with each of their first axes scaled."""
    scaled = np.asarray(values, dtype=float)
    for axis, scale in enumerate(scales):
        scaled = scaled * scale.reshape((-1,) + (1,) * (scaled.ndim - axis - 1))
    return scaled


def _digits(values: Array) -> bytes:
    """Return values rounded to BITS bits each; what is next to nothing is nothing."""
    given = np.asarray(values, dtype=float)
    defined = np.isfinite(given)
    known = np.where(defined & (np.abs(given) > NOTHING), given, 0.0)
    # a number next to a power of two, but for its last digit, is one
    exponent = np.frexp(known * (1 + 2.0**-40))[1]
    whole = np.rint(np.ldexp(known, BITS - exponent)).astype('<i8')
    whole[~defined] = np.iinfo('<i8').min
    return exponent.astype('<i8').tobytes() + whole.tobytes()


def _read_header(file: BinaryIO, path: Path, wanted: bytes,
                 size: int) -> tuple[np.dtype[np.signedinteger], int, int]:
    """Return type of an index, number of weights and checksum, all of them possible."""
    head, check = file.read(HEADER.size), file.read(CHECKSUM.size)
    if head[:len(MAGIC)] != MAGIC:
        raise ValueError(f'{path}: expected a stored kernel, got a file that begins with '
                         f'{head[:len(MAGIC)]!r}')
    if len(check) < CHECKSUM.size or CHECKSUM.unpack(check)[0] != zlib.crc32(head):
        raise ValueError(f'{path}: expected a stored kernel, got one whose header is damaged')
    _, version, width, mark, cells, weights, checksum = HEADER.unpack(head)
    length = HEADER.size + CHECKSUM.size + (cells + 1) * width + weights * (width + 8)
    for what, expected, found in (
            ('format', VERSION, version),
            ('fingerprint (of model, grid and settings)', wanted.decode(),
             mark.decode('ascii', 'replace')),
            ('number of cells', size, cells)):
        if found != expected:
            raise ValueError(f'{path}: expected the {what} {expected}, got {found}')
    if width not in (4, 8) or weights > size**2:
        raise ValueError(f'{path}: expected at most {size**2} weights with indices of 4 or 8 '
                         f'bytes, got {weights} with {width}')
    held = os.fstat(file.fileno()).st_size
    if held != length:
        raise ValueError(f'{path}: expected {length} bytes, got {held}')
    return np.dtype(f'<i{width}'), weights, checksum


def _flaw(size: int, pointers: NDArray[np.signedinteger], columns: NDArray[np.signedinteger],
          data: Array) -> str:
    """Return what keeps CSR's arrays from being a kernel (size, size), '' for nothing."""
    if (len(pointers) != size + 1 or pointers[0] != 0 or pointers[-1] != len(data)
            or len(columns) != len(data) or np.any(pointers[1:] < pointers[:-1])):
        return f'rows that do not add up to its {len(data)} weights'
    if len(data) and not (columns.min() >= 0 and columns.max() < size):
        return f'columns from {columns.min()} to {columns.max()}'
    if len(data) and not (data.min() >= 0 and data.max() < np.inf):
        return f'weights from {data.min():g} to {data.max():g}'
    return ''


def _raw(array: NDArray[np.generic]) -> memoryview:
    return array.view(np.uint8).data


def _plain(fingerprint: str) -> bytes:
    """Return a fingerprint as bytes; raise ValueError where it is none."""
    if len(fingerprint) != 64 or not set(fingerprint) <= set('0123456789abcdef'):
        raise ValueError(f'fingerprint: expected 64 hexadecimal digits, got {fingerprint!r}')
    return fingerprint.encode()


def _write(path: Path, parts: list[bytes | memoryview]) -> None:
    """Write a file beside its place and move it there once it is on the disk."""
    beside = path.with_name(f'.{path.name}.{secrets.token_hex(8)}')
    try:
        with open(beside, 'xb') as file:
            for part in parts:
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        beside.unlink(missing_ok=True)
        raise
