"""The parameters of the player."""

from pif_ros.plaza.settings import Settings
import pytest


def test_what_is_not_given_has_its_default() -> None:
    assert Settings.from_values({}) == Settings()


def test_whole_numbers_are_welcome_where_reals_are_meant() -> None:
    assert Settings.from_values({'speed': 2, 'start': 10}) == Settings(speed=2.0, start=10.0)


@pytest.mark.parametrize(('name', 'value', 'reason'), [
    ('speed', -1.0, 'expected a number of at least 0, got -1.0'),
    ('speed', float('nan'), 'expected a number of at least 0, got nan'),
    ('speed', 'fast', "expected a number of at least 0, got 'fast'"),
    ('speed', True, 'expected a number of at least 0, got True'),
    ('start', float('inf'), 'expected a number from 0 to 1e9, got inf'),
    ('start', -1, 'expected a number from 0 to 1e9, got -1'),
    ('start', 1.1e9, 'expected a number from 0 to 1e9, got 1100000000.0'),
    ('duration', [1.0], r'expected a number from 0 to 1e9, got \[1.0\]'),
    ('duration', None, 'expected a number from 0 to 1e9, got None'),
    ('duration', 1e300, r'expected a number from 0 to 1e9, got 1e\+300'),
    ('timeout', 0, 'expected a number above 0, got 0'),
    ('recording', 'Plaza3', "expected Plaza1 or Plaza2, got 'Plaza3'"),
    ('recording', ['Plaza1'], r"expected Plaza1 or Plaza2, got \['Plaza1'\]"),
    ('path', 7, 'expected a string, got 7'),
    ('follow', '', "expected the name of a topic, got ''"),
    ('odometry', 1, 'expected true or false, got 1'),
    ('sped', 1.0, 'expected one of recording, path, speed'),
])
def test_a_wrong_parameter_is_named_with_what_was_wanted_and_given(
        name: str, value: object, reason: str) -> None:
    with pytest.raises(ValueError, match=f"parameter '{name}': {reason}"):
        Settings.from_values({name: value})
