"""Kernels in files: bit for bit what was saved, and nothing that was not."""

import dataclasses
import os
import struct
import tracemalloc
import zlib

from hypothesis import given, strategies as st
import numpy as np
from pif_ros.core.grid import Grid
from pif_ros.core.kernels import dirac_feynman, KernelSettings
from pif_ros.core.kernels.stored import fingerprint, load_kernel, save_kernel
from pif_ros.core.models import StateModel
from pif_ros.core.systems import coupled_trigonometric, geometric_brownian_motion
import pytest
from scipy import sparse

MARK = 'ab' * 32
GRID = Grid((-6, -6), (6, 6), (20, 20))
SETTINGS = KernelSettings(0.05)
MODEL = coupled_trigonometric().model
SINE = StateModel(('x',), lambda x, t: np.sin(x), [[1.0]])
LINE = Grid((-3,), (3,), (40,))
# header, then its checksum: what a forger has to keep in order
HEADER, HEAD = struct.Struct('<8sII64sQQI'), 104


@pytest.fixture
def file(tmp_path):
    path = tmp_path / 'kernel'
    save_kernel(path, dirac_feynman(MODEL, GRID, SETTINGS), MARK)
    return path


def forged(path, payload=None, **fields):
    """Change a file so that its checksums are right, whatever it says."""
    names = ('magic', 'version', 'width', 'mark', 'cells', 'weights', 'checksum')
    raw = path.read_bytes()
    payload = raw[HEAD:] if payload is None else payload
    head = dict(zip(names, HEADER.unpack(raw[:HEADER.size])), checksum=zlib.crc32(payload))
    head = HEADER.pack(*{**head, **fields}.values())
    path.write_bytes(head + struct.pack('<I', zlib.crc32(head)) + payload)


def refusal(path, fingerprint=MARK, size=400):
    """Return why a file is refused, in a line."""
    with pytest.raises(ValueError) as error:
        load_kernel(path, fingerprint, size)
    line = str(error.value)
    assert line.startswith(f'{path}: expected ') and ', got ' in line and '\n' not in line
    return line


# There and back


def assert_same_bits(found, kernel):
    assert found.shape == kernel.shape
    for name in ('indptr', 'indices', 'data'):
        a, b = getattr(found, name), getattr(kernel, name)
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes()


@given(st.integers(0, 2**32 - 1))
def test_a_kernel_comes_back_bit_for_bit(tmp_path_factory, seed):
    rng = np.random.default_rng(seed)
    size = int(rng.integers(1, 60))
    kernel = sparse.csr_array(rng.random((size, size)) * (rng.random((size, size)) < 0.2))
    path = tmp_path_factory.mktemp('kernels') / 'kernel'
    save_kernel(path, kernel, MARK)
    assert_same_bits(load_kernel(path, MARK, size), kernel)


def test_a_loaded_kernel_gives_the_same_products_and_can_be_written_to(file):
    kernel, p = dirac_feynman(MODEL, GRID, SETTINGS), np.random.default_rng(1).random(400)
    found = load_kernel(file, MARK, 400)
    assert (found @ p).tobytes() == (kernel @ p).tobytes()
    found.data *= 2


def test_a_kernel_with_long_indices_keeps_them(tmp_path):
    kernel = sparse.csr_array(np.eye(3))
    kernel.indices, kernel.indptr = (a.astype(np.int64) for a in (kernel.indices, kernel.indptr))
    save_kernel(tmp_path / 'kernel', kernel, MARK)
    assert_same_bits(load_kernel(tmp_path / 'kernel', MARK, 3), kernel)


def test_a_kernel_that_holds_nothing_comes_back(tmp_path):
    save_kernel(tmp_path / 'kernel', sparse.csr_array((5, 5)), MARK)
    assert load_kernel(tmp_path / 'kernel', MARK, 5).nnz == 0


# Writing


def test_a_file_is_replaced_whole_or_left_as_it_was(file, monkeypatch):
    before = file.read_bytes()

    def fails(descriptor):
        raise OSError('disk full')

    monkeypatch.setattr(os, 'fsync', fails)
    with pytest.raises(OSError, match='disk full'):
        save_kernel(file, sparse.csr_array(np.eye(3)), MARK)
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == ['kernel']
    monkeypatch.undo()
    save_kernel(file, sparse.csr_array(np.eye(3)), MARK)
    assert load_kernel(file, MARK, 3).nnz == 3
    assert os.listdir(file.parent) == ['kernel']


