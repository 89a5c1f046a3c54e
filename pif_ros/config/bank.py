"""The filter of many targets: one kernel, and priors and sensors of their own."""

from __future__ import annotations

import dataclasses
from typing import Any

from pif_ros.config.build import build_tracker, find_sensors, find_system, plain
from pif_ros.config.identity import flat, SHARED
from pif_ros.config.kinds import ConfigError
from pif_ros.config.table import Config
from pif_ros.core.bank import Member
from pif_ros.core.filters import DiracFeynmanFilter, Filter


class FilterOfMany:
    """
    Makes the trackers of targets, as many of them as can be with the same filter.

    Targets with the same sensors have the same filter; those with other ones have its kernel.
    """

    def __init__(self) -> None:
        self._first: tuple[str, Config] | None = None
        self._filters: list[tuple[object, Filter[Any]]] = []

    def tracker(self, target: str, config: Config) -> Member:
        """Return a target's tracker; ConfigError where its kernel is not that of the others."""
        if self._first is None:
            self._first = target, plain(config)
        _check_shared(*self._first, plain(config))
        known = self._known(config)
        if not config.recovery.when_lost:
            # the watch takes longer than a target's share of a prediction together
            config = dataclasses.replace(config, lost=dataclasses.replace(
                config.lost, false_alarm_rate=0.0))
        tracker = build_tracker(config, known, Member)
        assert isinstance(tracker, Member)
        if all(filter_ is not tracker.filter for _, filter_ in self._filters):
            self._filters.append((_sensors_of(config), tracker.filter))
        return tracker

    def __len__(self) -> int:
        """Return how many filters there are."""
        return len(self._filters)

    def _known(self, config: Config) -> Filter[Any] | None:
        """Return a filter out of those that there are, None where it has to be made."""
        for sensors, filter_ in self._filters:
            if sensors == _sensors_of(config):
                return filter_
        first = self._filters[0][1] if self._filters else None
        if not isinstance(first, DiracFeynmanFilter):
            return None
        return first.with_sensors(find_sensors(config, find_system(config)))


def _sensors_of(config: Config) -> object:
    """Return what the sensors of a configuration are made of."""
    return [(name, source.sensor, dict(source.params))
            for name, source in plain(config).measurements.sources.items()]


def _check_shared(first: str, wanted: Config, given: Config) -> None:
    """Refuse a configuration whose kernel is not that of the first target."""
    for section in SHARED:
        expected = flat(section, getattr(wanted, section))
        found = flat(section, getattr(given, section))
        for name in {**expected, **found}:
            if expected.get(name) != found.get(name):
                raise ConfigError(f'{name}: expected {_shown(expected.get(name))} as {first} has, '
                                  'since all targets are on one kernel, got '
                                  f'{_shown(found.get(name))}')


def _shown(value: Any) -> str:
    """Return a value as it is written in a file."""
    if value is None:
        return 'none'
    return repr(list(value) if isinstance(value, tuple) else value)
