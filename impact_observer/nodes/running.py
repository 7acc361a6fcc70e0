"""Running one node as a process: arguments in, an orderly end, an exit code out."""

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from impact_observer.errors import ImpactObserverError
from impact_observer.nodes.session import Stop, require_ros

if TYPE_CHECKING:
    from rclpy.node import Node

_PATIENCE = 0.1
"""How long a signal may wait to be noticed, s."""


def run_node(name: str, make: "Callable[[], Node]", args: Sequence[str] | None = None) -> int:
    """Spin a node until Ctrl-C, SIGTERM, its own end or an error.

    Args:
        name: what errors call the process.
        make: makes the node; it may have an attribute ``done`` that ends it.
        args: the process's arguments with ``--ros-args``; None for ``sys.argv``.

    Returns:
        0 after an orderly end, also by a signal; 1 for a failure; 2 for wrong use.
    """
    try:
        require_ros()
        return _spin(make, args)
    except ImpactObserverError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_code


def _spin(make: "Callable[[], Node]", args: Sequence[str] | None) -> int:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.signals import SignalHandlerOptions

    with Stop() as stop:
        rclpy.init(
            args=None if args is None else list(args),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        node = None
        try:
            executor = SingleThreadedExecutor()
            node = make()
            _warn_of_unknown_parameters(node)
            executor.add_node(node)
            while rclpy.ok() and not stop.requested and not getattr(node, "done", False):
                executor.spin_once(timeout_sec=_PATIENCE)
        except ExternalShutdownException:
            return 0
        finally:
            if node is not None:
                node.destroy_node()
            rclpy.try_shutdown()
    return 0


def _warn_of_unknown_parameters(node: "Node") -> None:
    """A misspelt parameter is ignored by ROS; say so."""
    overrides = getattr(node, "_parameter_overrides", {})
    for name in overrides:
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            known = ", ".join(sorted(node.get_parameters_by_prefix("")))
            node.get_logger().warning(f"parameter {name} is not known; known are {known}")
