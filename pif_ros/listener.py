"""What hears measurements and controls: each message is judged, counted and put where it waits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
import functools
import math
from typing import Any

from pif_ros import interface
from pif_ros.accounts import Accounts
from pif_ros.config import Config, ConfigError, find_grid
from pif_ros.core.controls import carries_across
from pif_ros.core.filters import Filter
from pif_ros.inbox import Inbox
from pif_ros.process import guarded
from pif_ros.sources import ControlSource, Inlet, Refused, Source
from pif_ros.timekeeper import Timekeeper

#: An angle in radians, of either sign and rounded, is no more than this, unless it counts turns.
TURN = 2 * math.pi * (1 + 1e-6)


class Listener:
    """
    The subscriptions of a node to all of its sources, and to the control of a model with inputs.

    All are checked where this is made, and heard from listen() on.  refuses: says in a word why a
    source is not listened to now, '' where it is; arrived: called when something was put into the
    inbox, with whether nothing waited before.  Raises ConfigError for what cannot be listened to.
    """

    def __init__(self, node: Any, config: Config, filter_: Filter[Any], accounts: Accounts,
                 inbox: Inbox, time: Timekeeper, refuses: Callable[[str], str],
                 arrived: Callable[[bool], None]) -> None:
        self._node, self._inbox, self._time = node, inbox, time
        self._refuses, self._arrived = refuses, arrived
        self._frames = ('', config.frame_id)
        self._depth = config.measurements.queue_length
        self._known = {node.resolve_topic_name(own.name): own.type
                       for own in (*interface.PUBLICATIONS, *interface.SUBSCRIPTIONS)}
        model, ahead = filter_.model, config.time.max_ahead
        self._inlets: list[Source | ControlSource] = []
        if accounts.control is not None:
            # before the measurements: of what comes together it is the first to be taken
            too_fast = functools.partial(carries_across, model, find_grid(config, model),
                                         seconds=config.kernel.time_step)
            self._inlets.append(ControlSource(config.control, model.inputs, ahead, too_fast,
                                              accounts.control))
        for name, source in config.measurements.sources.items():
            self._inlets.append(Source(name, source, filter_.sensors[name], ahead,
                                       accounts.sources[name]))
        for inlet in self._inlets:
            with _naming_topic(inlet):
                self._check(inlet)

    def listen(self) -> None:
        """Subscribe to all of it."""
        for inlet in self._inlets:
            with _naming_topic(inlet):
                self._node.create_subscription(
                    inlet.type, inlet.topic, functools.partial(self._on_message, inlet),
                    interface.measurement_qos(self._depth))
            inlet.account.off = functools.partial(self._refuses, inlet.prefix)
            inlet.account.there = functools.partial(self._there, inlet)
            if inlet.covariances and isinstance(inlet, Source):
                self._node.get_logger().info(
                    f'{inlet.name}: {", ".join(inlet.covariances)} is checked, not used: what '
                    f'counts is the noise of its sensor ({inlet.prefix}.params)')

    @guarded
    def _on_message(self, inlet: Source | ControlSource, msg: Any,
                    info: Mapping[str, Any]) -> None:
        account, now_ns = inlet.account, self._time.now()
        account.received += 1
        if lost := inlet.lost(info['publication_sequence_number'],
                              lambda: self._publishers(inlet)):
            account.lose(lost)
            self._node.report(f'{inlet.name}: lost', f'{inlet.name}: {lost} {inlet.what}s were '
                              'lost before they came here, such as in a full queue of DDS')
        was_off, inlet.off = inlet.off, self._refuses(inlet.prefix)
        if inlet.off:
            self._turn_away(inlet, now_ns, inlet.off != was_off)
            return
        try:
            item = inlet.item(msg, now_ns, self._arrival(info))
            if inlet.is_placed and msg.header.frame_id not in self._frames:
                self._warn_of_frame(inlet, msg.header.frame_id)
            if any(abs(item.values[i]) > TURN for i in inlet.angles):
                self._warn_of_turns(inlet, item.values)
        except Refused as refused:
            if now_ns is not None:
                account.traffic.arrive(now_ns)
            self._inbox.reject(inlet, refused.reason, str(refused))
            return
        except Exception:
            account.reject('fault')
            raise
        assert now_ns is not None
        account.traffic.arrive(now_ns, item.stamp_ns if inlet.is_stamped else None)
        alone = not self._inbox.has_work
        self._inbox.put(inlet, item)
        self._arrived(alone)

    def _turn_away(self, inlet: Inlet, now_ns: int | None, is_first: bool) -> None:
        """Count a message of a source that is not listened to; of many only the first is told."""
        if now_ns is not None:
            inlet.account.traffic.arrive(now_ns)
        inlet.account.reject(inlet.off)
        if is_first:
            self._node.report(f'{inlet.name}: {inlet.off}', f'{inlet.name}: it is {inlet.off}: '
                              f'its {inlet.what}s are counted, and not taken')

    def _warn_of_frame(self, inlet: Inlet, frame: str) -> None:
        """Tell once that what is measured is in another frame."""
        inlet.is_placed = False
        self._node.report(f'{inlet.name}: frame', f'{inlet.name}: header.frame_id: expected '
                          f'{self._frames[1]!r}, which is frame_id, got {frame!r}: it is taken as '
                          'it is, since nothing is transformed')

    def _warn_of_turns(self, inlet: Inlet, values: Sequence[float]) -> None:
        """Tell once that an angle is beyond a turn, as one in degrees soon is."""
        angles, inlet.angles = inlet.angles, ()
        self._node.report(f'{inlet.name}: turns', f'{inlet.name}: expected angles in radians, '
                          f'within {TURN:.2f} of 0, got {[values[i] for i in angles]}: they count '
                          'but for whole turns')

    def _check(self, inlet: Inlet) -> None:
        """Raise ValueError for a topic that is known to be of another type."""
        topic = self._node.resolve_topic_name(inlet.topic)
        if self._known.setdefault(topic, inlet.type) is not inlet.type:
            raise ValueError(f'its messages are of type {self._known[topic].__name__}')

    def _there(self, inlet: Inlet) -> str:
        """Say what is listened to, and who publishes there."""
        kinds = [info.topic_type
                 for info in self._node.get_publishers_info_by_topic(inlet.topic)]
        who = (f'{len(kinds)} publisher{"s" if len(kinds) > 1 else ""} there, of '
               f'{", ".join(sorted(set(kinds)))}' if kinds else 'nobody publishes there')
        return (f'nothing on {self._node.resolve_topic_name(inlet.topic)} ({inlet.type_name}); '
                f'{who}')

    def _publishers(self, inlet: Inlet) -> int:
        """Return how many publish what an inlet hears."""
        count: int = self._node.count_publishers(self._node.resolve_topic_name(inlet.topic))
        return count

    def _arrival(self, info: Mapping[str, Any]) -> int | None:
        """Return when a message arrived, None where the node does not live in that time."""
        return None if self._time.is_simulated else info.get('received_timestamp') or None


@contextmanager
def _naming_topic(inlet: Inlet) -> Iterator[None]:
    """Make of any error a ConfigError that names the topic."""
    try:
        yield
    except Exception as error:  # noqa: B902  rclpy's own have no common base
        raise ConfigError(f'{inlet.prefix}.topic: expected a topic for messages '
                          f'of type {inlet.type.__name__}, got {inlet.topic!r} '
                          f'({str(error).splitlines()[0]})') from None
