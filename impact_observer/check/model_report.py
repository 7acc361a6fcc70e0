# SPDX-License-Identifier: Apache-2.0
"""A model check as text with tables, and as values for ``--json``."""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite, tau
from typing import Any

import numpy as np

from impact_observer.check.model_check import ModelCheck
from impact_observer.draw.reports import (
    ReportLine,
    TextTable,
    counted,
    figure,
    listed,
    print_facts,
    print_table,
)
from impact_observer.model import System
from impact_observer.model.free_parameters import is_observed
from impact_observer.observer.uncertainty import suggested_deviation
from impact_observer.plain_text import say
from impact_observer.states import Vector

_ENDS = 4
"""Rows shown at either end of a long table."""
_SHOWN = 3
"""Most remarks of one kind, and most terms of a list, that are shown."""


def for_json(checked: ModelCheck) -> dict[str, Any]:
    """The values of ``--json``: SI units, contacts by name, None for an undecided question."""
    system = checked.system
    computed = (checked.effective_mass, checked.rest, checked.swing)
    known = ([x if isfinite(x) else None for x in each.tolist()] for each in computed)
    rows = zip(system.contacts, system.rebounds, *known, strict=True)
    return {
        "name": system.name,
        "n": system.n,
        "m": system.m,
        "undamped_frequencies": checked.undamped.tolist(),
        "modes": [
            {
                "natural_frequency": abs(mode),
                "damped_frequency": mode.imag,
                "damping_ratio": abs(mode.real) / abs(mode),
                "decay": abs(mode.real),
            }
            for mode in checked.modes.tolist()
        ],
        "real_eigenvalues": checked.rates.tolist(),
        "rigid_modes": checked.rigid.tolist(),
        "unseen": [
            {"decay": abs(value.real), "frequency": value.imag, "shape": shape.tolist()}
            for value, shape in checked.unseen
        ],
        "excitations": [*_excitations(system)],
        "contacts": [
            {
                "name": contact.name,
                "gap": contact.gap,
                "restitution": law.written,
                "effective_mass": mass,
                "gap_under_load": rest,
                "swing": swing,
            }
            for contact, law, mass, rest, swing in rows
        ],
        "nonexpansive": checked.nonexpansive,
        "expansive": [
            {"contacts": [system.contact_names[i] for i in each.contacts], "factor": each.factor}
            for each in checked.growths
        ],
        "deviations": [
            {
                "name": each.name,
                "value": each.value,
                "deviation": deviation,
                "unit": each.unit,
                "observed": bool(deviation) and is_observed(each.name),
            }
            for each, deviation in checked.declared
        ],
        "findings": [remark._asdict() for remark in _findings(checked)],
    }


def print_values(values: Mapping[str, Any], what: str) -> None:
    """Print the lists of values that ``--json`` has as tables, and the findings below them.

    Args:
        values: of a model or of a robot.
        what: behind the name in the first line.
    """
    say(f"{values['name']}: {what}; SI units")
    for key in ("excitations", "joints", "modes", "contacts", "deviations"):
        if rows := values.get(key):
            say("")
            print_table(_shortened(rows))
    say("")
    print_facts((each["kind"], each["text"]) for each in values["findings"])


def _shortened(rows: Sequence[Mapping[str, object]]) -> TextTable:
    """A table of values by their names; of a long one the first and the last rows."""
    headings = tuple(rows[0])
    cells = [tuple(_text(row.get(name)) for name in headings) for row in rows]
    if (left_out := len(cells) - 2 * _ENDS) > 1:
        gap = (f"... {left_out} more in --json", *[""] * (len(headings) - 1))
        cells = [*cells[:_ENDS], gap, *cells[-_ENDS:]]
    return TextTable(headings, cells)


def _text(value: object) -> str:
    """A cell of a table."""
    if isinstance(value, Mapping):
        return " ".join(f"{key} {_text(each)}" for key, each in value.items())
    if isinstance(value, list):
        return " ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else str(value)


def _excitations(system: System) -> Iterator[dict[str, object]]:
    """All excitations: constants, harmonics of forces, harmonics of grounds, square waves."""
    frame, forcing = system.frame, system.own_forcing
    forces = [f"force on {name}" for name in system.coordinates]
    for name, value in zip(forces, forcing.constant.tolist(), strict=True):
        if value:
            yield {"name": name, "amplitude": value, "frequency": 0.0, "hertz": 0.0}
    moving = [(forcing, forces)]
    if frame is not None:
        moving.append((frame.grounds.motion, [f"ground {each}" for each in frame.grounds.names]))
    for motion, names in moving:
        amplitudes = np.hypot(motion.cosine, motion.sine)
        for k, i in np.argwhere(amplitudes).tolist():
            of_harmonic = {"name": names[i], "amplitude": float(amplitudes[k, i])}
            omega = float(motion.frequency[k])
            yield {**of_harmonic, "frequency": omega, "hertz": omega / tau}
    if (waves := forcing.squares) is not None:
        for k, i in np.argwhere(waves.force).tolist():
            square = {"name": f"square {forces[i]}", "amplitude": abs(float(waves.force[k, i]))}
            omega = float(waves.frequency[k])
            yield {**square, "frequency": omega, "hertz": omega / tau}


def _findings(checked: ModelCheck) -> Iterator[ReportLine]:
    """Remarks: each a fact with its consequence for an observer."""
    system = checked.system
    for growth in checked.growths[:_SHOWN]:
        names = listed([system.contact_names[i] for i in growth.contacts])
        yield ReportLine(
            "warning",
            f"An impact of {names} together can raise V by a factor of {growth.factor:.4g}: give"
            " them one restitution.",
        )
    if checked.nonexpansive and system.m:
        yield ReportLine("ok", "No impact raises V.")
    elif checked.nonexpansive is None:
        yield ReportLine("warning", "Whether an impact of several contacts can raise V is open.")
    if count := len(checked.rigid):
        shapes = "; ".join(_shape(system, each) for each in checked.rigid[:_SHOWN])
        modes = counted(count, "rigid-body mode")
        yield ReportLine("note", f"{modes}, which V does not see: {shapes}.")
    if checked.damped:
        slowest = -max([*checked.modes.real, *checked.rates])
        lasts = figure(0.5 / slowest, "s")
        yield ReportLine("ok", f"V falls between impacts too, by a factor e in {lasts} at least.")
    else:
        yield ReportLine("note", "Not all motion is damped: there only impacts reduce V.")
    if not system.m:
        yield ReportLine("warning", "Without contacts no event ever corrects an estimate.")
        return
    for value, shape in checked.unseen[:_SHOWN]:
        mode = f"the mode at {abs(value):.4g} rad/s" if value else "the rigid-body mode"
        text = f"No contact moves in {mode}, {_shape(system, shape)}: no impact corrects it."
        yield ReportLine("warning", text)
    if not checked.unseen:
        text = "Every mode moves some contact: enough impacts determine the whole state."
        yield ReportLine("ok", text)
    if suggested := suggested_deviation(system):
        text = f"The start of an observer of this size of rig: --initial-deviation {suggested}."
        yield ReportLine("note", text)


def _shape(system: System, shape: Vector) -> str:
    """The largest entries of a mode's shape, by coordinate."""
    largest = sorted(range(system.n), key=lambda i: -abs(shape[i]))[: 2 * _SHOWN]
    shown = [f"{system.coordinates[i]} {shape[i]:.3g}" for i in sorted(largest) if shape[i]]
    more = int(sum(shape != 0)) - len(shown)
    return f"({', '.join(shown)}{f' and {more} more' if more else ''})"
