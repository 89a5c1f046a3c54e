"""The executable filter_bank."""

from __future__ import annotations

from collections.abc import Sequence
import re
import sys
from typing import Any

from pif_ros.node import run
from pif_ros.process import sections, strangers, trees
import yaml


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
    for section in nobodys(arguments, bank.get_namespace().rstrip('/'), list(bank.targets)):
        bank.get_logger().warning('--params-file: expected parameters for the targets '
                                  f'{", ".join(bank.targets)}, got some for {section}')
    return bank.nodes


def nobodys(arguments: Sequence[str], namespace: str, targets: Sequence[str]) -> list[str]:
    """Return the sections for filter nodes that are no targets, neither here nor in a file."""
    try:
        found = [section for tree in trees(arguments) for section in sections(tree)]
    except (yaml.YAMLError, RecursionError):
        return []
    # a file may be that of several processes, which share the targets in it
    known = [f'{namespace}/{name}/filter_node'
             for name in [*targets, *(name for _, told in found for name in _targets(told))]]
    return [name for name, _ in found if name.endswith('/filter_node')
            and not any(re.fullmatch(_pattern(name), target) for target in known)]


def _targets(told: Any) -> list[str]:
    """Return the targets among the parameters of a section."""
    names = told.get('targets', []) if isinstance(told, dict) else []
    return [names] if isinstance(names, str) else names


def _pattern(section: str) -> str:
    """Return the names of nodes to which a section applies, where * is any one, ** any number."""
    return ''.join({'*': r'/\w+', '**': r'(/\w+)*'}.get(token, f'/{re.escape(token)}')
                   for token in section.strip('/').split('/'))


if __name__ == '__main__':
    sys.exit(main())
