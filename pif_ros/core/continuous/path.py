"""What is believed while a path is measured, and what a new point of the path does to it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pif_ros.core.continuous.increments import Increments
from pif_ros.core.controls import Controls, NO_CONTROLS
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor
from pif_ros.core.modes import Mode, MOST, SHARE

Array = NDArray[np.float64]


class Believed(Protocol):
    """What a belief lets be read off it."""

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""

    @property
    def mass(self) -> float:
        """Return the probability that is left."""

    def mean(self) -> Array:
        """Return the mean, shape (n,)."""

    def mode(self) -> Array:
        """Return the most probable state, shape (n,)."""

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""

    def entropy(self) -> float:
        """Return the differential entropy in nats."""

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """Return the humps, heaviest first, the most that are wanted."""

    def on(self, grid: Grid, axes: Sequence[int]) -> Any:
        """Return the density of some axes on the cells of a grid."""


Inner = TypeVar('Inner', bound=Believed)
#: Carries (what was believed at the last point, dy, its stamp, the new stamp) to (what is believed
#: now, what the next increment starts from, log p(dy | all before)).
Advance = Callable[[Inner, Array, int, int], tuple[Inner, Inner, float]]


@dataclass(frozen=True, eq=False)
class PathBelief(Generic[Inner]):
    """
    A belief between two points of a measured path.

    now: what is believed, a forecast where time has gone on since the last point; anchor: what
    the increment to the next point starts from; y, stamp_ns: the last point's values (m,) and
    stamp, None before the first, when the path says nothing yet; controls: what the forecast was
    driven by, and the steps since the last point are when they are taken anew.
    """

    now: Inner
    anchor: Inner
    y: Array | None = None
    stamp_ns: int | None = None
    controls: Controls = NO_CONTROLS

    @property
    def nbytes(self) -> int:
        """Return the memory that it takes, in bytes."""
        return 2 * self.now.nbytes

    @classmethod
    def before_the_path(cls, prior: Inner) -> PathBelief[Inner]:
        """Return a belief that waits for the first point of the path."""
        return cls(prior, prior)

    def forecast(self, now: Inner, controls: Controls = NO_CONTROLS) -> PathBelief[Inner]:
        """Return the same belief at a later time; the next increment starts where it did."""
        return PathBelief(now, self.anchor, self.y, self.stamp_ns, controls)

    def moved(self, by_ns: int) -> PathBelief[Inner]:
        """Return the same belief by a clock that is so much ahead."""
        held = replace(self.controls, stamps_ns=tuple(
            stamp + by_ns for stamp in self.controls.stamps_ns))
        stamp_ns = None if self.stamp_ns is None else self.stamp_ns + by_ns
        return replace(self, stamp_ns=stamp_ns, controls=held)

    @property
    def mass(self) -> float:
        """Return the probability that is left."""
        return self.now.mass

    def mean(self) -> Array:
        """Return the mean, shape (n,)."""
        return self.now.mean()

    def mode(self) -> Array:
        """Return the most probable state, shape (n,)."""
        return self.now.mode()

    def covariance(self, about: ArrayLike | None = None) -> Array:
        """Return the second moments about a point (the mean where none is given), (n, n)."""
        return self.now.covariance(about)

    def entropy(self) -> float:
        """Return the differential entropy in nats."""
        return self.now.entropy()

    def modes(self, share: float = SHARE, most: int = MOST) -> list[Mode]:
        """Return the humps, heaviest first, the most that are wanted."""
        return self.now.modes(share, most)

    def on(self, grid: Grid, axes: Sequence[int]) -> Any:
        """Return the density of some axes on the cells of a grid."""
        return self.now.on(grid, axes)

    def edge_mass(self) -> float:
        """Return the share of the mass at the grid's edge; AttributeError where there is none."""
        return self.now.edge_mass()  # type: ignore[attr-defined]

    @property
    def grid(self) -> Grid:
        """Return where the density lives; AttributeError where there is no grid."""
        return self.now.grid  # type: ignore[attr-defined]

    @property
    def density(self) -> Array:
        """Return the density on the grid; AttributeError where there is none."""
        return self.now.density  # type: ignore[attr-defined]


def correct_by_path(belief: PathBelief[Inner], y: ArrayLike, sensor: Sensor, at_ns: int,
                    advance: Advance[Inner]) -> tuple[PathBelief[Inner], float]:
    """
    Return the belief given the path's values y (m,) at a stamp, and log p(dy | all before).

    The first point is the reference: it says nothing of the state, and its log evidence is 0.  A
    point that no state allows, is not finite, or contradicts another of the same stamp has the
    log evidence -inf; belief and reference stay.  ValueError for a stamp before the last point's.
    """
    y = np.array(y, dtype=float)
    y.setflags(write=False)
    if not np.all(np.isfinite(y)):
        return belief, -np.inf
    if belief.y is None or belief.stamp_ns is None:
        return PathBelief(belief.now, belief.now, y, at_ns), 0.0
    if at_ns < belief.stamp_ns:
        raise ValueError(f'at_ns: expected a stamp from {belief.stamp_ns} on, the last of the '
                         f'path, got {at_ns}')
    dy = sensor.difference(y, belief.y)
    if at_ns == belief.stamp_ns:
        return belief, -np.inf if dy.any() else 0.0
    now, anchor, log_evidence = advance(belief.anchor, dy, belief.stamp_ns, at_ns)
    if log_evidence == -np.inf:
        return belief, log_evidence
    return PathBelief(now, anchor, y, at_ns), log_evidence


def path_log_peak(belief: PathBelief[Inner], sensor: Sensor, at_ns: int) -> float:
    """Return the log evidence of an increment that is just as expected, 0 where there is none."""
    if belief.stamp_ns is None or at_ns <= belief.stamp_ns:
        return 0.0
    return Increments(sensor).log_peak(at_ns - belief.stamp_ns, at_ns)
