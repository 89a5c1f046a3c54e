"""How far a case has come, on stderr."""

from __future__ import annotations

from collections.abc import Callable
import sys


class Progress:
    """One line that is rewritten on a terminal; elsewhere a line every quarter."""

    def __init__(self, what: str) -> None:
        """Name what is going on."""
        self._what, self._shown = what, -1
        self.show(0.0)

    def part(self, number: int, of: int) -> Callable[[float], None]:
        """Return what shows that a share of one of some equal parts is done."""
        return lambda share: self.show((number + share) / of)

    def show(self, share: float) -> None:
        """Show that a share of it is done."""
        percent = int(100 * share + 1e-9)
        terminal = sys.stderr.isatty()
        if percent == self._shown or (not terminal and percent // 25 == self._shown // 25):
            return
        self._shown = percent
        end = '\n' if percent >= 100 or not terminal else ''
        print(f'{chr(13) * terminal}{self._what}: {percent:3d} %', end=end, file=sys.stderr,
              flush=True)
