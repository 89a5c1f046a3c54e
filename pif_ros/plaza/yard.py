"""The filter's parameters for the yard of a recording."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from pif_ros.plaza.recording import Recording
from pif_ros.share import find
import yaml

_MARGIN = 10.0
#: By what the radios' ranges are too long, as the other recording has it.
_SCALE = 1.0701


def parameters_for(recording: Recording, out: Path, name: str = 'plaza_range_only') -> Path:
    """
    Return the parameter file of a name for a recording.

    It is the one that comes with the package, which is for Plaza1; elsewhere a copy in out, with
    the beacons and the yard of that recording, and the scale that was fitted on Plaza1.
    """
    shipped = find(f'config/{name}.yaml')
    if recording.name == 'Plaza1':
        return shipped
    tree = yaml.safe_load(shipped.read_text(encoding='utf-8'))
    given = next(iter(tree.values()))['ros__parameters']
    for beacon, place in recording.beacons.items():
        given['measurements'][f'beacon_{beacon}']['params'].update(
            landmark=list(place), scale=_SCALE)
    grid, places = given['grid'], np.array(list(recording.beacons.values()))
    spacing = (np.subtract(grid['upper'], grid['lower']) / grid['shape'])[:2]
    lower = np.floor(places.min(axis=0) - _MARGIN)
    shape = np.ceil((places.max(axis=0) + _MARGIN - lower) / spacing)
    # a heading is the same in every yard
    grid['lower'][:2], grid['shape'][:2] = lower.tolist(), [int(n) for n in shape]
    grid['upper'][:2] = (lower + shape * spacing).tolist()
    file = out / f'{recording.name.lower()}.yaml'
    # JSON is YAML in which every string is quoted: a bare y would be true
    file.write_text(json.dumps(tree, indent=2) + '\n', encoding='utf-8')
    return file
