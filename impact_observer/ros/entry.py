# SPDX-License-Identifier: Apache-2.0
"""The nodes as processes: ``ros2 run impact_observer NAME``, or ``python -m`` this module."""

import argparse
import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node

NODES = {
    "plant": "PlantNode",
    "detector": "DetectorNode",
    "observer": "ObserverNode",
    "monitor": "MonitorNode",
    "viewer": "ViewerNode",
}
"""Class of each node in the module ``NAME_node``; docs/parameters.md lists the parameters."""


def plant(args: Sequence[str] | None = None) -> int:
    """Run the plant node."""
    return _run("plant", args)


def detector(args: Sequence[str] | None = None) -> int:
    """Run the detector node."""
    return _run("detector", args)


def observer(args: Sequence[str] | None = None) -> int:
    """Run the observer node."""
    return _run("observer", args)


def monitor(args: Sequence[str] | None = None) -> int:
    """Run the monitor node."""
    return _run("monitor", args)


def viewer(args: Sequence[str] | None = None) -> int:
    """Run the viewer node."""
    return _run("viewer", args)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node that the first argument names; the other arguments are for ROS."""
    parser = argparse.ArgumentParser(prog="impact_observer.ros.entry")
    parser.add_argument("node", choices=NODES)
    parser.add_argument("ros_args", nargs=argparse.REMAINDER, metavar="--ros-args ...")
    given = parser.parse_args(args)
    return _run(given.node, given.ros_args)


def _run(name: str, args: Sequence[str] | None) -> int:
    return run_node(name, f"impact_observer.ros.{name}_node", NODES[name], args)


if __name__ == "__main__":
    sys.exit(main())
