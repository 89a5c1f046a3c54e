"""Every kind of belief as arrays, and back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pif_ros.core.active import ActiveBelief, Patch, Window
from pif_ros.core.belief import GridBelief
from pif_ros.core.continuous import PathBelief
from pif_ros.core.controls import Controls
from pif_ros.core.rivals import GaussianBelief, ParticleBelief
from pif_ros.core.rivals.passage import LARGEST

Array = NDArray[Any]
Arrays = dict[str, Array]

#: The two types of numbers that are kept: 64 bits, the lowest first.
REAL, WHOLE = '<f8', '<i8'
#: How many measurements or controls, patches, and components of one are kept at most.
MANY, PATCHES, COMPONENTS = range(1_000_001), range(10_001), range(65)
#: Active cells that are kept at most: so many times those of the grid, or of a grid of LEAST.
CELLS, LEAST = 64, 1 << 16
#: By how much the rounding of sums may bring a mass above 1.
ROUNDING = 1e-6
#: How often an axis is halved at most, whatever the settings.
FINEST = 20


class Form(NamedTuple):
    """What an array has to be: its type, and on each axis how long it is, or may be."""

    dtype: str
    shape: tuple[int | range, ...]

    def allows(self, dtype: str, shape: tuple[int, ...]) -> bool:
        """Return whether an array is of this form."""
        return dtype == self.dtype and len(shape) == len(self.shape) and all(
            size in wanted if isinstance(wanted, range) else size == wanted
            for size, wanted in zip(shape, self.shape))

    def __str__(self) -> str:
        """Return the form in words."""
        sizes = [f'{w[0]} to {w[-1]}' if isinstance(w, range) else str(w) for w in self.shape]
        return f'{self.dtype} [{", ".join(sizes)}]'


Forms = dict[str, Form]


@dataclass(frozen=True)
class Kind:
    """
    How beliefs of a type become arrays.

    arrays: of a belief; forms: of the arrays of beliefs like one; belief: like one, out of arrays
    of these forms, ValueError where their numbers are no belief.
    """

    arrays: Callable[[Any], Arrays]
    forms: Callable[[Any], Forms]
    belief: Callable[[Any, Mapping[str, Array]], Any]


def belief_arrays(belief: Any) -> Arrays:
    """Return the arrays that a belief is made of; TypeError for an unknown kind."""
    return _kind(belief).arrays(belief)


def belief_forms(like: Any) -> Forms:
    """Return the forms of the arrays of beliefs of the same filter as one."""
    return _kind(like).forms(like)


@np.errstate(all='ignore')
def belief_from(like: Any, arrays: Mapping[str, Array]) -> Any:
    """
    Return the belief that arrays are made of, of the same filter as one.

    Raises ValueError where their numbers are no belief.
    """
    return _kind(like).belief(like, arrays)


def check(name: str, holds: bool | np.bool_, wanted: str) -> None:
    """Raise ValueError where something that is wanted of an array does not hold."""
    if not holds:
        raise ValueError(f'{name}: expected {wanted}, got others')


def within(name: str, arrays: Mapping[str, Array]) -> Arrays:
    """Return the arrays whose names go on from a name."""
    return {key[len(name) + 1:]: array for key, array in arrays.items()
            if key.startswith(f'{name}.')}


def under(name: str, arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Return the same arrays, or forms, with a name before theirs."""
    return {f'{name}.{key}': array for key, array in arrays.items()}


def optional(value: int | None) -> Array:
    """Return a whole number, or None, as an array of one or of nothing."""
    return np.array([] if value is None else [value], dtype=WHOLE)


def _kind(belief: Any) -> Kind:
    if type(belief) not in _KINDS:
        raise TypeError(f'belief: expected one of {", ".join(k.__name__ for k in _KINDS)}, '
                        f'got a {type(belief).__name__}')
    return _KINDS[type(belief)]


def _check_density(density: Array, volume: float) -> None:
    check('density', np.all(np.isfinite(density)) and np.all(density >= 0),
          'finite numbers, 0 or more')
    check('density', density.sum() * volume <= 1 + ROUNDING, 'a mass of 1 or less')


def _check_states(name: str, x: Array) -> None:
    # a comparison with NaN is false
    check(name, np.all(np.abs(x) < LARGEST), 'numbers of states that have not blown up')


def _grid_belief(like: GridBelief, arrays: Mapping[str, Array]) -> GridBelief:
    _check_density(arrays['density'], like.grid.cell_volume)
    return GridBelief(like.grid, arrays['density'])


def _cloud(like: ParticleBelief, arrays: Mapping[str, Array]) -> ParticleBelief:
    points, log_weights = arrays['points'], arrays['log_weights']
    _check_states('points', points)
    check('log_weights', log_weights.max() <= ROUNDING
          and np.exp(log_weights).sum() <= 1 + ROUNDING, 'logs of weights with the sum 1 or less')
    return ParticleBelief(points, log_weights, like.box)


def _gaussian(like: GaussianBelief, arrays: Mapping[str, Array]) -> GaussianBelief:
    location, spread = arrays['location'], arrays['spread']
    # one without any number is one that was lost
    if not (np.all(np.isnan(location)) and np.all(np.isnan(spread))):
        _check_states('location', location)
        _check_states('spread', spread)
        size = np.linalg.eigvalsh(spread)
        check('spread', np.abs(spread - spread.T).max() <= ROUNDING * np.abs(spread).max()
              and size[0] >= -ROUNDING * size[-1], 'a covariance')
    return GaussianBelief(location, spread, like.box)


