"""A lawn mower found from ranges and odometry: the grid, an EKF and particles on the same data."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
from pathlib import Path
from tempfile import TemporaryDirectory
import time
from typing import Any

from benchmarks.progress import Progress
from benchmarks.report import Goal, Row, Table
from benchmarks.timing import Effort
import numpy as np
from numpy.typing import NDArray
from pif_ros.config import build_tracker, Config
from pif_ros.core.rivals import ExtendedKalmanFilter, ParticleFilter
from pif_ros.core.scoring import rmse
from pif_ros.core.tracker import Tracker
from pif_ros.plaza.baseline import played, track_of
from pif_ros.plaza.recording import load, NAMES, Recording
from pif_ros.plaza.report import errors, Scores
from pif_ros.plaza.schedule import Span
from pif_ros.plaza.yard import parameters_for

#: Standard deviations of a start that is known: metres and radians.
KNOWN = np.array([0.5, 0.5, 0.1])
PARTICLES = 20_000
#: What the first seconds are.
FIRST_NS = 5 * 10**9
#: Root mean square errors in metres over the last 90 % of a run that are to be reached.
GOALS = {('Plaza1', 'anywhere'): 0.40, ('Plaza2', 'anywhere'): 0.90,
         ('Plaza1', 'known'): 0.35, ('Plaza2', 'known'): 0.59}


@dataclasses.dataclass(frozen=True)
class Run:
    """
    What came of a run: scores, wall-clock seconds of each estimate, and seconds recorded.

    at_first: root mean square error in metres over the first seconds.
    """

    scores: Scores
    at_first: float
    took: NDArray[np.float64]
    recorded: float


def run(effort: Effort) -> Table:
    """Return errors and times of all filters on both recordings."""
    rows, goals = [], []
    for name in NAMES:
        recording = load(name)
        duration = 0.0 if effort.share == 1.0 else 100.0
        ran = {(who, start): _ran(recording, tracker, f'{name}, {who}, {start}', duration)
               for (who, start), tracker in _trackers(recording).items()}
        base = ran['active grid', 'anywhere'].took.sum()
        for (who, start), result in ran.items():
            rows.append(_row(f'{name}, {who}', start, result, base))
            if who == 'active grid':
                goals.append(Goal(f'{name}, start {start}, root mean square error in m',
                                  GOALS[name, start], result.scores.rmse))
                goals.append(Goal(f'{name}, start {start}, seconds per second recorded', 1.0,
                                  float(result.took.sum()) / result.recorded))
    return Table('Plaza: position from ranges and odometry', rows, NOTES, goals)


NOTES = (
    'Ranges and odometry arrive in the order in which they were recorded, some of them 64 s late; '
    'each estimate is scored at the stamp of its range.  RMSE, median and 95 % in m over the last '
    '90 % of the run; median, p99: seconds per range, with whatever is replayed for it.',
    'Everybody has the model, the sensors and the noise of config/plaza_unicycle.yaml.  The start '
    'is anywhere (uniform over yard and heading; for the EKF its mean and covariance) or known '
    '(0.5 m, 0.5 m, 0.1 rad).  at first: RMSE in m over the first five seconds, some twenty '
    'ranges.')


def _row(name: str, start: str, result: Run, base: float) -> Row:
    scores = result.scores
    return Row(name, f'start {start}', float(np.median(result.took)),
               float(np.percentile(result.took, 99)), float(result.took.sum() / base),
               'the grid from anywhere',
               {'at first': result.at_first, 'RMSE': scores.rmse,
                'median error': scores.median, '95 %': scores.percentile_95,
                'times real time': result.recorded / float(result.took.sum())})


def _trackers(recording: Recording) -> Mapping[tuple[str, str], Tracker[Any]]:
    """Return every filter from every start that it can begin with."""
    with TemporaryDirectory() as folder:
        config = Config.from_yaml(parameters_for(recording, Path(folder), 'plaza_unicycle'))
    grid = build_tracker(config)
    grid.filter.describe()
    model, sensors = grid.filter.model, grid.filter.sensors
    history, hold, world = config.time.history, config.control.hold, grid.filter.grid

    def tracker(filter_: Any, known: bool) -> Tracker[Any]:
        prior = (filter_.gaussian(_start(recording), np.diag(KNOWN**2)) if known
                 else filter_.uniform())
        return Tracker(filter_, prior, history, config.time.history_memory * 1e6, hold)

    particles = ParticleFilter(model, sensors, 0.2, world, PARTICLES)
    return {('active grid', 'anywhere'): tracker(grid.filter, False),
            ('active grid', 'known'): tracker(grid.filter, True),
            ('EKF', 'anywhere'): tracker(ExtendedKalmanFilter(model, sensors, 0.2, world), False),
            ('EKF', 'known'): tracker(ExtendedKalmanFilter(model, sensors, 0.2, world), True),
            (f'{PARTICLES:,} particles', 'anywhere'): tracker(particles, False),
            (f'{PARTICLES:,} particles', 'known'): tracker(particles, True)}


def _start(recording: Recording) -> NDArray[np.float64]:
    """Return where the mower is and looks to at the first range."""
    x, y, heading = recording.truth_at(recording.range_stamps_ns[0])
    return np.array([x, y, np.angle(np.exp(1j * heading))])


def _ran(recording: Recording, tracker: Tracker[Any], name: str, duration: float) -> Run:
    """Return the scores of a filter on a recording, and how long it took."""
    span, took, rows = Span(0.0, duration), [], []
    first, last = span.limits_ns(recording)
    progress = Progress(name)
    for stamp in played(recording, span, tracker):
        before = time.perf_counter()
        belief = tracker.estimate().belief
        took.append(time.perf_counter() - before)
        rows.append((stamp, belief.mean(), belief.covariance()))
        progress.show((stamp - first) / (last - first))
    progress.show(1.0)
    track = track_of(rows)
    truth = recording.truth_at(track.stamps_ns)
    early = track.stamps_ns < track.stamps_ns[0] + FIRST_NS
    at_first = rmse(track.means[early, :2] - truth[early, :2])
    return Run(errors(track, truth), at_first, np.array(took), (last - first) * 1e-9)
