"""Layouts for plotting tools, written from the one list of curves.

Foxglove imports JSON: panels by identifier, and a tree that splits the screen between them; paths
are its message paths. PlotJuggler 3 loads XML: tabs, splitters, plots; it names a series by its
way through the message, an element of a ``JointState`` by the joint and a diagnostic by its key,
and computes others by snippets of Lua.
"""

import json
import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

from impact_observer.draw.curves import Curve, CurveGroup, CurveStep, Shown
from impact_observer.errors import UsageError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import interface

_Config: TypeAlias = dict[str, Any]
_Tree: TypeAlias = "str | _Config"

# Blue, vermilion, green, orange, purple of Okabe and Ito, for eyes that see no red or no green;
# a grey that is seen on white and on black for the plant, whose line is wider too.
_PLANT = "#8c8c8c"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#e69f00", "#cc79a7", "#56b4e9")
_LONGEST_ARRAY = 100
"""Arrays of more numbers are not read by PlotJuggler, unless it is told to."""
_SCENE = interfaces.VIEWER_MARKERS.topic
"""Where plant and estimates are seen moving."""
_LUA = {
    Shown.LOGARITHM: "if value > 0 then return time, math.log(value) / math.log(10) end",
    Shown.ROOT: "if value >= 0 then return time, math.sqrt(value) end",
}


def foxglove(curves: Sequence[Curve], topics: Iterable[str] | None = None) -> str:
    """A layout as Foxglove imports it.

    Args:
        curves: what to show.
        topics: absolute names of what there is to see besides; None for all.

    Returns:
        JSON with a final line end.

    Raises:
        UsageError: a path cannot be written.
    """
    there = None if topics is None else set(topics)
    panels = _Panels(curves)
    overview: list[_Tree] = [
        panels.plots(curves, CurveGroup.DISTANCE, most=1),
        panels.plots(curves, CurveGroup.POSITIONS, most=2),
    ]
    if states := panels.transitions(curves):
        overview.append(states)
    tabs = [("overview", _split("column", [each for each in overview if each]))]
    tabs += [
        (group.value, _split("column", [*panels.beside(curves, group, there), tree]))
        for group in CurveGroup
        if (tree := panels.plots(curves, group))
    ]
    if there is None or _SCENE in there:
        tabs.append(("scene", panels.add("3D", {"topics": {_SCENE: {"visible": True}}})))
    layout = panels.add(
        "Tab",
        {"activeTabIdx": 0, "tabs": [{"title": title, "layout": tree} for title, tree in tabs]},
    )
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
        UsageError: a name holds both kinds of quotes, which the syntax cannot say.
    """
    shown = f".@{curve.shown.value}" if curve.shown.value else ""
    return curve.topic + "".join(map(_message_step, curve.steps)) + shown


def _message_step(step: CurveStep) -> str:
    """One step of a message path."""
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
    """Foxglove's panels: identifiers and what each shows."""

    def __init__(self, curves: Sequence[Curve]) -> None:
        self.configs: dict[str, _Config] = {}
        self._colours = _colours(curves)

    def add(self, kind: str, config: _Config) -> str:
        """A new panel; its identifier."""
        name = f"{kind}!{len(self.configs)}"
        self.configs[name] = config
        return name

    def plots(self, curves: Sequence[Curve], group: CurveGroup, most: int | None = None) -> _Tree:
        """The plots of a group, as many as wanted; empty where it has none."""
        quantities = [each for each in curves if each.group is group and not each.states]
        axes = _by_plot(quantities)[:most]
        return _grid([self._plot(title, on_them) for title, on_them in axes])

    def transitions(self, curves: Sequence[Curve]) -> str:
        """States over time: contacts, verdicts; empty where there are none."""
        states = [each for each in curves if each.states]
        if not states:
            return ""
        paths = [{**self._path(each), "label": each.name} for each in states]
        return self.add("StateTransitions", {"isSynced": True, "paths": paths})

    def beside(
        self, curves: Sequence[Curve], group: CurveGroup, there: set[str] | None
    ) -> list[_Tree]:
        """What stands above the plots of a group: states, the text of the messages."""
        topic = interfaces.DIAGNOSTIC_ARRAYS.topic
        if group is CurveGroup.DIAGNOSTICS and (there is None or topic in there):
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
        """One pair of axes."""
        return self.add(
            "Plot",
            {
                "foxglovePanelTitle": title,
                "yAxisLabel": title,
                "paths": [
                    {
                        **self._path(each),
                        "label": each.name,
                        "color": self._colours[each.source],
                        "lineSize": 3 if each.source == "plant" else 1.5,
                        "showLine": each.group is not CurveGroup.EVENTS,
                    }
                    for each in curves
                ],
                "showXAxisLabels": True,
                "showYAxisLabels": True,
                "showLegend": True,
                "legendDisplay": "floating",
                "showPlotValuesInLegend": False,
                "isSynced": True,
                "xAxisVal": "timestamp",
                "sidebarDimension": 240,
            },
        )

    @staticmethod
    def _path(curve: Curve) -> _Config:
        """A path, over the stamps of its messages: an estimate may come later than others."""
        return {"value": message_path(curve), "enabled": True, "timestampMethod": "headerStamp"}


