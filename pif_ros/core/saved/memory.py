"""What a tracker remembers as arrays, and back."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import dataclasses
import itertools
from typing import Any

import numpy as np
from pif_ros.core.estimates import Estimate, Measurement, Memory
from pif_ros.core.lost import Watch
from pif_ros.core.saved.beliefs import (Array, Arrays, belief_arrays, belief_forms, belief_from,
                                        check, COMPONENTS, Form, Forms, MANY, optional, REAL,
                                        under, WHOLE, within)
from pif_ros.core.steering import MOST_CONTROLS
from pif_ros.core.tracker import Tracker


def arrays_of(tracker: Tracker[Any]) -> Arrays:
    """
    Return what a tracker remembers, as arrays of 64-bit numbers by name.

    The density of a grid is the belief's own, not a copy: as beliefs are values, it may be
    written at leisure while the tracker goes on.  A prior that nothing was measured of is left
    out: it is the prior of whoever goes on.  Raises ValueError for more than is kept of anything.
    """
    memory = tracker.memory()
    arrays = {**under('anchor', _estimate_arrays(memory.anchor)),
              **under('watch', _watch_arrays(tracker, memory.anchor.watch)),
              **under('anchored', _measurement_arrays(
                  tracker, [] if memory.anchored is None else [memory.anchored])),
              **under('measurements', _measurement_arrays(tracker, memory.measurements)),
              **under('controls', _control_arrays(tracker, memory.controls))}
    if not _waits(tracker, memory):
        arrays |= under('belief', belief_arrays(memory.anchor.belief))
    forms, _ = forms_of(tracker)
    for name, array in arrays.items():
        wanted = forms[name]
        arrays[name] = np.ascontiguousarray(array, dtype=wanted.dtype)
        if not wanted.allows(wanted.dtype, array.shape):
            raise ValueError(f'{name}: expected {wanted}, got {list(array.shape)}')
    return arrays


def forms_of(tracker: Tracker[Any]) -> tuple[Forms, Forms]:
    """Return the forms of the arrays of a tracker's memory, with a belief and without one."""
    inputs, one = len(tracker.filter.model.inputs), range(2)
    sizes = [sensor.size for sensor in tracker.filter.sensors.values()]
    numbers = range(max([len(COMPONENTS), *(size + 1 for size in sizes)]))
    rest = {**under('anchor', {'stamp_ns': Form(WHOLE, (one,)), **{
                name: Form(REAL, (1,)) for name in _numbers()}}),
            **under('watch', {'score': Form(REAL, (1,)),
                              'counts': Form(WHOLE, (2 + len(tracker.filter.sensors),))}),
            **under('anchored', _measurement_forms(one, numbers)),
            **under('measurements', _measurement_forms(
                MANY, range(len(MANY) * len(numbers)))),
            **under('controls', {'stamps_ns': Form(WHOLE, (range(MOST_CONTROLS + 1),)),
                                 'values': Form(REAL, (range(MOST_CONTROLS + 1), inputs))})}
    return {**rest, **under('belief', belief_forms(tracker.prior))}, rest


def memory_from(tracker: Tracker[Any], arrays: Mapping[str, Array]) -> Memory[Any]:
    """
    Return the memory that arrays of a tracker's forms are made of.

    Raises ValueError where their numbers are no memory of such a tracker.
    """
    anchored = _measurements(tracker, 'anchored', within('anchored', arrays))
    memory = Memory(_estimate(tracker, *(within(part, arrays)
                                         for part in ('anchor', 'belief', 'watch'))),
                    anchored[0] if anchored else None,
                    _measurements(tracker, 'measurements', within('measurements', arrays)),
                    _controls(within('controls', arrays)))
    _check_order(memory)
    check('belief', bool(within('belief', arrays)) or _waits(tracker, memory),
          'one where something was measured')
    return memory


def _waits(tracker: Tracker[Any], memory: Memory[Any]) -> bool:
    """Return whether a memory is that of a prior of which nothing was measured yet."""
    return memory.anchor.belief is tracker.prior and memory.stamp_ns is None


def _check_order(memory: Memory[Any]) -> None:
    start, anchored, rest = memory.anchor.stamp_ns, memory.anchored, memory.measurements
    check('anchored', anchored is None or anchored.stamp_ns == start,
          "a measurement at the anchor's stamp")
    ordered = [*([] if anchored is None else [anchored]), *rest]
    check('measurements', all(a < b for a, b in itertools.pairwise(ordered)),
          'increasing measurements')
    check('measurements', start is None or not rest or rest[0].stamp_ns >= start,
          'stamps from the anchor on')


