"""The demonstration's findings, written down: a table, the numbers, the pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
import json
from pathlib import Path

import numpy as np
from pif_ros.config import build_filter, Config, find_grid, find_system
from pif_ros.core.rivals import ExtendedKalmanFilter
from pif_ros.core.tracker import Tracker
from pif_ros.plaza.baseline import estimates
from pif_ros.plaza.evaluation import corrected, forecasts, moments, Run, scores
from pif_ros.plaza.moments import telling_moments
from pif_ros.plaza.pictures import draw_errors, draw_track
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.report import Scores, table, Track
from pif_ros.plaza.schedule import Span
from pif_ros.plaza.snapshots import draw_moments

#: Standard deviations of a start that is known, in metres and radians.
KNOWN = np.array([1.0, 1.0, 0.1])
GRID = 'grid filter, over DDS, from a uniform prior'
EKF = 'EKF, from the truth'
EKF_LOST = 'EKF, from the middle of the yard'
#: The EKF's longest step, in seconds.
_STEP = 0.2


def write(run: Run, span: Span, params_file: Path, out: Path) -> str:
    """
    Write table.md, results.json, density.png, track.png and errors.png into out.

    Returns the table, lines on what became of ranges and odometry, and one on the forecasts.
    """
    tracks = {GRID: corrected(run), **_baselines(run.recording, span, params_file)}
    scored = scores(run.recording, tracks)
    silent = forecasts(run)
    text = f'{table(scored)}\n{_account_lines(run)}\n{_forecast_line(run, silent)}\n'
    (out / 'table.md').write_text(text)
    (out / 'results.json').write_text(json.dumps(_numbers(run, scored, silent), indent=2) + '\n')
    taken = moments(run, telling_moments(run.recording, span, 'controls' in run.sent))
    if taken:
        draw_moments(out / 'density.png', run.recording, taken)
    draw_track(out / 'track.png', run.recording, tracks[GRID].position(), span=span)
    draw_errors(out / 'errors.png', run.recording, {name: tracks[name] for name in (GRID, EKF)})
    return text


def _baselines(recording: Recording, span: Span, params_file: Path) -> dict[str, Track]:
    """Return the tracks of the EKF with the same model, sensors, history and controls."""
    config = Config.from_yaml(params_file)
    same = build_filter(config, find_system(config))
    yard = find_grid(config, same.model)
    ekf = ExtendedKalmanFilter(same.model, same.sensors, _STEP, yard)
    first, _ = span.limits_ns(recording)
    first = recording.arrivals_ns[recording.arrivals_ns >= first][0]
    n = same.model.ndim
    priors = {EKF: ekf.gaussian(recording.truth_at(first)[:n], np.diag(KNOWN[:n]**2)),
              EKF_LOST: ekf.uniform()}
    return {name: estimates(recording, span, Tracker(
        ekf, prior, config.time.history, hold=config.control.hold))
            for name, prior in priors.items()}


def _forecast_scores(run: Run, silent: Track) -> Scores | None:
    if len(silent.stamps_ns) == 0:
        return None
    return scores(run.recording, {GRID: silent}, skip=0.0)[GRID]


def _account_lines(run: Run) -> str:
    late = int(np.sum(run.recording.range_stamps_ns < run.recording.arrivals_ns))
    remarks = {'ranges': f' ({late} late ones in the whole recording)'}
    lines = []
    for what, sent in run.sent.items():
        told = ', '.join(f'{n} {became}' for became, n in run.accounts.get(what, {}).items())
        lines.append(f'{what.capitalize()}: {sent} sent{remarks.get(what, "")}; '
                     f'the node says: {told or "nothing"}.')
    return '\n'.join(lines)


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
        'sent': dict(run.sent),
        'node_accounts': {what: dict(account) for what, account in run.accounts.items()},
        'ranges_late_in_recording': int(np.sum(stamps < run.recording.arrivals_ns)),
        'poses_received': len(run.poses.stamps_ns),
        'scores': {name: asdict(s) for name, s in scored.items()},
        'forecasts': None if found is None else asdict(found)}
