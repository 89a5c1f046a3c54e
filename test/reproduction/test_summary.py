"""Seeds come to figures with their errors, and figures are held against what they are to be."""

from dataclasses import dataclass, field
import json

import numpy as np
from pif_ros.reproduction.report import chapter_text, FORMAT, gather, overview, RESULTS, write
from pif_ros.reproduction.study import Entry, Expected, Outcome
from pif_ros.reproduction.summary import Figure, Held, held, plain, rows
import pytest

SEEDS = range(6)
RNG = np.random.default_rng(0)
RMSE = 1.0 + 0.1 * RNG.standard_normal(6)


@dataclass(frozen=True)
class FakeCase:
    """A case whose scores are known."""

    name: str = 'fake'
    title: str = 'nothing'
    printed: str = '1.2'
    entries: tuple = (Entry('ours', 'best', 'fine'), Entry('theirs', 'optimum', 'many'),
                      Entry('lost', 'sir', 'few'))
    expected: tuple = (Expected('ours', 'rmse', 1.0, 0.2, 'a'),)
    remarks: tuple = ('A remark.',)
    median: bool = False
    covered: str = ''
    shift: float = 0.0
    outcomes: list = field(default_factory=list)


def outcomes(worse: float = 0.0, covered: float = 0.0) -> list[Outcome]:
    def scores(rmse: float, coverage: float) -> dict[str, float]:
        return {'rmse': rmse, 'coverage_1': coverage, 'coverage_2': 0.95, 'step_s': 1e-3,
                'start_s': 0.2}
    return [Outcome({'ours': scores(value * (1 + worse), 0.68 + covered),
                     'theirs': scores(value, 0.68),
                     'lost': scores(np.nan if seed == 2 else value, 0.5)})
            for seed, value in zip(SEEDS, RMSE)]


def chapter(found: list[Outcome], name: str = 'fake') -> dict:
    made = rows(FakeCase(), SEEDS, found, f'ros2 run pif_ros reproduce {name} --seeds 6 --out DIR')
    return {'format': FORMAT, 'example': name, 'title': 'Title', 'source': 'TM',
            'made': {'command': 'c', 'machine': 'm', 'date': 'd', 'versions': 'v'},
            'pictures': ['a.png'], 'cases': [{
                'name': 'fake', 'title': 'nothing', 'printed': '1.2', 'median': False,
                'rows': plain(made), 'held': plain(held(FakeCase(), made)),
                'remarks': ['A remark.']}]}


def test_figures_leave_out_what_was_lost():
    figure = Figure.of([1.0, np.nan, 3.0, 8.0])
    assert figure.values == (1.0, None, 3.0, 8.0)
    assert (figure.mean, figure.median) == (4.0, 3.0)
    assert figure.standard_error == pytest.approx(np.std([1, 3, 8], ddof=1) / np.sqrt(3))
    assert Figure.of([2.0]).standard_error is None
    assert Figure.of([np.nan]).mean is None


@pytest.mark.parametrize(('low', 'high', 'verdict'), [
    (None, 1.3, 'held'), (0.7, 1.3, 'held'), (None, 0.95, 'open'), (None, 0.5, 'missed'),
    (1.5, None, 'missed')])
def test_a_miss_within_twice_its_error_is_open(low, high, verdict):
    found = Held.to('mean', np.mean, np.array([0.8, 0.9, 1.0, 1.1, 1.2]), low, high)
    # the standard deviation over the root of the count
    assert found.error == pytest.approx(0.1414 / np.sqrt(5), rel=0.1)
    assert (found.got, found.verdict) == (pytest.approx(1.0), verdict)


@pytest.mark.parametrize(('worse', 'covered', 'verdicts'), [
    (0.02, 0.01, ['held'] * 4), (0.08, 0.0, ['held', 'missed', 'held', 'held']),
    (0.0, -0.03, ['held', 'held', 'missed', 'held'])])
def test_our_best_is_held_against_the_optimum_on_the_same_seeds(worse, covered, verdicts):
    made = rows(FakeCase(), SEEDS, outcomes(worse, covered), '')
    found = held(FakeCase(), made)
    assert [h.verdict for h in found] == verdicts
    # the same factor for every seed hangs on none of them
    assert found[1].got == pytest.approx(1 + worse) and found[1].error < 1e-9


def test_rows_name_their_seeds_and_what_was_lost():
    ours, _, lost = rows(FakeCase(), SEEDS, outcomes(), 'command')
    assert ours.seeds == tuple(SEEDS) and ours.lost == () and ours.command == 'command'
    assert lost.lost == (2,)


def test_the_tables_are_whole(tmp_path):
    text = chapter_text(chapter(outcomes(0.08)))
    assert f'{RMSE.mean() * 1.08:.2f} ± ' in text
    assert 'lost (lost in 1 of 6)' in text and 'A remark.' in text
    assert "- missed: rmse of ours over the optimum's: at most 1.05, got 1.08" in text
    for line in overview([chapter(outcomes())]).splitlines()[2:5]:
        assert line.count('|') == 12
    (tmp_path / 'fake').mkdir()
    write(chapter(outcomes()), tmp_path / 'fake')
    whole = gather(tmp_path, ['absent', 'fake'])
    assert '![a](fake/a.png)' in whole and whole == (tmp_path / 'table.md').read_text()
    assert set(json.loads((tmp_path / RESULTS).read_text())) == {'fake'}


def test_what_is_of_another_format_is_left_out(tmp_path):
    for name, text in (('old', json.dumps({'format': 0})), ('torn', '{"format":')):
        (tmp_path / name).mkdir()
        (tmp_path / name / RESULTS).write_text(text)
    gather(tmp_path, ['old', 'torn'])
    assert json.loads((tmp_path / RESULTS).read_text()) == {}
