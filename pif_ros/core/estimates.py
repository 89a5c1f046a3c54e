"""What a tracker takes and what it gives: measurements, and what is believed after each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
import math
from typing import Generic

from pif_ros.core.filters import Belief
from pif_ros.core.lost import Watch


@dataclass(frozen=True, order=True)
class Measurement:
    """What a source measured at a stamp; equal stamps are ordered by source and values."""

    stamp_ns: int
    source: str
    values: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Estimate(Generic[Belief]):
    """
    What is believed at a stamp.

    log_evidence: log p(y | all before it) of the measurement that led here, 0 where none did;
    total_log_evidence: its sum since the last reset, without what was gated; watch: what is
    remembered of how they fitted.  A stamp of None is that of a prior which waits for the first
    measurement.
    """

    stamp_ns: int | None
    belief: Belief
    log_evidence: float = 0.0
    total_log_evidence: float = 0.0
    watch: Watch = Watch()


@dataclass(frozen=True)
class Correction:
    """
    A correction that was made: by what, and what the belief before it said of it.

    log_peak: what the log evidence would have been, had the measurement been just as expected by
    a belief that is sure of itself; tail: how often a measurement surprises as much, NaN where
    nobody asked; gated: whether it was rejected for that, so that the belief does not know of it;
    recovered: whether a share of another belief was mixed in before; gap_ns: how long nothing was
    measured before it, so long that the prior held again, 0 otherwise.
    """

    measurement: Measurement
    log_evidence: float
    log_peak: float
    tail: float = math.nan
    gated: bool = False
    recovered: bool = False
    gap_ns: int = 0


@dataclass(frozen=True)
class Memory(Generic[Belief]):
    """
    All that decides what a tracker will believe: what it starts from, and what it took since.

    anchor: the belief before all else; anchored: the measurement that led to it, None where it is
    a start; measurements and controls (stamps and values): in their order.  The beliefs after the
    anchor follow from these to the bit.
    """

    anchor: Estimate[Belief]
    anchored: Measurement | None = None
    measurements: tuple[Measurement, ...] = ()
    controls: tuple[tuple[int, tuple[float, ...]], ...] = ()

    @property
    def stamp_ns(self) -> int | None:
        """Return the newest stamp of a measurement, None before there is one."""
        return self.measurements[-1].stamp_ns if self.measurements else self.anchor.stamp_ns


class Rejection(Enum):
    """Why a measurement or a control cannot be put where it belongs."""

    TOO_LATE = 'too late'
    DUPLICATE = 'duplicate'
    TOO_MANY = 'too many'


class CorrectionFailed(RuntimeError):
    """A measurement that could not be used, since something raised; the cause says what."""

    def __init__(self, measurement: Measurement) -> None:
        super().__init__(f'no correction by {measurement}')
        self.measurement = measurement
