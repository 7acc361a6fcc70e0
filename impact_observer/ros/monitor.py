"""The monitor node as a process: ``ros2 run impact_observer monitor``."""

import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the monitor node; the README lists its parameters."""
    return run_node("monitor", "impact_observer.ros.monitor_node", "MonitorNode", args)


if __name__ == "__main__":
    sys.exit(main())
