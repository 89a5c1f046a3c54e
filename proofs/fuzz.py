"""100,000 messages of each type into the callbacks: none escapes, and none leaves a trace."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import tempfile
import time
from types import MappingProxyType
from typing import Any

from benchmarks.progress import Progress
from proofs.events import Seeded
from proofs.inputs import BESIDE, INITIAL_POSE, INPUTS
from proofs.twins import Twins
from ros import Graph

MESSAGES = 100_000
SEED = 5
#: A node with a gate believes less than its twin is given: there only the invariants hold.
GATED, GATE = 'JointState', {'measurements.main.gate.tail_probability': 1e-2,
                             'measurements.main.outlier_probability': 1e-3}


def run(share: float = 1.0) -> list[str]:
    """Prove it for every type."""
    count = max(round(share * MESSAGES), 50)
    return [*(one(name, count) for name in (*INPUTS, INITIAL_POSE)),
            f'with a gate, {one(GATED, count, GATE)}']


def one(name: str, messages: int, more: Mapping[str, Any] = MappingProxyType({})) -> str:
    """Let so much happen to a node that takes a type, and return a line about it."""
    starts = name == INITIAL_POSE
    kind, progress = INPUTS[BESIDE if starts else name], Progress(f'fuzz: {name}')
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        graph = Graph(Path(folder))
        try:
            twins = Twins(graph, kind, **more)
            chooser = Seeded(SEED, *name.encode())
            with twins.overheard():
                for k in range(messages):
                    twins.step(chooser, share_of_starts=1 if starts and k % 3 else 100)
                    progress.show((k + 1) / messages)
                twins.settle()
            accounts = str(twins.node.accounts)
        finally:
            graph.close()
    return f'{name}: {messages} events in {time.monotonic() - began:.0f} s; {accounts}'