@pytest.mark.parametrize('kernel, got', [
    (sparse.csr_array((2, 3)), '2 x 3 of them'),
    (sparse.csr_array(-np.eye(2)), 'weights from -1 to -1'),
    (sparse.csr_array(np.diag([1, np.nan])), 'weights from nan to nan'),
    (sparse.csr_array(np.diag([1, np.inf])), 'weights from 1 to inf'),
])
def test_what_is_no_kernel_is_not_written(tmp_path, kernel, got):
    with pytest.raises(ValueError, match=f'^kernel: expected .*, got {got}$'):
        save_kernel(tmp_path / 'kernel', kernel, MARK)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize('mark', ['', 'ab', 'AB' * 32, 'g' * 64, 'é' * 64])
def test_what_is_no_fingerprint_is_refused(tmp_path, mark):
    for use in (lambda: save_kernel(tmp_path / 'kernel', sparse.csr_array(np.eye(2)), mark),
                lambda: load_kernel(tmp_path / 'kernel', mark, 2)):
        with pytest.raises(ValueError, match='^fingerprint: expected 64 hexadecimal digits, got'):
            use()


# What is refused


def test_any_single_flipped_bit_is_noticed(file):
    raw, rng = file.read_bytes(), np.random.default_rng(2)
    for place in [*range(HEAD), *rng.integers(HEAD, len(raw), 40), len(raw) - 1]:
        damaged = bytearray(raw)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        refusal(file)


@pytest.mark.parametrize('length', [0, 1, 8, 99, HEAD, HEAD + 1, -1])
def test_a_file_cut_short_is_refused(file, length):
    file.write_bytes(file.read_bytes()[:length])
    refusal(file)


def test_a_file_with_something_behind_it_is_refused(file):
    length = len(file.read_bytes())
    file.write_bytes(file.read_bytes() + b'x')
    assert refusal(file).endswith(f'expected {length} bytes, got {length + 1}')


@pytest.mark.parametrize('content', [b'PK\x03\x04' + bytes(300), b'\x80\x04.', bytes(1000), b''])
def test_foreign_files_are_refused_by_their_first_bytes(file, content):
    file.write_bytes(content)
    assert 'expected a stored kernel, got a file that begins with' in refusal(file)


def test_a_drift_that_is_steep_in_a_corner_hides_no_change_where_the_mass_is():
    marks = {fingerprint(StateModel(
        ('x',), lambda x, t, a=a: a * np.sin(x) - np.sinh(2 * x), np.eye(1)),
        Grid((-12,), (12,), (240,)), KernelSettings(0.01)) for a in (1.0, 1.3)}
    assert len(marks) == 2


def test_another_kernel_is_refused_with_both_names(file):
    other = 'cd' * 32
    assert refusal(file, other).endswith(
        f'fingerprint (of model, grid and settings) {other}, got {MARK}')
    assert refusal(file, size=401).endswith('number of cells 401, got 400')
    forged(file, version=4)
    assert refusal(file).endswith('the format 3, got 4')


@pytest.mark.parametrize('fields', [
    {'weights': 2**64 - 1}, {'weights': 400**2 + 1}, {'weights': 400**2}, {'weights': 0},
    {'cells': 2**64 - 1}, {'cells': 0}, {'width': 0}, {'width': 2**31}, {'width': 8},
])
def test_a_header_that_promises_too_much_is_refused_before_anything_is_allocated(file, fields):
    forged(file, **fields)
    tracemalloc.start()
    refusal(file)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # the buffer of a file and a few lines of text
    assert peak < 500_000


def payload_of(rows, columns, weights):
    return b''.join(np.array(values, kind).tobytes() for values, kind in (
        (rows, '<i4'), (columns, '<i4'), (weights, '<f8')))


