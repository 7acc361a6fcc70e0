# SPDX-License-Identifier: Apache-2.0
"""Running one node as a process: arguments in, an orderly end, an exit code out."""

import faulthandler
import gc
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import pairwise
from typing import TYPE_CHECKING

from impact_observer.errors import UnsetError, UsageError
from impact_observer.matrix_threads import one_matrix_thread
from impact_observer.process_end import Stop, end_with_parent, ends_within, run
from impact_observer.ros.session import refusals_of_ros, require_ros
from impact_observer.ros.wiring import FOLLOW

if TYPE_CHECKING:
    from rclpy.executors import SingleThreadedExecutor

    from impact_observer.ros.base_node import BaseNode

_SHUTDOWN_TIMEOUT = 5.0
"""How long the middleware may take to shut down before the process ends without it, s."""
_OBJECTS = 10_000, 20, 20
"""New objects after which the youngest are searched for garbage, and ratios for older ones."""
_SIGNAL_PERIOD = 0.1
"""Longest time until a signal is noticed, s."""
_LONGEST_END = 2.0
"""Time from a signal until a process ends in the midst of its work, s."""


def run_node(name: str, module: str, node_class: str, args: Sequence[str] | None = None) -> int:
    """Spin a node until Ctrl-C, SIGTERM, its own end or an error.

    Signals are handled from before the heavy imports on, so that an early signal ends the process
    without a traceback, too.

    Args:
        name: the process's name in error lines.
        module: the module of the node's class.
        node_class: the class; the process ends when the attribute ``done`` of the node is true.
        args: the process's arguments with ``--ros-args``; None for ``sys.argv``.

    Returns:
        0 after an orderly end, also by a signal; 1 for a failure; 2 for wrong use. Work that goes
        on for 2 s after a signal is ended, with 128 and the number of the signal.
    """

    def job() -> int:
        with Stop() as stop, ends_within(_LONGEST_END):
            end_with_parent(int(os.environ.get(FOLLOW, "0")))
            given = sys.argv[1:] if args is None else args
            require_ros()
            _spin(stop, module, node_class, given)
        return 0

    return run(name, job, own=args is None)


def _spin(stop: Stop, module: str, node_class: str, args: Sequence[str]) -> None:
    """Make the node, and spin the node until the end."""
    # Not EventsExecutor: in rclpy 7.1.6 an event of the middleware (incompatible quality of
    # service) ends its spinning with a SystemError.
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

    one_matrix_thread()  # before numpy is imported
    make: Callable[[], BaseNode] = getattr(import_module(module), node_class)
    node = executor = None
    try:
        node = _make_node(make, args)
        _collect_rarely()
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while rclpy.ok() and not stop.requested and not getattr(node, "done", False):
            _spin_once(executor, node)
    except ExternalShutdownException:
        return
    except KeyboardInterrupt:
        if node is not None:
            raise
    finally:
        # Fast DDS was once seen to hang when many nodes left at the same time.
        faulthandler.dump_traceback_later(_SHUTDOWN_TIMEOUT, exit=True)
        if executor is not None:
            executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        faulthandler.cancel_dump_traceback_later()


def _spin_once(executor: "SingleThreadedExecutor", node: "BaseNode") -> None:
    """Spin a node once; the node takes note of an error.

    rclpy converts requests and messages outside of callbacks, so that no callback could guard
    against what others send.
    """
    from rclpy.executors import ExternalShutdownException

    try:
        executor.spin_once(timeout_sec=_SIGNAL_PERIOD)
    except ExternalShutdownException:
        raise
    except Exception as error:
        if isinstance(error, node.ends_by):
            raise
        node.note_error(error)


def _collect_rarely() -> None:
    """Search what has been imported for garbage once, and the rest less often than by default.

    A search of everything takes 80 ms, in which no message is taken.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(*_OBJECTS)


def _make_node(make: "Callable[[], BaseNode]", args: Sequence[str]) -> "BaseNode":
    """Make the node.

    Raises:
        UsageError: ``--ros-args`` is followed by something that ROS does not accept.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    try:
        with refusals_of_ros("--ros-args: not understood"):
            rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
        with refusals_of_ros():
            node = make()
    except UnsetError as error:
        raise UsageError(f"{error}: give --ros-args -p {error.option}:=FILE") from None
    _warn_of_unknown_parameters(node, args)
    return node


def _warn_of_unknown_parameters(node: "BaseNode", args: Sequence[str]) -> None:
    """Warn of misspelt parameters, which ROS ignores: in the log and on ``/diagnostics``."""
    lines = [*_unknown_parameters(node, args)]
    for line in lines:
        node.lines.warning(line)
    node.doubts = "; ".join(lines)


def _unknown_parameters(node: "BaseNode", args: Sequence[str]) -> Iterator[str]:
    """A line for each parameter that the arguments give and ``node`` has not declared."""
    for name in dict.fromkeys(_given_parameters(node, args)):
        if not node.has_parameter(name) and not name.startswith("qos_overrides."):
            declared = ", ".join(sorted(node.get_parameters_by_prefix("")))
            yield f"parameter {name} does not exist and is ignored; expected {declared}"


def _given_parameters(node: "BaseNode", args: Sequence[str]) -> Iterator[str]:
    """Names of the parameters that the arguments give to ``node``.

    The arguments are read here, as rclpy knows only parameters that a node has declared.
    """
    from rclpy.parameter import parameter_dict_from_yaml_file

    for option, value in pairwise(args):
        if option in {"-p", "--param"}:
            target, _, name = value.partition(":=")[0].rpartition(":")
            if target in {"", node.get_name()}:
                yield name
        elif option == "--params-file":
            full = node.get_fully_qualified_name()
            for target in ("/**", full, full.lstrip("/")):
                with suppress(RuntimeError):  # the file has no parameters for that target
                    yield from parameter_dict_from_yaml_file(value, target_nodes=[target])
