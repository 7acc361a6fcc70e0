# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Detect the impacts in a bag of sensors: switches, accelerations, forces, or any messages.

The sensors are declared in a file, --sources; a single one by --contact and --topic:

    impact-observer detect BAG --contact stop --topic /switch -o OUT
    impact-observer detect BAG --contact stop --topic /imu --threshold 30 -o OUT
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import add_bag_output, add_model, stamp

if TYPE_CHECKING:
    from impact_observer.detector import SensorCounts, Source

_TEXTS = {
    "contact": "name of the contact in the model",
    "topic": "where its sensor publishes",
    "kind": "switch, peak or arrival (default: as the type of the topic says)",
    "field": "path in the message, such as wrench.force.z or data[3]",
    "direction": "of peaks: both (default), up or down",
    "stamp": "header or receive (default: the header's where there is one)",
}
_NUMBERS = {
    "threshold": "where a switch closes, or a peak begins; in the field's own unit",
    "hysteresis": "how far below that a switch opens, or a peak ends",
    "baseline": "time constant of the mean that is subtracted, s",
    "dead_time": "time after an event in which there is no other, s",
    "latency": "constant latency, which is subtracted from the stamps, s",
    "min_contact_duration": "least closed time of a switch in persistent contact (default 0.05 s)",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    add = parser.add_argument
    add("bag", metavar="BAG", type=Path, help="a bag of sensors")
    add("--sources", metavar="FILE", type=Path, help="the sensors, docs/detector.md")
    for name, meaning in _TEXTS.items():
        add(_option(name), metavar=name.upper(), help=meaning)
    for name, meaning in _NUMBERS.items():
        add(_option(name), metavar="X", type=float, help=meaning)
    add("--inverted", action="store_true", default=None, help="the switch is closed when low")
    add_model(parser, "a model file or a sample, to be put into the bag")
    add("--epoch", metavar="S", type=stamp, help="stamp of t = 0 (default: unknown)")
    add_bag_output(parser)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def run(args: argparse.Namespace) -> int:
    """Write a bag with the impacts detected in another one."""
    from impact_observer.cli.progress import Progress
    from impact_observer.detector.bag_detection import detect_bag
    from impact_observer.io.reader import BagReader
    from impact_observer.model import read_model

    sources, epoch = _sources(args), args.epoch or 0
    model = None if args.model is None else read_model(args.model)
    with BagReader(args.bag) as reader, Progress() as progress:

        def show(done: int, total: int) -> None:
            progress.step("detecting", done, total)

        result = detect_bag(
            reader,
            sources,
            args.output,
            model=model,
            epoch=epoch,
            flush=args.flush,
            progress=show,
        )
        for source, counts in zip(result.sources, result.counts, strict=True):
            found = _found(counts)
            progress.line(f"{source.contact}: {found} ({source.topic}, {source.kind})")
        progress.line(f"{args.output}: {result.events} events")
        if result.problems:
            progress.line(f"note: {'; '.join(result.problems)}")
    return 0


def _sources(args: argparse.Namespace) -> "tuple[Source, ...]":
    """The sensors of a file, or the one that the options declare."""
    from impact_observer.detector import Source, read_sources
    from impact_observer.errors import UsageError

    names = (*_TEXTS, *_NUMBERS, "inverted")
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if args.sources is not None:
        if given:
            option = _option(next(iter(given)))
            raise UsageError(f"{option}: given beside --sources; write it into {args.sources}")
        return read_sources(args.sources)
    if args.contact is None or args.topic is None:
        raise UsageError("no sensor named; give --sources, or --contact and --topic")
    return (Source(**given),)


def _found(counts: "SensorCounts") -> str:
    """How many impacts were detected, in words."""
    impacts = f"{counts.impacts} impact{'' if counts.impacts == 1 else 's'}"
    return f"{impacts}, {counts.closings} of them persistent" if counts.closings else impacts