@pytest.mark.parametrize('rows, columns, weights, got', [
    ([0, 2, 1], [0], [1.0], 'rows that do not add up to its 1 weights'),
    ([0, -5, 1], [0], [1.0], 'rows that do not add up to its 1 weights'),
    ([1, 1, 1], [0], [1.0], 'rows that do not add up to its 1 weights'),
    ([0, 0, 2], [0], [1.0], 'rows that do not add up to its 1 weights'),
    ([0, 0, 1], [2], [1.0], 'columns from 2 to 2'),
    ([0, 0, 1], [-1], [1.0], 'columns from -1 to -1'),
    ([0, 0, 1], [0], [-1e-9], 'weights from -1e-09 to -1e-09'),
    ([0, 0, 1], [0], [np.nan], 'weights from nan to nan'),
])
def test_a_forgery_with_the_right_checksums_cannot_lead_a_product_astray(
        file, rows, columns, weights, got):
    forged(file, payload_of(rows, columns, weights), cells=2, weights=1)
    assert refusal(file, size=2).endswith(f'a kernel of 2 cells, got {got}')


def test_more_weights_than_pairs_of_cells_are_refused(file):
    forged(file, payload_of([0, 2], [0, 0], [0.1, 0.1]), cells=1, weights=2)
    assert 'expected at most 1 weights' in refusal(file, size=1)


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path):
    assert refusal(tmp_path).endswith('got no regular file')
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    assert refusal(pipe).endswith('got no regular file')


def test_a_file_that_is_not_there_is_an_error_of_its_own(tmp_path):
    with pytest.raises(FileNotFoundError):
        load_kernel(tmp_path / 'kernel', MARK, 400)


# The fingerprint


def test_a_fingerprint_is_that_of_values_and_not_of_the_function_or_the_sensor():
    again = StateModel(('a',), lambda x, t: np.sin(x) + 0 * t, [[1.0]], units=('m',))
    assert fingerprint(again, LINE, SETTINGS) == fingerprint(SINE, LINE, SETTINGS)
    loud, quiet = (coupled_trigonometric(sigma_y=s).model for s in (1.0, 0.1))
    assert fingerprint(loud, GRID, SETTINGS) == fingerprint(quiet, GRID, SETTINGS)


@pytest.mark.parametrize('digit', [1e-15, -1e-15])
def test_the_last_digits_of_a_processor_make_no_other_kernel(digit):
    # of the largest value, so that sin(pi) on one machine is 0 on another
    shifted = StateModel(('x',), lambda x, t: np.sin(x) + digit, [[1.0 + digit]])
    assert fingerprint(shifted, LINE, SETTINGS) == fingerprint(SINE, LINE, SETTINGS)


def settings(**changes):
    return LINE, KernelSettings(**{'time_step': 0.05, **changes})


@pytest.mark.parametrize('model, grid, options', [
    (SINE, *settings(time_step=0.051)),
    (SINE, *settings(r=0.0)),
    (SINE, *settings(jacobian='exponential')),
    (SINE, *settings(extent=2)),
    (SINE, *settings(weights='moments')),
    (SINE, *settings(tolerance=1e-6)),
    (SINE, *settings(noise_inflation=1.0)),
    (SINE, Grid((-3,), (3,), (41,)), SETTINGS),
    (SINE, Grid((-3,), (3.1,), (40,)), SETTINGS),
    (SINE, Grid((-3,), (3,), (40,), (True,)), SETTINGS),
    (dataclasses.replace(SINE, drift=lambda x, t: np.sin(x) + 1e-6), LINE, SETTINGS),
    (dataclasses.replace(SINE, drift=lambda x, t: np.sin(x) + (x > 2.9) * 1e-6), LINE, SETTINGS),
    # at the centres of all cells it is the same
    (dataclasses.replace(SINE, drift=lambda x, t: np.sin(x) + np.cos(np.pi * x / 0.15)), LINE,
     SETTINGS),
    (dataclasses.replace(SINE, drift_jacobian=lambda x, t: np.cos(x)[None]), LINE, SETTINGS),
    (dataclasses.replace(SINE, vielbein=[[1.0 + 1e-6]]), LINE, SETTINGS),
    (dataclasses.replace(SINE, noise_covariance=[[2.0]]), LINE, SETTINGS),
    (dataclasses.replace(SINE, vielbein=[[1.0, 0.1]]), LINE, SETTINGS),
    (dataclasses.replace(SINE, multiplicative=True, vielbein=lambda x, t: x[None]), LINE,
     SETTINGS),
])
def test_whatever_changes_the_kernel_changes_its_fingerprint(model, grid, options):
    assert np.abs(np.cos(np.pi * LINE.points / 0.15)).max() < 1e-12
    assert fingerprint(model, grid, options) != fingerprint(SINE, LINE, SETTINGS)


