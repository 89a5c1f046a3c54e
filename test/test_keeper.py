"""Who keeps the state: when it is saved, over what, and what is gone on from."""

import threading

from pif_ros import state_file
from pif_ros.config import build_tracker, Config, ConfigError, identity, specifications
from pif_ros.core.estimates import Measurement
from pif_ros.keeper import FAILURES, Keeper
import pytest

SECOND = 1_000_000_000
T = 1_000 * SECOND
PLANE = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [12, 10], 'kernel.time_step': 0.1, 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.4}


class Kept:
    """A tracker with a keeper; lines: what it reported."""

    def __init__(self, file, **more):
        """Make both."""
        self.config = Config.from_parameters({**PLANE, 'state_file': str(file), **more})
        self.tracker, self.lines = build_tracker(self.config), []
        self.keeper = Keeper(self.config, self.tracker, lambda kind, line: self.lines.append(line))

    def measure(self, k):
        """Measure at a second and correct."""
        self.tracker.observe(Measurement(T + k * SECOND, 'main', (0.1, 0.2)))
        self.tracker.estimate()

    def refusal(self, action):
        """Return the line of an action that is refused."""
        with pytest.raises(FAILURES) as refused:
            action()
        return self.keeper.refusal(refused.value)

    def load(self, now_ns=T + 100 * SECOND):
        """Go on from the file."""
        memory, published_ns = self.keeper.load(now_ns)
        self.tracker.recall(memory)
        return published_ns

    def checkpoint(self, published_ns=0):
        """Save in the background, and wait for it."""
        self.keeper.checkpoint(published_ns)
        self.keeper._settle()


@pytest.fixture
def file(tmp_path):
    return tmp_path / 'state'


def saved(file, count=1, **more):
    """Leave a state of some measurements, and return who saved it."""
    one = Kept(file, **more)
    for k in range(count):
        one.measure(k)
    one.keeper.save(T)
    return one


def test_another_goes_on_from_what_was_saved(file):
    one, other = saved(file, 3), Kept(file)
    assert other.keeper.is_there() and other.load() == T
    assert other.tracker.memory().measurements == one.tracker.memory().measurements


def test_no_file_no_state(tmp_path):
    one = Kept('')
    assert not one.keeper.is_there()
    for action in (lambda: one.keeper.save(0), one.load):
        assert one.refusal(action) == "state_file: expected a file, got '' (none)"
    one.keeper.close(0)
    assert one.lines == []


def test_where_nothing_is_that_is_told(file):
    one = Kept(file)
    assert not one.keeper.is_there()
    assert one.refusal(one.load) == f'state_file: No such file or directory ({file})'


@pytest.mark.parametrize('given', ['nowhere/state', '.', '~nobody-of-that-name/state',
                                   'x' * 5000, 'a\0b'], ids=len)
def test_a_file_that_cannot_be_is_a_wrong_parameter(tmp_path, monkeypatch, given):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError) as refused:
        Kept(given)
    assert str(refused.value) == ('state_file: expected a file in a folder that can be written, '
                                  f'got {given!r}')


def test_a_link_is_followed_when_it_is_made_and_the_file_behind_it_replaced(tmp_path, file):
    link = tmp_path / 'link'
    link.symlink_to(file)
    saved(link)
    assert link.is_symlink() and file.is_file() and not file.is_symlink()


def test_a_checkpoint_is_written_only_where_there_is_something_new(file):
    one = Kept(file)
    one.checkpoint()
    first = state_file.mark_of(file)
    one.checkpoint()
    assert state_file.mark_of(file) == first
    one.measure(0)
    one.checkpoint()
    second = state_file.mark_of(file)
    one.checkpoint(published_ns=T)
    third = state_file.mark_of(file)
    one.tracker.reset()
    one.checkpoint(published_ns=T)
    assert len({first, second, third, state_file.mark_of(file)}) == 4


def test_a_checkpoint_is_what_was_believed_when_it_began_and_holds_nobody_up(file, monkeypatch):
    one, go, real = Kept(file), threading.Event(), state_file.write
    monkeypatch.setattr(state_file, 'write', lambda *a: go.wait(10) and real(*a))
    one.measure(0)
    one.keeper.checkpoint(0)
    one.measure(1)
    # the first is still being written: no other is begun, and none waits for it
    one.keeper.checkpoint(0)
    assert not file.exists()
    go.set()
    one.keeper._settle()
    other = Kept(file)
    other.load()
    assert [m.stamp_ns for m in other.tracker.memory().measurements] == [T]


def test_a_save_waits_for_the_checkpoint_before_it(file):
    one = Kept(file)
    for k in range(5):
        one.measure(k)
        one.keeper.checkpoint(0)
        one.keeper.save(0)
        other = Kept(file)
        other.load()
        assert other.tracker.stamp_ns == one.tracker.stamp_ns


