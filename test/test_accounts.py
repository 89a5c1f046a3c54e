"""What became of every measurement, in words."""

from pif_ros import accounts
from pif_ros.accounts import Accounts, SourceAccount, Throttle
import pytest


class Watch:
    """A clock that is set by hand."""

    def __init__(self) -> None:
        """Begin long after the epoch of the real one."""
        self.now = 1e6

    def monotonic(self) -> float:
        """Return what it was set to."""
        return self.now


@pytest.fixture
def watch(monkeypatch):
    """Return a clock for the throttle."""
    watch = Watch()
    monkeypatch.setattr(accounts, 'time', watch)
    return watch


def test_an_account_in_words_has_every_number_and_every_reason():
    account = SourceAccount(received=12, accepted=5, dropped=3)
    account.rejected['too late'] += 3
    account.rejected['not finite'] += 1
    assert str(account) == ('12 received, 5 accepted, 4 rejected (3 too late, 1 not finite), '
                            '3 dropped')


def test_an_account_without_rejections_names_no_reason():
    assert str(SourceAccount(received=1, accepted=1)) == (
        '1 received, 1 accepted, 0 rejected, 0 dropped')


def test_outliers_are_told_as_a_part_of_the_accepted():
    assert '7 accepted (2 outliers), 0 rejected' in str(
        SourceAccount(received=7, accepted=7, outliers=2))


def test_accounts_name_their_sources_and_the_initial_pose_where_there_was_one():
    both = Accounts(('gps', 'tower'))
    both.sources['tower'].received = 2
    assert str(both) == ('gps: 0 received, 0 accepted, 0 rejected, 0 dropped; '
                         'tower: 2 received, 0 accepted, 0 rejected, 0 dropped')
    both.initial_pose.received = both.initial_pose.accepted = 1
    assert str(both).endswith('; initialpose: 1 received, 1 accepted, 0 rejected, 0 dropped')


def test_accounts_of_sources_are_apart():
    both = Accounts(('gps', 'tower'))
    both.sources['gps'].rejected['late'] += 1
    assert both.sources['tower'].rejected.total() == 0


def test_the_first_line_of_a_kind_is_said_at_once_and_unchanged(watch):
    assert Throttle().line('late', 'one was late') == 'one was late'


def test_like_lines_are_kept_back_for_the_period_and_counted(watch):
    throttle = Throttle(period=5.0)
    throttle.line('late', 'first')
    said = []
    for second in range(1, 12):
        watch.now += 1.0
        said.append(throttle.line('late', f'after {second} s'))
    assert [line for line in said if line] == [
        'after 5 s (4 more like it)', 'after 10 s (4 more like it)']


def test_a_line_of_another_kind_is_not_kept_back(watch):
    throttle = Throttle()
    throttle.line('late', 'late')
    assert throttle.line('early', 'early') == 'early'


def test_a_line_just_after_the_machine_has_started_is_said(watch):
    watch.now = 0.0
    assert Throttle().line('late', 'late') == 'late'


def test_a_line_shows_no_more_of_a_long_text_than_a_reader_wants(watch):
    line = Throttle().line('frame', 'expected map, got ' + 'x' * 10_000_000)
    assert line.startswith('expected map, got xxx') and len(line) < 600
