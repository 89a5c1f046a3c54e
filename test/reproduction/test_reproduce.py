"""The command, from its arguments to its files."""

import json
from pathlib import Path
import subprocess
import sys

from pif_ros.reproduction import chapter, main, report
from pif_ros.reproduction.catalogue import EXAMPLES, find
import pytest


def reproduce(*arguments: str) -> int:
    return main.main([str(argument) for argument in arguments])


@pytest.mark.parametrize(('arguments', 'reason'), [
    (['tm-5'], 'EXAMPLE: expected some of tm-1, tm-2, '),
    ([], 'EXAMPLE: expected names of examples or --all, got neither'),
    (['tm-1', '--all'], 'EXAMPLE: expected names of examples or --all, got both'),
    (['tm-1', '--seeds', '0'], '--seeds: expected 1 or more, got 0'),
    (['tm-1', '--jobs', '0'], '--jobs: expected 1 or more, or -1, got 0'),
    (['tm-1', '--backend', 'dask'], '--scheduler: expected the address of a scheduler with'),
    (['tm-1', '--scheduler', 'tcp://a:1'], '--scheduler: expected the address of a scheduler')])
def test_bad_arguments_are_one_line_and_status_2(tmp_path, capsys, arguments, reason):
    assert reproduce(*arguments, '--out', tmp_path) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(f'reproduce: {reason}') and printed.err.count('\n') == 1
    assert printed.out == ''


def test_a_folder_is_asked_for(capsys):
    assert reproduce('tm-1') == 2
    assert capsys.readouterr().err == (
        'reproduce: --out: expected a folder for what is found, got none\n')


def test_every_example_is_listed_with_its_place_in_the_papers(capsys):
    assert reproduce('--list') == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(':')[0] for line in lines] == list(EXAMPLES)
    assert 'sensors-3: Four states with multiplicative noise [Sensors, section 5.3]' in lines


def test_names_of_cases_and_entries_are_unique():
    cases = [case for name in EXAMPLES for case in find(name).cases(True, '')]
    assert len({case.name for case in cases}) == len(cases)
    for case in cases:
        names = [entry.name for entry in case.entries]
        assert len(set(names)) == len(names)
        assert {e.entry for e in case.expected} <= set(names)


def test_an_example_is_run_written_kept_and_run_again_for_other_code(
        tmp_path, capsys, monkeypatch):
    assert reproduce('pmc-1', '--seeds', 2, '--quick', '--jobs', 1, '--out', tmp_path) == 0
    assert capsys.readouterr().out == (tmp_path / 'pmc-1' / 'table.md').read_text() + '\n'
    results = json.loads((tmp_path / 'results.json').read_text())['pmc-1']
    assert [case['name'] for case in results['cases']] == [
        'pmc-1, sigma_y = 0.05', 'pmc-1, sigma_y = 0.0125']
    check(results, tmp_path / 'pmc-1')

    monkeypatch.setattr(chapter, 'outcomes', lambda *_: pytest.fail('it was run again'))
    again = chapter.make('pmc-1', range(2), True, tmp_path, resume=True)
    assert again == results
    for seeds, code in ((range(3), again['code']), (range(2), 'other')):
        monkeypatch.setattr(chapter, 'fingerprint', lambda code=code: code)
        with pytest.raises(pytest.fail.Exception, match='run again'):
            chapter.make('pmc-1', seeds, True, tmp_path, resume=True)


def check(results: dict, folder: Path) -> None:
    """Hold results against what programs rely on."""
    assert results['format'] == report.FORMAT and results['seeds'] == [0, 1]
    for case in results['cases']:
        assert case['held'] == []  # small sizes are held against nothing
        roles = [row['role'] for row in case['rows']]
        assert {'printed', 'best', 'sir', 'ekf', 'optimum'} <= set(roles)
        for row in case['rows']:
            assert row['seeds'] == [0, 1] and row['lost'] == []
            assert row['command'] == (
                'ros2 run pif_ros reproduce pmc-1 --seeds 2 --quick --out DIR')
            for score in ('rmse', 'coverage_1', 'coverage_2', 'step_s', 'to_optimum', 'to_best'):
                figure = row['figures'][score]
                assert set(figure) == {'values', 'mean', 'standard_error', 'median'}
                assert len(figure['values']) == 2
                assert figure['mean'] == pytest.approx(sum(figure['values']) / 2)
    assert len(results['pictures']) == 6
    for name in results['pictures']:
        assert (folder / name).stat().st_size > 10_000


def test_processes_find_what_one_finds(tmp_path):
    # each in a process of its own, since with more threads libraries sum in another order
    for jobs in '12':
        subprocess.run([sys.executable, '-m', 'pif_ros.reproduction.main', 'tm-1', '--quick',
                        '--seeds', '2', '--out', tmp_path / jobs, '--jobs', jobs],
                       check=True, capture_output=True, timeout=120)
    one, two = (json.loads((tmp_path / jobs / 'tm-1' / 'results.json').read_text())['cases']
                for jobs in '12')
    assert one == two


def test_a_cluster_finds_what_this_machine_finds(tmp_path):
    distributed = pytest.importorskip('dask.distributed')
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False,
                                  dashboard_address=None) as here:
        assert reproduce('tm-1', '--quick', '--seeds', 2, '--out', tmp_path / 'dask',
                         '--backend', 'dask', '--scheduler', here.scheduler_address) == 0
    assert reproduce('tm-1', '--quick', '--seeds', 2, '--jobs', 1, '--out', tmp_path / 'own') == 0
    there, own = (json.loads((tmp_path / name / 'tm-1' / 'results.json').read_text())['cases']
                  for name in ('dask', 'own'))
    assert there == own
