"""
Recorded runs, whose means and variances are kept in recorded_runs.txt: any change is seen.

    python -m proofs.change        write the file anew, with the same measurements

The last bits differ between processors, and between numba and numpy, so that a number counts as
changed where it is another by more than 1e-9 of its scale.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path

from benchmarks.progress import Progress
import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.core.simulation import measure
from proofs import ROOT
from proofs.inputs import YARD
from ros import PLANE, SECOND

FILE = Path(__file__).with_name('recorded_runs.txt')
#: A file of config/, or parameters, by name: of each engine one.
RUNS = {
    'wiener': 'wiener.yaml', 'double_well': 'double_well.yaml',
    'coupled_trigonometric': 'coupled_trigonometric.yaml', 'cubic_sensor': 'cubic_sensor.yaml',
    'lorenz_63, active cells': 'lorenz_63.yaml', 'position_2d': PLANE,
    'unicycle_2d, driven, active cells': YARD,
    'position_2d, tabulated': {**PLANE, 'kernel.form': 'tabulated'},
    **{f'position_2d, {kind}': {**PLANE, 'filter.type': kind}
       for kind in ('ekf', 'ukf', 'particle')}}
STEPS = 12
INTERVAL_NS = 130_000_000
SEED = 7
START_NS = 1_000 * SECOND
#: A mean counts as changed by more than this share of its standard deviation or its size, a
#: variance of itself, a log evidence of 1 or its size.
CHANGE = 1e-9


@dataclass(frozen=True)
class Step:
    """A measurement of a source at a time in seconds, and what was believed after it."""

    seconds: float
    source: str
    y: tuple[float, ...]
    mean: tuple[float, ...] = ()
    variance: tuple[float, ...] = ()
    log_evidence: float = 0.0


def run(share: float = 1.0) -> list[str]:
    """Hold every run against the file, whatever the share: it is quick."""
    recorded, progress = _read(FILE.read_text(encoding='utf-8')), Progress('change')
    assert set(recorded) == set(RUNS), f'{FILE.name}: runs {sorted(set(recorded) ^ set(RUNS))}'
    changed, numbers = [], 0
    for k, (name, steps) in enumerate(recorded.items()):
        for old, new in zip(steps, _played(name, steps)):
            numbers += 2 * len(new.mean) + 1
            changed += [f'{name} at {new.seconds:g} s: {line}' for line in _changes(old, new)]
        progress.show((k + 1) / len(RUNS))
    assert not changed, '\n'.join(
        [f'{len(changed)} numbers changed of {numbers}; where that is meant, write them anew: '
         'python -m proofs.change', *changed[:20]])
    return [f'{len(RUNS)} recorded runs: {numbers} means, variances and evidences as they were, '
            f'but for {CHANGE:g}']


def _changes(old: Step, new: Step) -> Iterator[str]:
    """Yield a line for every number that is another."""
    for kind in ('mean', 'variance'):
        for i, (was, found) in enumerate(zip(getattr(old, kind), getattr(new, kind))):
            scale = abs(was) + (math.sqrt(old.variance[i]) if kind == 'mean' else 0.0)
            if not abs(found - was) <= CHANGE * scale:
                yield f'{kind} {i + 1}: {was!r} is now {found!r} ({(found - was) / scale:+.1e})'
    was, found = old.log_evidence, new.log_evidence
    if not abs(found - was) <= CHANGE * max(abs(was), 1.0):
        yield f'log evidence: {was!r} is now {found!r} ({found - was:+.1e})'


def _played(name: str, steps: list[Step]) -> Iterator[Step]:
    """Yield the steps with what is believed now."""
    tracker = build_tracker(_config(name))
    for step in steps:
        stamp_ns = START_NS + round(step.seconds * SECOND)
        if tracker.filter.model.inputs:
            tracker.control(stamp_ns - INTERVAL_NS // 3, (1.0 + step.seconds, 0.3))
        rejection = tracker.observe(Measurement(stamp_ns, step.source, step.y))
        assert rejection is None, f'{name}: {rejection}'
        estimate = tracker.estimate()
        yield Step(step.seconds, step.source, step.y, tuple(map(float, estimate.belief.mean())),
                   tuple(map(float, np.diag(estimate.belief.covariance()))),
                   float(estimate.log_evidence))


def _config(name: str) -> Config:
    given = RUNS[name]
    return (Config.from_yaml(ROOT / 'config' / given) if isinstance(given, str)
            else Config.from_parameters(given))


def _measured(name: str) -> list[Step]:
    """Return what a state that wanders about the mean of the prior would be measured as."""
    tracker, rng = build_tracker(_config(name)), np.random.default_rng(SEED)
    sensors = list(tracker.filter.sensors.items())
    x, steps = np.array(tracker.prior.mean()), []
    spread = np.sqrt(np.diag(tracker.prior.covariance()))
    for k in range(STEPS):
        source, sensor = sensors[k % len(sensors)]
        x = x + 0.1 * spread * rng.standard_normal(len(x))
        seconds = k * INTERVAL_NS / SECOND
        y = measure(sensor, x, START_NS / SECOND + seconds, rng)
        steps.append(Step(seconds, source, tuple(round(float(v), 3) for v in y)))
    return steps


def _read(text: str) -> dict[str, list[Step]]:
    """Return the recorded runs by name."""
    runs: dict[str, list[Step]] = {}
    for line in text.splitlines():
        if line.startswith('['):
            steps = runs[line.strip('[]')] = []
        elif line and not line.startswith('#'):
            seconds, source, *numbers = line.split(' | ')
            y, mean, variance, (evidence,) = ([float(v) for v in part.split()]
                                              for part in numbers)
            steps.append(Step(float(seconds), source, tuple(y), tuple(mean), tuple(variance),
                              evidence))
    return runs


def _write(runs: dict[str, list[Step]]) -> str:
    """Return the text of recorded runs."""
    lines = ['# seconds | source | y | means | variances | log evidence']
    for name, steps in runs.items():
        lines += ['', f'[{name}]']
        for step in steps:
            parts = (step.y, step.mean, step.variance, (step.log_evidence,))
            lines.append(' | '.join([f'{step.seconds:g}', step.source,
                                     *(' '.join(map(repr, part)) for part in parts)]))
    return '\n'.join(lines) + '\n'


def main() -> None:
    """Write the file anew; measurements that are recorded stay as they are."""
    recorded = _read(FILE.read_text(encoding='utf-8')) if FILE.exists() else {}
    FILE.write_text(_write({name: list(_played(name, recorded.get(name) or _measured(name)))
                            for name in RUNS}), encoding='utf-8')


if __name__ == '__main__':
    main()
