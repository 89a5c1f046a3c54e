"""The README says what the code says."""

from pathlib import Path
import re

import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.belief import GridBelief
from pif_ros.core.estimates import Rejection
from pif_ros.core.filters import DiracFeynmanFilter
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import KernelSettings
from pif_ros.core.lost import AMBIGUOUS, SPREAD
from pif_ros.core.steering import MOST_CONTROLS
from pif_ros.reference import filled, tables
from pif_ros.scenario import scenario, Settings
import pytest

README = Path(__file__).parent.parent / 'README.md'


def test_the_tables_of_the_readme_are_those_of_the_code():
    text = README.read_text(encoding='utf-8')
    assert set(re.findall(r'<!-- table: (\w+) -->', text)) == set(tables())
    assert text == filled(text)


def test_a_parameter_that_changes_makes_the_readme_differ():
    text = README.read_text(encoding='utf-8')
    assert filled(text.replace('`kernel.time_step` | `0.01`', '`kernel.time_step` | `0.02`')) \
        == text


def test_every_reason_of_a_rejection_is_named():
    text = ' '.join(README.read_text(encoding='utf-8').split())
    [named] = re.findall(r'counted by its reason \((.*?)\) and logged', text)
    reasons = {rejection.value for rejection in Rejection}
    for file in (README.parent / 'pif_ros').glob('*.py'):
        reasons |= set(re.findall(r"(?:\bRefused|\breject)\((?:inlet, )?'(.*?)'",
                                  file.read_text(encoding='utf-8')))
    assert {'other frame', 'too many', 'overload', 'fault', 'no clock'} <= reasons
    assert [reason for reason in sorted(reasons) if reason not in named] == []
    assert f'{MOST_CONTROLS:,} are kept' in named


def test_the_parameter_file_of_the_readme_makes_a_filter(tmp_path):
    path = tmp_path / 'robot.yaml'
    path.write_text(block('yaml'), encoding='utf-8')
    tracker = build_tracker(Config.from_yaml(path))
    assert set(tracker.filter.sensors) == {'uwb', 'tower', 'gps'}
    [remark] = tracker.filter.remarks()
    assert "1% of the cells are wider than sensor 'tower' resolves" in remark


def test_the_notebook_example_finds_both_signs(capsys):
    exec(block('python', 'GridBelief'), {})
    mean, modes = capsys.readouterr().out.split(' [', 1)
    # y = x^2 = 4.1: the density is even, so that the mean is 0 and the modes are at +-2.02
    assert abs(float(mean.strip('[]'))) < 1e-9
    found = [float(x) for x in re.findall(r'array\(\[([^]]+)\]\)', modes)]
    assert sorted(found) == pytest.approx([-2.02, 2.02], abs=0.15)


def test_the_smoothing_example_looks_back_at_both_signs(capsys):
    scope = {}
    exec(block('python', 'GridBelief'), scope)
    capsys.readouterr()
    exec(block('python', 'smoothing'), scope)
    modes, evidence = capsys.readouterr().out.rsplit('] ', 1)
    found = sorted(float(x) for x in re.findall(r'array\(\[([^]]+)\]\)', modes))
    assert found == pytest.approx([-2.0, 2.0], abs=0.1)
    # the filter's own: the product of what each measurement was expected with
    df, belief, total = scope['df'], scope['df'].gaussian([0.0], np.eye(1)), 0.0
    for k in range(20):
        if k:
            belief = df.predict(belief, (k - 1) * 10_000_000, k * 10_000_000)
        belief, log_evidence = df.correct(belief, [4.0], 'y', k * 10_000_000)
        total += log_evidence
    assert float(evidence) == pytest.approx(total, rel=1e-9)


def test_the_limits_of_being_found_are_those_of_the_code():
    text = README.read_text(encoding='utf-8')
    [limits] = re.findall(r'fills more than (\d+) % .*?less than (\d+) % of', text, re.S)
    assert tuple(int(limit) / 100 for limit in limits) == (SPREAD, AMBIGUOUS)


def test_the_robot_of_the_readme_can_be_simulated(tmp_path):
    path = tmp_path / 'robot.yaml'
    path.write_text(block('yaml'), encoding='utf-8')
    played = scenario(Config.from_yaml(path), Settings(duration=1.0, rate=5.0))
    assert {name: y.shape for name, y in played.measurements.items()} == {
        'uwb': (6, 1), 'tower': (6, 1), 'gps': (6, 2)}


def test_a_system_of_ones_own_works_as_the_readme_has_it():
    scope = {}
    exec(block('python', 'pendulum'), scope)
    system = scope['pendulum']()
    sensors = {'main': system.sensors['height']()}
    grid = Grid((-np.pi, -8), (np.pi, 8), (60, 80), (True, False))
    df = DiracFeynmanFilter(system.model, grid, sensors, KernelSettings(0.01))
    belief = GridBelief.gaussian(grid, [1.0, 0.0], 0.01 * np.eye(2))
    moved = df.predict(belief, 0, 200_000_000)
    # the drift alone: 0.2 s of a pendulum let go at 1 rad
    angle, speed = 1.0, 0.0
    for _ in range(2000):
        angle, speed = (angle + 1e-4 * speed,
                        speed + 1e-4 * (-9.81 * np.sin(angle) - 0.1 * speed))
    assert moved.mean() == pytest.approx([angle, speed], abs=0.05)
    assert np.isfinite(df.correct(moved, [-0.6], 'main', 200_000_000)[1])


def block(language: str, containing: str = '') -> str:
    """Return the README's first code block of a language that contains some text."""
    blocks = re.findall(rf'```{language}\n(.*?)```', README.read_text(encoding='utf-8'), re.S)
    return next(found for found in blocks if containing in found)
