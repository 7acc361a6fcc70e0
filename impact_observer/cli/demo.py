# SPDX-License-Identifier: Apache-2.0
"""Plant, two observers and their monitors as ROS 2 processes: recorded, compared, drawn.

The observers receive the plant's impact times only, and start from a wrong state.
"""

import argparse
import time
from pathlib import Path

from impact_observer.cli.arguments import positive
from impact_observer.cli.progress import Progress
from impact_observer.plain_text import say

GOAL = 1e-2
"""Largest final V/V0 of the geometric law."""
RATE = 100.0
"""Of true states and estimates, Hz."""
LAWS = ("geometric", "kinematic")
INITIAL_STATE = "random:1"
"""Of the observers."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument(
        "--model", metavar="MODEL", default="two_mass", help="a model file or a sample (two_mass)"
    )
    parser.add_argument(
        "--duration", metavar="S", type=positive, default=30.0, help="simulated, s (default 30)"
    )
    parser.add_argument(
        "--realtime-factor",
        metavar="F",
        type=positive,
        default=2.0,
        help="simulated seconds a second (default 2)",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        type=Path,
        help="for bag, picture and logs (default demo_DATE_TIME)",
    )


def run(args: argparse.Namespace) -> int:
    """Run the demonstration and check its result.

    Returns:
        0 if the geometric law ends at ``V/V0 <= GOAL``, 1 otherwise.
    """
    from impact_observer.model import read_model
    from impact_observer.ros.session import require_ros

    require_ros()
    read = read_model(args.model)
    read.initial_state()
    from impact_observer.ros import demonstration
    from impact_observer.ros.wiring import DemoSetup

    folder = args.output or Path(time.strftime("demo_%Y%m%d_%H%M%S"))
    setup = DemoSetup(
        args.model,
        LAWS,
        INITIAL_STATE,
        args.duration,
        args.realtime_factor,
        RATE,
        epoch=time.time_ns(),
    )
    with Progress() as progress:
        progress.line(f"{read.system.name}: plant, {len(LAWS)} observers, {len(LAWS)} monitors")
        progress.show("starting the processes")
        bag = demonstration.run(
            setup,
            folder,
            lambda now: progress.step("simulated time", now, args.duration),
        )
    return check_result(bag, folder / "lyapunov.png")


def check_result(bag: Path, picture: Path) -> int:
    """Compare, draw, and check the geometric law: the exit code of the demonstration."""
    from matplotlib.figure import Figure

    from impact_observer.compare.bag_comparison import compare_bag, labelled_by_law
    from impact_observer.compare.distance_picture import distance_picture
    from impact_observer.compare.error_tables import print_tables
    from impact_observer.draw.motion_picture import chosen_coordinates, motion_picture
    from impact_observer.draw.pictures import save
    from impact_observer.draw.recorded_motion import read_motion
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import model_of

    with BagReader(bag) as reader:
        result = compare_bag(reader, model_of(reader).system)
        motion = read_motion(reader)
    results = [(bag, result)]
    labelled = labelled_by_law(results)
    print_tables(labelled)
    chosen = chosen_coordinates(motion, None)
    heights = 2.0 + 1.5 * len(chosen), 5.0
    drawn = Figure(figsize=(10.0, sum(heights)), layout="constrained")
    above, below = drawn.subfigures(2, squeeze=False, height_ratios=heights)[:, 0]
    motion_picture(motion, chosen, above)
    distance_picture(labelled, results, below)
    save(drawn, picture)
    say(f"picture: {picture}\nbag:     {bag}")
    ratio = labelled[LAWS[0]].ratio
    if ratio is None:
        say(f"{LAWS[0]}: V/V0 is undefined: the observer started at the plant's own state")
        return 1
    verdict = "as wanted" if ratio <= GOAL else "too much"
    say(f"{LAWS[0]}: V/V0 ended at {ratio:.2e}, {verdict}: the goal is {GOAL:g}")
    return 0 if ratio <= GOAL else 1
