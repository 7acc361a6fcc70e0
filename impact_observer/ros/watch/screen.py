# SPDX-License-Identifier: Apache-2.0
"""What ``watch`` shows: a pure function from a snapshot to something that rich can print."""

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

from rich import box
from rich.cells import cell_len
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from impact_observer.events import Verdict
from impact_observer.model.free_parameters import with_unit
from impact_observer.ros.watch.charts import BLOCKS, bars, decades, from_first
from impact_observer.ros.watch.snapshot import (
    EstimateHistory,
    ObserverSnapshot,
    Snapshot,
    StateLine,
    TopicRate,
)
from impact_observer.stamps import seconds_between

_NARROWEST = 58
"""Least columns of an observer beside another."""
_SILENCE = 2.0
"""After so long without a message a topic is shown as silent, s."""
_LOWEST = 12
"""Least rows of an observer under another."""
_LOW = 36
"""A screen of fewer rows shows the topics of the plant in one row."""
_MOST_CHART = 6
_MOST_VERDICTS = 8
_MARGIN = 7
"""Columns at the left of a chart."""
_LEVELS = ("ok", "warning", "error", "stale")
_STYLES = ("", "bold yellow", "bold red", "bold red")
_ROUNDING = 2.0**-52
_CHART_STYLE = "cyan"


@dataclass(frozen=True, slots=True)
class ScreenStyle:
    """Size and characters of a terminal.

    Attributes:
        width: columns.
        height: rows; None for as many as it takes.
        keys: whether keys are read.
        frozen: whether the screen is frozen.
        levels: characters of charts, from empty to full.
    """

    width: int
    height: int | None = None
    keys: bool = False
    frozen: bool = False
    levels: str = BLOCKS


