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
from pif_ros.core.tracker import Measurement, Tracker
from pif_ros.plaza.recording import load, NAMES, Recording
from pif_ros.plaza.report import errors, Scores, Track
from pif_ros.plaza.schedule import Span, steps
from pif_ros.plaza.yard import parameters_for

#: Standard deviations of a start that is known: metres and radians.
KNOWN = np.array([0.5, 0.5, 0.1])
PARTICLES = 20_000
#: Root mean square errors in metres over the last 90 % of a run that are to be reached.
GOALS = {('Plaza1', 'anywhere'): 0.40, ('Plaza2', 'anywhere'): 0.90,
         ('Plaza1', 'known'): 0.35, ('Plaza2', 'known'): 0.59}


@dataclasses.dataclass(frozen=True)
class Run:
    """What came of a run: scores, wall-clock seconds of each estimate, and seconds recorded."""

    scores: Scores
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
    'is anywhere (uniform over yard and heading) or known (0.5 m, 0.5 m, 0.1 rad).  An EKF has no '
    'answer from anywhere.')


def _row(name: str, start: str, result: Run, base: float) -> Row:
    scores = result.scores
    return Row(name, f'start {start}', float(np.median(result.took)),
               float(np.percentile(result.took, 99)), float(result.took.sum() / base),
               'the grid from anywhere',
               {'RMSE': scores.rmse, 'median error': scores.median, '95 %': scores.percentile_95,
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
            ('EKF', 'known'): tracker(ExtendedKalmanFilter(model, sensors, 0.2, world), True),
            (f'{PARTICLES:,} particles', 'anywhere'): tracker(particles, False),
            (f'{PARTICLES:,} particles', 'known'): tracker(particles, True)}


def _start(recording: Recording) -> NDArray[np.float64]:
    """Return where the mower is and looks to at the first range."""
    pose = recording.truth_at(recording.range_stamps_ns[0])
    moved = np.diff(recording.truth[:, :2], axis=0)
    far = np.hypot(*moved.T) > 0.05
    # one of the recordings has headings that point backwards
    off = np.angle(np.mean(np.exp(1j * (
        np.arctan2(moved[far, 1], moved[far, 0]) - recording.truth[:-1][far, 2]))))
    heading = pose[2] + np.pi * np.rint(off / np.pi)
    return np.array([pose[0], pose[1], np.angle(np.exp(1j * heading))])


def _ran(recording: Recording, tracker: Tracker[Any], name: str, duration: float) -> Run:
    """Return the scores of a filter on a recording, and how long it took."""
    span, took, stamps, means, covariances = Span(0.0, duration), [], [], [], []
    schedule = list(steps(recording, span, odometry=True))
    first, last = schedule[0].stamp_ns, schedule[-1].stamp_ns
    progress = Progress(name)
    for number, step in enumerate(schedule):
        for i in step.odometry:
            if np.all(np.isfinite(recording.odometry[i])):
                tracker.control(int(recording.odometry_stamps_ns[i]), recording.odometry[i])
        for i in step.ranges:
            stamp = int(recording.range_stamps_ns[i])
            tracker.observe(Measurement(stamp, f'beacon_{recording.beacon_ids[i]}',
                                        (float(recording.ranges[i]),)))
            if stamp == recording.arrivals_ns[i]:
                before = time.perf_counter()
                belief = tracker.estimate().belief
                took.append(time.perf_counter() - before)
                stamps.append(stamp)
                means.append(belief.mean()[:2])
                covariances.append(belief.covariance()[:2, :2])
        progress.show((number + 1) / len(schedule))
    track = Track(np.array(stamps), np.array(means), np.array(covariances))
    truth = recording.truth_at(track.stamps_ns)
    return Run(errors(track.stamps_ns, track.means, track.covariances, truth, 0.1),
               np.array(took), (last - first) * 1e-9)
