# SPDX-License-Identifier: Apache-2.0
"""ROS in a command: the check that ROS can be used, and one node."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

_SECURITY, _STRATEGY = "ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY"


def require_ros() -> None:
    """Check that ROS 2 is installed, and that security is enforced if security is asked for.

    ROS runs without security, and without a message, where these words are spelt otherwise.

    Raises:
        UsageError: ``rclpy`` cannot be imported, or ROS would run without security.
    """
    asked = os.environ.get(_SECURITY, "")
    if asked not in {"", "false"}:
        for name, wanted in ((_SECURITY, "true"), (_STRATEGY, "Enforce")):
            if (found := os.environ.get(name, "")) != wanted:
                found = f"{found or 'nothing'} found with {_SECURITY}={asked}"
                raise UsageError(f"{name}: {found}; expected {wanted}")
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"this command needs ROS 2 ({error}); source Jazzy, or run ./dev setup"
        ) from error


@contextmanager
def refusals_of_ros(what: str = "ROS") -> Iterator[None]:
    """Within the block, an error with which ROS refuses to begin becomes one line.

    Args:
        what: begin of the line of an error without a known cause.

    Raises:
        UsageError: naming the cause.
    """
    import rclpy
    from rclpy.exceptions import ParameterException

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # from a node that cannot be made
            yield
    except ParameterException as error:
        raise UsageError(f"parameters: {' '.join(str(error).split())}") from None
    except RuntimeError as error:
        # The classes that rclpy raises here have no public names.
        if type(error).__module__.partition(".")[0] != rclpy.__name__:
            raise
        reason = str(error).splitlines()[0]
        raise UsageError(f"{what}: {reason}") from None


@contextmanager
def ros_node(
    name: str, *, use_sim_time: bool = False
) -> Iterator[tuple["Node", "SingleThreadedExecutor"]]:
    """Make a node and an executor in a ROS context of their own, until the block ends.

    ``rclpy`` installs no signal handlers for such a context; ``process_end.Stop`` does.

    Args:
        name: name of the node.
        use_sim_time: whether the clock of the node follows ``/clock``.
    """
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter

    context = Context()
    with refusals_of_ros():
        context.init(args=[])  # by default ROS would read the arguments of the command
    try:
        with refusals_of_ros():
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
