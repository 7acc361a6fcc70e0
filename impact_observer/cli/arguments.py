"""Types of command line arguments: a value that cannot be used is an error of one line."""

import argparse
import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_observer.observer import Options


def add_observer_arguments(
    parser: "argparse._ActionsContainer", *, simulated: bool = False
) -> None:
    """What users choose of observers; ``observer_options`` reads it.

    Defaults are those of ``observer.Options``, which knows the mathematics and is not imported
    for a ``--help``.

    Args:
        parser: of the subcommand, or a group of it.
        simulated: the command has a sensor with options of the same names, runs with seeds, and
            no bag.
    """
    start = "q1,..,qn,u1,..,un, random:SEED or zero"
    parser.add_argument(
        "--initial",
        metavar="STATE",
        help=f"{start} (default: random, of each run)" if simulated else f"{start} (default)",
    )
    parser.add_argument(
        "--deviation",
        metavar="D",
        help="standard deviations of the initial state: one number, or 2n (default 1)",
    )
    parser.add_argument(
        "--clock-error",
        metavar="S",
        type=not_negative,
        help="standard deviation of the impacts' stamps, s, at most 0.1; 0 for 1 ns"
        " (default: learnt from them)",
    )
    parser.add_argument(
        "--clock-offset-error",
        metavar="S",
        type=not_negative,
        help="minimum-variance: standard deviation of what all stamps are late by, s, at most 0.1;"
        " it is estimated (default 0: none)",
    )
    for name, meaning in (
        ("missed", "of an impact that it is not heard (default 0.1)"),
        ("spurious", "of an event that nothing has happened (default 0.1)"),
        ("mislabelled", "of an impact that it was another contact's (default 0.01)"),
    ):
        parser.add_argument(
            f"--observer-{name}" if simulated else f"--{name}",
            dest=name,
            metavar="P",
            type=not_negative,
            help=f"minimum-variance: probability {meaning}",
        )
    parser.add_argument(
        "--model-error",
        metavar="A",
        type=not_negative,
        help="of the model's accelerations, as white noise, m/s^1.5 (default 0)",
    )
    parser.add_argument(
        "--estimate-parameters",
        metavar="NAME[=D],...",
        type=_names,
        help="minimum-variance: parameters of the model, as of identify --free, that are learnt"
        " with the state, perhaps with standard deviations: restitution=0.1,stiffness-scale=0.03",
    )
    parser.add_argument(
        "--parameter-drift",
        metavar="R",
        type=not_negative,
        help="by what share of their deviations these go astray in a minute (default 0)",
    )
    parser.add_argument(
        "--compiled",
        action="store_true",
        default=None,
        help="minimum-variance: machine code for what an event takes, by numba: half a minute"
        " once, then a second at each start",
    )
    parser.add_argument(
        "--epoch",
        metavar="S",
        type=stamp,
        help=f"stamp of t = 0 (default{' 1' if simulated else ': as in the bag'})",
    )


def add_model(
    parser: argparse.ArgumentParser,
    meaning: str = "a model file or a sample (default: the one in the bag)",
) -> None:
    """Which model is meant."""
    parser.add_argument("--model", metavar="MODEL", help=meaning)


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """Which rig is meant in a bag of several."""
    parser.add_argument(
        "--namespace",
        metavar="NS",
        default="",
        help="of the rig that is meant, in a bag of several, such as /rig_a (default: any)",
    )


def add_ensemble_arguments(parser: argparse.ArgumentParser) -> None:
    """The same of what tells whether an estimate has converged."""
    parser.add_argument(
        "--ensemble", metavar="N", type=count, help="replicas run together (default 10)"
    )
    parser.add_argument(
        "--agreed",
        metavar="R",
        type=positive,
        help="V distance that counts as synchronized, over the motion's energy (default 1e-4)",
    )


def observer_options(args: argparse.Namespace, law: str) -> "Options":
    """The options of an observer with ``law``, as far as they were given."""
    from dataclasses import fields

    from impact_observer.observer import Options

    names = {field.name for field in fields(Options)} - {"law"}
    given = {name: value for name, value in vars(args).items() if name in names}
    return Options(law, **{name: value for name, value in given.items() if value is not None})


def positive(text: str) -> float:
    """A finite number above zero."""
    value = _number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number above 0")
    return value


def stamp(text: str) -> int:
    """A stamp given in seconds, at least 1 ns, with up to nine exact decimals."""
    whole, _, part = text.partition(".")
    if not (whole.isascii() and whole.isdigit() and (part + "0").isdigit() and len(part) <= 9):
        raise argparse.ArgumentTypeError(
            f"{text} found; expected seconds with at most nine decimals, such as 1.5"
        )
    nanoseconds = int(whole) * 1_000_000_000 + int(part.ljust(9, "0"))
    if nanoseconds == 0:
        raise argparse.ArgumentTypeError("0 found; stamps start above zero")
    return nanoseconds


def not_negative(text: str) -> float:
    """A finite number, not below zero."""
    value = _number(text)
    if value < 0:
        raise argparse.ArgumentTypeError(f"{text} found; expected a number, 0 or more")
    return value


def count(text: str) -> int:
    """A whole number above zero."""
    if not (text.isascii() and text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f"{text} found; expected a whole number, 1 or more")
    return int(text)


def seed(text: str) -> int:
    """A whole number, not below zero."""
    if not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text} found; expected a whole number, 0 or more")
    return int(text)


def _names(text: str) -> tuple[str, ...]:
    """Names with commas between them, one at least."""
    names = tuple(name.strip() for name in text.split(","))
    if not all(names):
        raise argparse.ArgumentTypeError(f"{text!r} found; expected NAME,NAME,...")
    return names


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} found; expected a number")
    return value
