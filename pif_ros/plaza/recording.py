"""The Plaza recordings: ranges to four radio beacons, odometry, and where the mower really was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import distribution, PackageNotFoundError
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.io import loadmat

Array = NDArray[np.float64]

NAMES = ('Plaza1', 'Plaza2')
_COLUMNS = {'GT': 4, 'TD': 4, 'TL': 3, 'DR': 3}
_OPTIONAL = ('DR',)
#: Metres from one pose to the next that tell in which direction it drives.
_FAR = 0.05


@dataclass(frozen=True, eq=False)
class Recording:
    """
    A drive among beacons; the ranges stand in the order in which they were received.

    truth_stamps_ns: (t,) increasing; truth: (t, 3), x and y in metres, and the heading in which
    it drives, in radians;
    range_stamps_ns: (k,) when each range was taken; beacon_ids: (k,); ranges: (k,) in metres, as
    read by the radios; beacons: where each beacon stands, in metres; odometry: (j, 2), speed in
    m/s and rate of turn in rad/s from odometry_stamps_ns (j,) to odometry_ends_ns (j,), where the
    next interval starts; j is 0 where none was recorded.
    """

    name: str
    truth_stamps_ns: NDArray[np.int64]
    truth: NDArray[np.float64]
    range_stamps_ns: NDArray[np.int64]
    beacon_ids: NDArray[np.int64]
    ranges: NDArray[np.float64]
    beacons: Mapping[int, tuple[float, float]]
    odometry_stamps_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    odometry_ends_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    odometry: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        """Refuse truth out of order, and ranges to beacons that stand nowhere."""
        if len(self.truth_stamps_ns) == 0 or len(self.range_stamps_ns) == 0:
            raise ValueError(f'{self.name}: expected at least one pose and one range')
        if np.any(np.diff(self.truth_stamps_ns) <= 0):
            raise ValueError(f'{self.name}: expected increasing stamps of the truth')
        if np.any(self.odometry_ends_ns <= self.odometry_stamps_ns):
            raise ValueError(f'{self.name}: expected increasing stamps of the odometry')
        unknown = set(self.beacon_ids.tolist()) - set(self.beacons)
        if unknown:
            raise ValueError(f'{self.name}: no position of beacon {min(unknown)}')

    @property
    def start_ns(self) -> int:
        """Return the stamp of the first known pose, which is time zero of every picture."""
        return int(self.truth_stamps_ns[0])

    @property
    def arrivals_ns(self) -> NDArray[np.int64]:
        """Return when each range arrived: no earlier than any range received before it."""
        return np.maximum.accumulate(self.range_stamps_ns)

    def seconds(self, stamps_ns: ArrayLike) -> NDArray[np.float64]:
        """Return stamps as seconds since the start."""
        elapsed = np.asarray(stamps_ns, dtype=np.int64) - self.start_ns
        return np.asarray(elapsed * 1e-9, dtype=np.float64)

    def truth_at(self, stamps_ns: ArrayLike) -> NDArray[np.float64]:
        """
        Return x, y and the unwrapped heading at the stamps, (..., 3), linear between the poses.

        ValueError where a stamp lies outside the truth.
        """
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        first, last = self.truth_stamps_ns[[0, -1]]
        if np.any((stamps < first) | (stamps > last)):
            raise ValueError(f'expected stamps between {first} and {last} ns')
        x, y, heading = self.truth.T
        at, known = self.seconds(stamps), self.seconds(self.truth_stamps_ns)
        return np.stack([np.interp(at, known, v) for v in (x, y, np.unwrap(heading))], axis=-1)


def load(name: str = 'Plaza1', path: str | Path | None = None) -> Recording:
    """
    Return a recording, from a .mat file at `path` or from the data that come with gtsam.

    ValueError or FileNotFoundError say in one line what is missing or wrong.
    """
    if name not in NAMES:
        raise ValueError(f"expected a recording of {' or '.join(NAMES)}, got {name!r}")
    file = Path(path) if path else _shipped(name)
    if not file.is_file():
        raise FileNotFoundError(f'no such recording: {file}')
    try:
        content = loadmat(str(file), variable_names=list(_COLUMNS))
    except Exception as e:  # loadmat raises half a dozen types, struct.error among them
        raise ValueError(f'{file} is no MATLAB file: {e}') from None
    tables = {key: _table(file, content, key) for key in _COLUMNS
              if key in content or key not in _OPTIONAL}
    return _assemble(name, **tables)


def _shipped(name: str) -> Path:
    """Find the recording in the installed distribution of gtsam, which need not be importable."""
    hint = f'{name} comes with gtsam: pip install --no-deps gtsam, or give the path of its file'
    try:
        file = Path(str(distribution('gtsam').locate_file(f'gtsam/Data/{name}_.mat')))
    except PackageNotFoundError:
        raise FileNotFoundError(hint) from None
    if not file.is_file():
        raise FileNotFoundError(hint)
    return file


def _table(file: Path, content: Mapping[str, object], key: str) -> NDArray[np.float64]:
    """Return a table of the file, refusing a wrong shape and values that are not finite."""
    columns = _COLUMNS[key]
    if key not in content:
        raise ValueError(f'{file}: expected a table {key}')
    table = np.asarray(content[key])
    if table.ndim != 2 or table.shape[1] != columns or not np.issubdtype(table.dtype, np.number):
        raise ValueError(f'{file}: expected {key} of {columns} columns, got {table.shape}')
    if not np.all(np.isfinite(table)):
        raise ValueError(f'{file}: expected finite numbers in {key}')
    return np.asarray(table, dtype=float)


def _assemble(name: str, GT: Array, TD: Array, TL: Array,
              DR: Array = np.zeros((0, 3))) -> Recording:
    """
    Name the columns of GT (time, x, y, heading), TD (time, antenna, beacon, range), TL and DR.

    A row of DR (time, distance, change of heading) tells of the time since the row before; of the
    first row's interval the start is not known.
    """
    ends = _nanoseconds(DR[:, 0])
    return Recording(
        name=name,
        truth_stamps_ns=_nanoseconds(GT[:, 0]), truth=_forwards(GT[:, 1:]),
        range_stamps_ns=_nanoseconds(TD[:, 0]),
        beacon_ids=TD[:, 2].astype(np.int64), ranges=TD[:, 3],
        beacons=MappingProxyType(
            {int(b): (float(x), float(y)) for b, x, y in sorted(TL.tolist())}),
        odometry_stamps_ns=ends[:-1], odometry_ends_ns=ends[1:],
        odometry=_rates(DR[1:, 1:], np.diff(ends)))


def _forwards(poses: Array) -> Array:
    """Return poses with headings in which it drives: one of the files has them point backwards."""
    moved, heading = np.diff(poses[:, :2], axis=0), poses[:-1, 2]
    far = np.hypot(*moved.T) > _FAR
    off = np.angle(np.sum(np.exp(1j * (np.arctan2(moved[:, 1], moved[:, 0]) - heading)[far])))
    if abs(off) < np.pi / 2:
        return poses
    return np.column_stack([poses[:, :2], (poses[:, 2] + 2 * np.pi) % (2 * np.pi) - np.pi])


def _rates(moved: Array, nanoseconds: NDArray[np.int64]) -> Array:
    """Return what moved in some times as rates per second; no number where there was no time."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return moved / (nanoseconds * 1e-9)[:, None]


def _nanoseconds(seconds: NDArray[np.float64]) -> NDArray[np.int64]:
    return np.rint(seconds * 1e9).astype(np.int64)
