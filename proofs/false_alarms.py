"""
How often a filter that is not lost is said to be, out of 100,000 measurements of its own model.

Three systems are simulated from their priors on, each filter with the model and the noise that
the truth has: a linear one, ranges to two landmarks, which a mirror image of the place has too,
and ranges to three.  How often each surprises is held against what it should be: uniform.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.core.guard import Guard
from pif_ros.core.lost import Alarm
from pif_ros.core.simulation import measure, simulate
from pif_ros.core.tracker import Tracker

#: Measurements in all, and the share of alarms that is to be stayed below.
COUNT, WANTED = 100_000, 1e-4
#: Measurements of one run: then another truth begins.
RUN = 1000
LEVELS = (0.1, 0.01, 0.001)
ALARM = Alarm(1e-5)


def _plane(**landmarks: list[float]) -> dict[str, Any]:
    """Return a walk in the plane, seen by ranges to landmarks."""
    given = {'model.name': 'position_2d', 'model.params.diffusion': 0.1,
             'grid.lower': [-7.0, -7.0], 'grid.upper': [7.0, 7.0], 'grid.shape': [70, 70],
             'prior.mean': [0.0, 0.0], 'prior.covariance_diagonal': [1.0, 1.0],
             'kernel.time_step': 0.1, 'measurements.names': list(landmarks)}
    for name, place in landmarks.items():
        given |= {f'measurements.{name}.sensor': 'range',
                  f'measurements.{name}.params.landmark': place,
                  f'measurements.{name}.params.sigma': 0.5}
    return given


#: Each with its share of all.
SYSTEMS: Mapping[str, tuple[float, Mapping[str, Any]]] = {
    'ornstein_uhlenbeck': (0.5, {
        'model.name': 'ornstein_uhlenbeck', 'grid.lower': [-4.5], 'grid.upper': [4.5],
        'grid.shape': [120], 'prior.mean': [0.0], 'prior.covariance_diagonal': [0.5],
        'kernel.time_step': 0.1}),
    'position_2d, two ranges, two modes': (0.3, _plane(a=[-9.0, 0.0], b=[9.0, 0.0])),
    'position_2d, three ranges': (0.2, _plane(a=[-9.0, -8.0], b=[9.0, -7.0], c=[0.0, 10.0]))}


def run(share: float = 1.0) -> list[str]:
    """Return what was found, a line each; AssertionError where a claim does not hold."""
    lines, alarms, total = [], 0, 0
    for name, (part, given) in SYSTEMS.items():
        runs = max(round(share * part * COUNT / RUN), 1)
        found = [_healthy(given, seed) for seed in range(runs)]
        tails = np.concatenate([tail for tail, _ in found])
        raised = sum(count for _, count in found)
        rates = ', '.join(f'{level:g}: {np.mean(tails < level):.2g}' for level in LEVELS)
        lines.append(f'{name}: {len(tails)} measurements, {raised} false alarms; '
                     f'tail probabilities below {rates}')
        alarms, total = alarms + raised, total + len(tails)
        assert abs(np.mean(tails < LEVELS[0]) - LEVELS[0]) < 0.1 * LEVELS[0] + 4 * np.sqrt(
            LEVELS[0] / len(tails)), lines
    lines.append(f'all: {alarms} false alarms in {total} measurements')
    assert alarms < max(WANTED * total, 1), lines
    return lines


def _healthy(given: Mapping[str, Any], seed: int) -> tuple[NDArray[np.float64], int]:
    """Return the tail probabilities of a run, and how often an alarm was raised in it."""
    config, rng = Config.from_parameters(given), np.random.default_rng(seed)
    made = build_tracker(config)
    step_ns, sources = made.filter.time_step_ns, list(config.measurements.names)
    times = np.arange(RUN) * step_ns * 1e-9
    start = rng.normal(config.prior.mean, np.sqrt(config.prior.covariance_diagonal))
    path = simulate(made.filter.model, start, times, rng, 10)
    tracker = Tracker(made.filter, made.prior, guard=Guard(alarm=ALARM))
    tails, raised, lost = [], 0, False
    for k, x in enumerate(path):
        name = sources[k % len(sources)]
        y = measure(tracker.filter.sensors[name], x, times[k], rng)
        tracker.observe(Measurement(k * step_ns, name, tuple(y.tolist())))
        estimate = tracker.estimate()
        tails.append(tracker.corrections[-1].tail)
        raised += estimate.watch.lost and not lost
        lost = estimate.watch.lost
    return np.array(tails), raised
