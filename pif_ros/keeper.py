"""What keeps a state in a file, and goes on from it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
import os
from pathlib import Path
import time
from typing import Any

import numpy as np
from pif_ros import state_file
from pif_ros.config import Config, ConfigError, find_grid, identity
from pif_ros.core.controls import carries_across, NO_CONTROLS
from pif_ros.core.estimates import Memory
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.saved import Arrays, arrays_of, Form, Forms, forms_of, memory_from
from pif_ros.core.tracker import Tracker
from pif_ros.state_file import StateRefused

#: What a save or a load may meet; no more than a line comes of it.
FAILURES = (OSError, ValueError, MemoryError)
#: The newest stamp that was published, kept beside the tracker's memory.
PUBLISHED = 'published_ns'


class Keeper:
    """
    Saves what a tracker remembers to the state file, and brings it back.

    report: called with a kind and a line where a checkpoint fails.  All writing is done by one
    thread of its own, to which only the frozen arrays of a belief are given.  So a checkpoint
    holds a node up for 0.3 ms with a hundred measurements to remember, whatever the size of the
    belief and however slow the disk; ~/save_state waits for the file, 30 ms for a million cells,
    and to load these takes 20 ms.  Raises ConfigError for a file that cannot be.

    It replaces only a file that it wrote or read itself.  Any other that is there, such as one
    that was refused, is first moved to NAME.refused; where that is taken, nothing is written.
    """

    def __init__(self, config: Config, tracker: Tracker[Any],
                 report: Callable[[str, str], None]) -> None:
        self.file = _writable(config.state_file)
        self._config, self._identity = config, identity(config)
        self._tracker, self._report = tracker, report
        self._ahead_ns = round(config.time.max_ahead * NANOSECONDS)
        self._max_gap_ns = round(config.time.max_gap * NANOSECONDS)
        self._writer = ThreadPoolExecutor(1, 'state file')
        self._pending: Future[None] | None = None
        self._mine: state_file.Mark | None = None
        self._last: tuple[Memory[Any], int] | None = None
        self._saved: float | None = None
        self._failure = ''

    def told(self) -> tuple[str, bool] | None:
        """Return how old what was saved is, and whether that went well; None without a file."""
        if self.file is None:
            return None
        if self._pending is not None and self._pending.done():
            self._settle()
        if self._failure:
            return self._failure, False
        return ('not yet' if self._saved is None else
                f'{time.monotonic() - self._saved:.1f} s ago'), True

    def save(self, published_ns: int) -> str:
        """Save now, and return a line that says so; raise one of FAILURES where it cannot be."""
        self._settle()
        file = self._known_file()
        try:
            self._submit(published_ns).result()
        except FAILURES as error:
            self._failure = self.refusal(error)
            raise
        finally:
            self._pending = None
        return f'saved to {file}'

    def checkpoint(self, published_ns: int) -> None:
        """Begin to save, unless nothing is new or the last time has not come to an end."""
        if self._pending is not None and not self._pending.done():
            return
        self._settle()
        if self._last != (self._tracker.memory(), published_ns):
            self._attempt(lambda: self._submit(published_ns))

    def close(self, published_ns: int | None) -> None:
        """Save where there is a file, unless no stamp is given, and let go of the thread."""
        self._settle()
        if self.file is not None and published_ns is not None:
            self._attempt(lambda: self.save(published_ns))
        self._writer.shutdown()

    def is_there(self) -> bool:
        """Return whether there is something to go on from."""
        return self.file is not None and os.path.lexists(self.file)

    def load(self, now_ns: int | None) -> tuple[Memory[Any], int]:
        """
        Return the memory in the file, and the newest stamp that was published.

        Raises one of FAILURES where there is none to go on from at this time; nothing has changed
        then.
        """
        self._settle()
        file = self._known_file()
        if now_ns is None:
            raise StateRefused('expected a /clock before it')
        arrays, mark = state_file.read(file, self._identity, self._layouts())
        memory, published_ns = memory_from(self._tracker, arrays), int(arrays[PUBLISHED][0])
        newest_ns = max(memory.stamp_ns or published_ns, published_ns)
        if newest_ns > now_ns + self._ahead_ns:
            raise StateRefused('expected a state from before now, got one from '
                               f'{(newest_ns - now_ns) / NANOSECONDS:.3f} s ahead of the clock')
        self._check_gaps(memory)
        self._check_controls(memory)
        self._mine = mark
        return memory, published_ns

    def refusal(self, error: Exception) -> str:
        """Return in one line why there was nothing saved or loaded."""
        text = getattr(error, 'strerror', None) or str(error) or type(error).__name__
        return f'state_file: {" ".join(text.split())} ({self.file or "none"})'

    def _known_file(self) -> Path:
        if self.file is None:
            raise StateRefused("expected a file, got ''")
        return self.file

    def _check_gaps(self, memory: Memory[Any]) -> None:
        """Refuse a path with a gap that would take ages; others the tracker does not cross."""
        path_ns, after = getattr(memory.anchor.belief, 'stamp_ns', None), memory.anchor.stamp_ns
        if path_ns is not None and after is not None and not (
                path_ns <= after <= path_ns + self._max_gap_ns):
            raise StateRefused('expected gaps between stamps of at most time.max_gap, '
                               f'got {(after - path_ns) / NANOSECONDS:.3f} s')

    def _check_controls(self, memory: Memory[Any]) -> None:
        """Refuse controls that would have been refused when they came."""
        model, step = self._tracker.filter.model, self._config.kernel.time_step
        held = getattr(memory.anchor.belief, 'controls', NO_CONTROLS)
        controls = [*memory.controls, *zip(held.stamps_ns, held.values)]
        grid = find_grid(self._config, model) if controls else None
        for stamp_ns, u in controls:
            if len(u) != len(model.inputs) or grid is not None and carries_across(
                    model, grid, u, stamp_ns / NANOSECONDS, step):
                raise StateRefused('expected controls that carry no state across the whole grid '
                                   f'in kernel.time_step, got {list(u)}')

    def _layouts(self) -> list[Forms]:
        return [{**forms, PUBLISHED: Form('<i8', (1,))} for forms in forms_of(self._tracker)]

    def _submit(self, published_ns: int) -> Future[None]:
        state = self._tracker.memory(), published_ns
        arrays = {**arrays_of(self._tracker), PUBLISHED: np.array([published_ns], dtype='<i8')}
        self._pending = self._writer.submit(self._write, arrays, state)
        return self._pending

    def _settle(self) -> None:
        """Wait for the checkpoint that is being written, and tell where it failed."""
        pending, self._pending = self._pending, None
        if pending is not None:
            self._attempt(pending.result)

    def _attempt(self, action: Callable[[], Any]) -> None:
        try:
            action()
        except FAILURES as error:
            self._failure = self.refusal(error)
            self._report('state', self._failure)

    def _write(self, arrays: Arrays, state: tuple[Memory[Any], int]) -> None:
        assert self.file is not None
        there = state_file.mark_of(self.file)
        if there is not None and there != self._mine:
            _put_aside(self.file)
        self._mine = state_file.write(self.file, arrays, self._identity)
        self._last, self._saved, self._failure = state, time.monotonic(), ''


def _put_aside(file: Path) -> None:
    """Move a file out of the way; StateRefused where another was moved there before."""
    aside = file.with_name(f'{file.name}.refused')
    if os.path.lexists(aside):
        raise StateRefused('expected no file but that of this node, got another, '
                           f'and {aside.name} is there already: move both away')
    file.rename(aside)


def _writable(given: str) -> Path | None:
    """Return where a state is to be kept, None for nowhere; ConfigError where it cannot be."""
    if not given:
        return None
    try:
        file = Path(os.path.realpath(Path(given).expanduser()))
        possible = not file.is_dir() and os.access(file.parent, os.W_OK | os.X_OK)
    except (OSError, ValueError, RuntimeError):
        # a name that is too long, holds what no name can, or the home of nobody
        possible = False
    if not possible:
        raise ConfigError('state_file: expected a file in a folder that can be written, '
                          f'got {given!r}')
    return file
