"""
The kidnapped robot: set down 20 m away, it is said to be lost, and found again.

On the Plaza1 recording the ranges after that moment are those that a robot 20 m away would have
measured: each gets the difference of the true distances, so that the radios' own errors stay.
Odometry, where it is used, knows of nothing.  Three simulated systems follow.  The grid filter has
a gate and its recovery, or no gate and a recovery when it is lost.  Beside it stands an extended
Kalman filter with a gate on Mahalanobis' distance of the same tail probability, which nothing
opens again, and one with our recovery.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.core.grid import Grid
from pif_ros.core.guard import Gate, Guard, Recovery
from pif_ros.core.lost import Alarm, verdict
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.tracker import Tracker
from pif_ros.plaza.baseline import played
from pif_ros.plaza.recording import load, Recording
from pif_ros.plaza.schedule import Span
from pif_ros.plaza.yard import parameters_for

Array = NDArray[np.float64]

FAR = 20.0
#: It is to be said to be lost, and to be found again, within so many measurements.
SAID, FOUND = 10, 50
#: What is no further away than this, in metres, so many times in a row, is found.
NEAR, STAYS = 3.0, 5
TAIL_PROBABILITY = 1e-4
#: Seconds into the recording, and directions in degrees; what leads off the yard is left out.
MOMENTS, DIRECTIONS = (300.0, 500.0, 900.0, 1200.0, 1500.0), (0.0, 120.0, 240.0)
#: Seconds that are played before and after.
BEFORE, AFTER = 25.0, 60.0
#: By what the radios' ranges are too long  [config/plaza_unicycle.yaml].
SCALE = 1.0697
ALARM = Alarm(1e-5)
NEVER = 10**9


@dataclass(frozen=True)
class Course:
    """
    How one kidnapped filter fared, in measurements after that moment; None for never.

    doubted: until the verdict on it was no longer 'found'; said: until it was said to be lost,
    both looked for in the first twenty; found: until it was back; gated: how many were rejected of
    the first fifty; recoveries: how many it took.
    """

    doubted: int | None
    said: int | None
    found: int | None
    gated: int
    recoveries: int


def run(share: float = 1.0) -> list[str]:
    """Return what was found, a line each; AssertionError where a claim does not hold."""
    lines = []
    for name, drives in (('plaza_unicycle', True), ('plaza_range_only', False)):
        courses = [_on_plaza(name, *kidnap) for kidnap in _some(list(_kidnaps(name)), share)]
        lines += _told(f'Plaza1, {name}', courses, drives)
    for name, system in SYSTEMS.items():
        lines += _told(name, [system(seed) for seed in _some(range(10), share)], True)
    return lines


def _some(values: Sequence[Any], share: float) -> Sequence[Any]:
    """Return a share of some values, evenly out of all, at least one."""
    count = max(round(share * len(values)), 1)
    return [values[k * len(values) // count] for k in range(count)]


def _told(name: str, courses: Sequence[Mapping[str, Course]], stays_lost: bool) -> list[str]:
    """
    Return a line for each filter; the grid filter's must be what is claimed.

    stays_lost: whether one without a gate does not find back before it is said to be lost.
    """
    lines = []
    for kind in courses[0]:
        found = [course[kind] for course in courses]
        lines.append(
            f'{name}: {kind}: {len(found)} kidnaps; doubted after '
            f'{_spread([each.doubted for each in found])} measurements, said to be lost after '
            f'{_spread([each.said for each in found])}, found after '
            f'{_spread([each.found for each in found])}; gated '
            f'{np.mean([each.gated for each in found]):.1f} of the first {FOUND}, recoveries '
            f'{np.mean([each.recoveries for each in found]):.1f}')
    for course in courses:
        for grid in (course[OURS], course[OPEN]):
            assert grid.found is not None and grid.found <= FOUND, lines
            is_said = grid.said is not None and grid.said <= SAID
            back = grid is course[OPEN] and not stays_lost and grid.found <= SAID
            assert is_said or back, lines
    return lines


def _spread(counts: Sequence[int | None]) -> str:
    known = sorted(count for count in counts if count is not None)
    never = len(counts) - len(known)
    text = f'{known[0]} to {known[-1]} (median {np.median(known):g})' if known else ''
    return ' and '.join([text] * bool(known) + [f'never in {never}'] * bool(never))


#: Who is sent.
OURS, OPEN = 'grid, gate and recovery', 'grid, no gate, recovery when lost'
GATED, RECOVERING = 'EKF, Mahalanobis gate', 'EKF, Mahalanobis gate and recovery'


def _guards(trackers: Mapping[str, Any], sources: Sequence[str]) -> dict[str, Guard]:
    """Return the guard of each of the filters."""
    gates = {OPEN: Gate(), GATED: Gate(TAIL_PROBABILITY, NEVER)}
    return {kind: Guard({name: gates.get(kind, Gate(TAIL_PROBABILITY)) for name in sources},
                        Recovery(filter_.uniform(), when_lost=kind != GATED), ALARM)
            for kind, filter_ in trackers.items()}


def _course(grid: Grid, rows: Sequence[tuple[Any, float, bool]]) -> Course:
    """Return how a filter fared by its estimates, errors and rejections after a kidnap."""
    words = [_word(grid, estimate) for estimate, *_ in rows[:2 * SAID]]
    doubted, said = (next((k for k, word in enumerate(words, 1) if word in levels), None)
                     for levels in (('unsure', 'lost'), ('lost',)))
    near = [error < NEAR for _, error, _ in rows]
    found = next((k for k in range(1, len(near) - STAYS + 2) if all(near[k - 1:k - 1 + STAYS])),
                 None)
    return Course(doubted, said, found, sum(gated for *_, gated in rows[:FOUND]),
                  rows[-1][0].watch.recoveries if rows else 0)


def _word(grid: Grid, estimate: Any) -> str:
    """Return the level of the verdict on an estimate's position."""
    axes = range(min(grid.ndim, 2))
    place = estimate.belief.on(grid, axes)
    if not place.mass > 0:
        return 'lost'
    filled = np.exp(place.entropy()) / (place.grid.size * place.grid.cell_volume)
    return verdict(estimate.watch, ALARM, float(filled),
                   [mode.mass for mode in place.modes()]).level


