"""The compiler, where there is one: numba, which is found at run time and never required."""

from __future__ import annotations

from functools import cache
from typing import Any


def is_available() -> bool:
    """Return whether there is a compiler."""
    return compiler() is not None


@cache
def compiler() -> Any:
    """Return numba, None where it is not installed or does not go with numpy."""
    try:
        # at its first use, since importing it takes a second
        import numba
    except ImportError:
        return None
    return numba