def screen(whole: Snapshot, style: ScreenStyle) -> RenderableType:
    """The whole picture.

    Args:
        whole: what is shown.
        style: the terminal.
    """
    head, foot = _head(whole, style), _foot(whole, style)
    if not whole.observers:
        words = "waiting for observers: no node publishes observer/state or observer_<law>/state"
        return Group(*head, Panel(Text(words), box=box.ROUNDED), *foot)
    columns = max(min(len(whole.observers), style.width // _NARROWEST), 1)
    rows = -(-len(whole.observers) // columns)
    budget, shown = None, whole.observers
    if style.height is not None:
        room = style.height - len(head) - len(foot)
        if rows > 1 and room < rows * _LOWEST:
            rows = max((room - 1) // _LOWEST, 1)
            shown = shown[: rows * columns]
            foot = [*_others(whole.observers[len(shown) :]), *foot]
            room -= 1
        budget = max(room // rows, 3)
    width = style.width // columns
    panels = [_observer(each, whole, width, budget, style.levels) for each in shown]
    grid = Table.grid(expand=True)
    for _ in range(columns):
        grid.add_column(ratio=1)
    for k in range(0, len(panels), columns):
        grid.add_row(*panels[k : k + columns])
    return Group(*head, grid, *foot)


def line(whole: Snapshot) -> str:
    """A snapshot in one line, for a file or a pipe."""
    if whole.is_empty:
        return "nothing received yet: neither a plant nor an observer"
    parts = [f"{_time(whole.clock, whole)}, {_impacts(whole)}"]
    for each in whole.observers:
        words = [f"V {_distance(each, whole, brief=True)}"]
        if each.convergence.now is not None and each.convergence.now >= 0:
            words.append(f"convergence {_energy(each.convergence.now, each)}")
        if each.synchronized:
            words.append("synchronized")
        elif each.obstacle:
            words.append(f"not synchronized: {each.obstacle}")
        if each.health is not None and each.health[0]:
            words.append(_health(each))
        parts.append(f"{each.name.lstrip('/')}: {', '.join(words)}")
    if whole.merged:
        parts.append(f"warning: {_mixture(whole)}")
    return "; ".join(parts if whole.observers else [*parts, "no estimate yet"])


def _mixture(whole: Snapshot) -> str:
    """That what is shown comes from several nodes."""
    return (
        f"several nodes publish {', '.join(whole.merged)}, and what is shown is a mixture: start"
        " one with another name (-r __node:=NAME), or on another ROS_DOMAIN_ID"
    )


def _energy(value: float, seen: ObserverSnapshot) -> str:
    """A V distance, J; 0 where it is only what the numbers of the state are rounded by."""
    largest = max((abs(each.estimate) for each in seen.lines), default=0.0)
    return "0 J" if value < (_ROUNDING * largest) ** 2 else f"{value:.2e} J"


def _head(whole: Snapshot, style: ScreenStyle) -> list[RenderableType]:
    """The plant, and the rates of its topics."""
    if whole.is_empty:
        words = "nothing received yet: no plant, no observer; is one running on this ROS domain?"
        return [Text(words, style="bold", overflow="fold")]
    first = [
        whole.model or "no model",
        f"{_time(whole.clock, whole)} ({'/clock' if whole.simulated else 'system clock'})",
        _impacts(whole),
    ]
    if not whole.truth:
        first.append("no truth")
    texts = [_cut(each, "bold") for each in _packed(first, style.width)]
    if whole.merged:
        rows = textwrap.wrap(_mixture(whole), style.width, max_lines=3)
        texts += [_cut(each, "bold yellow") for each in rows]
    low = style.height is not None and style.height < _LOW
    flows = list(_packed(map(_flow, whole.flows), style.width - 4 * low))
    if low and len(flows) > 1:
        flows = [f"{flows[0]} ..."]
    return [*texts, *(_cut(each, "dim") for each in flows)]


def _foot(whole: Snapshot, style: ScreenStyle) -> list[RenderableType]:
    """Keys, and the last message that could not be read."""
    words = ["FROZEN: space goes on" if style.frozen else "space freezes", "q ends"]
    foot: list[RenderableType] = []
    if whole.trouble:
        foot.append(_cut(f"not understood: {whole.trouble}"))
    if style.keys:
        foot.append(_cut("   ".join(words), "reverse" if style.frozen else "dim"))
    return foot


def _others(observers: Sequence[ObserverSnapshot]) -> list[RenderableType]:
    """The observers without room, and how to see them."""
    if not observers:
        return []
    names = ", ".join(each.name.lstrip("/") for each in observers)
    return [_cut(f"... {len(observers)} more, shown with --observers: {names}", "dim")]


@dataclass(frozen=True, slots=True)
class _Plan:
    """Rows of the parts of an observer."""

    lines: int
    chart: int
    verdicts: int
    flows: int


def _plan(seen: ObserverSnapshot, rows: int | None, words: int, flows: int) -> _Plan:
    """Distribute ``rows``: first a few for every part, then the rest.

    Args:
        seen: the observer.
        rows: with the frame; None for enough.
        words: rows that are always shown.
        flows: rows of the topics.
    """
    size, events, drawn = len(seen.lines), len(seen.verdicts), bool(seen.distance.values)
    if rows is None:
        return _Plan(size, 4 * drawn, min(events, _MOST_VERDICTS), flows)
    left = rows - 2 - words - drawn - bool(size)
    lines = size if size <= left else max(left - drawn - 1, 2)  # one row counts the others
    left -= lines + (lines < size)
    chart = int(drawn and left > 0)
    verdicts = max(min(events, left - chart, 3), 0)
    left -= chart + verdicts
    flows = flows if left >= flows else 0
    left -= flows
    more = max(min(left, _MOST_CHART - 1), 0) if chart else 0
    return _Plan(
        lines, chart + more, verdicts + max(min(left - more, events - verdicts), 0), flows
    )


def _observer(
    seen: ObserverSnapshot, whole: Snapshot, width: int, rows: int | None, levels: str
) -> Panel:
    """One observer in a frame of ``width`` columns, and at most ``rows``."""
    inner = width - 4
    own_error, flows = _own_error(seen, inner, levels), list(_packed(_own_flows(seen), inner))
    own_error = [*own_error, *_sensors(seen)]
    plan = _plan(seen, rows, len(own_error) + 2, len(flows))
    parts: list[RenderableType] = []
    if seen.lines:
        parts += _table(seen, plan.lines, inner)
    else:
        parts.append(_cut("no estimate yet: it begins with the first impact"))
    parts.append(_cut(f"V  {_distance(seen, whole)}"))
    parts += _chart(seen.distance, inner, plan.chart, levels)
    parts += map(_cut, own_error)
    counts = ", ".join(f"{n} {ruling}" for ruling, n in seen.counts) or "waiting for impacts ..."
    parts.append(_cut(f"events  {counts}"))
    epoch = seen.epoch or whole.epoch
    parts += [_verdict(*each, epoch) for each in seen.verdicts[: plan.verdicts]]
    parts.append(_cut(f"health  {_health(seen)}", _STYLES[_level(seen)]))
    parts += [_cut(each, "dim") for each in flows[: plan.flows]]
    law = f" ({seen.law})" if seen.law else ""
    title = Text(f"{seen.name.lstrip('/')}{law}", style="bold")
    taken = 2 + len(parts) + min(plan.lines, len(seen.lines))
    cut = rows if rows is not None and rows < taken else None
    return Panel(Group(*parts), title=title, title_align="left", box=box.ROUNDED, height=cut)


def _table(seen: ObserverSnapshot, rows: int, width: int) -> list[RenderableType]:
    """Estimates against the truth, as many rows and columns as fit."""
    shown = seen.lines[:rows]
    columns = {
        "": [each.name for each in shown],
        " ": [each.unit for each in shown],
        "estimate": [_value(each.estimate) for each in shown],
        "truth": [_value(each.truth) for each in shown],
        "error": [_short(_difference(each), "+") for each in shown],
        "std. dev.": [_short(each.deviation) for each in shown],
    }
    columns = {header: cells for header, cells in columns.items() if any(cells)}
    widths = {name: 2 + max(map(cell_len, [name, *cells])) for name, cells in columns.items()}
    for name in ("truth", "std. dev.", "error", " "):
        if sum(widths.values()) > width and name in columns:
            del columns[name], widths[name]
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    for header in columns:
        side: Literal["left", "right"] = "right" if header.strip() else "left"
        table.add_column(header, justify=side, no_wrap=True, overflow="ellipsis")
    for cells in zip(*columns.values(), strict=True):
        table.add_row(*cells)
    left = len(seen.lines) - rows
    return [table, *([_cut(f"... {left} more", "dim")] if left > 0 else [])]


def _difference(seen: StateLine) -> float | None:
    """Estimate minus truth."""
    return None if seen.truth is None else seen.estimate - seen.truth


def _short(value: float | None, sign: str = "") -> str:
    """A number with two digits."""
    return "" if value is None else f"{value:{sign}.1e}"


def _chart(history: EstimateHistory, width: int, rows: int, levels: str) -> list[RenderableType]:
    """A history with its decades at the left; empty where there is no room."""
    values = from_first(history.values)
    if not rows or not values:
        return []
    low, high = decades(values)
    drawn = bars(values, width - _MARGIN, rows, levels=levels)
    labels = [""] * rows
    labels[-1] = f"1e{low:+03d}"
    if rows > 1:
        labels[0] = f"1e{high:+03d}"
    return [
        Text.assemble((f"{label:>{_MARGIN - 1}} ", "dim"), (part, _CHART_STYLE))
        for label, part in zip(labels, drawn, strict=True)
    ]


def _own_error(seen: ObserverSnapshot, width: int, levels: str) -> list[str]:
    """What the observer reports of its own error, in rows."""
    rows = []
    convergence = seen.convergence
    if convergence.now is not None:
        agreed = ", synchronized" if seen.synchronized else ", not synchronized"
        agreed = "" if seen.obstacle else agreed
        words = (
            f"convergence  {_energy(convergence.now, seen)}{agreed}"
            if convergence.now >= 0
            else "one replica"
        )
        values = from_first(convergence.values)
        room = min(width - len(words) - 2, 24) if values and convergence.now >= 0 else 0
        rows.append(f"{words}  {bars(values, room, levels=levels)[0]}" if room > 7 else words)
    if seen.obstacle:
        rows.append(f"not synchronized  {seen.obstacle}")
    if seen.bound is not None:
        words = f"V <= {seen.bound:.3g} J, certified" if seen.bound >= 0 else "none certified"
        rows.append(f"bound  {words}")
    for name, value, deviation in seen.learned:
        what, _, unit = with_unit(name).rstrip("]").partition(" [")
        number = f"{value:.2e}" if name.startswith("clock") else f"{value:.6g}"
        estimate = " ".join(filter(None, (what, number, unit)))
        rows.append(f"learned  {estimate} +- {deviation:.1e}")
    if seen.closed:
        rows.append(f"closed  {', '.join(seen.closed)}")
    return rows


def _distance(seen: ObserverSnapshot, whole: Snapshot, *, brief: bool = False) -> str:
    """V at present, or why it is missing."""
    if seen.distance.now is None:
        if not whole.truth:
            return "unknown: no truth"
        if not seen.stamp:
            return "unknown: no estimate yet"
        return "unknown: no monitor, and no model of the plant's; give --model"
    if brief:
        return _energy(seen.distance.now, seen)
    span = (
        len(from_first(seen.distance.values)) * seen.distance.seconds / len(seen.distance.values)
    )
    source = " by the monitor" if seen.source == "monitor" else ""
    return f"{_energy(seen.distance.now, seen)}{source}, last {span:.0f} s"


def _verdict(verdict: Verdict, latency: float, epoch: int) -> Text:
    """One verdict."""
    words = [
        f"{seconds_between(epoch, verdict.stamp):>13.6f} s",
        verdict.contact or "all",
        verdict.ruling.name.lower().replace("_", " "),
        f"{verdict.innovation:.1f} std. dev." if verdict.innovation >= 0 else "",
        verdict.reason,
        f"{latency * 1e3:.1f} ms" if latency > 0 else "",
    ]
    return _cut("  ".join(word for word in words if word))


def _sensors(seen: ObserverSnapshot) -> list[str]:
    """A line for each sensor beside the impacts."""
    return [f"sensor  {each.name}: {each.message}" for each in seen.sensors]


def _health(seen: ObserverSnapshot) -> str:
    """Level and message of the diagnostics."""
    if seen.health is None:
        return "no diagnostics yet"
    return f"{_LEVELS[_level(seen)]}: {seen.health[1]}"


def _level(seen: ObserverSnapshot) -> int:
    """Level of the diagnostics; 0 before the first."""
    return 0 if seen.health is None else min(seen.health[0], len(_LEVELS) - 1)


def _own_flows(seen: ObserverSnapshot) -> list[str]:
    """Rates of the observer's own topics, and of its monitor's with its full name."""
    return [
        _flow(each, each.topic.removeprefix(f"{seen.name}/").lstrip("/")) for each in seen.flows
    ]


def _flow(flow: TopicRate, name: str = "") -> str:
    """Rate and latency of a topic."""
    words = [name or flow.topic]
    if flow.silent > _SILENCE and flow.rate is not None:
        words.append(f"silent {flow.silent:.0f} s")
    elif flow.rate is not None:
        words.append(f"{flow.rate:.3g} Hz")
    else:
        words.append(f"{flow.count}x")
    if flow.latency is not None:
        words.append(f"{flow.latency * 1e3:.1f} ms")
    return " ".join(words)


def _impacts(whole: Snapshot) -> str:
    """Number of impacts, and the last one."""
    if whole.last_impact is None:
        return "waiting for impacts ..."
    stamp, contacts = whole.last_impact
    ago = seconds_between(stamp, whole.clock)
    return f"{whole.impacts} impacts, last {ago:.1f} s ago ({contacts})"


def _time(stamp: int, whole: Snapshot) -> str:
    """A stamp since the epoch, if there is one."""
    return f"t = {seconds_between(whole.epoch, stamp):.2f} s"


def _value(value: float | None) -> str:
    """A number of constant width below 1e4."""
    if value is None:
        return ""
    return f"{value:+.6f}" if abs(value) < 1e4 else f"{value:+.5e}"


def _cut(text: str, style: str = "") -> Text:
    """One row, cut where it is too long."""
    return Text(text, style=style, no_wrap=True, overflow="ellipsis")


def _packed(words: Iterable[str], width: int) -> Iterator[str]:
    """Words in rows of at most ``width`` columns, never broken."""
    row = ""
    for word in words:
        if row and len(row) + 3 + len(word) > width:
            yield row
            row = ""
        row = f"{row}   {word}" if row else word
    if row:
        yield row