def _active_arrays(belief: ActiveBelief) -> Arrays:
    n, patches = belief.base.ndim, belief.patches
    windows = [(p.window.level, p.window.offset, p.window.shape) for p in patches]
    cells = [p.density.ravel() for p in patches]
    return {'windows': np.array(windows, dtype=WHOLE).reshape(len(patches), 3, n),
            'cells': np.concatenate(cells) if cells else np.zeros(0),
            'dropped': np.array([belief.dropped], dtype=REAL)}


def _active_forms(like: ActiveBelief) -> Forms:
    most = CELLS * max(like.base.size, LEAST)
    return {'windows': Form(WHOLE, (PATCHES, 3, like.base.ndim)),
            'cells': Form(REAL, (range(most + 1),)), 'dropped': Form(REAL, (1,))}


def _active_belief(like: ActiveBelief, arrays: Mapping[str, Array]) -> ActiveBelief:
    windows = [_window(like, *window) for window in arrays['windows'].tolist()]
    cells, dropped = arrays['cells'], float(arrays['dropped'][0])
    ends = np.cumsum([0, *(window.size for window in windows)]).tolist()
    check('windows', ends[-1] == len(cells), 'windows of all cells')
    patches = tuple(Patch(window, cells[a:b].reshape(window.shape).copy())
                    for window, a, b in zip(windows, ends, ends[1:]))
    check('dropped', 0 <= dropped <= 1, 'a share')
    for patch in patches:
        _check_density(patch.density, float(patch.window.spacing.prod()))
    belief = ActiveBelief(like.base, patches, dropped)
    check('cells', belief.mass <= 1 + ROUNDING, 'a mass of 1 or less')
    return belief


def _window(like: ActiveBelief, level: list[int], offset: list[int], shape: list[int]) -> Window:
    """Return a window; ValueError where it does not lie in the world, but for an edge."""
    base = like.base
    check('windows', all(0 <= up <= FINEST for up in level), 'levels that are kept')
    cells = [n << up for n, up in zip(base.shape, level)]
    check('windows', all(2 <= count <= most for count, most in zip(shape, cells))
          and math.prod(shape) < 1 << 40, 'windows that fit into the grid')
    check('windows', all(
        0 <= first and (first < most if round_ else first + count <= most) for first, count, most,
        round_ in zip(offset, shape, cells, base.periodic)), 'windows that lie on the grid')
    return Window.of(base, level, offset, shape)


def _path_arrays(belief: PathBelief[Any]) -> Arrays:
    known = belief.controls
    width = len(known.values[0]) if known.values else 0
    return {**under('now', belief_arrays(belief.now)),
            **under('anchor', belief_arrays(belief.anchor)),
            'y': np.zeros(0) if belief.y is None else belief.y,
            'stamp_ns': optional(belief.stamp_ns),
            'control_stamps_ns': np.array(known.stamps_ns, dtype=WHOLE),
            'control_values': np.array(known.values, dtype=REAL).reshape(-1, width)
            if width else np.zeros((0, 0)),
            'control_hold_ns': np.array([known.hold_ns], dtype=WHOLE)}


def _path_forms(like: PathBelief[Any]) -> Forms:
    # how many components path and control have is told by what was measured
    return {**under('now', belief_forms(like.now)), **under('anchor', belief_forms(like.anchor)),
            'y': Form(REAL, (COMPONENTS,)), 'stamp_ns': Form(WHOLE, (range(2),)),
            'control_stamps_ns': Form(WHOLE, (MANY,)),
            'control_values': Form(REAL, (MANY, COMPONENTS)),
            'control_hold_ns': Form(WHOLE, (1,))}


def _path_belief(like: PathBelief[Any], arrays: Mapping[str, Array]) -> PathBelief[Any]:
    y, stamp = arrays['y'], arrays['stamp_ns'].tolist()
    check('y', (len(y) > 0) == bool(stamp) and np.all(np.isfinite(y)),
          'finite numbers and a stamp, or neither')
    stamps, values = arrays['control_stamps_ns'], arrays['control_values']
    check('control_values', len(values) == len(stamps) and np.all(np.isfinite(values)),
          'finite numbers for each stamp')
    controls = Controls(tuple(stamps.tolist()), tuple(map(tuple, values.tolist())),
                        int(arrays['control_hold_ns'][0]))
    y.setflags(write=False)
    return PathBelief(belief_from(like.now, within('now', arrays)),
                      belief_from(like.anchor, within('anchor', arrays)),
                      y if stamp else None, stamp[0] if stamp else None, controls)


_KINDS: Mapping[type, Kind] = {
    GridBelief: Kind(
        lambda belief: {'density': belief.density},
        lambda like: {'density': Form(REAL, like.grid.shape)}, _grid_belief),
    ActiveBelief: Kind(_active_arrays, _active_forms, _active_belief),
    ParticleBelief: Kind(
        lambda belief: {'points': belief.points, 'log_weights': belief.log_weights},
        lambda like: {'points': Form(REAL, like.points.shape),
                      'log_weights': Form(REAL, like.log_weights.shape)}, _cloud),
    GaussianBelief: Kind(
        lambda belief: {'location': belief.location, 'spread': belief.spread},
        lambda like: {'location': Form(REAL, like.location.shape),
                      'spread': Form(REAL, like.spread.shape)}, _gaussian),
    PathBelief: Kind(_path_arrays, _path_forms, _path_belief)}
