"""Late data: whatever the order of arrival within the history, the belief is that of stamps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.progress import Progress
import numpy as np
from pif_ros.config import build_tracker, Config
from pif_ros.core.estimates import Measurement
from pif_ros.core.tracker import Tracker
from proofs.inputs import YARD
from proofs.invariants import check_belief, check_same
from ros import PLANE, SECOND

SHUFFLES = 300
HISTORY = 1.0
COUNT = 25
START_NS = 1_000 * SECOND
#: The filters of a belief with a density: all cells, and active ones that a control drives.
FILTERS = {'all cells': PLANE, 'active cells': YARD}
Item = tuple[int, Callable[[Tracker[Any]], Any]]


def run(share: float = 1.0) -> list[str]:
    """Prove it with so many seeds, each another shuffle, for each filter."""
    count = max(round(share * SHUFFLES), 2)
    progress = Progress('late')
    late = 0
    for number, (name, parameters) in enumerate(FILTERS.items()):
        config = Config.from_parameters({**parameters, 'time.history': HISTORY})
        shuffled, in_order = build_tracker(config), build_tracker(config)
        for seed in range(count):
            try:
                late += _shuffle(shuffled, in_order, np.random.default_rng([number, seed]))
            except AssertionError as failed:
                raise AssertionError(f'{name}, seed {seed}: {failed}') from None
            progress.part(number, len(FILTERS))((seed + 1) / count)
    return [f'{count} shuffles of {COUNT} measurements, and of controls among them, with '
            f'{", ".join(FILTERS)}: {late} arrived late, forecasts and estimates in between: '
            'each belief is that of arrival in order, to the last bit']


def _shuffle(shuffled: Tracker[Any], in_order: Tracker[Any], rng: np.random.Generator) -> int:
    """Give the same to both trackers, in two orders; return how many came late."""
    items = _items(rng, bool(shuffled.filter.model.inputs))
    delays = rng.uniform(0, 0.99 * HISTORY * SECOND, len(items)) * (rng.random(len(items)) < 0.6)
    order = np.argsort([stamp_ns for stamp_ns, _ in items] + delays, kind='stable')
    for tracker in (shuffled, in_order):
        tracker.reset()
    newest, late = 0, 0
    for k in order:
        stamp_ns, give = items[k]
        late += stamp_ns < newest
        newest = max(newest, stamp_ns)
        rejection = give(shuffled)
        assert rejection is None, f'rejected as {rejection} at {stamp_ns}'
        if rng.random() < 0.5:
            shuffled.estimate(at_most=int(rng.integers(1, 4)))
        if rng.random() < 0.2:
            shuffled.forecast(newest + int(rng.integers(SECOND)))
    for _, give in items:
        assert give(in_order) is None
    found, expected = shuffled.estimate(), in_order.estimate()
    check_same(found, expected)
    assert found.total_log_evidence == expected.total_log_evidence, 'another evidence'
    check_belief(found.belief, corrected=True)
    return late


def _items(rng: np.random.Generator, driven: bool) -> list[Item]:
    """Return measurements, and controls where some are wanted, in the order of their stamps."""
    stamps = START_NS + np.sort(rng.choice(5 * SECOND, COUNT, replace=False))
    # some at the same time
    stamps[rng.random(COUNT) < 0.1] = stamps[COUNT // 2]
    items: list[Item] = []
    for stamp_ns in np.sort(stamps):
        values = tuple(float(v) for v in rng.normal(0.0, 0.7, 2))
        items.append((int(stamp_ns), _measure(int(stamp_ns), values)))
    for stamp_ns in START_NS + rng.choice(5 * SECOND, COUNT if driven else 0, replace=False):
        values = tuple(float(v) for v in rng.normal(0.0, 0.5, 2))
        items.append((int(stamp_ns), _steer(int(stamp_ns), values)))
    return sorted(items, key=lambda item: item[0])


def _measure(stamp_ns: int, values: tuple[float, ...]) -> Callable[[Tracker[Any]], Any]:
    return lambda tracker: tracker.observe(Measurement(stamp_ns, 'main', values))


def _steer(stamp_ns: int, values: tuple[float, ...]) -> Callable[[Tracker[Any]], Any]:
    return lambda tracker: tracker.control(stamp_ns, values)
