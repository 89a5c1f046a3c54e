"""What the filter node's log tells."""

from pif_ros.accounts import Accounts
from pif_ros.plaza.filter_process import accounts


def last_words(inputs: tuple[str, ...]) -> str:
    """Return a log with accounts of two beacons and, for a model with inputs, of the control."""
    told = Accounts(['beacon_0', 'beacon_1'], inputs)
    told.sources['beacon_0'].received = told.sources['beacon_0'].accepted = 5
    told.sources['beacon_1'].received, told.sources['beacon_1'].dropped = 3, 2
    told.sources['beacon_1'].rejected['too late'] += 1
    if told.control is not None:
        told.control.received = told.control.accepted = 40
    return f'[INFO] a line: 7 received\n[INFO] [1.5] [filter_node]: stopped; {told}\n'


def test_ranges_are_counted_over_all_beacons_and_controls_apart() -> None:
    assert accounts(last_words(('speed',))) == {
        'ranges': {'received': 8, 'accepted': 5, 'rejected': 1, 'dropped': 2},
        'controls': {'received': 40, 'accepted': 40, 'rejected': 0, 'dropped': 0}}


def test_without_a_control_there_is_no_account_of_it() -> None:
    assert list(accounts(last_words(()))) == ['ranges']


def test_a_node_that_says_nothing_has_no_accounts() -> None:
    assert accounts('') == {}
