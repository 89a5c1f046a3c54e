"""A robot that is carried away: the shortest form of its proof, and how it is made."""

import numpy as np
from pif_ros.plaza.recording import load
from proofs.kidnap import _kidnaps, _moved, FOUND, GATED, OPEN, OURS, SAID, SCALE, SYSTEMS
import pytest


@pytest.mark.parametrize('name', SYSTEMS)
def test_it_is_said_to_be_lost_and_found_where_an_ekf_is_locked_out(name):
    course = SYSTEMS[name](1)
    for kind in (OURS, OPEN):
        assert course[kind].said <= SAID and course[kind].found <= FOUND
    assert course[GATED].said <= SAID and course[GATED].found is None
    assert course[GATED].gated > FOUND / 2


@pytest.fixture
def plaza():
    try:
        return load('Plaza1')
    except FileNotFoundError as error:
        pytest.skip(str(error))


def test_the_recording_of_a_robot_that_was_moved_has_its_ranges(plaza):
    seconds, move = next(_kidnaps('plaza_unicycle'))
    at_ns = plaza.start_ns + round(seconds * 1e9)
    moved = _moved(plaza, at_ns, move)
    assert np.linalg.norm(move) == pytest.approx(20)
    after = plaza.range_stamps_ns >= at_ns
    np.testing.assert_array_equal(moved.ranges[~after], plaza.ranges[~after])
    beacons = np.array([plaza.beacons[k] for k in plaza.beacon_ids[after]])

    def errors(recording):
        place = recording.truth_at(recording.range_stamps_ns[after])[:, :2]
        return recording.ranges[after] - SCALE * np.linalg.norm(place - beacons, axis=1)

    # but for the ranges of the moment in which it is moved, between two poses of the truth
    np.testing.assert_allclose(errors(moved)[2:], errors(plaza)[2:], atol=1e-9)
