# SPDX-License-Identifier: Apache-2.0
"""Layouts for plotting tools, written from the list of curves.

Foxglove imports JSON: panels by identifier, and a tree that splits the screen between the panels.
PlotJuggler 3 loads XML: tabs, splitters, plots, and snippets of Lua for transformed series.
"""

import json
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

from impact_observer.draw.curves import PLANT, TABS, Curve
from impact_observer.io import interfaces
from impact_observer.plain_text import printable_lines

_Config: TypeAlias = dict[str, Any]
_Tree: TypeAlias = "str | _Config"
"""The identifier of a panel, or a split between two trees."""

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
    "log10": "if value > 0 then return time, math.log(value) / math.log(10) end",
    "sqrt": "if value >= 0 then return time, math.sqrt(value) end",
}
_DOTS = "events"
"""The tab whose curves are dots, not lines."""


def foxglove(curves: Sequence[Curve], topics: Iterable[str] | None = None) -> str:
    """A layout as Foxglove imports it.

    Args:
        curves: what is shown.
        topics: absolute names of the topics that other panels may show; None for all.

    Returns:
        JSON with a final line end.
    """
    present = None if topics is None else set(topics)
    panels = _Panels(curves)
    overview = [panels.plots("distance", 1), panels.plots("positions", 2), panels.transitions()]
    tabs = [("overview", _split("column", [each for each in overview if each]))]
    tabs += [
        (tab, _split("column", [*panels.above(tab, present), plots]))
        for tab in TABS
        if (plots := panels.plots(tab))
    ]
    if present is None or _SCENE in present:
        tabs.append(("scene", panels.new_panel("3D", {"topics": {_SCENE: {"visible": True}}})))
    titled = [{"title": title, "layout": tree} for title, tree in tabs]
    layout = panels.new_panel("Tab", {"activeTabIdx": 0, "tabs": titled})
    whole = {
        "configById": panels.configs,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }
    return json.dumps(whole, indent=2, ensure_ascii=False) + "\n"


class _Panels:
    """The panels of a Foxglove layout, by identifier."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.configs: dict[str, _Config] = {}
        self._curves = curves
        self._colours = _colours(curves)

    def new_panel(self, kind: str, config: _Config) -> str:
        """Make a panel; return its identifier."""
        name = f"{kind}!{len(self.configs)}"
        self.configs[name] = config
        return name

    def plots(self, tab: str, most: int | None = None) -> _Tree:
        """The plots of a tab, at most so many; empty if the tab has none."""
        quantities = [each for each in self._curves if each.tab == tab and not each.is_state]
        plots = [self._plot(title, own) for title, own in _by_plot(quantities)[:most]]
        columns = [_split("column", each) for each in _columns(plots)]
        return _split("row", columns) if columns else ""

    def transitions(self) -> str:
        """A panel of states over time, such as contacts and verdicts; empty if there are none."""
        states = [_path(each) for each in self._curves if each.is_state]
        if not states:
            return ""
        return self.new_panel("StateTransitions", {"isSynced": True, "paths": states})

    def above(self, tab: str, present: set[str] | None) -> list[_Tree]:
        """The panels above the plots of a tab: states, the text of messages."""
        topic = interfaces.DIAGNOSTIC_ARRAYS.topic
        if tab == "diagnostics" and (present is None or topic in present):
            config = {"minLevel": 0, "topicToRender": topic, "sortByLevel": True}
            return [self.new_panel("DiagnosticSummary", {**config, "hardwareIdFilter": ""})]
        if tab != "events" or not (states := self.transitions()):
            return []
        verdicts = [each.topic for each in self._curves if each.series.endswith("/verdict")]
        texts: list[_Tree] = [
            self.new_panel("RawMessages", {"topicPath": each, "diffEnabled": False})
            for each in dict.fromkeys(verdicts)
        ]
        return [states, *([_split("row", texts)] if texts else [])]

    def _plot(self, title: str, curves: Sequence[Curve]) -> str:
        paths = [
            {
                **_path(each),
                "color": self._colours[each.source],
                "lineSize": 3 if each.source == PLANT else 1.5,
                "showLine": each.tab != _DOTS,
            }
            for each in curves
        ]
        titles = {"foxglovePanelTitle": title, "yAxisLabel": title}
        return self.new_panel("Plot", {**titles, "paths": paths, **_PLOT})


def _path(curve: Curve) -> _Config:
    """A path over the stamps of headers: messages may arrive out of order."""
    return {
        "value": curve.path,
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
        curves: what is shown; curves in arrays that PlotJuggler does not read are left out.

    Returns:
        XML with a final line end.
    """
    readable = _readable(curves)
    colours = _colours(readable)
    root = ET.Element("root")
    tabs = ET.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    for tab in TABS:
        if own := [each for each in readable if each.tab == tab]:
            _add_plots(ET.SubElement(tabs, "Tab", tab_name=tab, containers="1"), own, colours)
    ET.SubElement(tabs, "currentTabIndex", index="0")
    ET.SubElement(root, "use_relative_time_offset", enabled="1")
    ET.SubElement(root, "Plugins")
    equations = ET.SubElement(root, "customMathEquations")
    for each in readable:
        if each.transform:
            snippet = ET.SubElement(equations, "snippet", name=_series_drawn(each))
            ET.SubElement(snippet, "global")
            # A value without a transform, such as -1 for "none", gives no sample.
            ET.SubElement(snippet, "function").text = f"{_LUA[each.transform]}\nreturn {{}}"
            ET.SubElement(snippet, "linked_source").text = each.series
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    text = printable_lines(ET.tostring(root, encoding="unicode"))
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{text}\n"


def _series_drawn(curve: Curve) -> str:
    """The name of the series that is drawn; a transformed one has a name of its own."""
    return f"{curve.transform} {curve.name}" if curve.transform else curve.series


def _readable(curves: Sequence[Curve]) -> list[Curve]:
    """Curves in arrays that PlotJuggler reads; the last index shows how long an array is."""
    split = [re.fullmatch(r"(.*)\[(\d+)\]", each.series) for each in curves]
    last = {each[1]: int(each[2]) for each in split if each}
    return [
        curve
        for curve, each in zip(curves, split, strict=True)
        if not each or last[each[1]] < _LONGEST_ARRAY
    ]


def _add_plots(tab: ET.Element, curves: Sequence[Curve], colours: dict[str, str]) -> None:
    """Fill a tab with the plots of its curves."""
    columns = _columns(_by_plot(curves))
    rows = ET.SubElement(ET.SubElement(tab, "Container"), "DockSplitter", _sizes("|", columns))
    for column in columns:
        splitter = ET.SubElement(rows, "DockSplitter", _sizes("-", column))
        for title, own in column:
            area = ET.SubElement(splitter, "DockArea", name=title)
            settings = {"flip_x": "false", "flip_y": "false", "line_width": "1.5"}
            style = {"mode": "TimeSeries", "style": "Dots" if own[0].tab == _DOTS else "Lines"}
            plot = ET.SubElement(area, "plot", {**style, **settings})
            ET.SubElement(plot, "limitY")
            drawn = {_series_drawn(each): colours[each.source] for each in own}
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
    """Curves by the title of their plot."""
    plots: dict[str, list[Curve]] = {}
    for each in curves:
        plots.setdefault(each.plot, []).append(each)
    return list(plots.items())


def _colours(curves: Iterable[Curve]) -> dict[str, str]:
    """A colour for each source, in the order of the sources' first curves."""
    sources = dict.fromkeys(each.source for each in curves if each.source != PLANT)
    colours = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(sources)}
    return {PLANT: _PLANT, **colours}
