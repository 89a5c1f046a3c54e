"""A node with a life of its own: what it needs is made when it is configured, and let go of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
import functools
from typing import Any

from lifecycle_msgs.srv import ChangeState
from pif_ros.config import ConfigError
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn


class ManagedNode(LifecycleNode, ABC):
    """
    Makes all of its topics, services and timers when it is configured, and is deaf unless active.

    managed: whether a lifecycle manager can ask it to.
    """

    def __init__(self, name: str, managed: bool, **kwargs: Any) -> None:
        super().__init__(name, enable_communication_interface=managed, **kwargs)
        self.is_made = self.is_active = False
        self._refusal: str | None = None
        self._before: list[Any] = []
        if managed:
            asked = self._service_change_state
            asked.callback = functools.partial(self._on_change_state, asked.callback)

    @abstractmethod
    def make(self) -> None:
        """Make all that the node needs; ConfigError where its parameters allow none."""

    @abstractmethod
    def finish(self) -> None:
        """Bring to an end what was made, if it was, before it is let go of."""

    @abstractmethod
    def report(self, kind: str, text: str) -> None:
        """Warn of something."""

    def start(self) -> None:
        """Configure and activate without being asked; raises ConfigError where that fails."""
        if self.trigger_configure() != TransitionCallbackReturn.SUCCESS:
            raise ConfigError(self._refusal or 'the node was not configured')
        self.trigger_activate()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Make the filter, and all topics and services; where there is none keep the reason."""
        before = self._entities()
        try:
            self.make()
        except Exception as error:  # noqa: B902  rclpy would swallow it
            self._destroy(before)
            self._refusal = str(error)
            if not isinstance(error, ConfigError):
                self._refusal = f'{type(error).__name__}: {error}'
            return TransitionCallbackReturn.FAILURE
        self._before, self.is_made = before, True
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Listen and publish; what was believed is believed still."""
        self.is_active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Neither listen nor publish; what waits is worked in."""
        self.is_active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Save what is to be kept, and let go of filter, topics and services."""
        self._release()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Do the same, from any state and for ever."""
        self._release()
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Let go of the node, and of its state machine, which keeps it on the graph otherwise."""
        super().destroy_node()
        self._state_machine.destroy_when_not_in_use()

    def _on_change_state(self, change: Callable[..., Any], request: ChangeState.Request,
                         response: ChangeState.Response) -> ChangeState.Response:
        """Do as a manager asks, and say why it fails; rclpy raises where there is no way there."""
        self._refusal = None
        try:
            answer: ChangeState.Response = change(request, response)
        except Exception as error:  # noqa: B902  RCLError has no public name
            wanted = request.transition.label or request.transition.id
            self.report('lifecycle', f'lifecycle: expected a transition from here, got {wanted!r} '
                        f'({str(error).split(", at ")[0]})')
            response.success = False
            return response
        if self._refusal is not None:
            self.get_logger().error(self._refusal)
        return answer

    def _release(self) -> None:
        try:
            self.finish()
        finally:
            self.is_active = False
            if self.is_made:
                self.is_made = False
                self._destroy(self._before)

    def _entities(self) -> list[Any]:
        return [*self.publishers, *self.subscriptions, *self.services, *self.timers, *self.guards]

    def _destroy(self, spared: list[Any]) -> None:
        """Destroy all topics, services and timers that were made since."""
        kept = set(map(id, spared))
        for kind, some in (('publisher', self.publishers), ('subscription', self.subscriptions),
                           ('service', self.services), ('timer', self.timers),
                           ('guard_condition', self.guards)):
            for entity in list(some):
                if id(entity) not in kept:
                    getattr(self, f'destroy_{kind}')(entity)
