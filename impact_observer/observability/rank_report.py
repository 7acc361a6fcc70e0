# SPDX-License-Identifier: Apache-2.0
"""The observability of a recording in words, in a table and as JSON."""

from collections.abc import Iterator, Sequence

import numpy as np
from rich.table import Table

from impact_observer.draw.text_tables import console, plain_table, print_report
from impact_observer.observability.rank import Observability
from impact_observer.states import Vector

_SHOWN = 6
"""Most terms of a combination, combinations, names, and rows at either end of the table."""
_SMALL = 0.005
"""Smallest printed term of a combination over the largest, both in standard deviations."""


def for_json(found: Observability) -> dict[str, object]:
    """What ``--json`` prints; SI units, None without a meaning."""
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


def sentences(found: Observability) -> Iterator[str]:
    """The conclusions."""
    yield from _verdict(found)
    episode = found.episode
    if episode.episodes > 1:
        yield f"The bag has {episode.episodes} episodes: this is the last one."
    if episode.left_out:
        left_out = _count(episode.left_out, "event")
        yield f"{left_out} left out: sent twice, or from before the start."
    if episode.foreign:
        contacts, known = _listed(list(episode.foreign)), _listed(found.system.contact_names)
        events = _count(sum(episode.foreign.values()), "event")
        yield (
            f"{events} of contacts that the model does not have, left out: {contacts};"
            f" it has {known}."
        )


def _verdict(found: Observability) -> Iterator[str]:
    complete, singular = found.complete, found.singular[-1]
    if complete is not None:
        yield (
            f"Full rank after {_events(found, complete + 1)}, {found.seconds[complete]:.3f} s"
            f" after the start: all {found.size} numbers of the state are determined."
        )
        yield (
            f"Least known: {combination(found, found.weakest)}. A start that is wrong by that"
            f" moves the recorded gaps by {singular[-1]:.2g} m in all,"
            f" {found.condition[-1]:.3g} times less than the best known one."
        )
        return
    missing = len(found.undetermined)
    yield (
        f"The rank is {found.rank[-1]} of {found.size}: {_count(missing, 'combination')} of the"
        f" initial state {'is' if missing == 1 else 'are'} not determined. A start that is"
        " wrong by one of them gives the same impacts:"
    )
    for direction, left in list(zip(found.undetermined, found.remaining, strict=True))[:_SHOWN]:
        yield f"    {combination(found, direction)}, {_remaining(found, direction, left)}"
    if missing > _SHOWN:
        yield f"    and {missing - _SHOWN} more, in --json"
    if found.determined:
        yield f"Determined all the same: {_listed(found.determined)}."
    yield "What can be done about it is in docs/observability.md."


def _remaining(found: Observability, direction: Vector, left: Vector) -> str:
    """An undetermined error after the last event."""
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
    console(100).print(
        f"{found.system.name}: {_events(found, found.stamps.size)} in"
        f" {found.seconds[-1]:.3f} s{_samples(found)}, {found.size} unknown numbers\n"
    )
    print_report(growth_table(found), sentences(found))


def _samples(found: Observability) -> str:
    """The samples that count, in words."""
    each = [f"{_count(count, 'sample')} of {name}" for name, count in found.samples.items()]
    return f", {', '.join(each)}" if each else ""


def growth_table(found: Observability) -> Table:
    """The impacts and releases at which the rank rises, and the last one."""
    headings = ("event", "s", "contact", "rank", "most [m]", "least [m]", "condition")
    table = plain_table(*headings, words={"contact"})
    rises = [k for k, r in enumerate(found.rank) if r > (found.rank[k - 1] if k else 0)]
    rows = sorted({*rises, found.rank.size - 1})
    middle = len(rows) - 2 * _SHOWN
    for number, k in enumerate(rows):
        if middle <= 1 or not _SHOWN <= number < len(rows) - _SHOWN:
            table.add_row(*_row(found, k))
        elif number == _SHOWN:
            table.add_row("...", "", f"{middle} more in --json")
    return table


def _row(found: Observability, k: int) -> tuple[str, ...]:
    values, rank = found.singular[k], int(found.rank[k])
    return (
        str(k + 1),
        f"{found.seconds[k]:.3f}",
        _listed(found.contacts[k]) + (" opens" if found.released[k] else ""),
        f"{rank}/{found.size}",
        f"{values[0]:.3g}",
        f"{values[-1]:.3g}" if rank == found.size else "0",
        f"{found.condition[k]:.3g}" if rank == found.size else "-",
    )


def _listed(names: Sequence[str]) -> str:
    """Names in words; of many the first ones."""
    more = len(names) - _SHOWN
    return ", ".join(names[:_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _events(found: Observability, first: int) -> str:
    """The number of impacts and of releases among the first events."""
    releases = sum(found.released[:first].tolist())
    impacts = _count(first - releases, "impact")
    return f"{impacts} and {_count(releases, 'release')}" if releases else impacts


def _count(number: int, word: str, plural: str = "s") -> str:
    return f"{number} {word}{'' if number == 1 else plural}"
