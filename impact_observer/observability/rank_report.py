# SPDX-License-Identifier: Apache-2.0
"""The observability of a recording in words, in a table and as JSON."""

from collections.abc import Iterator

import numpy as np

from impact_observer.draw.reports import (
    ReportLine,
    TextTable,
    counted,
    figure,
    listed,
    print_facts,
    print_table,
)
from impact_observer.model.system import unit_of
from impact_observer.observability.rank import Observability
from impact_observer.plain_text import say
from impact_observer.states import Vector

_SHOWN = 6
"""Most terms of a combination, combinations, names, and rows at either end of the table."""
_SMALL = 0.005
"""Smallest printed term of a combination over the largest, both in standard deviations."""


def for_json(observed: Observability) -> dict[str, object]:
    """The values of ``--json``: SI units, None for a number without a meaning."""
    complete, released = observed.complete, observed.released.tolist()
    condition = [value if np.isfinite(value) else None for value in observed.condition.tolist()]
    return {
        "name": observed.system.name,
        "states": list(observed.states),
        "start_stamp_ns": observed.episode.start,
        "deviation": observed.deviation.tolist(),
        "tolerance": observed.tolerance,
        "uncertain": observed.size,
        "rank": int(observed.rank[-1]),
        "condition": condition[-1],
        "impacts": len(released) - sum(released),
        "releases": sum(released),
        "impacts_to_full_rank": None
        if complete is None
        else complete + 1 - sum(released[: complete + 1]),
        "seconds_to_full_rank": None if complete is None else float(observed.seconds[complete]),
        "unknown": observed.undetermined.tolist(),
        "unknown_at_the_end": observed.remaining.tolist(),
        "determined": list(observed.determined),
        "least_known": observed.weakest.tolist(),
        "foreign_switches": dict(observed.episode.foreign),
        "events_left_out": observed.episode.left_out,
        "episodes": observed.episode.episodes,
        "samples": dict(observed.samples),
        "growth": {
            "stamp_ns": observed.stamps.tolist(),
            "seconds": observed.seconds.tolist(),
            "contacts": [list(names) for names in observed.contacts],
            "released": released,
            "rank": observed.rank.tolist(),
            "condition": condition,
            "singular_values": observed.singular.tolist(),
        },
    }


def remarks(observed: Observability) -> Iterator[ReportLine]:
    """The conclusions, and the events that were left out."""
    yield from _verdict(observed)
    episode = observed.episode
    if episode.episodes > 1:
        text = f"The bag has {episode.episodes} episodes: this is the last one."
        yield ReportLine("note", text)
    if episode.left_out:
        left_out = counted(episode.left_out, "event")
        yield ReportLine("note", f"{left_out} left out: sent twice, or from before the start.")
    if episode.foreign:
        events = counted(sum(episode.foreign.values()), "event")
        yield ReportLine(
            "warning",
            f"{events} of contacts that the model does not have, left out:"
            f" {listed(episode.foreign, _SHOWN)}; the model has"
            f" {listed(observed.system.contact_names, _SHOWN)}.",
        )


def _verdict(observed: Observability) -> Iterator[ReportLine]:
    complete, singular = observed.complete, observed.singular[-1]
    unit = unit_of("m", observed.system.unit)
    if complete is not None:
        yield ReportLine(
            "ok",
            f"Full rank after {_events(observed, complete + 1)}, {observed.seconds[complete]:.3f}"
            f" s after the start: all {observed.size} numbers of the state are determined.",
        )
        yield ReportLine(
            "note",
            f"Least known: {combination(observed, observed.weakest)}. A start that is wrong by"
            f" that moves the recorded gaps by {singular[-1]:.2g} {unit} in all,"
            f" {observed.condition[-1]:.3g} times less than the best known one.",
        )
        return
    missing = len(observed.undetermined)
    yield ReportLine(
        "warning",
        f"The rank is {observed.rank[-1]} of {observed.size}: {counted(missing, 'combination')} of"
        f" the initial state {'is' if missing == 1 else 'are'} not determined. A start that is"
        " wrong by one of them gives the same impacts:",
    )
    for direction, left in list(zip(observed.undetermined, observed.remaining, strict=True))[
        :_SHOWN
    ]:
        yield ReportLine(
            "", f"{combination(observed, direction)}, {remaining(observed, direction, left)}"
        )
    if missing > _SHOWN:
        yield ReportLine("", f"and {missing - _SHOWN} more, in --json")
    if observed.determined:
        yield ReportLine(
            "note", f"Determined all the same: {listed(observed.determined, _SHOWN)}."
        )
    yield ReportLine("note", "Remedies are in docs/fitting.md.")


