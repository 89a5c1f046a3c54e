"""Which estimates go out as poses, and with which stamps."""

from __future__ import annotations

from typing import Any

from pif_ros.config import Config
from pif_ros.core.estimates import Estimate
from pif_ros.core.filters import NANOSECONDS
from pif_ros.core.tracker import Tracker
from pif_ros.epoch import Epoch
from pif_ros.outputs import Outputs
from pif_ros.stopwatch import Stopwatch


class Poses:
    """
    Publishes what a tracker believes, each estimate with no older stamp than the last.

    node: one that reports, knows the time and counts how often it began anew; outputs: publish a
    belief; watch: times that.
    """

    def __init__(self, node: Any, config: Config, tracker: Tracker[Any], outputs: Outputs,
                 watch: Stopwatch) -> None:
        self._node, self._tracker, self._outputs, self._watch = node, tracker, outputs, watch
        self._max_forecast_ns = config.time.max_forecast * NANOSECONDS
        self.epoch = Epoch(config)
        # whether there was something to tell while the node was inactive
        self.is_untold = False

    def tell(self, estimate: Estimate[Any]) -> None:
        """Publish an estimate, with no older stamp than the last unless it is of another time."""
        restarts, now_ns = self._node.restarts, self._node.now()
        if not self._node.is_active:
            self.is_untold = True
        # to ask for the time may have shown that the clock was set, so that all began anew
        if (estimate.stamp_ns is None or not self._node.is_active
                or self._node.restarts != restarts):
            return
        if self.epoch.is_over(estimate.stamp_ns):
            by = (self.epoch.newest_ns - estimate.stamp_ns) / NANOSECONDS
            self._node.report('back', f'poses go back by {by:.3f} s: what is believed now is of '
                              'another time')
            self.epoch.restart()
        stamp_ns = self.epoch.stamp_for(estimate.stamp_ns, now_ns)
        if stamp_ns is None:
            return
        if stamp_ns > estimate.stamp_ns:
            estimate = self._tracker.forecast(stamp_ns)
        if not estimate.belief.mass > 0:
            self._on_nothing_left()
            return
        self.epoch.advance(stamp_ns)
        with self._watch.timing('publish'):
            self._outputs.publish(estimate.belief, stamp_ns)

    def is_due(self, now_ns: int) -> bool:
        """Return whether a pose is to be predicted to now."""
        newest_ns = self._tracker.stamp_ns
        if newest_ns is None or self._tracker.backlog:
            return False
        if now_ns > newest_ns + self._max_forecast_ns:
            age = (now_ns - newest_ns) / NANOSECONDS
            self._node.report('stale', f'the newest measurement is {age:.0f} s old, more than '
                              'time.max_forecast: no pose until the next one')
            return False
        return now_ns > self.epoch.newest_ns

    def _on_nothing_left(self) -> None:
        """Begin anew where nothing is believed any more; a forecast alone commits to nothing."""
        if self._tracker.newest.belief.mass > 0:
            self._node.report('forecast', 'all of the belief is predicted to have left the grid: '
                              'no pose until the next measurement')
        else:
            self._node.give_up('all of the belief has left the grid: back to the prior')
