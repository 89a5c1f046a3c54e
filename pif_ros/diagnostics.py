"""What the node says of itself, for a person who reads /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pif_ros.accounts import Accounts, SourceAccount
from pif_ros.core.tracker import Tracker

OK, WARN = 0, 1
#: A belief that has so little of its mass left is more off the grid than on it.
MOSTLY_GONE = 0.5


@dataclass(frozen=True)
class Status:
    """One task's word: its name, a level, a sentence, and what it counts."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]


def statuses(tracker: Tracker[Any], accounts: Accounts) -> list[Status]:
    """Return what is to be said now: of the belief, and of each source."""
    found = [belief_status(tracker)]
    found += [source_status(name, account) for name, account in accounts.sources.items()]
    if accounts.control is not None:
        found.append(source_status('control', accounts.control))
    if accounts.initial_pose.received:
        found.append(source_status('initialpose', accounts.initial_pose))
    return found


def belief_status(tracker: Tracker[Any]) -> Status:
    """
    Return what the newest belief is like.

    mass: what is left on the grid since the last correction; dropped: the share of it that was
    left out as negligible since then; cells: those that are kept.
    """
    newest = tracker.newest
    belief, names = newest.belief, tracker.filter.model.names
    # what has left the grid altogether has no width
    spread = np.sqrt(np.maximum(np.diag(belief.covariance()), 0.0)) if belief.mass > 0 else ()
    values = {'mass': f'{belief.mass:.9f}'}
    for name, attribute in (('dropped', 'dropped'), ('cells', 'size')):
        if hasattr(belief, attribute):
            values[name] = f'{getattr(belief, attribute):.3g}'
    if hasattr(belief, 'patches'):
        values['patches'] = str(len(belief.patches))
    values.update({f'standard deviation of {name}': f'{float(s):.6g}'
                   for name, s in zip(names, spread)})
    values['log evidence of the newest measurement'] = f'{newest.log_evidence:.4g}'
    if newest.stamp_ns is None:
        return Status('belief', OK, 'the prior, which waits for a measurement', values)
    if belief.mass < MOSTLY_GONE:
        return Status('belief', WARN, f'{1 - belief.mass:.0%} of it has left the grid', values)
    return Status('belief', OK, 'on the grid', values)


def source_status(name: str, account: SourceAccount) -> Status:
    """Return what became of a source's messages."""
    values = {'received': account.received, 'accepted': account.accepted,
              'outliers': account.outliers, 'dropped': account.dropped,
              **{f'rejected, {reason}': count for reason, count in account.rejected.items()}}
    text = 'nothing received yet' if not account.received else str(account)
    return Status(name, WARN if account.dropped else OK, text,
                  {key: str(value) for key, value in values.items()})
