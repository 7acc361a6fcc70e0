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
from impact_observer.observability.rank import Observability
from impact_observer.plain_text import say
from impact_observer.states import Vector

_SHOWN = 6
"""Most terms of a combination, combinations, names, and rows at either end of the table."""
_SMALL = 0.005
"""Smallest printed term of a combination over the largest, both in standard deviations."""


def for_json(found: Observability) -> dict[str, object]:
    """The values of ``--json``: SI units, None for a number without a meaning."""
    complete, released = found.complete, found.released.tolist()
    condition = [value if np.isfinite(value) else None for value in found.condition.tolist()]
    return {
        "name": found.system.name,
        "states": list(found.states),
        "start_stamp_ns": found.episode.start,
        "deviation": found.deviation.tolist(),
        "tolerance": found.tolerance,
        "uncertain": found.size,
        "rank": int(found.rank[-1]),
        "condition": condition[-1],
        "impacts": len(released) - sum(released),
        "releases": sum(released),
        "impacts_to_full_rank": None
        if complete is None
        else complete + 1 - sum(released[: complete + 1]),
        "seconds_to_full_rank": None if complete is None else float(found.seconds[complete]),
        "unknown": found.undetermined.tolist(),
        "unknown_at_the_end": found.remaining.tolist(),
        "determined": list(found.determined),
        "least_known": found.weakest.tolist(),
        "foreign_switches": dict(found.episode.foreign),
        "events_left_out": found.episode.left_out,
        "episodes": found.episode.episodes,
        "samples": dict(found.samples),
        "growth": {
            "stamp_ns": found.stamps.tolist(),
            "seconds": found.seconds.tolist(),
            "contacts": [list(names) for names in found.contacts],
            "released": released,
            "rank": found.rank.tolist(),
            "condition": condition,
            "singular_values": found.singular.tolist(),
        },
    }


def remarks(found: Observability) -> Iterator[ReportLine]:
    """The conclusions, and the events that were left out."""
    yield from _verdict(found)
    episode = found.episode
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
            f" {listed(found.system.contact_names, _SHOWN)}.",
        )


def _verdict(found: Observability) -> Iterator[ReportLine]:
    complete, singular = found.complete, found.singular[-1]
    if complete is not None:
        yield ReportLine(
            "ok",
            f"Full rank after {_events(found, complete + 1)}, {found.seconds[complete]:.3f} s"
            f" after the start: all {found.size} numbers of the state are determined.",
        )
        yield ReportLine(
            "note",
            f"Least known: {combination(found, found.weakest)}. A start that is wrong by that"
            f" moves the recorded gaps by {singular[-1]:.2g} m in all,"
            f" {found.condition[-1]:.3g} times less than the best known one.",
        )
        return
    missing = len(found.undetermined)
    yield ReportLine(
        "warning",
        f"The rank is {found.rank[-1]} of {found.size}: {counted(missing, 'combination')} of the"
        f" initial state {'is' if missing == 1 else 'are'} not determined. A start that is"
        " wrong by one of them gives the same impacts:",
    )
    for direction, left in list(zip(found.undetermined, found.remaining, strict=True))[:_SHOWN]:
        yield ReportLine(
            "", f"{combination(found, direction)}, {remaining(found, direction, left)}"
        )
    if missing > _SHOWN:
        yield ReportLine("", f"and {missing - _SHOWN} more, in --json")
    if found.determined:
        yield ReportLine("note", f"Determined all the same: {listed(found.determined, _SHOWN)}.")
    yield ReportLine("note", "Remedies are in docs/observability.md.")


def remaining(found: Observability, direction: Vector, left: Vector) -> str:
    """How much of an undetermined error is left after the last event.

    Args:
        found: the observability of a recording.
        direction: the error at the start, shape (2n,), SI units.
        left: the same error after the last event, shape (2n,), SI units.
    """
    gone = max(abs(left)) <= found.tolerance * max(abs(direction))
    return "gone at the end" if gone else f"at the end {combination(found, left)}"


def combination(found: Observability, direction: Vector) -> str:
    """A direction of the state as a sum, such as ``0.71 x1 + 0.70 dx2/dt``."""
    size = [abs(v) / (d or 1.0) for v, d in zip(direction, found.deviation, strict=True)]
    order = sorted(range(len(size)), key=lambda i: -size[i])
    worth = [i for i in order if size[i] >= _SMALL * size[order[0]]]
    words = ""
    for i in sorted(worth[:_SHOWN]):
        value = direction[i]
        minus = "-" if value < 0 else ""
        joint = f" {minus or '+'} " if words else minus
        words += f"{joint}{abs(value):#.2g} {found.states[i]}"
    more = len(worth) - _SHOWN
    return f"{words} and {more} more" if more > 0 else words


def print_observability(found: Observability) -> None:
    """Print how the rank grew, and the conclusions."""
    samples = [f"{counted(count, 'sample')} of {name}" for name, count in found.samples.items()]
    say(
        f"{found.system.name}: {_events(found, found.stamps.size)} in {found.seconds[-1]:.3f} s"
        f"{', ' if samples else ''}{', '.join(samples)}, {found.size} unknown numbers"
    )
    say("")
    print_table(growth_table(found))
    say("")
    print_facts(remarks(found))


def growth_table(found: Observability) -> TextTable:
    """The impacts and releases at which the rank rises, and the last one."""
    headings = ("event", "s", "contact", "rank", "most [m]", "least [m]", "condition")
    rises = [k for k, r in enumerate(found.rank) if r > (found.rank[k - 1] if k else 0)]
    shown = sorted({*rises, found.rank.size - 1})
    rows = [_row(found, k) for k in shown]
    if (left_out := len(rows) - 2 * _SHOWN) > 1:
        gap = ("...", "", f"{left_out} more in --json", "", "", "", "")
        rows = [*rows[:_SHOWN], gap, *rows[-_SHOWN:]]
    return TextTable(headings, rows, words=("contact",))


def _row(found: Observability, k: int) -> tuple[str, ...]:
    """The row of event ``k``."""
    values, rank = found.singular[k], int(found.rank[k])
    return (
        str(k + 1),
        f"{found.seconds[k]:.3f}",
        listed(found.contacts[k], _SHOWN) + (" opens" if found.released[k] else ""),
        f"{rank}/{found.size}",
        figure(values[0]),
        figure(values[-1]) if rank == found.size else "0",
        figure(found.condition[k]) if rank == found.size else "-",
    )


def _events(found: Observability, first: int) -> str:
    """The number of impacts and of releases among the first events."""
    releases = sum(found.released[:first].tolist())
    impacts = counted(first - releases, "impact")
    return f"{impacts} and {counted(releases, 'release')}" if releases else impacts