# On the recording

def _kidnaps(name: str) -> Iterator[tuple[float, Array]]:
    """Yield moments and moves after which the drive stays on the grid."""
    recording = load('Plaza1')
    grid = _config(recording, name).grid
    low, high = np.array(grid.lower[:2]), np.array(grid.upper[:2])
    for seconds in MOMENTS:
        start = recording.start_ns + round(seconds * 1e9)
        stamps = np.arange(start, start + round(AFTER * 1e9), 10**9)
        for degrees in DIRECTIONS:
            move = FAR * np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])
            drive = recording.truth_at(stamps)[:, :2] + move
            if np.all((drive > low + NEAR) & (drive < high - NEAR)):
                yield seconds, move


def _config(recording: Recording, name: str) -> Config:
    with TemporaryDirectory() as folder:
        return Config.from_yaml(parameters_for(recording, Path(folder), name))


def _moved(recording: Recording, at_ns: int, move: Array) -> Recording:
    """Return the recording of a robot that is set down elsewhere at a stamp."""
    place = recording.truth_at(recording.range_stamps_ns)[:, :2]
    beacons = np.array([recording.beacons[k] for k in recording.beacon_ids.tolist()])
    longer = np.hypot(*(place + move - beacons).T) - np.hypot(*(place - beacons).T)
    after, later = recording.range_stamps_ns >= at_ns, recording.truth_stamps_ns >= at_ns
    truth = recording.truth.copy()
    truth[later, :2] += move
    return dataclasses.replace(recording, truth=truth, ranges=recording.ranges
                               + np.where(after, SCALE * longer, 0.0))


def _on_plaza(name: str, seconds: float, move: Array) -> dict[str, Course]:
    """Return how each filter fares that is kidnapped so many seconds into the recording."""
    recording = load('Plaza1')
    config = _config(recording, name)
    at_ns = recording.start_ns + round(seconds * 1e9)
    kidnapped, span = _moved(recording, at_ns, move), Span(seconds - BEFORE, BEFORE + AFTER)
    grid: Any = build_tracker(config).filter
    filters = _filters(grid, 0.2 if grid.model.inputs else 0.25)
    start = recording.truth_at(at_ns - round(BEFORE * 1e9))[:grid.model.ndim]
    found = {}
    for kind, guard in _guards(filters, config.measurements.names).items():
        # the grid begins anywhere, the others where it is
        filter_ = filters[kind]
        prior = (filter_.uniform() if filter_ is grid else
                 filter_.gaussian(start, np.diag([0.25, 0.25, 0.01][:len(start)])))
        tracker = Tracker(filter_, prior, config.time.history,
                          hold=config.control.hold, guard=guard)
        found[kind] = _course(grid.grid, [
            (estimate, _error(estimate, kidnapped.truth_at(stamp)), gated)
            for stamp, estimate, gated in _estimates(kidnapped, span, tracker) if stamp >= at_ns])
    return found


def _filters(grid: Any, time_step: float) -> dict[str, Any]:
    ekf = ExtendedKalmanFilter(grid.model, grid.sensors, time_step, grid.grid)
    return {OURS: grid, OPEN: grid, GATED: ekf, RECOVERING: ekf}


