"""What became of the measurements that were taken, as their newest replay has it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
import math

from pif_ros.accounts import SourceAccount
from pif_ros.core.estimates import Correction, Measurement

GATE, OFF_THE_GRID, FAULT, OUTLIER = 'gate', 'off the grid', 'fault', 'outlier'
#: A measurement beyond so many standard deviations of all that is believed is an outlier.
FAR = 10.0
#: So many are kept, at least, before those are looked for that no replay can reach.
ROOM = 64


def surprise(made: Correction) -> float:
    """Return how many standard deviations a measurement is from all that was believed."""
    return math.sqrt(max(2 * (made.log_peak - made.log_evidence), 0.0))


class Verdicts:
    """
    Moves measurements between accepted, outliers and rejected, so that a source's sums hold.

    A replay may come to another verdict on a measurement than the one before.  What was not
    received here, but recalled from a file, is not accounted for.
    """

    def __init__(self, accounts: Mapping[str, SourceAccount]) -> None:
        self._accounts = accounts
        self._found: dict[Measurement, str] = {}
        self._foreign: frozenset[Measurement] = frozenset()
        self._room = ROOM

    def take(self, made: Correction) -> None:
        """Account for a measurement as its newest correction has it."""
        found = None
        if made.gated:
            found = GATE
        elif made.log_evidence == -math.inf:
            found = OFF_THE_GRID
        elif surprise(made) > FAR:
            found = OUTLIER
        self._settle(made.measurement, found)

    def fail(self, measurement: Measurement) -> None:
        """Count a measurement as rejected, since something raised; it does not come again."""
        self._settle(measurement, FAULT)
        self._found.pop(measurement, None)

    def forget(self, before_ns: int | None = None) -> None:
        """Let the verdicts before a stamp stand, all where none is given; none comes again."""
        if before_ns is None:
            self._found.clear()
            self._foreign = frozenset()
        elif len(self._found) > self._room:
            self._found = {m: why for m, why in self._found.items() if m.stamp_ns >= before_ns}
            self._room = max(2 * len(self._found), ROOM)

    def disregard(self, measurements: Iterable[Measurement]) -> None:
        """Do not account for some, which another process did."""
        self._foreign = frozenset(measurements)

    def _settle(self, measurement: Measurement, found: str | None) -> None:
        """Count a measurement as what it was found to be, accepted where that is nothing."""
        before = self._found.pop(measurement, None)
        if measurement in self._foreign:
            return
        account = self._accounts[measurement.source]
        for what, step in ((before, -1), (found, 1)):
            if what == OUTLIER:
                account.outliers += step
            elif what is not None:
                account.judge_anew(what, refused=step > 0)
        if found is not None:
            self._found[measurement] = found
