# SPDX-License-Identifier: Apache-2.0
"""A page of HTML with a recording's curves, to zoom in, by plotly; no network is needed."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from impact_observer.draw.pictures import Style
from impact_observer.draw.plot.picture import (
    BAND,
    MARKS,
    limits,
    mark_rows_of,
    styles_of_recording,
)
from impact_observer.draw.plot.series import PlotContent
from impact_observer.errors import UsageError
from impact_observer.output_files import replacing
from impact_observer.plain_text import markup, printable

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

_PANEL, _ROW, _SPACE, _EDGES = 190, 20, 14, 130
"""Heights of a panel, of a row of marks, between panels, and above and below all, pixels."""
_DASHES = {"-": "solid", "--": "dash", ":": "dot", "-.": "dashdot"}
_SYMBOLS = {"|": "line-ns-open", "x": "x-thin-open", "^": "triangle-up-open"}
"""Symbols of plotly by the markers of matplotlib."""


def check_plotly(path: Path) -> None:
    """Raise unless plotly, which makes the page ``path``, is installed.

    Raises:
        UsageError: plotly is not installed.
    """
    try:
        import plotly  # noqa: F401
    except ImportError as error:
        raise UsageError(
            f"{path}: a page needs plotly ({error}); pip install plotly, or write a .png, .svg or"
            " .pdf"
        ) from None


def write_page(recording: PlotContent, path: Path) -> None:
    """Write the page; an existing file is replaced.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    title = markup(printable(recording.name)) or "recording"
    plot = page_figure(recording).to_html(
        full_html=False,
        include_plotlyjs=True,
        config={"scrollZoom": True, "displaylogo": False, "responsive": True},
    )
    text = (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'</head>\n<body style="font: 14px sans-serif"><h3>{title}</h3>\n<p>{_note(recording)}</p>'
        f"\n{plot}\n</body></html>\n"
    )
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page_figure(recording: PlotContent) -> "Figure":
    """The figure of plotly: a row of marks for each contact, below it a panel a quantity."""
    from plotly.subplots import make_subplots

    rows = mark_rows_of(recording)
    strip = [_ROW * (len(rows) + 1)] if rows else []
    heights = [*strip, *[_PANEL] * len(recording.quantities)]
    height = sum(heights) + _SPACE * (len(heights) - 1)
    figure = make_subplots(
        rows=len(heights),
        cols=1,
        shared_xaxes=True,
        row_heights=heights,
        vertical_spacing=_SPACE / height if len(heights) > 1 else 0.0,
    )
    for trace in _mark_traces(recording):
        figure.add_trace(trace, row=1, col=1)
    if rows:
        figure.update_yaxes(
            tickvals=list(range(len(rows))),
            ticktext=[_text(label) for label in rows],
            range=[len(rows) - 0.5, -0.5],
            showgrid=False,
            fixedrange=True,
            row=1,
            col=1,
        )
    styles = styles_of_recording(recording)
    for column, quantity in enumerate(recording.quantities):
        row = column + 1 + len(strip)
        figure.add_traces(_traces(recording, column, styles), rows=row, cols=1)
        low, high, cut_off = limits(recording, column)
        figure.update_yaxes(title_text=_text(quantity.label), range=[low, high], row=row, col=1)
        if cut_off:
            place = {"x": 1.0, "y": 1.0, "xref": "x domain", "yref": "y domain"}
            figure.add_annotation(text=cut_off, showarrow=False, **place, row=row, col=1)
    figure.update_xaxes(range=[recording.start, recording.end], showspikes=True)
    figure.update_xaxes(title_text=recording.zero.axis, row=len(heights), col=1)
    figure.update_layout(
        template="simple_white",
        height=height + _EDGES,
        hovermode="x",
        dragmode="pan",
        legend={"orientation": "h", "yanchor": "bottom", "y": 1.0},
        margin={"l": 80, "r": 20, "t": _EDGES / 2, "b": _EDGES / 2},
    )
    return figure


def _traces(recording: PlotContent, column: int, styles: Sequence[Style]) -> list[Any]:
    """Bands and curves of all series, and samples of sensors, of one quantity."""
    from plotly.graph_objects import Scatter

    bands, curves = [], []
    for each, style in zip(recording.series, styles, strict=True):
        seconds, values, deviations = (
            a[:, column] for a in (each.seconds, each.values, BAND * each.deviations)
        )
        group = {"name": _text(each.label), "legendgroup": _text(each.label)}
        known = np.isfinite(deviations)
        if known.any():
            t, y, d = seconds[known], values[known], deviations[known]
            red, green, blue = (round(255 * part) for part in to_rgb(style["color"]))
            bands.append(
                Scatter(
                    x=np.concatenate([t, t[::-1]]),
                    y=np.concatenate([y + d, (y - d)[::-1]]),
                    fill="toself",
                    fillcolor=f"rgba({red},{green},{blue},0.22)",
                    line={"width": 0},
                    mode="lines",
                    hoverinfo="skip",
                    showlegend=False,
                    **group,
                )
            )
        deviation = " ± %{customdata:.2g}" if known.any() else ""
        curves.append(
            Scatter(
                x=seconds,
                y=values,
                customdata=deviations,
                hovertemplate=f"%{{y:.7g}}{deviation}",
                showlegend=column == 0,
                **_line(style),
                **group,
            )
        )
    dots = recording.dots.get(recording.quantities[column].name, ())
    samples = [
        Scatter(
            x=each.seconds,
            y=each.values,
            mode="markers",
            marker={"size": 3, "color": "black"},
            name=f"samples: {_text(each.name)}",
        )
        for each in dots
    ]
    return [*bands, *curves, *samples]


def _line(style: Style) -> dict[str, Any]:
    """The style of a curve, in the words of plotly."""
    colour = to_hex(style["color"])
    if style.get("linestyle") == "none":
        return {"mode": "markers", "marker": {"color": colour, "size": 6}}
    dash = _DASHES.get(style.get("linestyle", "-"), "longdash")
    return {"mode": "lines", "line": {"color": colour, "width": style["linewidth"], "dash": dash}}


def _mark_traces(recording: PlotContent) -> Iterator[Any]:
    """The impacts by verdict, in one row a contact; each verdict once in the legend."""
    from plotly.graph_objects import Scatter

    named = set[str]()
    for place, row in enumerate(mark_rows_of(recording).values()):
        for ruling, seconds in row.items():
            name, style = MARKS[ruling]
            marker = {"symbol": _SYMBOLS[style["marker"]], "color": to_hex(style["color"])}
            yield Scatter(
                x=seconds,
                y=np.full(seconds.size, place),
                mode="markers",
                marker={**marker, "size": 9, "line": {"width": 1.5}},
                name=name,
                legendgroup=name,
                showlegend=name not in named,
                hovertemplate="%{x:.6f} s",
            )
            named.add(name)


def _note(recording: PlotContent) -> str:
    """Advice on reading the curves of the page, and on zooming."""
    note = f"Shaded: ± {BAND:g} standard deviations. Wheel: zoom. Drag: move. Double click: all."
    if recording.left_out:
        note += f" {recording.left_out} coordinates that move less are not drawn."
    if any(len(each.values) < each.samples for each in recording.series):
        note += " Long curves show their extremes; a shorter part has every sample."
    return note


def _text(name: str) -> str:
    """A name from a bag as text of plotly; the bag may come from a stranger."""
    return markup(printable(name))
