# SPDX-License-Identifier: Apache-2.0
"""The rows of a sweep: a Parquet file, and medians with quartiles as table, JSON and picture."""

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from impact_observer.draw.pictures import save, styles
from impact_observer.draw.reports import TextTable, print_table
from impact_observer.options import SETTLED
from impact_observer.output_files import replacing
from impact_observer.sweep.cases import COUNTS, FIGURES, Sweep, Value, parsed

Quartiles = dict[str, float | None]
"""``low``, ``median`` and ``high``; None for never."""
Group = dict[str, Any]
"""Cases that differ in their run only: law, values of the swept columns, ``runs``, ``failed``
(cases without metrics, which do not count), ``not_settled`` (share of the runs), and the quartiles
of ``settling_time`` (s) and ``V_ratio``; None without values."""
_NEVER = 1e300
"""Substitute for infinity in the quartiles of numpy: infinities have no difference."""
_WIDE = 20.0
"""Ratio of largest to least value from which the axis of the picture is logarithmic."""
_MARKERS = "sovD^<>phX*"


def table_of(rows: Iterable[Mapping[str, Value]]) -> pd.DataFrame:
    """The rows of cases in order of their numbers; a metric that is undefined is missing."""
    types = dict.fromkeys(FIGURES, "Float64") | dict.fromkeys(COUNTS, "Int64")
    return pd.DataFrame(rows).sort_values("case").astype(types)


def write_table(table: pd.DataFrame, path: Path) -> None:
    """Write the rows of a sweep to a Parquet file.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    with replacing(path) as temporary:
        table.to_parquet(temporary, compression="zstd", index=False)


def groups_of(table: pd.DataFrame, swept: Sequence[str]) -> list[Group]:
    """The cases in groups of equal law and ``swept`` columns, in the order of the sweep."""
    groups = []
    for _, own in table.groupby(["law", *swept], sort=False):
        good = own[own["error"] == ""]
        times = good["settling_time"].fillna(math.inf).tolist()
        group = {
            **own[["law", *swept]].to_dict("records")[0],
            "runs": len(own),
            "failed": len(own) - len(good),
            "not_settled": times.count(math.inf) / len(times) if times else None,
            "settling_time": _quartiles(times),
            "V_ratio": _quartiles(good["V_ratio"].dropna().tolist()),
        }
        groups.append(group)
    return groups


def _quartiles(values: Sequence[float]) -> Quartiles | None:
    """A quartile between two values is never if the upper one is."""
    if not values:
        return None
    cuts = np.quantile(np.minimum(values, _NEVER), (0.25, 0.5, 0.75)).tolist()
    shown = (None if value > _NEVER / 8 else value for value in cuts)
    return dict(zip(("low", "median", "high"), shown, strict=True))


def print_groups(sweep: Sweep, groups: Sequence[Group]) -> None:
    """Print a row for each law with each combination of swept values."""
    failed = ["failed"] if any(group["failed"] for group in groups) else []
    swept = sweep.swept
    headings = ("law", *map(sweep.title, swept), "runs", "settling time [s]", "not settled")
    rows = [
        (
            group["law"],
            *(_word(group[name]) for name in swept),
            str(group["runs"]),
            _words(group["settling_time"], ".3g"),
            "" if group["not_settled"] is None else f"{group['not_settled']:.0%}",
            _words(group["V_ratio"], ".1e"),
            *(str(group[name]) for name in failed),
        )
        for group in groups
    ]
    about = f"Medians (quartiles) over the runs; settled while V stays below {SETTLED:g} V0"
    print_table(TextTable((*headings, "V/V0 at the end", *failed), rows, title=about))


def _word(value: Value) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _words(values: Quartiles | None, form: str) -> str:
    """``4.2 (3.1, never)``."""
    low, median, high = ("never" if x is None else format(x, form) for x in _cuts(values))
    shown = median if low == median == high else f"{median} ({low}, {high})"
    return "" if values is None else shown


def _cuts(values: Quartiles | None) -> tuple[float | None, ...]:
    return (math.nan,) * 3 if values is None else tuple(values.values())


def save_picture(sweep: Sweep, groups: Sequence[Group], path: Path) -> None:
    """Draw settling times above, and the share that has not settled below.

    The horizontal axis has the first swept column, or else the laws. Every law with every
    combination of the other columns is a curve of medians, with bars from the first to the third
    quartile. Runs that never settle are in a row above all times.

    Raises:
        UsageError: the file cannot be written.
    """
    columns, system = sweep.swept, parsed(sweep.model).system
    curves: dict[str, list[Group]] = {}
    for group in groups:
        others = (_label(sweep.title(name), group[name]) for name in columns[1:])
        curves.setdefault(", ".join((group["law"], *others)), []).append(group)
    times = [time for group in groups for time in _cuts(group["settling_time"])]
    longest = max((time for time in times if time and time > 0), default=sweep.duration)
    never, about = 1.1 * longest, f"{system.name}: {sweep.runs} runs, medians and quartiles"
    figure = Figure(figsize=(8.0, 5.2), layout="constrained")
    upper, lower = figure.subplots(2, sharex=True, gridspec_kw={"height_ratios": (3, 1)})
    looks = styles([own[0]["law"] for own in curves.values()])
    for place, ((label, own), style) in enumerate(zip(curves.items(), looks, strict=True)):
        own.sort(key=lambda group: [group[name] for name in columns[:1]])
        x = [float(group[columns[0]]) if columns else place for group in own]
        cuts = [_cuts(group["settling_time"]) for group in own]
        low, median, high = np.array([[never if c is None else c for c in row] for row in cuts]).T
        marked = {**style, "marker": _MARKERS[place % len(_MARKERS)]}
        bars = (median - low, high - median)
        upper.errorbar(x, median, bars, label=label, capsize=3, elinewidth=0.8, **marked)
        shares = [group["not_settled"] for group in own]
        lower.plot(x, [math.nan if share is None else 100 * share for share in shares], **marked)
    if None in times:
        ticks = [float(tick) for tick in upper.get_yticks() if 0 <= tick <= longest]
        upper.set_yticks([*ticks, never], [*(f"{tick:g}" for tick in ticks), "never"])
    upper.set(ylim=(0, None), ylabel=f"settling time (V < {SETTLED:g} V0) [s]")
    lower.set(ylim=(-5, 105), ylabel="not settled [%]")
    if columns:
        lower.set_xlabel(sweep.title(columns[0]))
        values = [float(group[columns[0]]) for group in groups]
        sizes = sorted(filter(None, map(abs, values)))
        if sizes and sizes[-1] / sizes[0] >= _WIDE:
            lower.set_xscale("symlog", linthresh=sizes[0])
            lower.set_xlim(min(values) - 0.2 * sizes[0], max(values) + 0.2 * sizes[-1])
        figure.legend(loc="outside lower left", ncol=3, fontsize="small", frameon=False)
    else:
        lower.set_xticks(range(len(curves)), [*curves])
    figure.suptitle(about, x=0.01, ha="left", fontsize="medium")
    save(figure, path, about=about)


def _label(title: str, value: Value) -> str:
    """A value with its quantity, such as ``missed 0.1`` or ``jitter 0.001 s``."""
    words, _, unit = title.rstrip("]").partition(" [")
    return f"{words} {_word(value)} {unit}".rstrip()
