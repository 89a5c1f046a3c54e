"""The demonstration's findings, written down: a table, the numbers, the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import json
from pathlib import Path
from typing import Any

import numpy as np
from pif_ros.config import build_filter, Config, find_grid, find_system
from pif_ros.core.filters import Filter
from pif_ros.core.models import Sensor
from pif_ros.plaza.baseline import extended_kalman_track
from pif_ros.plaza.evaluation import corrected, forecasts, moments, Run, scores
from pif_ros.plaza.moments import telling_moments
from pif_ros.plaza.pictures import draw_errors, draw_moments, draw_track
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Scores, table, Track
from pif_ros.plaza.schedule import Span

GRID = 'grid filter, over DDS, from a uniform prior'
EKF = 'EKF, from the truth'
EKF_LOST = 'EKF, from the middle of the yard'


def write(run: Run, span: Span, params_file: Path, out: Path) -> str:
    """
    Write table.md, results.json, density.png, track.png and errors.png into out.

    Returns the table, a line on what became of the ranges, and one on the forecasts.
    """
    tracks = {GRID: corrected(run), **_baselines(run.recording, span, params_file)}
    scored = scores(run.recording, tracks)
    silent = forecasts(run)
    text = f'{table(scored)}\n{_account_line(run)}\n{_forecast_line(run, silent)}\n'
    (out / 'table.md').write_text(text)
    (out / 'results.json').write_text(json.dumps(_numbers(run, scored, silent), indent=2) + '\n')
    taken = moments(run, telling_moments(run.recording, span))
    if taken:
        draw_moments(out / 'density.png', run.recording, taken)
    draw_track(out / 'track.png', run.recording, tracks[GRID])
    draw_errors(out / 'errors.png', run.recording, {name: tracks[name] for name in (GRID, EKF)})
    return text


def _baselines(recording: Recording, span: Span, params_file: Path) -> dict[str, Track]:
    """Return the tracks of the EKF with the same model, sensors and history."""
    config = Config.from_yaml(params_file)
    filter_ = build_filter(config, find_system(config))
    first, _ = span.limits_ns(recording)
    first = recording.arrivals_ns[recording.arrivals_ns >= first][0]
    yard = find_grid(config, filter_.model)
    width = np.subtract(yard.upper, yard.lower)
    middle = np.add(yard.upper, yard.lower) / 2.0
    priors = {EKF: (recording.truth_at(first)[:2], np.eye(2)),
              EKF_LOST: (middle, np.diag(width**2 / 12.0))}
    sensors = _sensors(recording, config, filter_)
    return {name: extended_kalman_track(recording, span, filter_.model, sensors, mean, covariance,
                                        config.time.history)
            for name, (mean, covariance) in priors.items()}


def _sensors(recording: Recording, config: Config,
             filter_: Filter[Any]) -> Mapping[int, Sensor]:
    """Return the sensor of each beacon, known by its topic."""
    by_topic = {source.topic.strip('/'): filter_.sensors[name]
                for name, source in config.measurements.sources.items()}
    return {beacon: by_topic[f'beacon_{beacon}/range'] for beacon in recording.beacons}


def _forecast_scores(run: Run, silent: Track) -> Scores | None:
    if len(silent.stamps_ns) == 0:
        return None
    return scores(run.recording, {GRID: silent}, skip=0.0)[GRID]


def _account_line(run: Run) -> str:
    late = int(np.sum(run.recording.range_stamps_ns < run.recording.arrivals_ns))
    told = ', '.join(f'{count} {what}' for what, count in run.accounts.items())
    return (f'Ranges: {run.sent} sent ({late} late ones in the whole recording); '
            f'the node says: {told or "nothing"}.')


def _forecast_line(run: Run, silent: Track) -> str:
    found = _forecast_scores(run, silent)
    if found is None:
        return 'No forecasts across silences were published.'
    return (f'Forecasts across silences of more than 10 s: {found.count}, of which '
            f'{found.coverage_1_sigma:.2f} in 1 sigma and {found.coverage_2_sigma:.2f} in 2.')


def _numbers(run: Run, scored: Mapping[str, Scores], silent: Track) -> dict[str, object]:
    found = _forecast_scores(run, silent)
    stamps = run.recording.range_stamps_ns
    return {
        'recording': run.recording.name,
        'ranges_sent': run.sent,
        'node_accounts': dict(run.accounts),
        'ranges_late_in_recording': int(np.sum(stamps < run.recording.arrivals_ns)),
        'poses_received': len(run.poses.stamps_ns),
        'scores': {name: asdict(s) for name, s in scored.items()},
        'forecasts': None if found is None else asdict(found)}
