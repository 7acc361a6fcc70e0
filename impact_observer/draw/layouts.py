# SPDX-License-Identifier: Apache-2.0
"""Layouts for plotting tools, written from the list of curves.

Foxglove imports JSON: panels by identifier, and a tree that splits the screen between them; curves
are message paths. PlotJuggler 3 loads XML: tabs, splitters, plots. It names a series by its path
in the message, an element of a ``JointState`` by the joint and a diagnostic by its key, and
computes transformed series by snippets of Lua.
"""

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

from impact_observer.draw.curves import Curve, CurveGroup, FieldStep, Transform
from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import interface
from impact_observer.plain_text import printable_lines

_Config: TypeAlias = dict[str, Any]
_Tree: TypeAlias = "str | _Config"

# Blue, vermilion, green, orange, purple of Okabe and Ito, for people who see no red or no green.
# The plant is grey, visible on white and on black, and its line is wider.
_PLANT = "#8c8c8c"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9")
_LONGEST_ARRAY = 100
"""PlotJuggler does not read longer arrays by default."""
_SCENE = interfaces.VIEWER_MARKERS.topic
"""The topic of the moving drawing of plant and estimates."""
_PLOT = {
    "showXAxisLabels": True,
    "showYAxisLabels": True,
    "showLegend": True,
    "legendDisplay": "floating",
    "showPlotValuesInLegend": False,
    "isSynced": True,
    "xAxisVal": "timestamp",
    "sidebarDimension": 240,
}
"""Settings of every plot of Foxglove."""
_LUA = {
    Transform.LOGARITHM: "if value > 0 then return time, math.log(value) / math.log(10) end",
    Transform.ROOT: "if value >= 0 then return time, math.sqrt(value) end",
}