def _numbers() -> list[str]:
    """Return what an estimate has besides a stamp and a belief: numbers."""
    return [field.name for field in dataclasses.fields(Estimate)
            if field.name not in ('stamp_ns', 'belief', 'watch')]


def _estimate_arrays(estimate: Estimate[Any]) -> Arrays:
    return {'stamp_ns': optional(estimate.stamp_ns), **{
        name: np.array([getattr(estimate, name)], dtype=REAL) for name in _numbers()}}


def _estimate(tracker: Tracker[Any], arrays: Arrays, belief: Arrays,
              watch: Arrays) -> Estimate[Any]:
    stamp = arrays['stamp_ns'].tolist()
    numbers: dict[str, Any] = {name: float(arrays[name][0]) for name in _numbers()}
    check('anchor', not np.isnan(list(numbers.values())).any(), 'numbers')
    return Estimate(stamp[0] if stamp else None,
                    belief_from(tracker.prior, belief) if belief else tracker.prior,
                    watch=_watch(tracker, watch), **numbers)


def _watch_arrays(tracker: Tracker[Any], watch: Watch) -> Arrays:
    counts = [int(watch.lost), watch.recoveries, *map(watch.rejections, tracker.filter.sensors)]
    return {'score': np.array([watch.score], dtype=REAL), 'counts': np.array(counts, dtype=WHOLE)}


def _watch(tracker: Tracker[Any], arrays: Arrays) -> Watch:
    [score], [lost, recoveries, *rejected] = (arrays[name].tolist() for name in (
        'score', 'counts'))
    check('watch', 0 <= score < np.inf and lost in (0, 1) and min([recoveries, *rejected]) >= 0,
          'numbers, 0 or more')
    return Watch(score, bool(lost), tuple(sorted(
        (name, count) for name, count in zip(tracker.filter.sensors, rejected) if count)),
        recoveries)


def _measurement_arrays(tracker: Tracker[Any], some: Sequence[Measurement]) -> Arrays:
    names = list(tracker.filter.sensors)
    return {'stamps_ns': np.array([m.stamp_ns for m in some], dtype=WHOLE),
            'sources': np.array([names.index(m.source) for m in some], dtype=WHOLE),
            'values': np.array([v for m in some for v in m.values], dtype=REAL)}


def _measurement_forms(count: range, values: range) -> Forms:
    return {'stamps_ns': Form(WHOLE, (count,)), 'sources': Form(WHOLE, (count,)),
            'values': Form(REAL, (values,))}


def _measurements(tracker: Tracker[Any], name: str, arrays: Arrays) -> tuple[Measurement, ...]:
    names, sensors = list(tracker.filter.sensors), tracker.filter.sensors
    stamps, sources, values = arrays['stamps_ns'], arrays['sources'], arrays['values']
    check(f'{name}.sources', len(sources) == len(stamps) and np.all(
        (0 <= sources) & (sources < len(names))), 'a source for each stamp')
    sizes = np.array([sensors[each].size for each in names], dtype=int)[sources]
    check(f'{name}.values', len(values) == sizes.sum() and np.all(np.isfinite(values)),
          'finite numbers, as many as the sensors give')
    ends, given = np.cumsum([0, *sizes]).tolist(), values.tolist()
    return tuple(Measurement(stamp, names[source], tuple(given[a:b])) for stamp, source, a, b
                 in zip(stamps.tolist(), sources.tolist(), ends, ends[1:]))


def _control_arrays(tracker: Tracker[Any],
                    controls: Sequence[tuple[int, tuple[float, ...]]]) -> Arrays:
    inputs = len(tracker.filter.model.inputs)
    return {'stamps_ns': np.array([stamp for stamp, _ in controls], dtype=WHOLE),
            'values': np.array([u for _, u in controls], dtype=REAL).reshape(-1, inputs)
            if inputs else np.zeros((0, 0))}


def _controls(arrays: Arrays) -> tuple[tuple[int, tuple[float, ...]], ...]:
    stamps, values = arrays['stamps_ns'], arrays['values']
    check('controls.stamps_ns', np.all(stamps[:-1] < stamps[1:]), 'increasing stamps')
    check('controls.values', len(values) == len(stamps) and np.all(np.isfinite(values)),
          'finite numbers for each stamp')
    return tuple(zip(stamps.tolist(), map(tuple, values.tolist())))
