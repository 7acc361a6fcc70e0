# SPDX-License-Identifier: Apache-2.0
"""The entry point: parses the arguments and runs the subcommand."""

import argparse
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from keyword import iskeyword
from types import ModuleType
from typing import NoReturn

from impact_observer import __version__
from impact_observer.errors import NotLinearError
from impact_observer.matrix_threads import one_matrix_thread
from impact_observer.plain_text import printable
from impact_observer.process_end import run

PROGRAM = "impact-observer"
COMMANDS = {
    "demo": "plant, observers and monitors as processes, a bag, a comparison, a picture",
    "new": "copy a commented rig to edit: a model, its sensors, a launch file",
    "check-model": "what a model means for an observer, and what the impacts in a bag determine",
    "identify": "estimate a model's parameters from impact times, or check it against them",
    "fit": "from a recording to numbers, a table of impacts and a picture",
    "simulate": "run a plant without ROS: impacts and true states into a bag",
    "detect": "find the impacts in a bag of sensors, or in a signal (CSV, WAV)",
    "import": "make a bag from the impact times in a CSV file",
    "observe": "run an observer on the impacts in a bag",
    "smooth": "the best estimate of a recording at every instant, from all its impacts",
    "compare": "estimates against the truth: V(t), errors, a picture",
    "sweep": "Monte Carlo over laws, starts, sensors and wrong models, on all cores or a cluster",
    "plot": "states of a bag over time with deviations, impacts and verdicts: a picture",
    "export": "states, errors or events of a bag as CSV or Parquet",
    "check": "what a bag holds, whether an observer can use it, and what is wrong with it",
    "play": "publish a bag on its topics",
    "record": "record topics into a bag",
    "watch": "a live view of plant and observers in the terminal",
}
GONE = {
    "animate": "plot",
    "info": "check",
    "observability": "check-model MODEL BAG",
    "figure": "compare --figure MODEL --plot FILE",
    "layout": "the files in layouts/",
    "urdf": "a robot has a URDF of its own",
}
"""What to use instead of the commands that went in 0.4.0."""
_OBSERVE = "observe with the option, then compare with its bag"
_ONE_RUN = "simulate and observe"
_IN_SOURCES = "the keys of a sensor in the file of --sources"
_IN_TABLE = "the key table in the file of --sources"
GONE_OPTIONS = {
    "--deviation": "--initial-deviation",
    "--compression": "zstd",
    "--force": "another name; no file is replaced",
    "--namespace": "a bag of the topics of one rig",
    "--most-estimates": "--rate, --start and --duration",
    "--parameter-drift": "parts of the recording, by --start and --duration",
    "--agreed": "convergence of the estimates, in J",
    "fit --time-unit": _IN_TABLE,
    "fit --time-column": _IN_TABLE,
    "fit --sort": _IN_TABLE,
    "fit --separator": _IN_TABLE,
    "fit --decimal": _IN_TABLE,
    "fit --skip-rows": _IN_TABLE,
    "fit --frame-rate": _IN_TABLE,
    "detect --time-unit": _IN_TABLE,
    "detect --sort": _IN_TABLE,
    "detect --separator": _IN_TABLE,
    "detect --decimal": _IN_TABLE,
    "detect --skip-rows": _IN_TABLE,
    "detect --kind": _IN_SOURCES,
    "detect --direction": _IN_SOURCES,
    "detect --min-contact-duration": _IN_SOURCES,
    "detect --stamp": _IN_SOURCES,
    "detect --hysteresis": _IN_SOURCES,
    "detect --inverted": _IN_SOURCES,
    "compare --observers": "a bag whose topics are /observer_NAME/joint_states",
    "compare --truth": "a bag whose truth is /plant/joint_states",
    "compare --clock-error": _OBSERVE,
    "compare --initial-deviation": _OBSERVE,
    "compare --clock-offset-error": _OBSERVE,
    "compare --missed": _OBSERVE,
    "compare --spurious": _OBSERVE,
    "compare --mislabelled": _OBSERVE,
    "compare --dead-time": _OBSERVE,
    "compare --model-error": _OBSERVE,
    "compare --estimate-parameters": _OBSERVE,
    "compare --epoch": _OBSERVE,
    "compare --csv": "--json",
    "compare --from": "--start",
    "--settled": "V of export --what errors; the ratio is 0.01",
    "--horizon": "--duration",
    "--held-back": "nothing; the last fifth is held back",
    "--accept": "the file, which is written where a model does not fit, too",
    "--trust-events": "nothing; a search is made only where reported impacts do not fit",
    "play --start": "export or observe of a part, or ros2 bag play",
    "play --duration": "--topics, and Ctrl-C",
    "--no-clock": "ros2 bag play where another clock runs",
    "demo --rate": "simulate and observe",
    "--tolerance": "the singular values of --json",
    "--measurement-noise": "the deviation in the file of --measurements",
    "sweep --epoch": "an epoch of 1 s",
    "sweep --clock-offset-error": _ONE_RUN,
    "sweep --observer-missed": _ONE_RUN,
    "sweep --observer-spurious": _ONE_RUN,
    "sweep --observer-mislabelled": _ONE_RUN,
    "sweep --observer-dead-time": _ONE_RUN,
    "sweep --estimate-parameters": _ONE_RUN,
    "plot --observers": "a bag of one observer",
    "export --epoch": "the column stamp_ns",
    "simulate --epoch": "an epoch of 1 s",
    "demo --initial-state": "random:1",
    "check-model --plot": "--json",
    "watch --json": "export of a recorded bag",
    "watch --observers": "nothing; all are shown",
    "record --use-sim-time": "the stamps of the headers",
    "play --delay": "nothing; 5 s",
    "--flush": "nothing; a recorder writes to the disk every second",
    "--remap": "remappings of the nodes that listen",
}
"""What to use instead of options that went in 0.4.0, of all commands or of the one named."""
_OPTION = re.compile(r"--[a-z][a-z-]*")
_NEGATIVE = re.compile(r"-\.?\d")


