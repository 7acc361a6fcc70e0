"""What the impacts in a bag have told of the state, before anyone trusts an estimate."""

import argparse
import json as json_module
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from impact_observer.cli.arguments import add_model, add_namespace, positive

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.observability.rank import Observability
    from impact_observer.states import Vector

_WIDTH = 100
"""Columns where there is no terminal."""
_SHOWN = 6
"""Terms of a combination, combinations, and rows at either end of a table, that are shown."""
_SMALL = 0.005
"""Term of a combination that is not shown, relative to the largest, in deviations."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("bag", metavar="BAG", type=Path, help="a bag with impacts")
    add_model(parser)
    add_namespace(parser)
    parser.add_argument(
        "--deviation",
        metavar="D",
        default="1",
        help="standard deviations of the initial state, SI units: one number, or q1,..,qn,u1,..,un"
        " (default 1)",
    )
    parser.add_argument(
        "--tolerance",
        metavar="R",
        type=positive,
        help="singular value that counts as none, over the largest (default 1e-9: stamps of 1 ns)",
    )
    parser.add_argument(
        "--plot", metavar="FILE", type=Path, help="write singular values over time: PNG, SVG, PDF"
    )
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return observe(
        args.bag,
        model=args.model,
        namespace=args.namespace,
        deviation=args.deviation,
        tolerance=args.tolerance,
        plot=args.plot,
        json=args.json,
    )


def observe(
    bag: Path,
    *,
    model: str | None = None,
    namespace: str = "",
    deviation: str = "1",
    tolerance: float | None = None,
    plot: Path | None = None,
    json: bool = False,
) -> int:
    """Judge the impacts in a bag and print what comes out.

    Args:
        bag: has impacts.
        model: a model file or a sample's name; None for the model that the bag carries.
        namespace: of the rig that is meant; empty for the only one.
        deviation: standard deviations of the initial state; see ``deviation_of``.
        tolerance: singular value that counts as none, over the largest; None for the default.
        plot: a picture to write; None for none.
        json: print JSON instead of a table and words.

    Returns:
        0, also where the rank is not full.

    Raises:
        UsageError, ModelError: the arguments cannot be used.
        BagError: the bag cannot be read, or contains no impact of the model's contacts.
        ImpactLawError: the impact law has no solution at an event.
    """
    from impact_observer.errors import BagError
    from impact_observer.estimation.uncertainty import deviation_of
    from impact_observer.io.reader import BagReader
    from impact_observer.io.recordings import events_in, system_of
    from impact_observer.observability.rank import TOLERANCE, observability

    if plot is not None:
        from impact_observer.draw.pictures import check_output

        check_output(plot)
    with BagReader(bag, namespace) as reader:
        system = system_of(reader, model)
        events = events_in(reader)
    try:
        told = observability(
            system,
            events,
            deviation=deviation_of(deviation, system),
            tolerance=TOLERANCE if tolerance is None else tolerance,
        )
    except BagError as error:
        raise BagError(f"{bag}: {error}") from None
    if json:
        print(json_module.dumps(figures(told), indent=2, allow_nan=False))
    else:
        print_told(told)
    if plot is not None:
        draw(told, plot)
        if not json:
            print(f"picture: {plot}")
    return 0


def draw(told: "Observability", plot: Path) -> None:
    """Draw singular values and rank over time."""
    from impact_observer.draw.pictures import save
    from impact_observer.observability.rank_picture import observability_figure

    title = f"{told.system.name}: what the impacts have told of the initial state"
    save(observability_figure(told, title=title), plot)


def figures(told: "Observability") -> dict[str, object]:
    """What ``--json`` prints; SI units, None where a figure has no meaning."""
    complete, released = told.complete, told.released.tolist()
    condition = [float(c) if r == told.size else None for c, r in _conditions(told)]
    return {
        "name": told.system.name,
        "states": list(told.states),
        "start_stamp_ns": told.start,
        "deviation": told.deviation.tolist(),
        "tolerance": told.tolerance,
        "uncertain": told.size,
        "rank": int(told.rank[-1]),
        "condition": condition[-1],
        "impacts": len(released) - sum(released),
        "releases": sum(released),
        "impacts_to_full_rank": None
        if complete is None
        else complete + 1 - sum(released[: complete + 1]),
        "seconds_to_full_rank": None if complete is None else float(told.seconds[complete]),
        "unknown": told.unknown.tolist(),
        "unknown_at_the_end": told.left.tolist(),
        "told": list(told.told),
        "least_known": told.least.tolist(),
        "foreign_switches": dict(told.foreign),
        "events_left_out": told.left_out,
        "episodes": told.episodes,
        "growth": {
            "stamp_ns": told.stamps.tolist(),
            "seconds": told.seconds.tolist(),
            "contacts": [list(names) for names in told.contacts],
            "released": released,
            "rank": told.rank.tolist(),
            "condition": condition,
            "singular_values": told.singular.tolist(),
        },
    }


def _conditions(told: "Observability") -> "Iterator[tuple[float, int]]":
    """Condition number and rank after each event."""
    return zip(told.condition.tolist(), told.rank.tolist(), strict=True)


def sentences(told: "Observability") -> Iterator[str]:
    """What it comes down to, in plain words."""
    yield from _verdict(told)
    if told.episodes > 1:
        yield f"The bag has {told.episodes} episodes: this is the last one."
    if told.left_out:
        yield f"{_count(told.left_out, 'event')} left out: sent twice, or from before the start."
    if told.foreign:
        contacts, known = _listed(list(told.foreign)), _listed(told.system.contact_names)
        yield (
            f"{_count(sum(told.foreign.values()), 'switch', 'es')} of contacts that the model does"
            f" not have left out: {contacts}; it has {known}."
        )


def _verdict(told: "Observability") -> Iterator[str]:
    complete, singular = told.complete, told.singular[-1]
    if complete is not None:
        yield (
            f"Full rank after {_events(told, complete + 1)}, {told.seconds[complete]:.3f} s"
            f" after the start: all {told.size} numbers of the state have been told."
        )
        yield (
            f"Least known: {combination(told, told.least)}. A start that is wrong by that moves"
            f" the recorded gaps by {singular[-1]:.2g} m in all, {told.condition[-1]:.3g} times"
            " less than the best known one."
        )
        return
    missing = len(told.unknown)
    yield (
        f"The rank is {told.rank[-1]} of {told.size}: {_count(missing, 'combination')} of the"
        f" initial state {'has' if missing == 1 else 'have'} never been told. A start that is"
        " wrong by such a one gives the same impacts:"
    )
    for direction, left in list(zip(told.unknown, told.left, strict=True))[:_SHOWN]:
        yield f"    {combination(told, direction)}, {_left(told, direction, left)}"
    if missing > _SHOWN:
        yield f"    and {missing - _SHOWN} more, in --json"
    if told.told:
        yield f"Told all the same: {_listed(told.told)}."
    yield "What can be done about it is in docs/observability.md."


def _left(told: "Observability", direction: "Vector", left: "Vector") -> str:
    """What has become of an unknown direction."""
    gone = max(abs(left)) <= told.tolerance * max(abs(direction))
    return "gone at the end" if gone else f"at the end {combination(told, left)}"


def combination(told: "Observability", direction: "Vector") -> str:
    """A direction of the state as a sum, such as ``0.71 x1 + 0.70 dx2/dt``."""
    size = [abs(v) / (d or 1.0) for v, d in zip(direction, told.deviation, strict=True)]
    order = sorted(range(len(size)), key=lambda i: -size[i])
    worth = [i for i in order if size[i] >= _SMALL * size[order[0]]]
    words = ""
    for i in sorted(worth[:_SHOWN]):
        value = direction[i]
        minus = "-" if value < 0 else ""
        joint = f" {minus or '+'} " if words else minus
        words += f"{joint}{abs(value):#.2g} {told.states[i]}"
    more = len(worth) - _SHOWN
    return f"{words} and {more} more" if more > 0 else words


def print_told(told: "Observability") -> None:
    """Print how the rank grew, and what it comes down to."""
    from rich.console import Console

    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, width=width)
    console.print(
        f"{told.system.name}: {_events(told, told.stamps.size)} in"
        f" {told.seconds[-1]:.3f} s, {told.size} unknown numbers"
    )
    console.print()
    console.print(growth_table(told))
    console.print()
    for sentence in sentences(told):
        console.print(sentence)


def growth_table(told: "Observability") -> "Table":
    """The impacts and releases at which the rank rises, and the last one."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for heading in ("event", "s", "contact", "rank", "most [m]", "least [m]", "condition"):
        justify: Literal["left", "right"] = "left" if heading == "contact" else "right"
        table.add_column(heading, justify=justify, overflow="fold")
    rises = [k for k, r in enumerate(told.rank) if r > (told.rank[k - 1] if k else 0)]
    rows = sorted({*rises, told.rank.size - 1})
    middle = len(rows) - 2 * _SHOWN
    for k in rows if middle <= 1 else rows[:_SHOWN]:
        table.add_row(*_row(told, k))
    if middle > 1:
        table.add_row("...", "", f"{middle} more in --json")
        for k in rows[-_SHOWN:]:
            table.add_row(*_row(told, k))
    return table


def _row(told: "Observability", k: int) -> tuple[str, ...]:
    """What was known after one event."""
    values, rank = told.singular[k], int(told.rank[k])
    return (
        str(k + 1),
        f"{told.seconds[k]:.3f}",
        _listed(told.contacts[k]) + (" opens" if told.released[k] else ""),
        f"{rank}/{told.size}",
        f"{values[0]:.3g}",
        f"{values[-1]:.3g}" if rank == told.size else "0",
        f"{told.condition[k]:.3g}" if rank == told.size else "-",
    )


def _listed(names: Sequence[str]) -> str:
    """Names in words; of many the first ones."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _events(told: "Observability", first: int) -> str:
    """How many impacts and releases there are among the first events."""
    releases = sum(told.released[:first].tolist())
    impacts = _count(first - releases, "impact")
    return f"{impacts} and {_count(releases, 'release')}" if releases else impacts


def _count(number: int, word: str, plural: str = "s") -> str:
    return f"{number} {word}{'' if number == 1 else plural}"
