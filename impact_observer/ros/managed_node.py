# SPDX-License-Identifier: Apache-2.0
"""The base class of nodes with a life cycle: configured, activated, paused and cleaned up."""

from abc import ABC, abstractmethod
from collections.abc import Callable

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher

from impact_observer.io.messages import AnyMessage
from impact_observer.options import Option
from impact_observer.process_end import one_line
from impact_observer.ros.base_node import BaseNode

_SUCCESS = TransitionCallbackReturn.SUCCESS
_LONGEST = 40
"""Characters of the name of a transition that are logged."""


class ManagedNode(LifecycleNodeMixin, BaseNode, ABC):
    """A node that configures and activates itself, unless ``autostart`` is false.

    An inactive node goes on receiving, and ``publish`` publishes nothing.

    Attributes:
        done: whether the node's process is to end.
        is_configured: whether the node is inactive or active.
        is_active: whether the node publishes.
    """

    def __init__(self, name: str, table: tuple[Option, ...]) -> None:
        """Declare the parameters of ``table``; configure and activate the node by ``autostart``.

        Raises:
            UsageError: a parameter is of the wrong type, out of range, or missing; or the node
                cannot be configured.
        """
        BaseNode.__init__(self, name, table)
        LifecycleNodeMixin.__init__(self)
        self._lasting |= self._entities().keys()
        self.done = self.is_configured = self.is_active = False
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        self._failures: list[Exception] = []
        if self.values.flag("autostart"):
            self.trigger_configure()
            if self._failures:
                self.destroy_node()
                raise self._failures[0]
            self.trigger_activate()

    @abstractmethod
    def configure(self) -> None:
        """Read the files that parameters name, and make topics, services and timers.

        Raises:
            UsageError: a parameter does not suit the others.
        """

    def publish(
        self, publisher: Publisher, convert: Callable[..., AnyMessage], *values: object
    ) -> AnyMessage | None:
        """Publish ``convert(*values)`` if the node is active; see ``BaseNode``."""
        return super().publish(publisher, convert, *values) if self.is_active else None

    def on_configure(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Begin anew; an error is logged, and the node stays unconfigured."""
        try:
            self.configure()
        except Exception as error:  # noqa: BLE001 (rclpy would hide the error)
            self._forget()
            return self.refuse(error)
        self.is_configured = True
        return _SUCCESS

    def on_activate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Publish from now on."""
        self.is_active = True
        return _SUCCESS

    def on_deactivate(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Pause: keep the state, and publish nothing."""
        self.is_active = False
        return _SUCCESS

    def on_cleanup(self, _: LifecycleState) -> TransitionCallbackReturn:
        """Forget everything but the parameters."""
        self._forget()
        return _SUCCESS

    def on_shutdown(self, _: LifecycleState) -> TransitionCallbackReturn:
        """End the process."""
        self._forget()
        self.done = True
        return _SUCCESS

    def destroy_node(self) -> None:
        """Destroy the node, and the state machine, which would keep the node on the graph."""
        super().destroy_node()
        self.__dict__.pop("_state_machine", None)

    def refuse(self, why: Exception) -> TransitionCallbackReturn:
        """Let a transition fail; who asked for it finds the line of ``why`` in the log."""
        self._failures = [why]
        return TransitionCallbackReturn.FAILURE

    def _forget(self) -> None:
        """Destroy what ``configure`` made, and what was made later in its callbacks."""
        self.is_configured = self.is_active = False
        self.diagnose(tuple)
        if self._jump is not None:
            self._jump.unregister()
            self._jump = None
        for each, destroy in self._entities().items():
            if each not in self._lasting:
                destroy(each)

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Make a transition; rclpy would end the node at one that is not possible."""
        state = self._state_machine.current_state[1]
        self._failures.clear()
        try:
            response = self._change_state(request, response)
        except Exception:  # noqa: BLE001 (a request must not end the node)
            response.success = False
        if not response.success:
            transition = request.transition.label[:_LONGEST] or request.transition.id
            why = one_line(self._failures[0]) if self._failures else f"the node is {state}"
            self.lines.error(f"transition {transition} failed: {why}")
        return response
