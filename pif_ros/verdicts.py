"""Which of the measurements that were taken are refused after all, as their replays have it."""

from __future__ import annotations

from collections.abc import Mapping
import math

from pif_ros.accounts import SourceAccount
from pif_ros.core.estimates import Correction, Measurement

GATE, OFF_THE_GRID = 'gate', 'off the grid'
#: So many are kept, at least, before those are looked for that no replay can reach.
ROOM = 64


class Verdicts:
    """
    Moves measurements between accepted and rejected, so that a source's sums always hold.

    A replay may come to another verdict on a measurement than the one before.
    """

    def __init__(self, accounts: Mapping[str, SourceAccount]) -> None:
        self._accounts = accounts
        self._refused: dict[Measurement, str] = {}
        self._room = ROOM

    def take(self, made: Correction) -> None:
        """Account for a measurement as its newest correction has it."""
        if made.gated:
            self._settle(made.measurement, GATE)
        elif made.log_evidence == -math.inf:
            self._settle(made.measurement, OFF_THE_GRID)
        else:
            self.accept(made.measurement)

    def accept(self, measurement: Measurement) -> None:
        """Count a measurement as accepted, whatever was said of it before."""
        self._settle(measurement, None)

    def forget(self, before_ns: int | None = None) -> None:
        """Let the verdicts before a stamp stand, all where none is given; none comes again."""
        if before_ns is None:
            self._refused.clear()
        elif len(self._refused) > self._room:
            self._refused = {m: why for m, why in self._refused.items() if m.stamp_ns >= before_ns}
            self._room = max(2 * len(self._refused), ROOM)

    def _settle(self, measurement: Measurement, reason: str | None) -> None:
        """Count a measurement as refused for a reason, as accepted where there is none."""
        account, before = self._accounts[measurement.source], self._refused.pop(measurement, None)
        if before is not None:
            account.judge_anew(before, refused=False)
        if reason is not None:
            self._refused[measurement] = reason
            account.judge_anew(reason, refused=True)
