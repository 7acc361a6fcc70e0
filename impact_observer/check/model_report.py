# SPDX-License-Identifier: Apache-2.0
"""A model check as text with tables, and as values for ``--json``."""

from collections.abc import Iterator, Sequence
from math import isfinite, tau
from typing import NamedTuple

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
from impact_observer.filter.uncertainty import suggested_deviation
from impact_observer.model import System
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.system import UNITS, unit_of
from impact_observer.plain_text import say
from impact_observer.states import Vector

_ENDS = 4
"""Rows shown at either end of a long table."""
_SHOWN = 3
"""Most remarks of one kind, and most terms of a list, that are shown."""


def for_json(checked: ModelCheck) -> dict[str, object]:
    """The values of ``--json``: SI units, contacts by name, None for an undecided question."""
    system = checked.system
    rows = zip(
        system.contacts,
        system.rebounds,
        checked.effective_mass.tolist(),
        *([x if isfinite(x) else None for x in each] for each in (checked.rest, checked.swing)),
        strict=True,
    )
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
        "excitations": [excitation._asdict() for excitation in _excitations(system)],
        "contacts": [
            {
                "name": contact.name,
                "gap": contact.gap,
                **law.document,
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
            {"name": each.name, "value": each.value, "deviation": deviation, "unit": each.unit}
            for each, deviation in checked.declared
        ],
        "findings": [remark._asdict() for remark in _findings(checked)],
    }


def print_check(checked: ModelCheck) -> None:
    """Print the tables of a model and the remarks on it."""
    system = checked.system
    say(
        f"{system.name}: {counted(system.n, 'coordinate')}, {counted(system.m, 'contact')};"
        " SI units"
    )
    for table in _tables(checked):
        say("")
        print_table(table)
    say("")
    print_facts(_findings(checked))


class _Excitation(NamedTuple):
    """A constant force, or a harmonic of a force or of a ground; ``frequency`` is in rad/s."""

    name: str
    amplitude: float
    frequency: float


def _excitations(system: System) -> Iterator[_Excitation]:
    """All excitations: constants, harmonics of forces, then harmonics of grounds."""
    frame, forcing = system.frame, system.own_forcing
    forces = [f"force on {name}" for name in system.coordinates]
    for name, value in zip(forces, forcing.constant.tolist(), strict=True):
        if value:
            yield _Excitation(name, value, 0.0)
    moving = [(forcing, forces)]
    if frame is not None:
        moving.append((frame.grounds.motion, [f"ground {each}" for each in frame.grounds.names]))
    for motion, names in moving:
        amplitudes = np.hypot(motion.cosine, motion.sine)
        for k, i in np.argwhere(amplitudes).tolist():
            yield _Excitation(names[i], float(amplitudes[k, i]), float(motion.frequency[k]))


def _tables(checked: ModelCheck) -> Iterator[TextTable]:
    """Excitations, modes, contacts, declared deviations."""
    length = checked.system.unit if checked.system.unit in UNITS else ""
    force, mass = (unit_of(each, length) if length else "" for each in ("N", "kg"))
    if excitations := [
        (
            name,
            f"{amplitude:.6g} {force if name.startswith('force') else length}".rstrip(),
            *(f"{x:.6g}" if x else "" for x in (omega, omega / tau)),
        )
        for name, amplitude, omega in _excitations(checked.system)
    ]:
        yield _shortened(("excitation", "amplitude", "rad/s", "Hz"), excitations)
    modes = [
        (
            str(i),
            f"{mode.imag:.6g}",
            f"{mode.imag / tau:.6g}",
            f"{abs(mode.real) / abs(mode):.4g}",
            f"{-1 / mode.real:.4g}" if mode.real else "never",
        )
        for i, mode in enumerate(checked.modes, start=1)
    ]
    modes += [
        ("overdamped" if rate else "free", "", "", "", f"{-1 / rate:.4g}" if rate else "never")
        for rate in reversed(checked.rates)
    ]
    yield _shortened(("mode", "rad/s", "Hz", "damping ratio", "s to 1/e"), modes)
    if checked.system.contacts:
        yield _contact_table(checked, length, mass)
    if checked.declared:
        declared = [
            (
                *(each.name, f"{each.value:.6g}", f"{deviation:.3g}", each.unit),
                *("uncertain" if deviation and is_observed(each.name) else "exact",),
            )
            for each, deviation in checked.declared
        ]
        headings = ("parameter", "value", "deviation", "unit", "an observer takes it as")
        yield TextTable(headings, declared, words=headings[-2:])


def _contact_table(checked: ModelCheck, length: str, mass: str) -> TextTable:
    """The contacts: gap, restitution, effective mass, and the amplitude of the gap."""
    system = checked.system
    computed = np.transpose([checked.effective_mass, checked.rest, checked.swing]).tolist()
    rows = [
        (name, f"{gap:g}", law.text, *(f"{x:.4g}" if isfinite(x) else "" for x in of_contact))
        for name, gap, law, of_contact in zip(
            system.contact_names, system.q_r.tolist(), system.rebounds, computed, strict=True
        )
    ]
    units = ("", length, "", mass, length, length)
    words = ("contact", "gap", "restitution", "eff. mass", "under load", "swing")
    pairs = zip(words, units, strict=True)
    return _shortened([f"{word} [{unit}]" if unit else word for word, unit in pairs], rows)


def _shortened(headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> TextTable:
    """A table; of a long one the first and the last rows."""
    if (left_out := len(rows) - 2 * _ENDS) > 1:
        gap = (f"... {left_out} more in --json", *[""] * (len(headings) - 1))
        rows = [*rows[:_ENDS], gap, *rows[-_ENDS:]]
    return TextTable(headings, rows)


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
        text = f"The start of an observer of this size of rig: --deviation {suggested}."
        yield ReportLine("note", text)


def _shape(system: System, shape: Vector) -> str:
    """The largest entries of a mode's shape, by coordinate."""
    largest = sorted(range(system.n), key=lambda i: -abs(shape[i]))[: 2 * _SHOWN]
    shown = [f"{system.coordinates[i]} {shape[i]:.3g}" for i in sorted(largest) if shape[i]]
    more = int(sum(shape != 0)) - len(shown)
    return f"({', '.join(shown)}{f' and {more} more' if more else ''})"