def test_the_end_saves_what_is_new(file):
    one = Kept(file)
    one.measure(0)
    one.keeper.close(T + 5)
    other = Kept(file)
    assert other.load() == T + 5 and other.tracker.stamp_ns == T


def test_a_refused_file_is_left_where_it_is_and_moved_aside_only_when_another_is_saved(file):
    file.write_bytes(b'precious')
    one, aside = Kept(file), file.with_name('state.refused')
    assert one.refusal(one.load).startswith('state_file: expected 56 to ')
    assert file.read_bytes() == b'precious' and not aside.exists()
    one.keeper.save(0)
    assert aside.read_bytes() == b'precious'
    Kept(file).load()


def test_no_second_file_is_moved_over_the_first_and_that_is_told_each_time(file):
    file.write_bytes(b'precious')
    Kept(file).keeper.save(0)
    file.write_bytes(b'precious too')
    one = Kept(file)
    for _ in range(2):
        one.checkpoint()
        assert 'expected no file but that of this node' in one.lines.pop()
        assert one.lines == []
    assert 'move both away' in one.refusal(lambda: one.keeper.save(0))
    one.keeper.close(0)
    assert file.read_bytes() == b'precious too'
    assert file.with_name('state.refused').read_bytes() == b'precious'
    file.unlink()


def test_a_file_that_was_not_gone_on_from_is_not_replaced(file):
    saved(file, 3)
    sound = file.read_bytes()
    Kept(file).keeper.save(0)
    assert file.with_name('state.refused').read_bytes() == sound


def test_ones_own_file_and_one_that_was_loaded_are_replaced(file):
    one = saved(file, 3)
    one.keeper.save(0)
    other = Kept(file)
    other.load()
    other.keeper.save(0)
    assert [path.name for path in file.parent.iterdir()] == ['state']


def test_a_file_that_somebody_puts_there_meanwhile_is_not_replaced(file):
    one = saved(file)
    saved(file.with_name('other'), 5)
    file.with_name('other').replace(file)
    precious = file.read_bytes()
    one.keeper.save(0)
    assert file.with_name('state.refused').read_bytes() == precious


def test_a_state_from_a_time_to_come_is_refused(file):
    one = saved(file)
    # as far ahead as a stamp may be
    assert one.load(T - SECOND) == T
    assert one.refusal(lambda: one.load(T - SECOND - 1)) == (
        'state_file: expected a state from before now, got one from 1.000 s ahead of the clock '
        f'({file})')
    assert one.refusal(lambda: one.load(None)).startswith('state_file: expected a /clock before')


@pytest.mark.parametrize('max_gap', [30.0, 29.9])
def test_a_state_with_a_gap_is_gone_on_from_as_if_it_was_measured_anew(file, max_gap):
    first, again, other = (Kept(file, **{'time.max_gap': max_gap}) for _ in range(3))
    for one in (first, again):
        one.measure(0)
        one.measure(30)
    first.keeper.save(0)
    other.load()
    found, wanted = other.tracker.estimate(), again.tracker.estimate()
    assert found.belief.density.tobytes() == wanted.belief.density.tobytes()
    assert found.total_log_evidence == wanted.total_log_evidence
    # the prior holds after the longer gap alone
    alone = Kept(file)
    alone.measure(30)
    is_alone = found.total_log_evidence == alone.tracker.estimate().total_log_evidence
    assert is_alone == (max_gap < 30)


def test_a_path_with_a_gap_that_would_take_ages_is_refused(file):
    path = {'filter.type': 'ekf_continuous', 'kernel.time_step': 5.0}
    hour = {'time.max_gap': 3600.0}
    one = Kept(file, **path, **hour)
    one.measure(0)
    # what no state allows ends no increment of the path
    one.tracker.observe(Measurement(T + 30 * SECOND, 'main', (1e200, 0.2)))
    one.measure(60)
    one.tracker.observe(Measurement(T + 90 * SECOND, 'main', (1e200, 0.2)))
    one.tracker.observe(Measurement(T + 92 * SECOND, 'main', (1e200, 0.2)))
    one.tracker.estimate()
    one.keeper.save(0)
    Kept(file, **path, **hour).load()
    other = Kept(file, **path, **{'time.max_gap': 29.9})
    assert other.refusal(other.load) == (
        'state_file: expected gaps between stamps of at most time.max_gap, got 30.000 s '
        f'({file})')


