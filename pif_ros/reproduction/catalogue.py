"""Which examples there are."""

from __future__ import annotations

from importlib import import_module
from typing import cast

from pif_ros.reproduction.study import Example, Outcome

#: Names for the command line, and modules of pif_ros.reproduction.examples.
EXAMPLES = {
    'tm-1': 'wiener', 'tm-2': 'double_well', 'tm-3': 'cosine_drift', 'tm-4': 'sine_cubic_drift',
    'tm-9': 'smoothing', 'sensors-1': 'cubic_bearing', 'sensors-2': 'coupled_trigonometric',
    'sensors-3': 'multiplicative_4d', 'pmc-1': 'arctangent_sensor', 'pmc-2': 'cubic_sensor'}


def find(name: str) -> Example:
    """Return the example of a name."""
    return cast(Example, import_module(f'pif_ros.reproduction.examples.{EXAMPLES[name]}'))


def run(name: str, case: int, seed: int, quick: bool, keep: bool, scratch: str) -> Outcome:
    """Return the outcome of a seed of a case; names and numbers alone, so that it travels."""
    return find(name).cases(quick, scratch)[case].run(seed, keep)
