"""Starting and ending a process that uses ROS: one node, and an orderly stop."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, final

from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

_SIGNALS = (signal.SIGINT, signal.SIGTERM)


def require_ros() -> None:
    """Raise an error of one line where ROS 2 is not installed.

    Raises:
        UsageError: ``rclpy`` cannot be imported.
    """
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"this command needs ROS 2 ({error}); source Jazzy, or run ./dev setup"
        ) from error


@final
class Stop:
    """Whether SIGINT (Ctrl-C) or SIGTERM has asked the process to end; a context manager.

    The first signal only sets ``requested``, so that work is finished in order; a second one
    raises ``KeyboardInterrupt``. Outside the main thread, which receives signals, it does nothing.

    Attributes:
        requested: whether a signal has come.
    """

    def __init__(self) -> None:
        self.requested = False
        self._previous: dict[signal.Signals, signal._HANDLER] = {}

    def __enter__(self) -> "Stop":
        if threading.current_thread() is threading.main_thread():
            self._previous = {each: signal.signal(each, self._handle) for each in _SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for each, handler in self._previous.items():
            signal.signal(each, handler)

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def ros_node(
    name: str, *, use_sim_time: bool = False
) -> Iterator[tuple["Node", "SingleThreadedExecutor"]]:
    """A node in a context of its own, with an executor; both end with the block.

    ``rclpy`` installs no signal handlers for such a context; :class:`Stop` does.

    Args:
        name: the node's name.
        use_sim_time: whether its clock follows ``/clock``.
    """
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    context = Context()
    context.init(args=[])  # otherwise ROS reads the command's arguments
    try:
        node = Node(
            name,
            context=context,
            parameter_overrides=[Parameter("use_sim_time", value=use_sim_time)],
            start_parameter_services=False,
        )
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown()
            node.destroy_node()
    finally:
        context.try_shutdown()
