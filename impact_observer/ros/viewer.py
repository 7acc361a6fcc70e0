"""The viewer node as a process: ``ros2 run impact_observer viewer``."""

import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the viewer node; the README lists its parameters."""
    return run_node("viewer", "impact_observer.ros.viewer_node", "ViewerNode", args)


if __name__ == "__main__":
    sys.exit(main())
