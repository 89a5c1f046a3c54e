"""How far a recording has been played, on stderr."""

from __future__ import annotations

from importlib.util import find_spec
import sys


class Progress:
    """A bar on a terminal; elsewhere, and without tqdm, a line every ten per cent."""

    def __init__(self, first_ns: int, last_ns: int) -> None:
        """Start at the first stamp, to end at the last."""
        self._first_ns = first_ns
        self._total_ns = max(last_ns - first_ns, 1)
        self._tenths = 0
        self._bar = None
        if sys.stderr.isatty() and find_spec('tqdm') is not None:
            from tqdm import tqdm
            self._bar = tqdm(
                total=self._total_ns * 1e-9, desc='recording', leave=True,
                bar_format='{desc} {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s [{elapsed}]')

    def show(self, stamp_ns: int) -> None:
        """Show that the recording has been played up to a stamp."""
        done_ns = stamp_ns - self._first_ns
        tenths = 10 * done_ns // self._total_ns
        if self._bar is not None:
            self._bar.update(done_ns * 1e-9 - self._bar.n)
        elif tenths > self._tenths:
            self._tenths = tenths
            print(f'recording {10 * tenths:3d} %  {done_ns * 1e-9:.0f} s of '
                  f'{self._total_ns * 1e-9:.0f} s', file=sys.stderr, flush=True)

    def close(self) -> None:
        """Leave the bar as it stands."""
        if self._bar is not None:
            self._bar.close()
