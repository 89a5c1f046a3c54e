"""The executable filter_bank."""

from __future__ import annotations

from collections.abc import Sequence
import sys
from typing import Any

from pif_ros.node import run
from pif_ros.process import strangers


def main(args: Sequence[str] | None = None) -> int:
    """
    Run the nodes of all targets until SIGINT or SIGTERM, and return the exit status.

    0: told to stop; 2: parameters that make no filters, named in one line on stderr.
    """
    return run('filter_bank', _filter_bank, args)


def _filter_bank(arguments: Sequence[str]) -> list[Any]:
    from pif_ros.config import ConfigError
    from pif_ros.filter_bank import FilterBank

    bank = FilterBank()
    if (not any(target.told for target in bank.targets.values())
            and (line := strangers(arguments, bank.get_fully_qualified_name()))):
        raise ConfigError(line)
    return bank.nodes


if __name__ == '__main__':
    sys.exit(main())
