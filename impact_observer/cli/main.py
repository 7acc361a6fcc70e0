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
from impact_observer.output_files import check_outputs
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
    for name, summary in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=summary)
        if name == command:  # only the module that is needed is imported: --help stays quick
            module = _module(name)
            subparser.description = module.__doc__
            subparser.formatter_class = argparse.RawDescriptionHelpFormatter
            module.add_arguments(subparser)
    args, unknown = parser.parse_known_args(_joined(argv))
    if unknown:
        found = f"unrecognized arguments: {' '.join(unknown)}"
        subparsers.choices[args.command].error(f"{found}; CHANGELOG.rst has what went in 0.4.0")
    outputs: dict[str, Sequence[str]] = getattr(args, "outputs", {})
    given = [(getattr(args, name), suffixes) for name, suffixes in outputs.items()]
    check_outputs([each for each in given if each[0] is not None])
    try:
        return int(_module(args.command).run(args))
    except NotLinearError as error:
        raise error.in_command(args.command) from None


def _module(command: str) -> ModuleType:
    """The module of a subcommand; after a keyword of Python stands ``_``."""
    name = f"{command}_" if iskeyword(command) else command.replace("-", "_")
    return import_module(f"impact_observer.cli.{name}")
