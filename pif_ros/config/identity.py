"""Which filter a configuration describes, whatever it is fed by and where its results go."""

from __future__ import annotations

from collections.abc import Mapping
import dataclasses
import json
from typing import Any

from pif_ros.config.build import plain
from pif_ros.config.table import Config

#: The sections that make the kernel, and with it the filter.
SHARED = ('model', 'grid', 'region', 'filter', 'kernel', 'operator')
#: What does not change what is believed: where a kernel is kept.
ASIDE = 'operator.file'


def identity(config: Config) -> dict[str, Any]:
    """
    Return the parameters that make a state of one filter none of another's, as JSON has them.

    Model, grid, filter, kernel, the sensors, and for how long a control holds.  Not the prior, by
    which nothing goes that is believed already, nor topics, rates and how long is remembered.
    What is written out that is so by default is left out.
    """
    found: dict[str, Any] = {}
    config = plain(config)
    for section in SHARED:
        found |= flat(section, getattr(config, section))
    del found[ASIDE]
    found['measurements.names'] = config.measurements.names
    for name, source in config.measurements.sources.items():
        prefix = f'measurements.{name}'
        found |= {f'{prefix}.sensor': source.sensor,
                  **{f'{prefix}.params.{key}': each for key, each in source.params.items()}}
    found['control.hold'] = config.control.hold
    as_json: dict[str, Any] = json.loads(json.dumps(found, default=list))
    return as_json


def flat(section: str, settings: Any) -> dict[str, Any]:
    """Return the parameters of a section by their full names."""
    found: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value, name = getattr(settings, field.name), f'{section}.{field.name}'
        found |= ({f'{name}.{key}': each for key, each in value.items()}
                  if isinstance(value, Mapping) else {name: value})
    return found
