# SPDX-License-Identifier: Apache-2.0
"""ROS in a command: the check that ROS is installed, one node, and spinning."""

import os
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError
from impact_observer.plain_text import printable

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node

_DOMAIN = "ROS_DOMAIN_ID"
_LAST_DOMAIN = 232
"""Largest domain for which Fast DDS has ports."""


def require_ros() -> None:
    """Check that ROS 2 is installed, and that the domain is valid.

    Raises:
        UsageError: ``rclpy`` cannot be imported, or ``ROS_DOMAIN_ID`` is no domain.
    """
    domain = os.environ.get(_DOMAIN, "")
    if domain and not (domain.isascii() and domain.isdigit() and int(domain) <= _LAST_DOMAIN):
        raise UsageError(
            f"{_DOMAIN}: {domain[:40]} found; expected a whole number from 0 to {_LAST_DOMAIN}"
        )
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
    context.init(args=[])  # by default ROS would read the arguments of the command
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
