"""What the node says of itself, for a person who reads /diagnostics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

import numpy as np
from pif_ros.accounts import Accounts, SourceAccount
from pif_ros.config import DiagnosticsConfig
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.lost import verdict
from pif_ros.core.tracker import Tracker
from pif_ros.stopwatch import resident_bytes

OK, WARN, ERROR = 0, 1, 2
#: How bad it is to be found, unsure, or lost.
VERDICTS = {'found': OK, 'unsure': WARN, 'lost': ERROR}
#: So many modes are shown at most.
MODES = 5
MS, MB = 1e3, 1e6
Limits = tuple[float, ...]


@dataclass(frozen=True)
class Status:
    """One task's word: its name, a level, a sentence, what it counts, and a line for the log."""

    name: str
    level: int
    message: str
    values: Mapping[str, str]
    line: str = ''


@dataclass(frozen=True)
class Facts:
    """
    What is known of a node at a moment.

    now_ns: None before there is a /clock; since_ns: when it began to listen; times: median and
    longest in seconds by kind of work; busy: share of the time that the work took; skipped: poses
    that the timer owed; behind: seconds for which there was more to do than could be done; faults:
    callbacks that failed; restarts: how often the belief was begun anew, and why at last;
    log_volume: of the grid; masses: those of the modes, as they were when they were last found;
    active: whether it listens; saved: how old the saved state is, and whether that went well, None
    where none is kept.
    """

    tracker: Tracker[Any]
    accounts: Accounts
    limits: DiagnosticsConfig
    now_ns: int | None
    since_ns: int
    times: Mapping[str, tuple[float, float]]
    busy: float = 0.0
    skipped: int = 0
    behind: float = 0.0
    faults: int = 0
    restarts: int = 0
    why: str = ''
    log_volume: float = 0.0
    masses: Sequence[float] = ()
    active: bool = True
    saved: tuple[str, bool] | None = None


def statuses(facts: Facts) -> list[Status]:
    """Return what is to be said now: of the filter, its belief, its sources and its time."""
    accounts = facts.accounts
    found = [filter_status(facts), belief_status(facts)]
    found += [source_status(name, account, facts) for name, account in accounts.sources.items()]
    if accounts.control is not None:
        found.append(source_status('control', accounts.control, facts))
    if accounts.initial_pose.received:
        found.append(source_status('initialpose', accounts.initial_pose, facts, quiet=True))
    return [*found, timing_status(facts)]


def filter_status(facts: Facts) -> Status:
    """Return whether the filter does what it is for, and since when it begins anew."""
    newest_ns, limits = facts.tracker.stamp_ns, facts.limits
    values = {'model': f'{len(facts.tracker.filter.model.names)} states: '
                       f'{", ".join(facts.tracker.filter.model.names)}',
              'faults': str(facts.faults), 'restarts': str(facts.restarts)}
    if facts.why:
        values['last restart'] = facts.why
    if facts.saved is not None:
        values['state saved'] = facts.saved[0]
    if not facts.active:
        return Status('filter', OK, 'inactive: it does not listen until it is activated', values)
    if facts.now_ns is None:
        return Status('filter', WARN, 'waits for a /clock', values)
    if newest_ns is None:
        return Status('filter', OK, 'waits for a measurement', values)
    age = (facts.now_ns - newest_ns) / NANOSECONDS
    values |= {'newest stamp': f'{newest_ns / NANOSECONDS:.3f}', 'its age': _seconds(age)}
    if facts.behind:
        return Status('filter', _level(facts.behind, limits.max_age),
                      f'behind for {facts.behind:.1f} s, {facts.tracker.backlog} corrections left',
                      values)
    level = _level(age, limits.max_age)
    text = 'tracks' if level == OK else f'no measurement for {age:.1f} s: predicts only'
    if facts.faults and level == OK:
        level, text = WARN, f'tracks, after {facts.faults} faults (the log tells)'
    if facts.saved is not None and not facts.saved[1] and level == OK:
        level, text = WARN, f'tracks, but its state is not saved: {facts.saved[0]}'
    return Status('filter', level, text, values)