def _estimates(recording: Recording, span: Span,
               tracker: Tracker[Any]) -> Iterator[tuple[int, Any, bool]]:
    for stamp in played(recording, span, tracker):
        estimate = tracker.estimate()
        yield stamp, estimate, tracker.corrections[-1].gated


def _error(estimate: Any, truth: Array) -> float:
    return float(np.linalg.norm(estimate.belief.mean()[:2] - truth[:2]))


# Simulated

def _simulated(given: Mapping[str, Any], start: Sequence[float], move: Sequence[float],
               control: Sequence[float], seed: int) -> dict[str, Course]:
    """Return how each filter fares that is kidnapped in the middle of a simulated drive."""
    count, step_ns = 100 + FOUND + STAYS, 250_000_000
    config, rng = Config.from_parameters(given), np.random.default_rng(seed)
    grid: Any = build_tracker(config).filter
    times = np.arange(count) * step_ns * 1e-9
    plain = grid.model.under(control)
    path = simulate(plain, start, times[:101], rng, 10)
    path = np.concatenate([path[:-1], simulate(
        plain, path[-1] + np.array(move), times[100:], rng, 10)])
    sources = list(config.measurements.names)
    seen = [sources[k % len(sources)] for k in range(count)]
    values = [measure(grid.sensors[name], x, t, rng) for name, x, t in zip(seen, path, times)]
    found = {}
    filters = _filters(grid, 0.05)
    for kind, guard in _guards(filters, sources).items():
        tracker = Tracker(filters[kind], filters[kind].gaussian(
            start, np.diag(config.prior.covariance_diagonal)), hold=1.0, guard=guard)
        rows = []
        for k, (name, x, y) in enumerate(zip(seen, path, values)):
            stamp = k * step_ns
            if control:
                tracker.control(stamp, control)
            tracker.observe(Measurement(stamp, name, tuple(y.tolist())))
            estimate = tracker.estimate()
            rows.append((estimate, _error(estimate, x), tracker.corrections[-1].gated))
        found[kind] = _course(grid.grid, rows[100:])
    return found


def _wiener(seed: int) -> dict[str, Course]:
    return _simulated({
        'model.name': 'wiener', 'model.params.sigma': 0.3, 'model.params.sigma_y': 0.5,
        'grid.lower': [-40.0], 'grid.upper': [40.0], 'grid.shape': [400], 'prior.mean': [-10.0],
        'prior.covariance_diagonal': [1.0], 'kernel.time_step': 0.25}, [-10.0], [FAR], (), seed)


def _ranges(seed: int) -> dict[str, Course]:
    return _simulated({
        'model.name': 'position_2d', 'model.params.diffusion': 0.3, **_plane([160, 160]),
        'prior.mean': [-12.0, -10.0], 'prior.covariance_diagonal': [1.0, 1.0],
        'kernel.time_step': 0.25, **_landmarks('range')}, [-12.0, -10.0], [16.0, 12.0], (), seed)


def _bearings(seed: int) -> dict[str, Course]:
    return _simulated({
        'model.name': 'unicycle_2d', 'model.params.sigma_position': 0.1,
        'model.params.sigma_heading': 0.05, **_plane([80, 80, 36], np.pi),
        'grid.periodic': [False, False, True], 'prior.mean': [-12.0, -10.0, 0.0],
        'prior.covariance_diagonal': [1.0, 1.0, 0.1], 'kernel.time_step': 0.25,
        **_landmarks('bearing')}, [-12.0, -10.0, 0.0], [16.0, 12.0, 0.0], (1.0, 0.2), seed)


def _plane(shape: Sequence[int], *more: float) -> dict[str, Any]:
    edges = [40.0, 40.0, *more]
    return {'grid.lower': [-edge for edge in edges], 'grid.upper': edges,
            'grid.shape': list(shape)}


def _landmarks(sensor: str) -> dict[str, Any]:
    """Return three sources that see a landmark each."""
    places, sigma = ([-30.0, -25.0], [32.0, -20.0], [0.0, 33.0]), 0.5
    given: dict[str, Any] = {'measurements.names': ['a', 'b', 'c']}
    for name, place in zip('abc', places):
        given |= {f'measurements.{name}.sensor': sensor,
                  f'measurements.{name}.params.landmark': place,
                  f'measurements.{name}.params.sigma': sigma if sensor == 'range' else 0.03}
    return given


SYSTEMS: Mapping[str, Callable[[int], dict[str, Course]]] = {
    'wiener, its position': _wiener, 'position_2d, three ranges': _ranges,
    'unicycle_2d, three bearings': _bearings}
