# SPDX-License-Identifier: Apache-2.0
"""ROS in a command: the check that ROS can be used, one node, and spinning."""

import os
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError
from impact_observer.plain_text import printable
from impact_observer.ros.environment import SECURITY, check_environment, security_warning

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

_LOG_FAULT = "failed to initialize logging: "
"""Begin of the error of ROS when no folder of logs can be made."""


def require_ros(args: Sequence[str] = ()) -> None:
    """Check that ROS 2 is installed, and that its environment variables can be used.

    Args:
        args: the arguments of a node.

    Raises:
        UsageError: ``rclpy`` cannot be imported, or a variable has a value that ROS cannot use.
    """
    check_environment(args)
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
        if reason.startswith(_LOG_FAULT):
            fault = reason.removeprefix(_LOG_FAULT).partition(", at /")[0]
            expected = "expected a folder that can be written (ROS_LOG_DIR)"
            raise UsageError(f"the log of ROS: {fault}; {expected}") from None
        if os.environ.get(SECURITY) == "true":
            raise UsageError(
                f"{SECURITY} is true, but no secure node can be made: {reason};"
                " docs/security.md says what it needs"
            ) from None
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
        if warning := security_warning():
            node.get_logger().warning(printable(warning))
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        try:
            yield node, executor
        finally:
            executor.shutdown()
            node.destroy_node()
    finally:
        context.try_shutdown()


def spin_once(
    executor: "SingleThreadedExecutor", node: "Node", timeout: float | None = None
) -> None:
    """Spin ``executor`` once; warn of a time before zero on ``/clock``, and ignore that time.

    Args:
        executor: the executor of ``node``.
        node: the node that logs the warning.
        timeout: longest time to wait for work, s; None for any time.
    """
    try:
        executor.spin_once(timeout_sec=timeout)
    except (ValueError, OverflowError) as error:
        frames = traceback.walk_tb(error.__traceback__)
        if all(frame.f_globals.get("__name__") != "rclpy.time_source" for frame, _ in frames):
            raise
        node.get_logger().warning(
            printable(f"/clock: a time that is none is ignored ({error})"),
            throttle_duration_sec=5.0,
        )