def remaining(observed: Observability, direction: Vector, left: Vector) -> str:
    """How much of an undetermined error is left after the last event.

    Args:
        observed: the observability of a recording.
        direction: the error at the start, shape (2n,), SI units.
        left: the same error after the last event, shape (2n,), SI units.
    """
    gone = max(abs(left)) <= observed.tolerance * max(abs(direction))
    return "gone at the end" if gone else f"at the end {combination(observed, left)}"


def combination(observed: Observability, direction: Vector) -> str:
    """A direction of the state as a sum, such as ``0.71 x1 + 0.70 dx2/dt``."""
    size = [abs(v) / (d or 1.0) for v, d in zip(direction, observed.deviation, strict=True)]
    order = sorted(range(len(size)), key=lambda i: -size[i])
    worth = [i for i in order if size[i] >= _SMALL * size[order[0]]]
    words = ""
    for i in sorted(worth[:_SHOWN]):
        value = direction[i]
        minus = "-" if value < 0 else ""
        joint = f" {minus or '+'} " if words else minus
        words += f"{joint}{abs(value):#.2g} {observed.states[i]}"
    more = len(worth) - _SHOWN
    return f"{words} and {more} more" if more > 0 else words


def print_observability(observed: Observability) -> None:
    """Print how the rank grew, and the conclusions."""
    samples = [f"{counted(count, 'sample')} of {name}" for name, count in observed.samples.items()]
    say(
        f"{observed.system.name}: {_events(observed, observed.stamps.size)} in"
        f" {observed.seconds[-1]:.3f} s{', ' if samples else ''}{', '.join(samples)},"
        f" {observed.size} unknown numbers"
    )
    say("")
    print_table(growth_table(observed))
    say("")
    print_facts(remarks(observed))


def growth_table(observed: Observability) -> TextTable:
    """The impacts and releases at which the rank rises, and the last one."""
    sizes = (f"{each} [{unit_of('m', observed.system.unit)}]" for each in ("most", "least"))
    headings = ("event", "s", "contact", "rank", *sizes, "condition")
    rises = [k for k, r in enumerate(observed.rank) if r > (observed.rank[k - 1] if k else 0)]
    shown = sorted({*rises, observed.rank.size - 1})
    rows = [_row(observed, k) for k in shown]
    if (left_out := len(rows) - 2 * _SHOWN) > 1:
        gap = ("...", "", f"{left_out} more in --json", "", "", "", "")
        rows = [*rows[:_SHOWN], gap, *rows[-_SHOWN:]]
    return TextTable(headings, rows, words=("contact",))


def _row(observed: Observability, k: int) -> tuple[str, ...]:
    """The row of event ``k``."""
    values, rank = observed.singular[k], int(observed.rank[k])
    return (
        str(k + 1),
        f"{observed.seconds[k]:.3f}",
        listed(observed.contacts[k], _SHOWN) + (" opens" if observed.released[k] else ""),
        f"{rank}/{observed.size}",
        figure(values[0]),
        figure(values[-1]) if rank == observed.size else "0",
        figure(observed.condition[k]) if rank == observed.size else "-",
    )


def _events(observed: Observability, first: int) -> str:
    """The number of impacts and of releases among the first events."""
    releases = sum(observed.released[:first].tolist())
    impacts = counted(first - releases, "impact")
    return f"{impacts} and {counted(releases, 'release')}" if releases else impacts
