"""The demonstration, from its command line to its files."""

from collections.abc import Sequence
import json
from pathlib import Path
import signal
import subprocess
import sys

import pytest
import synthetic

FAILING = """
import sys
from pif_ros.plaza import demo, filter_process
filter_process.COMMAND = (sys.executable, '-c', 'import sys; sys.exit("filter_node: no")')
sys.exit(demo.main())
"""


def demo(*arguments: str, program: Sequence[str] = ('-m', 'pif_ros.plaza.demo'),
         ) -> subprocess.Popen:
    """Start the demonstration."""
    return subprocess.Popen([sys.executable, *program, *arguments], text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def test_the_real_node_finds_the_mower_from_a_uniform_prior(
        synthetic_file: Path, tmp_path: Path) -> None:
    process = demo('--out', str(tmp_path / 'out'), '--path', str(synthetic_file))
    output, errors = process.communicate(timeout=120.0)
    assert process.returncode == 0, errors
    out = tmp_path / 'out'
    results = json.loads((out / 'results.json').read_text())
    grid = results['scores']['grid filter, over DDS, from a uniform prior']
    assert grid['median'] < 1.0 and grid['coverage_2_sigma'] > 0.75
    accounts = results['node_accounts']['ranges']
    assert results['sent'] == {'ranges': accounts['received']}
    assert accounts['received'] == accounts['accepted'] > 300
    assert results['forecasts']['count'] >= 25
    assert (out / 'table.md').read_text() in output
    for name in ('density.png', 'track.png', 'errors.png'):
        assert (out / name).stat().st_size > 10000
    assert 'recording 100 %' in errors and 'ended by SIGINT with status 0' in errors


def test_with_odometry_the_real_node_finds_position_and_heading(
        synthetic_file: Path, tmp_path: Path) -> None:
    process = demo('--out', str(tmp_path), '--path', str(synthetic_file), '--odometry',
                   '--duration', '30')
    output, errors = process.communicate(timeout=120.0)
    assert process.returncode == 0, errors
    results = json.loads((tmp_path / 'results.json').read_text())
    for what, sent in results['sent'].items():
        accounts = results['node_accounts'][what]
        assert sent == accounts['received'] == accounts['accepted'] > 100
    grid = results['scores']['grid filter, over DDS, from a uniform prior']
    # the first tenth of the time is not scored; the heading takes some metres
    assert grid['median'] < 0.5 and grid['heading_rmse'] < 45.0
    assert 'Controls: ' in output and 'heading RMSE' in output
    for name in ('density.png', 'track.png', 'errors.png'):
        assert (tmp_path / name).stat().st_size > 10000


def test_a_recording_without_odometry_cannot_be_played_with_it(tmp_path: Path) -> None:
    file = synthetic.write(tmp_path / 'without.mat', DR=None)
    process = demo('--out', str(tmp_path), '--path', str(file), '--odometry')
    assert process.communicate(timeout=30.0)[1] == (
        'plaza_demo: Plaza1: expected a table DR, the odometry\n')
    assert process.returncode == 2


def test_where_the_filter_fails_its_words_are_repeated_and_the_status_is_1(
        synthetic_file: Path, tmp_path: Path) -> None:
    process = demo('--out', str(tmp_path), '--path', str(synthetic_file),
                   program=('-c', FAILING))
    errors = process.communicate(timeout=30.0)[1]
    assert errors.splitlines() == [
        'filter_node: no', 'plaza_demo: the filter node ended by itself with status 1']
    assert process.returncode == 1


def test_a_signal_ends_it_and_the_node(synthetic_file: Path, tmp_path: Path) -> None:
    process = demo('--out', str(tmp_path), '--path', str(synthetic_file), '--speed', '10')
    for line in process.stderr:
        if 'recording  10 %' in line:
            break
    process.send_signal(signal.SIGINT)
    assert process.wait(15.0) == 130
    assert 'stopped; beacon_0' in (tmp_path / 'filter_node.log').read_text()


@pytest.mark.parametrize(('arguments', 'reason'), [
    (['--path', '/absent.mat'], 'plaza_demo: no such recording: /absent.mat\n'),
    (['--start', '1e6'], 'plaza_demo: no range of Plaza1 arrives between 1e+06 s and the end\n'),
    (['--speed', '-1'],
     "plaza_demo: parameter 'speed': expected a number of at least 0, got -1.0\n")])
def test_bad_arguments_are_one_line_and_status_2(
        synthetic_file: Path, tmp_path: Path, arguments: list[str], reason: str) -> None:
    process = demo('--out', str(tmp_path), '--path', str(synthetic_file), *arguments)
    assert process.communicate(timeout=30.0)[1] == reason
    assert process.returncode == 2
