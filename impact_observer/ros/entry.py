# SPDX-License-Identifier: Apache-2.0
"""The nodes as processes: ``ros2 run impact_observer NAME``, or ``python -m`` this module."""

import argparse
import os
import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from itertools import takewhile
from textwrap import fill

from impact_observer.matrix_threads import one_matrix_thread
from impact_observer.plain_text import say
from impact_observer.process_end import Stop, end_with_parent, ends_within, run
from impact_observer.ros.parameters import TABLES
from impact_observer.ros.session import require_ros
from impact_observer.ros.wiring import FOLLOW

NODES = {
    "plant": "PlantNode",
    "detector": "DetectorNode",
    "observer": "ObserverNode",
    "monitor": "MonitorNode",
}
"""Class of each node in the module ``NAME_node``; docs/nodes.md lists the parameters."""
_JOBS = {
    "plant": "Simulates a system, and publishes its impacts and true states.",
    "detector": "Finds impacts in what switches and other sensors publish.",
    "observer": "Estimates the state of a system from its impacts.",
    "monitor": "Compares an estimate with the true state.",
}
_LONGEST_END = 2.0
"""Time from a signal until a process ends in the midst of its work, s."""
_HELP = """\
usage: {name} --ros-args -p PARAMETER:=VALUE ... [--params-file FILE] [-r NAME:=OTHER ...]

{job} Topics: docs/nodes.md.

parameters:
"""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node that the first argument names; the other arguments are for ROS."""
    parser = argparse.ArgumentParser(prog="impact_observer.ros.entry")
    parser.add_argument("node", choices=NODES)
    parser.add_argument("ros_args", nargs=argparse.REMAINDER, metavar="--ros-args ...")
    given = parser.parse_args(args)
    return _run(given.node, given.ros_args)


def _help(name: str) -> str:
    """What ``--help`` of a node prints."""
    lines = [_HELP.format(name=name, job=_JOBS[name])]
    for each in TABLES[name]:
        meaning = fill(each.description, 94, initial_indent="      ", subsequent_indent="      ")
        lines += [f"  {each.name} ({each.type})", meaning]
    return "\n".join(lines)


def _run(name: str, args: Sequence[str] | None = None) -> int:
    """Run a node until Ctrl-C, SIGTERM, its own end or an error.

    Signals are handled from before the heavy imports on, so that an early signal ends the process
    without a traceback, too.

    Returns:
        0 after an orderly end, also by a signal; 1 for a failure; 2 for wrong use. Work that goes
        on for 2 s after a signal is ended, with 128 and the number of the signal.
    """
    given = sys.argv[1:] if args is None else args
    if not {"-h", "--help"}.isdisjoint(takewhile("--ros-args".__ne__, given)):
        say(_help(name))
        return 0

    def job() -> int:
        with Stop() as stop, ends_within(_LONGEST_END):
            end_with_parent(int(os.environ.get(FOLLOW, "0")))
            require_ros()
            one_matrix_thread()  # before numpy is imported
            from impact_observer.ros.base_node import spin

            node_class = getattr(import_module(f"impact_observer.ros.{name}_node"), NODES[name])
            spin(stop, node_class, given)
        return 0

    return run(name, job, own=args is None)


plant, detector, observer, monitor = (partial(_run, name) for name in NODES)

if __name__ == "__main__":
    sys.exit(main())
