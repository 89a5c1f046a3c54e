"""Each example at a small size: its filters against particles, and what it is to show."""

from functools import cache
from pathlib import Path
import tempfile

import numpy as np
from pif_ros.reproduction.catalogue import EXAMPLES, find
from pif_ros.reproduction.examples import (arctangent_sensor, coupled_trigonometric, cubic_bearing,
                                           cubic_sensor, multiplicative_4d, sine_cubic_drift)
from pif_ros.reproduction.pictures import cloud_picture
from pif_ros.reproduction.smoothing_case import APART
from pif_ros.reproduction.study import Outcome
import pytest

SCRATCH = tempfile.TemporaryDirectory(prefix='pif_ros_test_')


@cache
def outcome(name: str, case: int) -> Outcome:
    """Return what a case gives at its small size for the first seed."""
    return find(name).cases(True, SCRATCH.name)[case].run(0, True)


def score(name: str, case: int, entry: str, of: str) -> float:
    return outcome(name, case).scores[entry][of]


@pytest.mark.parametrize(('name', 'case', 'best', 'within'), [
    # the scatter of the mean of 1000 to 2000 particles about a posterior as wide as it is here
    ('tm-4', 0, sine_cubic_drift.BEST, 0.03),
    ('sensors-2', 0, coupled_trigonometric.BEST, 0.10),
    ('sensors-2', 1, coupled_trigonometric.BEST, 0.15),
    ('pmc-1', 0, arctangent_sensor.BEST, 0.010),
    ('pmc-1', 1, arctangent_sensor.BEST, 0.010),
    # and of 500
    ('pmc-2', 0, cubic_sensor.BEST, 0.05),
    ('sensors-3', 0, multiplicative_4d.BEST, 0.6),
    ('sensors-3', 1, multiplicative_4d.BEST, 0.6),
    # twice the printed cells still spread x1 by about half a cell, 0.01 and 0.025, and more in all
    ('sensors-1', 0, cubic_bearing.BEST, 0.03),
    ('sensors-1', 1, cubic_bearing.BEST, 0.06)])
def test_the_best_grid_has_the_mean_of_many_particles(name, case, best, within):
    assert score(name, case, best, 'to_optimum') < within
    rmse = [score(name, case, entry, 'rmse') for entry in (best, _optimum(name, case))]
    assert rmse[0] < rmse[1] + within


def _optimum(name: str, case: int) -> str:
    entries = find(name).cases(True, SCRATCH.name)[case].entries
    return next(entry.name for entry in entries if entry.role == 'optimum')


@pytest.mark.parametrize(('name', 'case', 'best', 'within'), [
    ('tm-4', 0, sine_cubic_drift.BEST, 1.0), ('sensors-2', 0, coupled_trigonometric.BEST, 0.5),
    ('pmc-1', 0, arctangent_sensor.BEST, 0.3), ('pmc-1', 1, arctangent_sensor.BEST, 0.3),
    ('pmc-2', 0, cubic_sensor.BEST, 0.1)])
def test_the_best_grid_has_the_evidence_of_many_particles(name, case, best, within):
    # the scatter of the log of the evidence of 500 to 2000 particles, corrections added up
    evidence = [score(name, case, entry, 'log_evidence') for entry in (best, _optimum(name, case))]
    assert evidence[0] == pytest.approx(evidence[1], abs=within)


def test_the_sign_is_not_seen_and_few_particles_lose_it():
    scores = find('tm-4').cases(True, SCRATCH.name)[0].run(1, False).scores
    alive = {entry: scores[entry]['both signs alive'] for entry in (
        sine_cubic_drift.PRINTED, sine_cubic_drift.BEST, sine_cubic_drift.SIR)}
    assert alive[sine_cubic_drift.BEST] == alive[sine_cubic_drift.PRINTED] == 1.0
    assert alive[sine_cubic_drift.SIR] < 0.9


def test_inflated_noise_widens_what_is_believed():
    tracks = outcome('sensors-1', 0).exhibit.tracks
    spread = {entry: np.sqrt(tracks[entry].variances).mean() for entry in (
        cubic_bearing.PRINTED, cubic_bearing.BEST, cubic_bearing.OPTIMUM)}
    entries = find('sensors-1').cases(True, SCRATCH.name)[0].entries
    assert 'noise inflation 1,' in entries[0].setting
    assert spread[cubic_bearing.PRINTED] > 2 * spread[cubic_bearing.OPTIMUM]
    assert spread[cubic_bearing.BEST] < 1.6 * spread[cubic_bearing.OPTIMUM]


def test_the_printed_extent_loses_mass_and_a_wide_window_does_not():
    assert score('sensors-2', 1, coupled_trigonometric.PRINTED, 'mass') < 0.9
    assert score('sensors-2', 1, coupled_trigonometric.WIDE, 'mass') > 0.99


def test_the_operator_made_for_one_sensor_is_loaded_for_the_other():
    outcome('sensors-3', 0)
    kernels = {file: file.stat().st_mtime_ns for file in Path(SCRATCH.name).glob('*.kernel')}
    assert len(kernels) == 2
    outcome('sensors-3', 1)
    assert {file: file.stat().st_mtime_ns for file in kernels} == kernels


def test_where_the_noise_is_small_the_printed_forms_are_off():
    off = {entry: score('pmc-1', 1, entry, 'to_optimum') for entry in (
        arctangent_sensor.PRINTED, arctangent_sensor.POST, arctangent_sensor.BEST)}
    assert off[arctangent_sensor.BEST] < 0.3 * off[arctangent_sensor.POST]
    assert off[arctangent_sensor.POST] < off[arctangent_sensor.PRINTED]


@pytest.mark.parametrize('case', [0, 1])
def test_paths_and_grid_differ_by_monte_carlo_error_alone(case):
    # about 1 for one window, whose moments are not independent of one another
    assert score('tm-9', case, 'path Monte Carlo', APART) < 2.0
    assert score('tm-9', case, 'smoother', 'rmse') == pytest.approx(
        score('tm-9', case, 'path Monte Carlo', 'rmse'), abs=0.05)


@pytest.mark.parametrize('name', [name for name in EXAMPLES if name not in (
    'tm-1', 'tm-2', 'tm-3')])
def test_every_picture_can_be_drawn(name, tmp_path):
    example = find(name)
    exhibits = {case.name: outcome(name, k).exhibit
                for k, case in enumerate(example.cases(True, SCRATCH.name))}
    pictures = example.draw(exhibits)
    assert pictures
    for file, figure in pictures.items():
        figure.savefig(tmp_path / file)
        assert (tmp_path / file).stat().st_size > 10_000


def test_below_the_clouds_the_grid_is_shown_with_both_signs():
    record = outcome('tm-4', 0).exhibit.record
    grid = sine_cubic_drift.FINE
    x, count = grid.axes[0], len(record.stamps_ns)
    film = np.tile(np.exp(-(np.abs(x) - 4.0)**2), (count, 1))
    figure = cloud_picture(record, {'SIR': np.ones((count // 2, 1, 5))}, {'grid': (film, grid)},
                           0, 'x', 2)
    below = figure.axes[-1]
    assert below.get_title(loc='left') == 'grid'
    shown = below.images[0].get_array()
    np.testing.assert_array_equal(shown.mask, shown.mask[::-1])
    assert shown[np.abs(x + 4.0).argmin(), 0] == shown[np.abs(x - 4.0).argmin(), 0] > 0.99
