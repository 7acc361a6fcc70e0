"""A process that uses ROS without being a node of the package: one node, and its end."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node


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


@contextmanager
def ros_node(
    name: str, *, use_sim_time: bool = False
) -> Iterator[tuple["Node", "SingleThreadedExecutor"]]:
    """A node in a context of its own, with an executor; both end with the block.

    ``rclpy`` installs no signal handlers for such a context;
    ``process_end.Stop`` does.

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
