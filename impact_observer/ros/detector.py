"""The detector node as a process: ``ros2 run impact_observer detector``."""

import sys
from collections.abc import Sequence

from impact_observer.ros.node_process import run_node


def main(args: Sequence[str] | None = None) -> int:
    """Run the detector node; the README lists its parameters."""
    return run_node("detector", "impact_observer.ros.detector_node", "DetectorNode", args)


if __name__ == "__main__":
    sys.exit(main())
