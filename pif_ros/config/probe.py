"""What the functions of a system give, tried at a few states before all else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from pif_ros.config.kinds import ConfigError
from pif_ros.core.grid import Grid
from pif_ros.core.models import Sensor, StateModel

#: So many states at a time: neither one nor as many as a state has components.
PLACES = 5


def check_functions(name: str, model: StateModel, grid: Grid,
                    sensors: Mapping[str, Sensor]) -> None:
    """Refuse a system, by its name, whose functions raise or do not fit its states."""
    owner, n, x = f'model.name {name!r}', model.ndim, _places(grid)
    plain, given = model.under(()), 'x, u, t' if model.inputs else 'x, t'
    _tried(owner, f'drift({given})', lambda: plain.drift(x, 0.0), n, PLACES)
    if plain.drift_jacobian is not None:
        _tried(owner, f'drift_jacobian({given})', lambda: plain.jacobian(x, 0.0), n, n, PLACES)
    if plain.multiplicative:
        _, p, _ = _tried(owner, 'vielbein(x, t)', lambda: plain.vielbein_at(x, 0.0),
                         n, 'p', PLACES)
        if plain.vielbein_jacobian is not None:
            _tried(owner, 'vielbein_jacobian(x, t)',
                   lambda: plain.vielbein_jacobian_at(x, 0.0), n, p, n, PLACES)
    elif callable(plain.vielbein):
        _tried(owner, 'vielbein(t)', lambda: plain.vielbein(0.0), n, 'p')  # type: ignore
    for source, sensor in sensors.items():
        _check_sensor(f'measurements.{source}.sensor', sensor, x)


def _check_sensor(owner: str, sensor: Sensor, x: np.ndarray) -> None:
    m, _ = _tried(owner, 'covariance(t)', lambda: sensor.noise(0.0), 'm', 'm')
    _tried(owner, 'h(x, t)', lambda: sensor.function(x, 0.0), m, PLACES)


def said(error: Exception) -> str:
    """Return what went wrong in a function of another package, in a line."""
    line = ' '.join(str(error).split())
    return line if ': expected ' in line else f'{type(error).__name__}: {line}'


def _places(grid: Grid) -> np.ndarray:
    """Return centres of cells from corner to corner, (n, PLACES)."""
    index = np.arange(PLACES) * np.array(grid.shape)[:, None] // PLACES
    return np.array(grid.lower)[:, None] + (index + 0.5) * grid.spacing[:, None]


def _tried(owner: str, call: str, function: Callable[[], Any],
           *expected: int | str) -> tuple[int, ...]:
    """Return the shape of what a function returns; a letter stands for one number, any."""
    try:
        with np.errstate(all='ignore'):
            shape = np.shape(function())
    except Exception as error:  # noqa: B902  whatever foreign code may raise
        raise ConfigError(f'{owner}: {call}: {said(error)}') from None
    letters: dict[str, int] = {}
    if len(shape) != len(expected) or any(
            found != (letters.setdefault(wanted, found) if isinstance(wanted, str) else wanted)
            for wanted, found in zip(expected, shape)):
        whole = ', '.join(map(str, expected))
        raise ConfigError(f'{owner}: {call}: expected shape ({whole}), got {shape}')
    return shape