def test_multiplicative_noise_is_told_apart_by_its_values_and_its_sense():
    grid = Grid((0.1,), (3,), (40,))
    marks = {fingerprint(model, grid, SETTINGS) for model in (
        geometric_brownian_motion().model, geometric_brownian_motion(sigma=0.31).model,
        dataclasses.replace(geometric_brownian_motion().model, s=0.5),
        dataclasses.replace(geometric_brownian_motion().model, vielbein_jacobian=None))}
    assert len(marks) == 4


@pytest.mark.parametrize('unit', [1.0, 1e-6, 1e-9])
def test_what_is_small_for_its_units_alone_is_told_apart(unit):
    # a double well, and what a bead does in water: 1e-13 m^2/s
    def mark(drift=1.0, slope=1.0, noise=1.0, bend=1.0, multiplicative=False):
        e, names, grid = unit * noise * np.eye(2), ('x', 'y'), Grid(
            (-2 * unit,) * 2, (2 * unit,) * 2, (20, 20))
        model = StateModel(
            names, lambda x, t: drift * (x - x**3 / unit**2),
            (lambda x, t: e[:, :, None] + 0 * x) if multiplicative else e,
            drift_jacobian=lambda x, t: slope * np.eye(2)[:, :, None] * (1 - 3 * x**2 / unit**2),
            multiplicative=multiplicative, vielbein_jacobian=lambda x, t: np.full(
                (2, 2, 2, x.shape[1]), bend))
        return fingerprint(model, grid, SETTINGS)

    changes = [{}, {'drift': 1.1}, {'slope': 1.1}, {'noise': 1.1}]
    assert len({mark(**change) for change in changes}) == 4
    assert len({mark(**change, multiplicative=True) for change in [*changes, {'bend': 1.1}]}) == 5


@pytest.mark.parametrize('unit', [1e-6, 1e6])
def test_noise_in_seconds_is_told_apart_by_its_correlation_however_small(unit):
    grid = Grid((-1, -1), (1, 1), (20, 20))
    marks = {fingerprint(StateModel(
        ('x', 'y'), lambda x, t: 0 * x, lambda x, t: np.eye(2)[:, :, None] / unit + 0 * x,
        unit**2 * np.array([[1.0, share], [share, 1.0]]), multiplicative=True), grid, SETTINGS)
        for share in (0.0, 1e-3, 0.5)}
    assert len(marks) == 3


def test_a_fingerprint_holds_at_its_time_only_where_the_model_changes():
    moving = StateModel(('x',), lambda x, t: np.sin(x - t), [[1.0]], time_dependent=True)
    noisy = StateModel(('x',), lambda x, t: np.sin(x), lambda t: np.array([[1 + t]]))
    for model, others in ((SINE, 1), (moving, 2), (noisy, 2)):
        assert len({fingerprint(model, LINE, SETTINGS, t) for t in (0.0, 1.0)}) == others


def test_a_drift_that_is_undefined_past_the_edge_has_a_fingerprint():
    root = StateModel(('x',), lambda x, t: np.sqrt(x), [[1.0]])
    log = StateModel(('x',), lambda x, t: np.log(x), [[1.0]])
    grid = Grid((0,), (3,), (40,))
    assert fingerprint(root, grid, SETTINGS) != fingerprint(log, grid, SETTINGS)
    assert fingerprint(log, grid, SETTINGS) == fingerprint(log, grid, SETTINGS)


def test_a_fingerprint_asks_for_few_places_of_a_cell_and_no_weights():
    grid, asked = Grid((-6, -6), (6, 6), (80, 80)), []

    def drift(x, t):
        asked.append(x[0].size)
        return MODEL.drift(x, t)

    fingerprint(dataclasses.replace(MODEL, drift=drift), grid, SETTINGS)
    # a kernel is of a hundred weights for each cell
    assert sum(asked) <= 8 * grid.size
    assert dirac_feynman(MODEL, grid, SETTINGS).nnz > 100 * grid.size
