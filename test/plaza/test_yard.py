"""The filter's parameters for each recording."""

from dataclasses import replace
from pathlib import Path
import re

from pif_ros.config import build_tracker, Config
from pif_ros.plaza.recording import Recording
from pif_ros.plaza.yard import parameters_for
import pytest


def test_the_shipped_file_knows_where_the_beacons_of_the_first_recording_stand(
        tmp_path: Path, plaza: Recording) -> None:
    config = Config.from_yaml(parameters_for(plaza, tmp_path))
    for beacon, place in plaza.beacons.items():
        source = config.measurements.sources[f'beacon_{beacon}']
        assert source.topic == f'beacon_{beacon}/range'
        assert source.params['landmark'] == pytest.approx(place, abs=1e-3)


def test_another_recording_gets_its_own_beacons_and_yard(
        tmp_path: Path, small: Recording) -> None:
    beacons = {b: (x + 100.0, y - 50.0) for b, (x, y) in small.beacons.items()}
    moved = replace(small, name='Plaza2', beacons=beacons)
    config = Config.from_yaml(parameters_for(moved, tmp_path))
    grid = build_tracker(config).prior.grid
    for beacon, place in beacons.items():
        assert config.measurements.sources[f'beacon_{beacon}'].params['landmark'] == list(place)
        assert grid.contains(place)
    assert grid.spacing == pytest.approx([0.5, 0.5])


def test_no_string_is_left_unquoted_for_ros_to_take_for_a_truth_value(
        tmp_path: Path, small: Recording) -> None:
    """ROS reads YAML 1.1, in which a bare y is true; the states are called x and y."""
    text = parameters_for(replace(small, name='Plaza2'), tmp_path).read_text()
    assert re.search(r'"y"', text) and not re.search(r'(?<!")\by\b(?!")', text)
