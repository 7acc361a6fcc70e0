# SPDX-License-Identifier: Apache-2.0

r"""Write the files of a new rig: a model, its sensors, and a launch file; none is overwritten.

In a terminal it asks, unless parts are given:

    impact-observer new hammer --mass x1,1 --mass x2,1 --spring ground,x1,10,0.1 \
        --spring x1,x2,10,0.1 --force x2,4,2.5 --stop anvil,x2,above,0.5,0.7 --sensor anvil,/switch

A stop without a sensor gets a switch on the topic of its name.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.errors import UsageError
from impact_observer.plain_text import say

if TYPE_CHECKING:
    from impact_observer.new.parts import PartKind
    from impact_observer.new.rig import NewRig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    from impact_observer.new.parts import MODEL_KINDS, SENSOR
    from impact_observer.new.rig import COORDINATE_UNITS

    parser.add_argument(
        "name", metavar="NAME", type=Path, help="of the rig and its files, perhaps in a folder"
    )
    parser.add_argument(
        "--unit",
        choices=COORDINATE_UNITS,
        help="of the coordinates: m (default), or rad or deg of what turns: then kg stands for"
        " kg m^2, N for N m, N/m for N m/rad, and Ns/m for N m s/rad",
    )
    for kind in (*MODEL_KINDS, SENSOR):
        parser.add_argument(
            f"--{kind.name}",
            metavar="PART",
            action="append",
            default=[],
            help=f"{' or '.join(kind.forms)}: {kind.words('m')}; may be repeated",
        )


def run(args: argparse.Namespace) -> int:
    """Write the files, and say what their model means for an observer."""
    from impact_observer.cli.check_model import check
    from impact_observer.new.parts import MODEL_KINDS, SENSOR
    from impact_observer.new.rig import NewRig, complete, write

    rig, kinds = NewRig(args.name.name, unit=args.unit or "m"), (*MODEL_KINDS, SENSOR)
    if any(getattr(args, kind.name) for kind in kinds):
        for kind in kinds:
            for text in getattr(args, kind.name):
                rig = rig.with_part(kind, text)
    elif sys.stdin.isatty():
        say("The parts of the rig, one a line; an empty line goes on to the next kind.")
        rig = rig if args.unit else _with_unit(rig)
        for kind in MODEL_KINDS:
            rig = _asked(rig, kind)
        for stop in rig.stops_without_sensor:
            rig = _sensor_asked(rig, stop)
    files = write(complete(rig), args.name.parent)
    say(f"{', '.join(map(str, files))}: written\n")
    code = check(files[0])
    model, sensors, launch = files
    deviation = rig.deviation
    option = f" --deviation {deviation}" if deviation else ""
    observed = "--initial drawn:1 --law minimum-variance"
    parameter = f" -p initial_deviation:={deviation}" if deviation else ""
    epoch = " epoch:=NANOSECONDS" if rig.asks_for_epoch else ""
    say(f"""
Next, with a simulation in the place of the rig, then with its sensors. In a clone ./dev run stands
for impact-observer, and the nodes lie in .venv/bin:

    impact-observer simulate {model} --duration 30 -o {args.name}_bag
    impact-observer observe {args.name}_bag {observed}{option} -o {args.name}_estimate
    detector --ros-args -p sources:={sensors}{epoch and f" -p{epoch}"}
    observer --ros-args -p model:={model} -p law:=minimum-variance{parameter}
    ros2 launch {launch}{epoch}    # both nodes, where there is ROS 2 Jazzy""")
    return code


def _with_unit(rig: "NewRig") -> "NewRig":
    """The rig with the unit of its coordinates that the user gives."""
    from impact_observer.new.rig import COORDINATE_UNITS

    unit = ""
    while unit not in COORDINATE_UNITS:
        unit = _answer("unit: m of what moves along a line, rad or deg of what turns (m): ") or "m"
    return replace(rig, unit=unit)


def _asked(rig: "NewRig", kind: "PartKind") -> "NewRig":
    """The rig with the parts of a kind that the user gives, one a line."""
    say(f"\n{kind.name}: {kind.words(rig.unit)}")
    say(f"  {' or '.join(kind.forms)}, such as {kind.example}")
    while text := _answer(f"{kind.name} {len(rig.items(kind)) + 1} (empty: no more): "):
        rig = _tried(rig, kind, text)
    return rig


def _sensor_asked(rig: "NewRig", stop: str) -> "NewRig":
    """The rig with the sensor of a stop."""
    from impact_observer.new.parts import SENSOR

    say(f"\nsensor {SENSOR.words(rig.unit)}\n  TOPIC[,THRESHOLD]")
    while stop in rig.stops_without_sensor:
        rig = _tried(
            rig, SENSOR, f"{stop},{_answer(f'sensor of {stop} (/{stop}): ') or '/' + stop}"
        )
    return rig


def _tried(rig: "NewRig", kind: "PartKind", text: str) -> "NewRig":
    """The rig with a part, or without it and an explanation."""
    try:
        return rig.with_part(kind, text)
    except UsageError as error:
        say(str(error))
        return rig


def _answer(question: str) -> str:
    """A line of the user's."""
    try:
        return input(question).strip()
    except EOFError:
        raise UsageError("the input has ended: nothing is written") from None
