"""The recordings, read from their file."""

from pathlib import Path

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from pif_ros.plaza import recording as module
from pif_ros.plaza.recording import load, Recording
import pytest
import synthetic


def test_reads_every_column_of_the_file(small: Recording) -> None:
    """Oracle: the tables that were written."""
    tables = synthetic.tables()
    assert_allclose(small.truth_stamps_ns * 1e-9, tables['GT'][:, 0], atol=1e-9)
    assert_array_equal(small.truth, tables['GT'][:, 1:])
    assert_allclose(small.range_stamps_ns * 1e-9, tables['TD'][:, 0], atol=1e-9)
    assert_array_equal(small.beacon_ids, tables['TD'][:, 2])
    assert_array_equal(small.ranges, tables['TD'][:, 3])
    assert small.beacons == {int(b): (x, y) for b, x, y in synthetic.BEACONS}


def test_odometry_is_what_was_driven_per_second_from_one_row_to_the_next(
        small: Recording) -> None:
    """Oracle: the circle, 12 m in radius, driven once in two minutes."""
    stamps = synthetic.tables()['DR'][:, 0]
    assert_allclose(small.odometry_stamps_ns * 1e-9, stamps[:-1], atol=1e-9)
    assert_allclose(small.odometry_ends_ns * 1e-9, stamps[1:], atol=1e-9)
    assert_allclose(small.odometry[:, 0], 2.0 * np.pi / 120.0 * 12.0, rtol=1e-6)
    assert_allclose(small.odometry[:, 1], 2.0 * np.pi / 120.0, rtol=1e-6)


@pytest.mark.parametrize('name', ['Plaza1', 'Plaza2'])
def test_odometry_tells_how_far_the_truth_went_and_turned_in_its_very_interval(name: str) -> None:
    """Oracle: the truth, which has its heading from the same gyroscope, but for a bias."""
    try:
        plaza = load(name)
    except FileNotFoundError:
        pytest.skip('needs the data that come with gtsam')
    seconds = (plaza.odometry_ends_ns - plaza.odometry_stamps_ns) * 1e-9
    begins, ends = (plaza.truth_at(s) for s in (plaza.odometry_stamps_ns, plaza.odometry_ends_ns))
    turned = ends[:, 2] - begins[:, 2]
    driven = np.linalg.norm(ends[:, :2] - begins[:, :2], axis=1)
    # one interval earlier or later the correlation is below 0.98 of both
    assert np.corrcoef(turned, plaza.odometry[:, 1] * seconds)[0, 1] > 0.9999
    assert np.corrcoef(driven, plaza.odometry[:, 0] * seconds)[0, 1] > 0.998
    assert 0 <= plaza.odometry[:, 0].min() and plaza.odometry[:, 0].max() < 5.0


def test_headings_that_point_backwards_are_turned_round(tmp_path: Path, small: Recording) -> None:
    """Oracle: the same drive, whose file has them right."""
    truth = synthetic.tables()['GT']
    truth[:, 3] += np.pi
    found = load(path=synthetic.write(tmp_path / 'backwards.mat', GT=truth))
    assert_allclose(np.exp(1j * found.truth[:, 2]), np.exp(1j * small.truth[:, 2]), atol=1e-12)
    assert np.abs(found.truth[:, 2]).max() <= np.pi


@pytest.mark.parametrize('name', ['Plaza1', 'Plaza2'])
def test_the_truth_looks_where_it_drives(name: str) -> None:
    """Oracle: the direction from one pose to one that is a metre away."""
    try:
        plaza = load(name)
    except FileNotFoundError:
        pytest.skip('needs the data that come with gtsam')
    begins, ends = plaza.truth[:-10], plaza.truth[10:]
    moved = ends[:, :2] - begins[:, :2]
    straight = (np.hypot(*moved.T) > 1.0) & (np.abs(ends[:, 2] - begins[:, 2]) < 0.1)
    off = np.arctan2(moved[:, 1], moved[:, 0]) - begins[:, 2]
    assert straight.sum() > 500
    assert np.abs(np.angle(np.exp(1j * off[straight]))).mean() < np.radians(5.0)


def test_a_recording_may_be_without_odometry(tmp_path: Path) -> None:
    found = load(path=synthetic.write(tmp_path / 'without.mat', DR=None))
    assert found.odometry.shape == (0, 2) and len(found.odometry_stamps_ns) == 0


