"""Running one node as a process: arguments in, an orderly end, an exit code out."""

import ctypes
import faulthandler
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import TYPE_CHECKING

from impact_observer.errors import ImpactObserverError, UsageError
from impact_observer.ros.session import Stop, require_ros

if TYPE_CHECKING:
    from rclpy.node import Node

FOLLOW = "IMPACT_OBSERVER_FOLLOW"
"""Environment variable with the process whose end, however it comes, is to be this one's too."""
_PR_SET_PDEATHSIG = 1
_LAST_RESORT = 5.0
"""How long the middleware may take to shut down before the process ends without it, s."""
_PATIENCE = 0.1
"""How long a signal may wait to be noticed, s."""


def run_node(name: str, module: str, node_class: str, args: Sequence[str] | None = None) -> int:
    """Spin a node until Ctrl-C, SIGTERM, its own end or an error.

    Signals are noted before anything heavy is imported: one that comes early ends the process
    as quietly as a late one.

    Args:
        name: what errors call the process.
        module: where the node's class is.
        node_class: the class; an attribute ``done`` of its instance ends it.
        args: the process's arguments with ``--ros-args``; None for ``sys.argv``.

    Returns:
        0 after an orderly end, also by a signal; 1 for a failure; 2 for wrong use.
    """
    try:
        with Stop() as stop:
            _follow(os.environ.get(FOLLOW))
            require_ros()
            _spin(stop, module, node_class, args)
    except ImpactObserverError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def _follow(process: str | None) -> None:
    """Be terminated when ``process``, if it is the parent, dies (Linux)."""
    if process == str(os.getppid()):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _spin(stop: Stop, module: str, node_class: str, args: Sequence[str] | None) -> None:
    import rclpy
    from rclpy.executors import ExternalShutdownException

    from impact_observer.ros.executor import DirectExecutor

    # Before numpy is imported: threads for small matrices only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    make = getattr(import_module(module), node_class)
    node = executor = None
    try:
        node = _started(make, args)
        executor = DirectExecutor()
        executor.add_node(node)
        while rclpy.ok() and not stop.requested and not getattr(node, "done", False):
            executor.spin_once(timeout_sec=_PATIENCE)
    except ExternalShutdownException:
        return
    except KeyboardInterrupt:
        if node is not None:
            raise
    finally:
        # Seen once in some fifty ends, when many nodes left at once: Fast DDS never came back.
        faulthandler.dump_traceback_later(_LAST_RESORT, exit=True)
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()


def _started(make: "type[Node]", args: Sequence[str] | None) -> "Node":
    """The node, or one line about the arguments that ROS cannot read.

    Raises:
        UsageError: after ``--ros-args`` stands something that is no argument of ROS.
    """
    import rclpy
    from rclpy.exceptions import ParameterException
    from rclpy.impl.implementation_singleton import rclpy_implementation
    from rclpy.signals import SignalHandlerOptions

    try:
        rclpy.init(
            args=None if args is None else list(args),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        node = make()
    except (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError) as error:
        raise UsageError(f"--ros-args: not understood: {str(error).splitlines()[0]}") from None
    except ParameterException as error:
        raise UsageError(f"parameters: {' '.join(str(error).split())}") from None
    _warn_of_unknown_parameters(node)
    return node


def _warn_of_unknown_parameters(node: "Node") -> None:
    """A misspelt parameter is ignored by ROS; say so."""
    for name in getattr(node, "_parameter_overrides", {}):
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            known = ", ".join(sorted(node.get_parameters_by_prefix("")))
            node.get_logger().warning(f"parameter {name} is not known; known are {known}")
