"""The state file: all of it or none, and nothing else is taken for one."""

import errno
import functools
import os
import secrets

import numpy as np
from pif_ros import state_file
from pif_ros.core.saved import Form
from pif_ros.state_file import StateRefused
import pytest


ARRAYS = {'cells': np.linspace(0.0, 1.0, 12).reshape(3, 4), 'stamps': np.array([5, -7]),
          'none': np.zeros((0, 2))}
LAYOUT = {'cells': Form('<f8', (3, 4)), 'stamps': Form('<i8', (range(1, 9),)),
          'none': Form('<f8', (range(3), 2))}
#: All that JSON has, but for what is no number.
OF = {'model.name': 'wiener', 'sigma': 0.1 + 0.2, 'shape': [3, 4], 'deep': {'on': True}, 'a': None}


@pytest.fixture
def file(tmp_path):
    """Return where a state is, which is sound."""
    path = tmp_path / 'state'
    state_file.write(path, ARRAYS, OF)
    return path


def refusal(path, of=OF, layouts=(LAYOUT,)):
    """Return the line with which a file is refused."""
    with pytest.raises(StateRefused) as refused:
        state_file.read(path, of, layouts)
    assert str(refused.value).isprintable()
    return str(refused.value)


def test_what_is_read_is_what_was_written(file):
    found, mark = state_file.read(file, OF, [LAYOUT])
    assert found.keys() == ARRAYS.keys() and mark == state_file.mark_of(file)
    for name, array in ARRAYS.items():
        assert (found[name].tobytes(), found[name].shape) == (array.tobytes(), array.shape)
        assert found[name].dtype == array.dtype
        # as new arrays are, so that sums over them are the same to the bit
        assert found[name].flags.owndata and found[name].flags.c_contiguous
        assert found[name].flags.writeable
    assert os.listdir(file.parent) == ['state']


def test_the_file_can_be_read_by_its_description_alone(file):
    data = file.read_bytes()
    assert data.startswith(b'pif_ros state 1\n')
    length = int.from_bytes(data[16:24], 'little')
    header, cells = data[56:56 + length], data[56 + length:]
    assert b'"cells", "<f8", [3, 4]' in header
    np.testing.assert_array_equal(np.frombuffer(cells[:96], '<f8').reshape(3, 4), ARRAYS['cells'])
    np.testing.assert_array_equal(np.frombuffer(cells[96:], '<i8'), ARRAYS['stamps'])


def test_no_byte_of_it_may_be_another(file):
    sound = file.read_bytes()
    for k, byte in enumerate(sound):
        file.write_bytes(sound[:k] + bytes([byte ^ 1 << k % 8]) + sound[k + 1:])
        refusal(file)


def test_the_order_of_layouts_is_that_of_choice_and_names_decide(file):
    other = {'cells': LAYOUT['cells']}
    assert state_file.read(file, OF, [other, LAYOUT])[0].keys() == ARRAYS.keys()
    assert refusal(file, layouts=[other]).startswith('arrays: expected 1 of known names, got 3')


@pytest.mark.parametrize(('of', 'words'), [
    ({**OF, 'sigma': 0.3}, 'sigma: expected 0.3 as it is now, got a state with '
                           '0.30000000000000004'),
    ({**OF, 'more': 1}, 'more: expected 1 as it is now, got a state with none'),
    ({k: v for k, v in OF.items() if k != 'deep'},
     "deep: expected none as it is now, got a state with {'on': True}")])
def test_a_state_of_another_filter_is_refused_with_what_differs(file, of, words):
    assert refusal(file, of) == words


@pytest.mark.parametrize(('name', 'form'), [
    ('cells', Form('<f8', (4, 3))), ('cells', Form('<i8', (3, 4))), ('cells', Form('<f8', (12,))),
    ('stamps', Form('<i8', (range(2),))), ('none', Form('<f8', (range(1, 3), 2)))])
def test_other_arrays_than_the_filter_has_are_refused_by_name(file, name, form):
    line = refusal(file, layouts=[{**LAYOUT, name: form}])
    assert line.startswith(f'{name}: expected {form}, got ')


def test_what_is_no_file_is_refused_and_nobody_waits(tmp_path):
    os.mkfifo(tmp_path / 'pipe')
    assert refusal(tmp_path / 'pipe') == 'expected a regular file, got something else'
    assert refusal('/dev/zero') == 'expected a regular file, got something else'
    with pytest.raises(OSError):
        state_file.read(tmp_path / 'nothing', OF, [LAYOUT])