def _split(direction: str, trees: Sequence[_Tree]) -> _Tree:
    """Panels one beside (``row``) or under (``column``) another, of equal size."""
    first, *others = trees
    if not others:
        return first
    return {
        "direction": direction,
        "splitPercentage": round(100 / len(trees), 3),
        "first": first,
        "second": _split(direction, others),
    }


def _grid(panels: Sequence[str]) -> _Tree:
    """Panels in columns, about twice as wide as high; empty for none."""
    columns = [_split("column", column) for column in _columns(panels)]
    return _split("row", columns) if columns else ""


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
        if each.shown in _LUA:
            snippet = ET.SubElement(equations, "snippet", name=series_drawn(each))
            ET.SubElement(snippet, "global")
            # What is not to be drawn, as -1 for "none", becomes no sample at all.
            ET.SubElement(snippet, "function").text = f"{_LUA[each.shown]}\nreturn {{}}"
            ET.SubElement(snippet, "linked_source").text = series(each)
    ET.SubElement(root, "snippets")
    ET.indent(root, " ")
    return f"<?xml version='1.0' encoding='UTF-8'?>\n{ET.tostring(root, encoding='unicode')}\n"


def series(curve: Curve) -> str:
    """The name of PlotJuggler's series that a curve is drawn of.

    ``/plant/joint_states/x1/position``, ``/monitor/error/position_error[0]``,
    ``/diagnostics/two_mass//observer: impacts/level``; of several switches in one event the first.
    """
    known = interface(curve.topic)
    if known is not None and known.type == interfaces.JOINT_STATE:
        return f"{curve.topic}/{curve.element}/{curve.steps[0].field}"
    if known is not None and known.type == interfaces.DIAGNOSTICS:
        status, *inside = curve.steps
        key = inside[0].where[1] or inside[0].field
        return f"{curve.topic}/{curve.element}/{status.where[1]}/{key}"
    return curve.topic + "".join(map(_series_step, curve.steps))


def series_drawn(curve: Curve) -> str:
    """The name of the series that is drawn: what is computed has a name of its own."""
    return f"{curve.shown.value} {curve.name}" if curve.shown in _LUA else series(curve)


def _series_step(step: CurveStep) -> str:
    """One step of the name of a series."""
    index = 0 if step.where[0] else step.index
    return f"/{step.field}" + ("" if index is None else f"[{index}]")


def _readable(curves: Sequence[Curve]) -> list[Curve]:
    """Those that lie in no array that PlotJuggler finds too long; the last entry tells that."""
    last = {(each.topic, each.steps[0].field): each.steps[0].index or 0 for each in curves}
    return [each for each in curves if last[each.topic, each.steps[0].field] < _LONGEST_ARRAY]


def _tab(tab: ET.Element, curves: Sequence[Curve], colours: dict[str, str]) -> None:
    """Fill a tab with plots in columns."""
    columns = _columns(_by_plot(curves))
    rows = ET.SubElement(ET.SubElement(tab, "Container"), "DockSplitter", _sizes("|", columns))
    for column in columns:
        splitter = ET.SubElement(rows, "DockSplitter", _sizes("-", column))
        for title, on_them in column:
            area = ET.SubElement(splitter, "DockArea", name=title)
            dots = on_them[0].group is CurveGroup.EVENTS
            plot = ET.SubElement(
                area,
                "plot",
                mode="TimeSeries",
                style="Dots" if dots else "Lines",
                flip_x="false",
                flip_y="false",
                line_width="1.5",
            )
            ET.SubElement(plot, "limitY")
            drawn = {series_drawn(each): colours[each.source] for each in on_them}
            for name, colour in drawn.items():
                ET.SubElement(plot, "curve", name=name, color=colour)


def _sizes(orientation: str, parts: Sequence[object]) -> dict[str, str]:
    """A splitter of equal parts: ``|`` beside, ``-`` under each other."""
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
    """Titles of plots, and the curves of each."""
    plots: dict[str, list[Curve]] = {}
    for each in curves:
        plots.setdefault(each.plot, []).append(each)
    return list(plots.items())


def _colours(curves: Iterable[Curve]) -> dict[str, str]:
    """A colour for each source, in the order of their first curves."""
    sources = dict.fromkeys(each.source for each in curves if each.source != "plant")
    colours = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(sources)}
    return {"plant": _PLANT, **colours}
