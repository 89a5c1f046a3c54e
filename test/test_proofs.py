"""A share of each long proof that takes seconds."""

from importlib import import_module

import pytest

#: What each proof may do here.
SHARES = {'change': 1.0, 'examples': 0.01, 'false_alarms': 0.01, 'fuzz': 0.003, 'hostile': 0.2,
          'late': 0.01, 'overload': 0.07, 'signals': 0.02, 'soak': 0.003, 'state': 0.05,
          'wire': 0.02, 'wrong_configurations': 0.02}


@pytest.mark.parametrize('name', SHARES)
def test_a_share_of_what_is_proven_holds(name):
    for line in import_module(f'proofs.{name}').run(SHARES[name]):
        print(line)