def test_a_huge_file_is_refused_before_it_is_read(file):
    os.truncate(file, 1 << 42)
    assert refusal(file).startswith(f'expected 56 to {state_file.LARGEST} bytes, got {1 << 42}')


def test_a_state_that_could_not_be_read_is_not_written(tmp_path, monkeypatch):
    monkeypatch.setattr(state_file, 'LARGEST', 1000)
    with pytest.raises(StateRefused, match='at most 1000 bytes'):
        state_file.write(tmp_path / 'state', {'cells': np.zeros(200)}, {})
    with pytest.raises(StateRefused, match='^header: expected at most'):
        state_file.write(tmp_path / 'state', {}, {'x': 'y' * state_file.LONGEST_HEADER})
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize('step', ['write', 'fsync', 'replace'])
def test_where_the_disk_fails_the_old_file_is_still_there(file, monkeypatch, step):
    before = file.read_bytes()

    def full(*_):
        raise OSError(errno.ENOSPC, 'No space left on device')

    if step == 'write':
        monkeypatch.setattr(state_file, '_bytes', full)
        monkeypatch.setattr(state_file, '_encoded', lambda arrays, of: b'{}')
    else:
        monkeypatch.setattr(os, step, full)
    with pytest.raises(OSError, match='No space left'):
        state_file.write(file, ARRAYS, OF)
    assert file.read_bytes() == before and os.listdir(file.parent) == ['state']


def noted(done, name, real, *arguments):
    """Note that something is done, and do it."""
    done.append(name)
    return real(*arguments)


def test_the_new_file_is_on_the_disk_before_it_takes_the_place_of_the_old_one(file, monkeypatch):
    done = []
    for name in ('fsync', 'replace'):
        real = getattr(os, name)
        monkeypatch.setattr(os, name, functools.partial(noted, done, name, real))
    state_file.write(file, ARRAYS, OF)
    # the file, its name, the folder
    assert done == ['fsync', 'replace', 'fsync']


def test_what_an_interrupted_write_left_is_in_nobodys_way(file):
    for name in (f'state.{os.getpid()}.00c0ffee.partial', 'state.1.0123abcd.partial'):
        file.with_name(name).write_bytes(b'half')
    others = ['another.1.0123abcd.partial', 'state.1.partial.bak']
    for name in others:
        file.with_name(name).write_bytes(b'precious')
    state_file.write(file, {'stamps': ARRAYS['stamps']}, OF)
    assert sorted(os.listdir(file.parent)) == sorted([*others, 'state'])


def test_a_link_in_place_of_a_partial_file_is_not_followed(file, tmp_path, monkeypatch):
    monkeypatch.setattr(secrets, 'token_hex', lambda size: 2 * size * 'a')
    other = tmp_path / 'other'
    other.write_bytes(b'precious')
    link = file.with_name(f'state.{os.getpid()}.aaaaaaaa.partial')
    link.symlink_to(other)
    with pytest.raises(FileExistsError):
        state_file.write(file, ARRAYS, OF)
    assert other.read_bytes() == b'precious' and not file.is_symlink() and link.is_symlink()


def test_of_two_writers_at_once_neither_takes_what_is_the_others(file, monkeypatch):
    real, stamps, left = os.fsync, {'stamps': np.array([1])}, []

    def fsync(handle):
        real(handle)
        monkeypatch.setattr(os, 'fsync', real)
        state_file.write(file, {'stamps': np.array([2])}, OF)
        left.extend(os.listdir(file.parent))

    monkeypatch.setattr(os, 'fsync', fsync)
    mark = state_file.write(file, stamps, OF)
    # the second is done while the first still has its own to put there
    assert len(left) == 2
    found, there = state_file.read(file, OF, [{'stamps': LAYOUT['stamps']}])
    assert found['stamps'] == [1] and there == mark
    assert os.listdir(file.parent) == ['state']


def test_a_write_that_fails_leaves_nothing(file, monkeypatch):
    monkeypatch.setattr(os, 'replace', functools.partial(os.link, follow_symlinks=False))
    with pytest.raises(FileExistsError):
        state_file.write(file, ARRAYS, OF)
    assert os.listdir(file.parent) == ['state']