def belief_status(facts: Facts) -> Status:
    """
    Return what the newest belief is like, and whether it is lost.

    mass: what is left on the grid since the last correction; dropped: the share of it that was
    left out as negligible since then; cells: those that are kept.
    """
    tracker, limits = facts.tracker, facts.limits
    newest = tracker.newest
    belief, names = newest.belief, tracker.filter.model.names
    values = {'mass': f'{belief.mass:.9f}'}
    for name, attribute in (('dropped', 'dropped'), ('cells', 'size')):
        if hasattr(belief, attribute):
            values[name] = f'{getattr(belief, attribute):.3g}'
    if hasattr(belief, 'patches'):
        values['patches'] = str(len(belief.patches))
    values['log evidence of the newest measurement'] = f'{newest.log_evidence:.4g}'
    if not belief.mass > 0:
        return Status('belief', ERROR, 'all of it has left the grid', values)
    spread = np.sqrt(np.maximum(np.diag(belief.covariance()), 0.0))
    values |= {f'standard deviation of {name}': f'{float(s):.6g}'
               for name, s in zip(names, spread)}
    entropy = belief.entropy()
    found = verdict(newest.watch, tracker.guard.alarm, math.exp(min(
        entropy - facts.log_volume, 0.0)), facts.masses)
    values |= {'entropy': f'{entropy:.4g} nats', 'masses of the modes': ', '.join(
        f'{mass:.3f}' for mass in facts.masses[:MODES]) or 'not looked for'}
    values |= {key: f'{number:.3g}' for key, number in found.numbers.items()}
    if newest.stamp_ns is None:
        return Status('belief', OK, 'the prior, which waits for a measurement', values)
    lost, edge = 1 - belief.mass, _edge_mass(belief)
    concerns = [(VERDICTS[found.level], found.sentence),
                (_level(lost, limits.max_lost_mass), f'{lost:.0%} of it has left the grid')]
    if edge is not None:
        values['mass at the edge'] = f'{edge:.3g}'
        concerns.append((_level(edge, limits.max_edge_mass),
                         f'{edge:.0%} of it lies at the edge of the grid'))
    level, text = max(concerns, key=lambda concern: concern[0])
    return Status('belief', level, text, values)


def _edge_mass(belief: Any) -> float | None:
    """Return the share of a belief at the edge of the grid, None where it has none."""
    try:
        return float(belief.edge_mass())
    except AttributeError:
        return None


def source_status(name: str, account: SourceAccount, facts: Facts,
                  quiet: bool = False) -> Status:
    """Return what became of a source's messages; quiet: whether it may be silent for ever."""
    traffic, limits, now_ns = account.traffic, facts.limits, facts.now_ns
    values = {'received': account.received, 'accepted': account.accepted,
              'outliers': account.outliers, 'dropped': account.dropped,
              **{f'rejected, {reason}': count for reason, count in account.rejected.items()},
              'lost before us': account.lost}
    words = {key: str(value) for key, value in values.items()} | dict(_traffic(account, now_ns))
    concerns = [(OK, str(account) if account.received else 'nothing received yet')]
    if not facts.active:
        return Status(name, *concerns[0], words)
    if off := account.off():
        return Status(name, OK, f'{off}: {account}', words)
    line = ''
    if now_ns is not None and not quiet:
        silence = traffic.silence(now_ns, facts.since_ns)
        level, text = _level(silence, limits.max_age), f'silent for {silence:.1f} s'
        if level > OK and (there := account.there()):
            text = f'{text}: {there}'
            line = f'{name}: {text}'
        concerns.append((level, text))
    if traffic.delay is not None:
        concerns.append((_level(traffic.delay, limits.max_delay),
                         f'its stamps are {traffic.delay:.2f} s old when they come'))
    concerns.append((_level(traffic.refused, limits.max_refused),
                     f'{traffic.refused:.0%} of the last were not taken or never came: {account}'))
    level, text = max(concerns, key=lambda concern: concern[0])
    return Status(name, level, text, words, line)


def timing_status(facts: Facts) -> Status:
    """Return how long the work takes, and how much of the time."""
    tracker = facts.tracker
    values = {f'{kind}, ms (median, longest)': f'{MS * middle:.2f}, {MS * longest:.2f}'
              for kind, (middle, longest) in facts.times.items()}
    values |= {'busy': f'{facts.busy:.0%}', 'poses skipped': str(facts.skipped),
               'beliefs kept': f'{tracker.kept} ({tracker.nbytes / MB:.1f} MB)'}
    memory = resident_bytes()
    if memory is not None:
        values['memory of the process'] = f'{memory / MB:.0f} MB'
    level = _level(facts.busy, facts.limits.max_busy)
    return Status('timing', level, f'busy for {facts.busy:.0%} of the time' + (
        '' if level == OK else ': it cannot keep up for long'), values)


def _traffic(account: SourceAccount, now_ns: int | None) -> Iterator[tuple[str, str]]:
    """Give how messages come in, as far as it is known."""
    traffic = account.traffic
    if traffic.rate is not None:
        yield 'rate', f'{traffic.rate:.3g} Hz'
    if now_ns is not None and (age := traffic.age(now_ns)) is not None:
        yield 'age of the newest', _seconds(age)
    if traffic.delay is not None:
        yield 'delay', _seconds(traffic.delay)
    if traffic.skew is not None:
        yield 'clock less stamp at the first message', _seconds(traffic.skew)
    if traffic.log_evidence:
        found = np.array(traffic.log_evidence)
        yield (f'log evidence of the last {len(found)} (mean, least)',
               f'{found.mean():.4g}, {found.min():.4g}')


def _level(value: float, limits: Limits) -> int:
    """Return WARN from the first limit on, ERROR from the second on."""
    warn, error = limits
    return ERROR if value >= error else WARN if value >= warn else OK


def _seconds(value: float) -> str:
    return f'{value:.3f} s'