class _Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line."""

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse as ``ArgumentParser`` does; refuse a negative number without its value."""
        if empty := next((word for word in args or () if word.endswith("=--")), ""):
            wanted = f"{empty.removesuffix('--')}VALUE"
            self.exit(2, f"{self.prog}: {empty}: no value found; expected {wanted}\n")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """End with a line and exit code 2."""
        self.exit(2, f"{self.prog}: {printable(message)}; see {self.prog} --help\n")

    def refuse(self, words: Sequence[str]) -> NoReturn:
        """End with the unknown ``words``, or with what to use instead of an option that went."""
        for option in (word.partition("=")[0] for word in words):
            of_command = f"{self.prog.removeprefix(PROGRAM).strip()} {option}"
            if remedy := GONE_OPTIONS.get(of_command) or GONE_OPTIONS.get(option):
                self.error(f"{option} went in 0.4.0; use {remedy}")
        self.error(f"unrecognized arguments: {' '.join(words)}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``impact-observer`` with ``argv``, by default the process's own arguments.

    Returns:
        0, or 1 for a job that failed or was interrupted, or 2 for wrong use; 143 after SIGTERM.
    """
    one_matrix_thread()  # before numpy is imported
    own = argv is None
    if own:  # pictures go to files: matplotlib needs no window, and no unknown one
        os.environ["MPLBACKEND"] = "agg"
    given = sys.argv[1:] if argv is None else argv
    return run(PROGRAM, lambda: _run(given), own=own)


def _joined(argv: Sequence[str]) -> list[str]:
    """``--option -1e-3`` as ``--option=-1e-3``: argparse takes most such numbers for options."""
    joined: list[str] = []
    for word in argv:
        if _NEGATIVE.match(word) and joined and _OPTION.fullmatch(joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _run(argv: Sequence[str]) -> int:
    """Parse the arguments and run the subcommand."""
    parser = _Parser(
        prog=PROGRAM,
        description="Estimate the state of an impacting mechanical system from its impact times.",
    )
    parser.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    command = next((word for word in argv if not word.startswith("-")), "")
    if command in GONE:
        sys.stderr.write(f"{PROGRAM}: {command} went in 0.4.0: {GONE[command]}\n")
    for name, summary in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=summary)
        if name == command:  # only the module that is needed is imported: --help stays quick
            module = _module(name)
            subparser.description = module.__doc__
            subparser.formatter_class = argparse.RawDescriptionHelpFormatter
            module.add_arguments(subparser)
    args, unknown = parser.parse_known_args(_joined(argv))
    if unknown:
        subparsers.choices[args.command].refuse(unknown)
    if outputs := getattr(args, "outputs", ()):
        from impact_observer.output_files import check_outputs

        given = (getattr(args, name) for name in outputs)
        check_outputs([path for path in given if path is not None])
    try:
        return int(_module(args.command).run(args))
    except NotLinearError as error:
        raise error.in_command(args.command) from None


def _module(command: str) -> ModuleType:
    """The module of a subcommand; after a keyword of Python stands ``_``."""
    name = f"{command}_" if iskeyword(command) else command.replace("-", "_")
    return import_module(f"impact_observer.cli.{name}")
