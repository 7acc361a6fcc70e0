"""The observer node as a process: ``ros2 run impact_observer observer``."""

import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the observer node; the README lists its parameters."""
    return run_node("observer", "impact_observer.ros.observer_node", "ObserverNode", args)


if __name__ == "__main__":
    sys.exit(main())
