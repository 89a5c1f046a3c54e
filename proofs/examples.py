"""5,000 examples that hypothesis looks for: events that hurt, and the fewest of them that do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
import tempfile
from typing import Any

from benchmarks.progress import Progress
from hypothesis import given, HealthCheck, seed, settings
from hypothesis import strategies as st
from proofs.inputs import INPUTS
from proofs.twins import Twins
from ros import Graph

EXAMPLES = 5_000
#: Events of one example, at most.
LENGTH = 12
#: The types among which it looks: one that holds any number of values, and one with a stamp.
TYPES = ('JointState', 'PoseWithCovarianceStamped')


class Drawn:
    """A chooser that hypothesis decides; the simplest of what it finds is what it shows."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data

    def one_of(self, options: Sequence[Any]) -> Any:
        """Return one of some options."""
        return options[self._data.draw(st.integers(0, len(options) - 1))]

    def number(self) -> float:
        """Return a number of any kind that is finite, mostly of the size of what is measured."""
        return self._data.draw(st.floats(-4, 4) | st.floats(allow_nan=False, allow_infinity=False))

    def rarely(self, times: int) -> bool:
        """Return true once in so many times."""
        return self._data.draw(st.integers(0, times - 1)) == times - 1


def run(share: float = 1.0) -> list[str]:
    """Look at so many examples of each type."""
    count = max(round(share * EXAMPLES / len(TYPES)), 10)
    return [_look(name, count) for name in TYPES]


def _look(name: str, count: int) -> str:
    """Look at so many examples of messages of a type."""
    progress, events = Progress(f'examples: {name}'), [0, 0]
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder))
        try:
            # one node for all: each example begins with the belief reset
            twins = Twins(graph, INPUTS[name])
            for _ in range(8):
                twins.tick()

            @seed(5)
            @settings(max_examples=count, deadline=None, database=None, print_blob=False,
                      suppress_health_check=list(HealthCheck))
            @given(st.data())
            def hold(data: st.DataObject) -> None:
                chooser = Drawn(data)
                twins.begin_anew()
                for _ in range(data.draw(st.integers(1, LENGTH))):
                    twins.step(chooser, share_of_starts=8)
                twins.settle()
                events[0] += 1
                progress.show(min(events[0] / count, 1.0))

            with twins.overheard():
                hold()
            total = twins.events
        finally:
            graph.close()
    return f'{name}: {events[0]} examples of {total} events'
