"""How far it is, on stderr."""

import sys

from pif_ros.plaza.progress import Progress
import pytest


def show_all(last: int) -> None:
    progress = Progress(100, last)
    for stamp in range(100, last + 1):
        progress.show(stamp)
    progress.close()


def test_without_tqdm_it_is_lines_on_a_terminal_too(
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    monkeypatch.setitem(sys.modules, 'tqdm', None)
    show_all(1000)
    assert len(capsys.readouterr().err.splitlines()) == 10


@pytest.mark.parametrize('last', [110, 997, 5003])
def test_elsewhere_than_on_a_terminal_it_is_a_line_every_tenth(
        capsys: pytest.CaptureFixture[str], last: int) -> None:
    show_all(last)
    lines = capsys.readouterr().err.splitlines()
    assert [int(line.split()[1]) for line in lines] == list(range(10, 101, 10))


def test_on_a_terminal_it_is_a_bar_in_one_line(
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, 'isatty', lambda: True)
    show_all(1000)
    shown = capsys.readouterr().err
    assert shown.count('\n') == 1 and '100%' in shown
