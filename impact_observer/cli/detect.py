# SPDX-License-Identifier: Apache-2.0
"""Detect the impacts in a bag of sensors, or in a signal: a CSV with a column time, or a sound.

The sensors are declared in a file, --sources; a single one by --contact and --topic. The topic of
a signal is its column, or its channel (channel1); a single one need not be named.

    impact-observer detect BAG --contact stop --topic /switch -o OUT
    impact-observer detect BAG --contact stop --topic /imu --threshold 30 -o OUT
    impact-observer detect acc.csv --contact stop --topic az --threshold 30 --baseline 1 -o OUT
    impact-observer detect sound.wav --contact stop --threshold 0.1 -o OUT
"""

import argparse
import re
from typing import TYPE_CHECKING

from impact_observer.cli.arguments import PART, TABLE, add_shared, table_form
from impact_observer.cli.progress import Progress
from impact_observer.draw.reports import TextTable, print_table
from impact_observer.errors import UsageError
from impact_observer.output_files import PICTURES

if TYPE_CHECKING:
    from collections.abc import Mapping

    from impact_observer.detector import Source
    from impact_observer.detector.bag_detection import BagDetection
    from impact_observer.model import Model

_TEXTS = {
    "contact": "name of the contact in the model (default: the only one of --model)",
    "topic": "where its sensor publishes; of a signal, its column (default: the only one)",
    "field": "path in the message, such as wrench.force.z or data[3]",
    "instant": "of peaks, what the stamp is of: top (default), or onset, the first top",
}
_NUMBERS = {
    "threshold": "where a switch closes, or a peak begins; in the field's own unit",
    "baseline": "time constant of the mean that is subtracted, s",
    "dead_time": "time after an event in which there is no other, s (default: of a peak 0.02, of a"
    " switch 0.005, of an arrival 0)",
    "decay": "time constant of the ringing after a peak, s: a peak counts only if it is 1.5 times"
    " higher than what is left of the one before (default 0: any peak counts)",
    "latency": "constant latency, which is subtracted from the stamps, s; may be negative",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    signal = "a bag of sensors, or a signal: .csv, .txt, .tsv, .dat, .wav, .flac, .ogg"
    add_shared(parser, "bag", "sources", bag=signal)
    for name, meaning in _TEXTS.items():
        parser.add_argument(_option(name), metavar=name.upper(), help=meaning)
    for name, meaning in _NUMBERS.items():
        parser.add_argument(_option(name), metavar="X", type=float, help=meaning)
    model = "a model file or a sample, to be put into the bag"
    epoch = "stamp of t = 0 (default: unknown; of a signal, that of the file's time 0)"
    plot = "the signals with thresholds, impacts and dead times"
    add_shared(parser, "model", "epoch", *PART, "plot", model=model, epoch=epoch, plot=plot)
    pulses = (
        "index pulses of a drive, of which the first is the epoch: a topic of Header (default:"
    )
    pulses += " /phase_reference), or the column of a signal whose rising edges they are"
    parser.add_argument("--pulses", metavar="TOPIC", help=pulses)
    parser.set_defaults(outputs={"plot": PICTURES})
    add_shared(parser, "output")
    group = parser.add_argument_group("a signal", "how its table is to be read")
    add_shared(group, *TABLE)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def run(args: argparse.Namespace) -> int:
    """Write a bag with the impacts detected in another one, or in a signal."""
    from impact_observer.io.bag_files import SIGNAL_FILES
    from impact_observer.model import read_model

    is_signal = args.bag.suffix.lower() in SIGNAL_FILES
    if is_signal and args.pulses is not None and args.pulses == args.topic:
        raise UsageError(f"--pulses {args.pulses}: the signal itself; expected another column")
    model = None if args.model is None else read_model(args.model)
    with Progress() as progress:
        result = (_in_signal if is_signal else _in_bag)(args, model, progress)
        print_table(_table(result))
        if result.part is not None:
            progress.line(f"part: {result.part.words}")
        progress.line(f"{args.output}: {result.events} events")
        progress.warn([*result.doubts, *result.problems])
        if args.plot is not None and result.zero is not None:
            from impact_observer.draw.detections import detection_picture
            from impact_observer.draw.pictures import save

            names = [f"{source.contact}: {source.topic}" for source in result.sources]
            thresholds = [source.threshold for source in result.sources]
            picture = detection_picture(names, thresholds, result.traces, result.zero)
            save(picture, args.plot)
            progress.line(f"{args.plot}: the signals")
    return 0


def _in_bag(
    args: argparse.Namespace, model: "Model | None", progress: "Progress"
) -> "BagDetection":
    """Detect in a bag."""
    from impact_observer.detector.bag_detection import detect_bag
    from impact_observer.io.reader import BagReader
    from impact_observer.io.tables import TableForm
    from impact_observer.recording.sources_file import read_fit_sources

    declared = read_fit_sources(args.sources, table_form(args))
    if declared.form != TableForm() or args.time_zero is not None:
        raise UsageError(f"{args.bag}: options of a table go with a signal, not with a bag")
    sources = _sources(args, declared.sources, model)
    with BagReader(args.bag) as reader:
        return detect_bag(
            reader,
            sources,
            args.output,
            model=model,
            epoch=args.epoch or 0,
            pulses=args.pulses,
            start=args.start,
            duration=args.duration,
            traced=args.plot is not None,
            progress=lambda done, total: progress.step("detecting", done, total),
        )


def _in_signal(
    args: argparse.Namespace, model: "Model | None", progress: "Progress"
) -> "BagDetection":
    """Detect in a signal; print which stamps were given to it."""
    from impact_observer.detector.signal_detection import detect_signal, pulses_in
    from impact_observer.io.bag_part import BagPart
    from impact_observer.io.signals import read_signal
    from impact_observer.recording.sources_file import read_fit_sources
    from impact_observer.stamps import text

    progress.show(f"reading {args.bag}")
    declared = read_fit_sources(args.sources, table_form(args))
    signal, pulses, part = read_signal(args.bag, declared.form, args.time_zero), [], None
    if args.frame_rate and not signal.is_counted:
        raise UsageError(
            f"{args.bag}: has a column of time; leave out --frame-rate, or the column"
        )
    if args.start is not None or args.duration is not None:
        part = BagPart.between(signal.time_zero, args.start, args.duration)
    if args.pulses is not None:
        pulses = pulses_in(signal, args.pulses)
        progress.line(f"{args.pulses}: {len(pulses)} pulses, the first at {text(pulses[0])} s")
    by_default = pulses[0] if pulses else signal.zero
    epoch = by_default if args.epoch is None else args.epoch

    def show(rows: int) -> None:
        if rows % 1000 == 0:
            progress.show(f"{args.bag}: {rows} rows")

    result = detect_signal(
        signal,
        _sources(args, declared.sources, model, signal.topics),
        args.output,
        model=model,
        epoch=epoch,
        pulses=pulses,
        part=part,
        traced=args.plot is not None,
        progress=show,
    )
    known = f"epoch {text(epoch)} s" if epoch else "epoch unknown"
    rows = f"{result.rows} rows in {result.seconds:.6g} s"
    if result.seconds:
        rows += f" ({(result.rows - 1) / result.seconds:.4g} Hz)"
    rows += f", {signal.times}" if signal.times else ""
    progress.line(f"{args.bag}: {rows}; time 0 is stamp {text(signal.zero)} s, {known}")
    return result


def _sources(
    args: argparse.Namespace,
    declared: "tuple[Source, ...]",
    model: "Model | None",
    columns: "Mapping[str, str] | None" = None,
) -> "tuple[Source, ...]":
    """The ``declared`` sensors of a file, or the one that the options declare.

    ``columns`` are those of a signal with their topics; None for a bag.
    """
    from impact_observer.detector import Source

    names = (*_TEXTS, *_NUMBERS)
    given = {name: getattr(args, name) for name in names if getattr(args, name) is not None}
    if declared:
        if given:
            option = _option(next(iter(given)))
            raise UsageError(f"{option}: given beside --sources; write it into {args.sources}")
        return declared
    contacts = () if model is None else model.subject.contact_names
    if len(contacts) == 1:
        given.setdefault("contact", contacts[0])
    if columns is not None:
        given["topic"] = _topic(args, columns)
    if "contact" not in given and (contacts or columns is not None):
        which = f", one of {', '.join(contacts)}" if contacts else ", or --model with one contact"
        raise UsageError(f"{args.bag}: no contact named; give --contact NAME{which}")
    if not {"contact", "topic"} <= given.keys():
        raise UsageError("no sensor named; give --sources, or --contact and --topic")
    return (Source(**given),)


def _topic(args: argparse.Namespace, columns: "Mapping[str, str]") -> str:
    """The topic of a signal's column: the one that is named, or the only one.

    A name may stand without its unit in brackets.
    """
    from impact_observer.io.interfaces import absolute

    if args.topic is None and len(columns) == 1:
        return next(iter(columns.values()))
    for name, topic in columns.items():
        if args.topic is not None and args.topic in (name, re.sub(r"\s*[\[(].*", "", name)):
            return topic
    if args.topic is None or absolute(args.topic) not in columns.values():
        found = "" if args.topic is None else f"no column {args.topic}; "
        raise UsageError(f"{args.bag}: {found}columns {', '.join(columns)}; name one with --topic")
    return absolute(args.topic)


def _table(result: "BagDetection") -> TextTable:
    """What was found by each sensor; ``late`` is the mean time from threshold to stamp."""
    from impact_observer.stamps import seconds_between

    headings = ("contact", "sensor", "dead time [s]", "impacts", "persistent", "suppressed")
    rows = []
    for k, source in enumerate(result.sources):
        counts = result.counts[k]
        numbers = counts.impacts, counts.closings, counts.suppressed, counts.short_releases
        sensor = f"{source.topic}, {source.kind}"
        rise = seconds_between(0, counts.rises) / max(counts.impacts, 1)
        late = f"{1e3 * rise:.2g}" if rise > 0 else ""
        time = f"{source.dead_time:g}"
        rows.append([source.contact, sensor, time, *map(str, numbers), late])
    return TextTable((*headings, "short releases", "late [ms]"), rows, words=("sensor",))
