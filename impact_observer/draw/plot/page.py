# SPDX-License-Identifier: Apache-2.0
"""A page of HTML with a recording's curves, to zoom in; it needs no network."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from impact_observer.draw.plot.picture import BAND, MARKS, mark_rows_of, styles_of
from impact_observer.draw.plot.series import PlotContent
from impact_observer.errors import UsageError
from impact_observer.plain_text import markup, printable
from impact_observer.states import Vector

_DASHES = {"-": [], "--": [7, 4], ":": [2, 3], "-.": [8, 3, 2, 3]}


def write_page(recording: PlotContent, path: Path) -> None:
    """Write the page; an existing file is replaced.

    Raises:
        UsageError: the file cannot be written.
    """
    # In a script "<" could end it: names are those of a file that may come from a stranger.
    data = json.dumps(_content(recording), separators=(",", ":")).replace("<", "\\u003c")
    title = markup(recording.name or "recording")
    try:
        path.write_text(_PAGE.replace("TITLE", title).replace("DATA", data), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: cannot be written: {error.strerror}") from None


def _content(recording: PlotContent) -> dict[str, Any]:
    """What the script draws."""
    drawn = styles_of(recording.series)
    series = [
        {
            "label": printable(each.label),
            "colour": to_hex(style["color"]),
            "width": style["linewidth"],
            "dash": _DASHES.get(style.get("linestyle", "-"), [4, 2]),
            "samples": each.samples,
            "kept": len(each.values),
        }
        for each, style in zip(recording.series, drawn, strict=True)
    ]
    panels = [
        {
            "label": printable(quantity.label),
            "curves": [
                {
                    "t": _numbers(each.seconds[:, column], 9),
                    "y": _rounded(each.values[:, column]),
                    "d": _rounded(BAND * each.deviations[:, column])
                    if np.isfinite(each.deviations[:, column]).all()
                    else [],
                }
                for each in recording.series
            ],
            "dots": [
                {
                    "name": printable(each.name),
                    "t": _numbers(each.seconds, 9),
                    "y": _rounded(each.values),
                }
                for each in recording.dots.get(quantity.name, ())
            ],
        }
        for column, quantity in enumerate(recording.quantities)
    ]
    marks = [
        {
            "label": printable(label),
            "marks": [
                {
                    "t": _numbers(seconds, 9),
                    "sign": MARKS[ruling][1]["marker"],
                    "colour": to_hex(MARKS[ruling][1]["color"]),
                    "what": MARKS[ruling][0],
                }
                for ruling, seconds in row.items()
            ],
        }
        for label, row in mark_rows_of(recording).items()
    ]
    return {
        "from": recording.start,
        "to": recording.end,
        "series": series,
        "panels": panels,
        "rows": marks,
        "left_out": recording.left_out,
    }


def _numbers(values: Vector, decimals: int) -> list[float]:
    return [round(value, decimals) for value in values.tolist()]


def _rounded(values: Vector) -> list[float]:
    """To seven digits of the largest."""
    largest = float(np.abs(values).max(initial=0.0))
    return (
        _numbers(values, 7 - int(np.floor(np.log10(largest))))
        if largest > 0
        else [0] * len(values)
    )


_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>TITLE</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body { font: 14px sans-serif; margin: 1em auto; max-width: 75em; padding: 0 1em; color: #111 }
h1 { font-size: 1.2em } p { color: #444; margin: .3em 0 }
canvas { display: block; width: 100%; cursor: crosshair }
#legend { display: flex; flex-wrap: wrap; column-gap: 1.4em }
#legend span { white-space: nowrap }
</style></head><body><h1>TITLE</h1>
<p id="legend"></p>
<p id="note"></p>
<div id="panels"></div>
<script>
const data = DATA;
const left = 76, right = 10, [all, legend, note, place] = [
  [data.from, data.to], ...["legend", "note", "panels"].map((id) => document.getElementById(id))];
let [from, to] = all, at = null;

function span(text, colour) {
  const made = document.createElement("span");
  made.textContent = text;
  made.style.color = colour;
  return made;
}
data.series.forEach((each) => legend.append(span("\\u2501 " + each.label, each.colour)));
const signs = { "|": "|", "x": "\\u00d7", "^": "\\u25b3" }, named = new Set();
data.rows.forEach((row) => row.marks.forEach((each) => {
  if (!named.has(each.what)) {
    legend.append(span(signs[each.sign] + " " + each.what, each.colour));
    named.add(each.what);
  }
}));
const sensors = new Set(data.panels.flatMap((panel) => panel.dots.map((each) => each.name)));
if (sensors.size) legend.append(span("\\u2022 samples: " + [...sensors].join(", "), "#111"));
const thinned = data.series.filter((each) => each.kept < each.samples);
note.textContent = "Time in s since the epoch; shaded: two standard deviations."
  + " Wheel: zoom. Drag: move. Double click: all."
  + (data.left_out ? " " + data.left_out + " coordinates that move less are not drawn." : "")
  + (thinned.length ? " Long curves show their extremes; a shorter part has every sample." : "");

function ticks(low, high, most) {
  const raw = (high - low) / most, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * power).find((k) => k >= raw), found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(k * step);
  return [found, Math.max(0, -Math.floor(Math.log10(step) + 1e-9))];
}
function first(t, time) {  // index of the first one that is not before a time
  let low = 0, high = t.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] < time) low = middle + 1; else high = middle;
  }
  return low;
}
function canvas(height, label) {
  const made = document.createElement("canvas");
  made.style.height = height + "px";
  made.setAttribute("role", "img");
  made.setAttribute("aria-label", label);
  place.append(made);
  return made;
}
function begin(made) {
  const scale = window.devicePixelRatio || 1, { clientWidth: w, clientHeight: h } = made;
  made.width = w * scale;
  made.height = h * scale;
  const pen = made.getContext("2d");
  pen.scale(scale, scale);
  pen.font = "11px sans-serif";
  return [pen, w, h];
}
const x = (t, w) => left + (t - from) / (to - from) * (w - left - right);

const strip = data.rows.length ? canvas(17 * data.rows.length + 6, "impacts") : null;
function drawStrip() {
  const [pen, w] = begin(strip);
  data.rows.forEach((row, k) => {
    const middle = 17 * k + 10;
    pen.fillStyle = "#111";
    pen.textAlign = "right";
    pen.fillText(row.label, left - 8, middle + 4, left - 10);
    pen.textAlign = "center";
    row.marks.forEach((each) => {
      pen.fillStyle = each.colour;
      for (let i = first(each.t, from); i < each.t.length && each.t[i] <= to; i++)
        pen.fillText(signs[each.sign], x(each.t[i], w), middle + 4);
    });
  });
}
const panels = data.panels.map((panel) => [panel, canvas(170, panel.label)]);
function range(panel) {
  let low = Infinity, high = -Infinity;
  [...panel.curves, ...panel.dots].forEach(({ t, y }) => {
    for (let i = Math.max(first(t, from) - 1, 0); i < t.length; i++) {
      low = Math.min(low, y[i]);
      high = Math.max(high, y[i]);
      if (t[i] > to) break;
    }
  });
  const room = 0.06 * (high - low) || 0.5 * Math.abs(high) || 1;
  return low <= high ? [low - room, high + room] : [0, 1];
}
function axes(pen, w, h, low, high, label) {
  const y = (value) => h - 22 - (value - low) / (high - low) * (h - 32);
  pen.lineWidth = 1;
  const [times, decimals] = ticks(from, to, w / 90), [values, places] = ticks(low, high, 4);
  pen.textAlign = "center";
  for (const t of times) {
    pen.strokeStyle = "#e5e5e5";
    pen.strokeRect(x(t, w), 10, 0, h - 32);
    pen.fillStyle = "#333";
    pen.fillText(t.toFixed(decimals), x(t, w), h - 8);
  }
  pen.textAlign = "right";
  for (const value of values) {
    pen.strokeRect(left, y(value), w - left - right, 0);
    pen.fillText(value.toFixed(places), left - 18, y(value) + 4);
  }
  pen.save();
  pen.translate(11, h / 2 - 8);
  pen.rotate(-Math.PI / 2);
  pen.textAlign = "center";
  pen.fillText(label, 0, 0, h - 10);
  pen.restore();
  pen.strokeStyle = "#555";
  pen.strokeRect(left, 10, w - left - right, h - 32);
  return y;
}
function drawPanel([panel, made]) {
  const [pen, w, h] = begin(made), [low, high] = range(panel);
  const y = axes(pen, w, h, low, high, panel.label), readings = [];
  pen.save();
  pen.beginPath();
  pen.rect(left, 10, w - left - right, h - 32);
  pen.clip();
  panel.curves.forEach(({ t, y: values, d }, k) => {
    const { colour, width, dash, label } = data.series[k];
    const start = Math.max(first(t, from) - 1, 0), end = Math.min(first(t, to) + 1, t.length);
    if (d.length) {
      pen.beginPath();
      for (let i = start; i < end; i++) pen.lineTo(x(t[i], w), y(values[i] + d[i]));
      for (let i = end - 1; i >= start; i--) pen.lineTo(x(t[i], w), y(values[i] - d[i]));
      pen.fillStyle = colour + "38";
      pen.fill();
    }
    pen.beginPath();
    for (let i = start; i < end; i++) pen.lineTo(x(t[i], w), y(values[i]));
    Object.assign(pen, { strokeStyle: colour, lineWidth: width, lineJoin: "round" });
    pen.setLineDash(dash);
    pen.stroke();
    pen.setLineDash([]);
    const near = Math.max(first(t, at) - 1, 0);
    if (at !== null && t.length)
      readings.push(label + " " + values[near].toPrecision(6)
        + (d.length ? " \\u00b1 " + d[near].toPrecision(2) : ""));
  });
  pen.fillStyle = "#111";
  panel.dots.forEach(({ t, y: values }) => {
    for (let i = first(t, from); i < t.length && t[i] <= to; i++)
      pen.fillRect(x(t[i], w) - 1, y(values[i]) - 1, 2, 2);
  });
  if (at !== null) {
    Object.assign(pen, { strokeStyle: "#888", lineWidth: 1, textAlign: "left" });
    pen.strokeRect(x(at, w), 10, 0, h - 32);
    const text = at.toFixed(6) + " s   " + readings.join("   ");
    pen.fillStyle = "#ffffffd0";
    pen.fillRect(left + 1, 11, pen.measureText(text).width + 8, 15);
    pen.fillStyle = "#111";
    pen.fillText(text, left + 5, 22);
  }
  pen.restore();
}
let waiting = false;
function draw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    if (strip) drawStrip();
    panels.forEach(drawPanel);
  });
}
function time(event) {
  const w = place.clientWidth - left - right;
  const share = (event.clientX - place.getBoundingClientRect().left - left) / w;
  return from + Math.min(Math.max(share, 0), 1) * (to - from);
}
function show(low, high) {
  const span = Math.min(Math.max(high - low, 1e-7), all[1] - all[0] || 1);
  from = Math.min(Math.max(low, all[0]), all[1] - span);
  to = from + span;
  draw();
}
place.addEventListener("wheel", (event) => {
  event.preventDefault();
  const factor = Math.exp(event.deltaY * 0.002), middle = time(event);
  show(middle - (middle - from) * factor, middle + (to - middle) * factor);
}, { passive: false });
let held = null;
place.onpointerdown = (event) => { held = time(event); place.setPointerCapture(event.pointerId); };
place.onpointerup = () => { held = null; };
place.onpointermove = (event) => {
  at = time(event);
  if (held !== null) show(from + held - at, to + held - at);
  draw();
};
place.onpointerleave = () => { at = null; draw(); };
place.ondblclick = () => show(...all);
window.onresize = draw;
draw();
</script></body></html>
"""
