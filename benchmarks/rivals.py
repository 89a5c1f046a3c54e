"""The rivals of the grid filter on its problem, beside other people's implementations of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from benchmarks.problem import (
    PRIOR_COVARIANCE, PRIOR_MEAN, Recording, SENSOR, simulate, STEP_NS, SYSTEM, TIME_STEP)
from benchmarks.progress import Progress
from benchmarks.reference import Means, Referee
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Contestant, Effort, interleave, ratio
import numpy as np
from numpy.typing import NDArray
from pif_ros.core.rivals import (
    ExtendedKalmanFilter, GaussianBelief, ParticleBelief, ParticleFilter, UnscentedKalmanFilter)
from scipy.special import erf

Array = NDArray[np.float64]

STEPS = 200
PER_TURN = 10
PASSES = 5
SEEDS = (1, 2, 3)
COUNT = 10_000
SWARM, EXTENDED, UNSCENTED = 'particle filter', 'extended Kalman', 'unscented Kalman'
OURS = 'ours'
#: The extended filter may take longer: see the notes.
MOST = {SWARM: 1.0, EXTENDED: 4.0, UNSCENTED: 1.0}


class Player(Protocol):
    """A filter that goes through the measurements of a recording."""

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""

    def means(self) -> Means:
        """Return the means of x and |x|."""


class Rival:
    """One of this package's rivals."""

    def __init__(self, filter_: Any, means: Callable[..., Means]) -> None:
        """Take the filter, and what reads the means of x and |x| off its belief."""
        self.filter, self._means = filter_, means

    def start(self, measurements: Array) -> None:
        """Begin with the prior."""
        self.belief = self.filter.gaussian(PRIOR_MEAN, PRIOR_COVARIANCE)
        self._measurements = [tuple(y.tolist()) for y in measurements]

    def step(self, k: int) -> None:
        """Predict, and correct with the k-th measurement."""
        to_ns = (k + 1) * STEP_NS
        moved = self.filter.predict(self.belief, to_ns - STEP_NS, to_ns)
        self.belief, _ = self.filter.correct(moved, self._measurements[k], 'squares', to_ns)

    def means(self) -> Means:
        """Return the means of x and |x|."""
        return self._means(self.belief)


@dataclass(frozen=True, eq=False)
class Entry:
    """A player with its line in the table."""

    kind: str
    whose: str
    player: Player

    @property
    def key(self) -> str:
        """Return what tells it from the others."""
        return f'{self.kind}, {self.whose}'


def run(effort: Effort) -> Table:
    """Time all players on one recording, and hold their means against the exact filter's."""
    entries = _entries()
    recordings = [simulate(seed, STEPS) for seed in SEEDS[:effort.scaled(len(SEEDS), 1)]]
    accuracy = _accuracy(entries, recordings)
    samples = interleave(
        {entry.key: Contestant(entry.player.step, PER_TURN, lambda entry=entry: (
            entry.player.start(recordings[0].measurements))) for entry in entries},
        STEPS // PER_TURN, effort.scaled(PASSES, 1), Progress('rivals: timing'))
    rows, goals = [], []
    for entry in entries:
        taken, ours = samples[entry.key], samples[f'{entry.kind}, {OURS}']
        rows.append(Row.timed(entry.kind, entry.whose, taken, ours, OURS, accuracy[entry.key]))
        if entry.whose != OURS:
            goals.append(Goal(f'{entry.kind}, ours, against {entry.whose}', MOST[entry.kind],
                              ratio(ours, taken)))
    return Table('The rivals, `coupled_trigonometric`', rows, [
        f'Prior N(0, 10 I), one measurement and one step each {TIME_STEP:g} s, {STEPS} of them; '
        f'{len(recordings)} simulated paths; times are those of the first.  {COUNT:,} particles, '
        'resampled systematically below half of them effective.',
        "dev: RMS distance of the posterior mean from the exact filter's, and dev of abs x that "
        'of the mean of |x|, which the sensor sees: for particles it is chance, for the Kalman '
        'filters what a Gaussian cannot say.',
        "FilterPy has no particle filter: numpy's arithmetic around its resampling, with "
        'nothing general in it.  Its Kalman filters are given the transition of one step, '
        'Runge-Kutta of the mean or of each point; its extended one the slope at the start of '
        'the step, expanded to second order, and that of the sensor as a formula, where ours '
        'finds both for itself, of fourth order and by differences.'], goals)


def folded(m: Array, P: Array) -> Means:
    """Return the means of x and of |x| for a Gaussian."""
    s = np.sqrt(np.diag(P))
    return Means(m, s * np.sqrt(2 / np.pi) * np.exp(-m**2 / (2 * s**2))
                 + m * erf(m / (s * np.sqrt(2))))


def _entries() -> list[Entry]:
    from benchmarks import peer_rivals, peers
    model, sensors = SYSTEM.model, {'squares': SENSOR}
    extended = ExtendedKalmanFilter(model, sensors, TIME_STEP)
    unscented = UnscentedKalmanFilter(model, sensors, TIME_STEP)
    swarm = ParticleFilter(model, sensors, TIME_STEP, particles=COUNT)
    return [Entry(SWARM, OURS, Rival(swarm, _of_particles)),
            Entry(SWARM, 'particles', peers.Particles(COUNT)),
            Entry(SWARM, 'Stone Soup', peer_rivals.StoneSoupParticles(COUNT)),
            Entry(SWARM, 'FilterPy and numpy', peer_rivals.FilterPyParticles(COUNT)),
            Entry(EXTENDED, OURS, Rival(extended, _of_gaussian)),
            Entry(EXTENDED, 'FilterPy', peer_rivals.FilterPyExtended()),
            Entry(UNSCENTED, OURS, Rival(unscented, _of_gaussian)),
            Entry(UNSCENTED, 'FilterPy', peer_rivals.FilterPyUnscented())]


def _of_particles(belief: ParticleBelief) -> Means:
    return Means(belief.mean(), np.abs(belief.points) @ belief.weights)


def _of_gaussian(belief: GaussianBelief) -> Means:
    return folded(belief.mean(), belief.covariance())


def _accuracy(entries: Sequence[Entry],
              recordings: Sequence[Recording]) -> dict[str, dict[str, float | None]]:
    """Return the RMS distances of each player from the exact filter."""
    referee, progress = Referee(), Progress('rivals: reference')
    references = [referee.means(recording, progress.part(i, len(recordings))).means
                  for i, recording in enumerate(recordings)]
    figures: dict[str, dict[str, float | None]] = {}
    for entry in entries:
        distances = [_means(entry.player, recording).distance(reference)
                     for recording, reference in zip(recordings, references)]
        dev, dev_size = np.sqrt(np.mean(np.square(distances), axis=0))
        figures[entry.key] = {'dev': float(dev), 'dev of abs x': float(dev_size)}
    return figures


def _means(player: Player, recording: Recording) -> Means:
    player.start(recording.measurements)
    x, size = [], []
    for k in range(len(recording.measurements)):
        player.step(k)
        means = player.means()
        x.append(means.x)
        size.append(means.size)
    return Means(np.array(x), np.array(size))