def foxglove(curves: Sequence[Curve], topics: Iterable[str] | None = None) -> str:
    """A layout as Foxglove imports it.

    Args:
        curves: what to show.
        topics: absolute names of those that other panels may show; None for all.

    Returns:
        JSON with a final line end.

    Raises:
        UsageError: a path cannot be written.
    """
    present = None if topics is None else set(topics)
    panels = _Panels(curves)
    overview = [
        panels.plots(curves, CurveGroup.DISTANCE, most=1),
        panels.plots(curves, CurveGroup.POSITIONS, most=2),
        panels.transitions(curves),
    ]
    tabs = [("overview", _split("column", [each for each in overview if each]))]
    tabs += [
        (group.value, _split("column", [*panels.above(curves, group, present), tree]))
        for group in CurveGroup
        if (tree := panels.plots(curves, group))
    ]
    if present is None or _SCENE in present:
        tabs.append(("scene", panels.add("3D", {"topics": {_SCENE: {"visible": True}}})))
    titled = [{"title": title, "layout": tree} for title, tree in tabs]
    layout = panels.add("Tab", {"activeTabIdx": 0, "tabs": titled})
    whole = {
        "configById": panels.configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


def message_path(curve: Curve) -> str:
    """A curve in Foxglove's message path syntax, such as ``/monitor/error.v.@log10``.

    Raises:
        UsageError: a name holds both kinds of quotes, which the syntax cannot express.
    """
    shown = f".@{curve.transform.value}" if curve.transform.value else ""
    return curve.topic + "".join(map(_message_step, curve.steps)) + shown


def _message_step(step: FieldStep) -> str:
    if step.index is not None:
        return f".{step.field}[{step.index}]"
    key, value = step.where
    if not key:
        return f".{step.field}"
    quote = "'" if '"' in value else '"'
    if quote in value:
        raise UsageError(f"{value}: has both kinds of quotes; a message path can hold one only")
    return f".{step.field}[:]{{{key}=={quote}{value}{quote}}}"


class _Panels:
    """The panels of a Foxglove layout, by identifier."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.configs: dict[str, _Config] = {}
        self._colours = _colours(curves)

    def add(self, kind: str, config: _Config) -> str:
        """Add a panel; return its identifier."""
        name = f"{kind}!{len(self.configs)}"
        self.configs[name] = config
        return name

    def plots(self, curves: Sequence[Curve], group: CurveGroup, most: int | None = None) -> _Tree:
        """The plots of a group, at most so many; empty if it has none."""
        quantities = [each for each in curves if each.group is group and not each.is_state]
        axes = _by_plot(quantities)[:most]
        columns = _columns([self._plot(title, own) for title, own in axes])
        return _split("row", [_split("column", each) for each in columns]) if columns else ""

    def transitions(self, curves: Sequence[Curve]) -> str:
        """States over time, such as contacts and verdicts; empty if there are none."""
        states = [each for each in curves if each.is_state]
        if not states:
            return ""
        config = {"isSynced": True, "paths": [_path(each) for each in states]}
        return self.add("StateTransitions", config)

    def above(
        self, curves: Sequence[Curve], group: CurveGroup, present: set[str] | None
    ) -> list[_Tree]:
        """The panels above the plots of a group: states, the text of messages."""
        topic = interfaces.DIAGNOSTIC_ARRAYS.topic
        if group is CurveGroup.DIAGNOSTICS and (present is None or topic in present):
            config = {"minLevel": 0, "topicToRender": topic, "sortByLevel": True}
            return [self.add("DiagnosticSummary", {**config, "hardwareIdFilter": ""})]
        if group is not CurveGroup.EVENTS or not (states := self.transitions(curves)):
            return []
        found = dict.fromkeys(each.topic for each in curves if each.steps[0].field == "verdict")
        texts: list[_Tree] = [
            self.add("RawMessages", {"topicPath": topic, "diffEnabled": False}) for topic in found
        ]
        return [states, *([_split("row", texts)] if texts else [])]

    def _plot(self, title: str, curves: Sequence[Curve]) -> str:
        paths = [
            {
                **_path(each),
                "color": self._colours[each.source],
                "lineSize": 3 if each.source == "plant" else 1.5,
                "showLine": each.group is not CurveGroup.EVENTS,
            }
            for each in curves
        ]
        titles = {"foxglovePanelTitle": title, "yAxisLabel": title}
        return self.add("Plot", {**titles, "paths": paths, **_PLOT})


def _path(curve: Curve) -> _Config:
    """A path over the stamps of headers: messages may arrive out of order."""
    return {
        "value": message_path(curve),
        "enabled": True,
        "timestampMethod": "headerStamp",
        "label": curve.name,
    }


def _split(direction: str, trees: Sequence[_Tree]) -> _Tree:
    """Panels of equal size side by side (``row``) or below each other (``column``)."""
    first, *others = trees
    if not others:
        return first
    return {
        "direction": direction,
        "splitPercentage": round(100 / len(trees), 3),
        "first": first,
        "second": _split(direction, others),
    }


def plotjuggler(curves: Sequence[Curve]) -> str:
    """A layout that PlotJuggler 3 loads.

    Args:
        curves: what to show; those in arrays that PlotJuggler does not read are left out.

    Returns:
        XML with a final line end.
    """
    readable = _readable(curves)
    colours = _colours(readable)
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for group in CurveGroup:
        if own := [each for each in readable if each.group is group]:
            _tab(ET.SubElement(tabs, "Tab", tab_name=group.value, containers="1"), own, colours)
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "Plugins")
    equations = ET.SubElement(root, "customMathEquations")
    for each in readable:
        if each.transform in _LUA:
            snippet = ET.SubElement(equations, "snippet", name=series_drawn(each))
            ET.SubElement(snippet, "global")
            # A value without a transform, such as -1 for "none", gives no sample.
            ET.SubElement(snippet, "function").text = f"{_LUA[each.transform]}\nreturn {{}}"
            ET.SubElement(snippet, "linked_source").text = series(each)
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    text = printable_lines(ET.tostring(root, encoding="unicode"))
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{text}\n"


def series(curve: Curve) -> str:
    """The name of PlotJuggler's series of a curve, before its transform.

    ``/plant/joint_states/x1/position``, ``/monitor/error/position_error[0]``,
    ``/diagnostics/two_mass//observer: impacts/level``; the first of several switches in an event.
    """
    found = interface(curve.topic)
    if found is not None and found.type == interfaces.JOINT_STATE:
        return f"{curve.topic}/{curve.element}/{curve.steps[0].field}"
    if found is not None and found.type == interfaces.DIAGNOSTICS:
        status, *inside = curve.steps
        key = inside[0].where[1] or inside[0].field
        return f"{curve.topic}/{curve.element}/{status.where[1]}/{key}"
    name = curve.topic
    for step in curve.steps:
        index = 0 if step.where[0] else step.index
        name += f"/{step.field}" + ("" if index is None else f"[{index}]")
    return name


def series_drawn(curve: Curve) -> str:
    """The name of the series that is drawn; a transformed one has a name of its own."""
    return f"{curve.transform.value} {curve.name}" if curve.transform in _LUA else series(curve)


def _readable(curves: Sequence[Curve]) -> list[Curve]:
    """Curves in arrays that PlotJuggler reads; the last index shows how long an array is."""
    last = {(each.topic, each.steps[0].field): each.steps[0].index or 0 for each in curves}
    return [each for each in curves if last[each.topic, each.steps[0].field] < _LONGEST_ARRAY]


def _tab(tab: ET.Element, curves: Sequence[Curve], colours: dict[str, str]) -> None:
    columns = _columns(_by_plot(curves))
    rows = ET.SubElement(ET.SubElement(tab, "Container"), "DockSplitter", _sizes("|", columns))
    for column in columns:
        splitter = ET.SubElement(rows, "DockSplitter", _sizes("-", column))
        for title, curves_there in column:
            area = ET.SubElement(splitter, "DockArea", name=title)
            dots = curves_there[0].group is CurveGroup.EVENTS
            settings = {"flip_x": "false", "flip_y": "false", "line_width": "1.5"}
            style = {"mode": "TimeSeries", "style": "Dots" if dots else "Lines"}
            plot = ET.SubElement(area, "plot", {**style, **settings})
            ET.SubElement(plot, "limitY")
            drawn = {series_drawn(each): colours[each.source] for each in curves_there}
            for name, colour in drawn.items():
                ET.SubElement(plot, "curve", name=name, color=colour)


def _sizes(orientation: str, parts: Sequence[object]) -> dict[str, str]:
    """Attributes of a splitter of equal parts: ``|`` side by side, ``-`` below each other."""
    sizes = ";".join([f"{1 / len(parts):.6g}"] * len(parts))
    return {"orientation": orientation, "count": str(len(parts)), "sizes": sizes}


def _columns(parts: Sequence[Any]) -> list[list[Any]]:
    """Parts in columns of nearly equal length."""
    if not parts:
        return []
    count = math.ceil(math.sqrt(len(parts) / 2))
    length = math.ceil(len(parts) / count)
    return [list(parts[k : k + length]) for k in range(0, len(parts), length)]


def _by_plot(curves: Iterable[Curve]) -> list[tuple[str, list[Curve]]]:
    plots: dict[str, list[Curve]] = {}
    for each in curves:
        plots.setdefault(each.plot, []).append(each)
    return list(plots.items())


def _colours(curves: Iterable[Curve]) -> dict[str, str]:
    """A colour for each source, in the order of their first curves."""
    sources = dict.fromkeys(each.source for each in curves if each.source != "plant")
    colours = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(sources)}
    return {"plant": _PLANT, **colours}
