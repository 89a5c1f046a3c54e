"""What an inbox tells and counts of gaps."""

import itertools
from types import SimpleNamespace

import numpy as np
from pif_ros.accounts import Accounts
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.inbox import Inbox
import pytest

SECOND = 1_000_000_000
T = 1_000 * SECOND
PLANE = {
    'model.name': 'position_2d', 'grid.lower': [-4.0, -3.0], 'grid.upper': [4.0, 5.0],
    'grid.shape': [12, 10], 'kernel.time_step': 1.0, 'measurements.main.sensor': 'position',
    'measurements.main.params.sigma': 0.4, 'filter.type': 'ekf', 'time.max_gap': 10.0}


class Listening:
    """An inbox, and what it said."""

    def __init__(self, **more):
        """Make it, its tracker and its accounts."""
        self.config, self.said = Config.from_parameters({**PLANE, **more}), []
        self.accounts, self.tracker = Accounts(['main']), build_tracker(self.config)
        self.inbox = Inbox(self.tracker, self.accounts, self.config,
                           lambda kind, text: self.said.append((kind, text)))

    def hear(self, *seconds):
        """Let measurements wait, and work each in by itself."""
        inlet = SimpleNamespace(name='main', what='measurement',
                                account=self.accounts.sources['main'])
        for second in seconds:
            self.inbox.put(inlet, Measurement(T + round(second * SECOND), 'main', (0.1, second)))
            while self.inbox.has_work:
                self.inbox.work()

    @property
    def gaps(self):
        """Return the lines that tell of a gap."""
        return [text for kind, text in self.said if kind == 'gap']


@pytest.mark.parametrize(('seconds', 'gaps'), [
    # the second one comes to within the longest gap of the first
    ((0, 9.8, 10.5), 0), ((0, 10.2, 11.0), 1), ((0, 20.0, 20.5), 1), ((0, 0.5, 11.0), 1)])
def test_a_gap_is_one_of_the_stamps_and_not_of_the_order_of_arrival(seconds, gaps):
    means = []
    for order in itertools.permutations(range(3)):
        listening = Listening(**{'time.history': 30.0})
        listening.hear(*(seconds[k] for k in order))
        means.append(listening.tracker.newest.belief.mean())
        assert listening.inbox.gaps == gaps
    np.testing.assert_array_equal(means, [means[0]] * len(means))


def test_a_gap_is_told_once_also_where_a_late_measurement_ends_it():
    listening = Listening()
    listening.hear(0, 20.5, 20.0, 20.7)
    assert listening.gaps == ['main: a gap of 20 s, more than time.max_gap: back to the prior']
    assert listening.inbox.last_gap == listening.gaps[0] and listening.inbox.gaps == 1
    listening.hear(60)
    assert len(listening.gaps) == 2 and listening.inbox.gaps == 2
    listening.inbox.restart(None, None)
    assert listening.inbox.last_gap == '' and listening.inbox.gaps == 2


def test_a_gap_that_a_late_measurement_bridges_is_none_and_the_next_is_told():
    listening = Listening()
    listening.hear(0, 10.5, 9.8)
    assert listening.inbox.gaps == 0 and listening.inbox.last_gap == ''
    listening.hear(30)
    assert listening.inbox.gaps == 1 and len(listening.gaps) == 2