def test_a_control_that_would_be_refused_as_too_fast_is_not_taken_from_a_file(file):
    driven = {'model.name': 'unicycle_2d', 'grid.lower': [-4.0, -3.0, -3.2],
              'grid.upper': [4.0, 5.0, 3.2], 'grid.shape': [12, 10, 8], 'filter.type': 'ekf',
              'prior.mean': [0.0, 0.0, 0.0], 'prior.covariance_diagonal': [1.0, 1.0, 1.0]}
    for speed, taken in ((79.0, True), (1e6, False)):
        one, other = Kept(file, **driven), Kept(file, **driven)
        one.measure(0)
        one.tracker.control(T, (speed, 0.0))
        one.keeper.save(0)
        if taken:
            other.load()
            file.unlink()
        else:
            assert 'controls that carry no state across' in other.refusal(other.load)


@pytest.mark.parametrize(('name', 'value'), [
    ('model.params.diffusion', 2.0), ('grid.shape', [12, 12]), ('grid.upper', [4.0, 6.0]),
    ('kernel.time_step', 0.2), ('filter.type', 'ekf'), ('grid.periodic', [True, False]),
    ('measurements.main.params.sigma', 0.5), ('region.kind', 'active'),
    ('filter.significance', 0.01)])
def test_the_state_of_another_filter_is_refused_with_the_parameter_that_differs(file, name, value):
    saved(file)
    other = Kept(file, **{name: value})
    assert other.refusal(other.load).startswith(
        f'state_file: {name}: expected {value!r} as it is now, got a state with ')


@pytest.mark.parametrize(('name', 'value'), [
    ('prior.mean', [1.0, 1.0]), ('time.history', 2.0), ('publish.rate', 5.0),
    ('measurements.main.topic', 'elsewhere'), ('frame_id', 'odom'), ('operator.file', '')])
def test_what_does_not_change_the_filter_may_change_between(file, name, value):
    one, other = saved(file), Kept(file, **{name: value})
    other.load()
    assert (other.tracker.estimate().belief.density.tobytes()
            == one.tracker.estimate().belief.density.tobytes())


SAID = {'measurements.main.sensor': '', 'model.params.diffusion': 1, 'grid.periodic': [False] * 2}


@pytest.mark.parametrize('name', SAID)
def test_what_is_so_by_default_may_be_written_out_or_not(file, name):
    for said, unsaid in ((SAID, {}), ({}, SAID)):
        one, other = saved(file, **{k: v for k, v in said.items() if k == name}), Kept(
            file, **{k: v for k, v in unsaid.items() if k == name})
        other.load()
        assert (other.tracker.estimate().belief.density.tobytes()
                == one.tracker.estimate().belief.density.tobytes())
        file.unlink()


def test_a_state_of_the_default_configuration_has_the_names_that_it_always_had():
    found = identity(Config.from_parameters({}))
    assert found['measurements.main.sensor'] == '' and found['grid.periodic'] == []
    assert not [name for name in found if '.params.' in name]


def test_every_parameter_is_either_of_the_filter_or_named_here():
    # a new section has to be placed: a state of other values in it goes on, or does not
    free = {'prior', 'pose', 'publish', 'density', 'modes', 'markers', 'time', 'frame_id', 'lost',
            'recovery', 'diagnostics', 'state_file', 'checkpoint_period', 'autostart'}
    of_the_filter = {'measurements.names', 'measurements.main.sensor', 'control.hold'}
    known = identity(Config.from_parameters({}))
    for name in specifications():
        if name.split('.')[0] in {*free, 'measurements', 'control'} or name == 'operator.file':
            assert (name in known) == (name in of_the_filter), name
        else:
            assert name in known, name


def test_a_full_disk_is_told_and_tried_again(file, monkeypatch):
    one, real = Kept(file), state_file.write

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(state_file, 'write', full)
    one.checkpoint()
    assert one.lines == [f'state_file: No space left on device ({file})']
    assert 'No space' in one.refusal(lambda: one.keeper.save(0))
    monkeypatch.setattr(state_file, 'write', real)
    one.checkpoint()
    assert file.exists() and len(one.lines) == 1


def test_it_tells_how_old_the_saved_state_is_and_that_saving_fails(tmp_path, monkeypatch):
    assert Kept('').keeper.told() is None
    folder = tmp_path / 'folder'
    folder.mkdir()
    one, now = Kept(folder / 'state'), [100.0]
    monkeypatch.setattr('time.monotonic', lambda: now[0])
    assert one.keeper.told() == ('not yet', True)
    one.measure(0)
    one.checkpoint()
    now[0] += 12.5
    assert one.keeper.told() == ('12.5 s ago', True)
    folder.rename(tmp_path / 'elsewhere')
    one.measure(1)
    one.checkpoint()
    text, is_well = one.keeper.told()
    assert not is_well and 'No such file' in text and one.lines == [text]
    (tmp_path / 'elsewhere').rename(folder)
    one.checkpoint()
    assert one.keeper.told() == ('0.0 s ago', True)
