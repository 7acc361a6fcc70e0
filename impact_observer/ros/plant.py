"""The plant node as a process: ``ros2 run impact_observer plant``."""

import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the plant node; the README lists its parameters."""
    return run_node("plant", "impact_observer.ros.plant_node", "PlantNode", args)


if __name__ == "__main__":
    sys.exit(main())