def test_truth_is_linear_between_the_poses_and_its_heading_never_jumps(small: Recording) -> None:
    """Oracle: the circle itself; a chord of a fifth of a second is off it by less than 1 mm."""
    t = np.arange(100.05, 219.0, 0.0371)
    found = small.truth_at(np.rint(t * 1e9).astype(np.int64))
    assert_allclose(found[:, :2], synthetic.where(t)[:, :2], atol=1e-3)
    assert_allclose(np.diff(found[:, 2]), 2.0 * np.pi / 120.0 * 0.0371, rtol=1e-3)


def test_a_pose_of_the_truth_is_found_at_its_own_stamp(plaza: Recording) -> None:
    found = plaza.truth_at(plaza.truth_stamps_ns)
    assert_allclose(found[:, :2], plaza.truth[:, :2], atol=1e-6)


@pytest.mark.parametrize('offset', [-1, 10**12])
def test_refuses_to_know_the_truth_where_there_is_none(small: Recording, offset: int) -> None:
    with pytest.raises(ValueError, match='expected stamps between'):
        small.truth_at(small.start_ns + offset)


def test_a_range_arrives_with_the_newest_stamp_before_it(plaza: Recording) -> None:
    """Oracle: a loop."""
    newest, late = 0, 0
    for stamp, arrival in zip(plaza.range_stamps_ns.tolist(), plaza.arrivals_ns.tolist()):
        newest = max(newest, stamp)
        late += stamp < newest
        assert arrival == newest
    assert late > 5


def test_ranges_read_seven_per_cent_long(plaza: Recording) -> None:
    at = plaza.truth_at(plaza.range_stamps_ns)[:, :2]
    beacons = np.array([plaza.beacons[b] for b in plaza.beacon_ids.tolist()])
    distance = np.linalg.norm(at - beacons, axis=1)
    scale = float(plaza.ranges @ distance / (distance @ distance))
    assert 1.06 < scale < 1.08
    assert 0.4 < np.std(plaza.ranges - scale * distance) < 0.7


def test_says_what_to_install_where_the_data_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise module.PackageNotFoundError(name)

    monkeypatch.setattr(module, 'distribution', missing)
    with pytest.raises(FileNotFoundError, match='pip install --no-deps gtsam') as raised:
        load('Plaza1')
    assert '\n' not in str(raised.value)


def test_finds_the_data_that_come_with_gtsam_without_importing_it(
        monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / 'gtsam' / 'Data').mkdir(parents=True)
    synthetic.write(tmp_path / 'gtsam' / 'Data' / 'Plaza2_.mat')

    class Distribution:

        def locate_file(self, path: str) -> Path:
            return tmp_path / path

    monkeypatch.setattr(module, 'distribution', lambda name: {'gtsam': Distribution()}[name])
    assert load('Plaza2').name == 'Plaza2'
    with pytest.raises(FileNotFoundError, match='pip install'):
        load('Plaza1')


def test_refuses_a_recording_of_another_name() -> None:
    with pytest.raises(ValueError, match="Plaza1 or Plaza2, got 'Plaza3'"):
        load('Plaza3')


@pytest.mark.parametrize(('changed', 'reason'), [
    ({'GT': None}, 'expected a table GT'),
    ({'TD': np.zeros((3, 5))}, 'expected TD of 4 columns'),
    ({'TL': np.array([['a', 'b', 'c']], dtype=object)}, 'expected TL of 3 columns'),
    ({'TD': np.full((3, 4), np.nan)}, 'finite numbers in TD'),
    ({'TD': np.zeros((0, 4))}, 'at least one pose and one range'),
    ({'TD': np.array([[101.0, 2.0, 9.0, 10.0]])}, 'no position of beacon 9'),
    ({'DR': np.zeros((3, 4))}, 'expected DR of 3 columns'),
    ({'DR': np.array([[1.0, 0, 0], [1.0, 0, 0]])}, 'increasing stamps of the odometry'),
    ({'GT': np.array([[1.0, 0, 0, 0], [0.5, 0, 0, 0]])}, 'increasing stamps of the truth'),
])
def test_refuses_a_wrong_file_in_one_line(tmp_path: Path, changed: dict, reason: str) -> None:
    file = synthetic.write(tmp_path / 'wrong.mat', **changed)
    with pytest.raises(ValueError, match=reason) as raised:
        load(path=file)
    assert '\n' not in str(raised.value)


def test_refuses_what_is_no_matlab_file(tmp_path: Path) -> None:
    file = tmp_path / 'text.mat'
    file.write_text('nothing of the kind\n' * 40)
    with pytest.raises(ValueError, match='is no MATLAB file'):
        load(path=file)
    with pytest.raises(FileNotFoundError, match='no such recording'):
        load(path=tmp_path / 'absent.mat')
