"""Which of the measurements that were taken a gate rejects, as their replays have it now."""

from __future__ import annotations

from collections.abc import Mapping

from pif_ros.accounts import SourceAccount
from pif_ros.core.estimates import Correction, Measurement

GATE = 'gate'
#: So many are kept, at least, before those are looked for that no replay can reach.
ROOM = 64


class Verdicts:
    """
    Moves measurements between accepted and rejected, so that a source's sums always hold.

    A replay may come to another verdict on a measurement than the one before.
    """

    def __init__(self, accounts: Mapping[str, SourceAccount]) -> None:
        self._accounts = accounts
        self._gated: set[Measurement] = set()
        self._room = ROOM

    def take(self, made: Correction) -> None:
        """Account for a measurement as its newest correction has it."""
        if made.gated:
            self._reject(made.measurement)
        else:
            self.accept(made.measurement)

    def accept(self, measurement: Measurement) -> None:
        """Count a measurement as accepted, whatever was said of it before."""
        if measurement in self._gated:
            self._gated.remove(measurement)
            self._accounts[measurement.source].judge_anew(GATE, refused=False)

    def forget(self, before_ns: int | None = None) -> None:
        """Let the verdicts before a stamp stand, all where none is given; none comes again."""
        if before_ns is None:
            self._gated.clear()
        elif len(self._gated) > self._room:
            self._gated = {m for m in self._gated if m.stamp_ns >= before_ns}
            self._room = max(2 * len(self._gated), ROOM)

    def _reject(self, measurement: Measurement) -> None:
        if measurement not in self._gated:
            self._gated.add(measurement)
            self._accounts[measurement.source].judge_anew(GATE, refused=True)
