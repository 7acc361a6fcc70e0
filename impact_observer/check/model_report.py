# SPDX-License-Identifier: Apache-2.0
"""A model check as text with tables, and as values for ``--json``."""

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite, tau
from typing import NamedTuple

import numpy as np

from impact_observer.check.forced_motion import forced_motion
from impact_observer.check.model_check import ModelCheck
from impact_observer.check.model_findings import findings
from impact_observer.draw.reports import (
    TextTable,
    counted,
    listed,
    print_facts,
    print_table,
)
from impact_observer.model import Forcing, System
from impact_observer.model.free_parameters import is_observed
from impact_observer.model.grounds import MovingFrame
from impact_observer.model.parametric_family import ModelParameter
from impact_observer.model.system import UNITS, unit_of
from impact_observer.plain_text import say
from impact_observer.states import Vector

_FORCE = "force on "
_ENDS = 4
"""Rows shown at either end of a long table."""


def for_json(checked: ModelCheck) -> dict[str, object]:
    """The values of ``--json``: SI units, contacts by name, None for an undecided question."""
    system = checked.system
    motion = forced_motion(system)

    def names(contacts: Iterable[int]) -> list[str]:
        return [system.contact_names[i] for i in contacts]

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
        "resonances": [{"harmonic": k, "frequency": omega} for k, omega in checked.resonances],
        "unseen": [
            {"decay": abs(value.real), "frequency": value.imag, "shape": shape.tolist()}
            for value, shape in checked.unseen
        ],
        "excitations": [excitation._asdict() for excitation in _excitations(system)],
        "contacts": [
            {
                "name": c.name,
                "gap": c.gap,
                **law.document,
                "effective_mass": mass,
                "gap_under_load": rest,
                "swing": swing,
                "swing_speed": speed,
            }
            for c, law, mass, rest, swing, speed in zip(
                system.contacts,
                system.rebounds,
                checked.effective_mass.tolist(),
                *map(_finite, (motion.rest, motion.swing, motion.speed)),
                strict=True,
            )
        ],
        "redundant": [names(contacts) for contacts in checked.redundant.sets],
        "redundant_decided": checked.redundant.decided,
        "nonexpansive": checked.nonexpansive,
        "expansive": [
            {
                "contacts": names(growth.contacts),
                "factor": growth.factor,
                "contact_speeds": [growth.one.tolist(), growth.two.tolist()],
            }
            for growth in checked.growths
        ],
        **({"deviations": [*_deviations(checked)]} if checked.declared else {}),
        "findings": [remark._asdict() for remark in findings(checked)],
    }


def _deviations(checked: ModelCheck) -> Iterator[dict[str, object]]:
    for each, deviation in checked.declared:
        value = {"value": each.value, "deviation": deviation, "unit": each.unit}
        yield {"name": each.name, **value}


def _finite(values: Vector) -> list[float | None]:
    """Finite values; None for an unknown value or one that grows without bound."""
    return [value if isfinite(value) else None for value in values.tolist()]


def print_check(checked: ModelCheck) -> None:
    """Print the tables of a model and the remarks on it."""
    system = checked.system
    say(
        f"{system.name}: {counted(system.n, 'coordinate')}, {counted(system.m, 'contact')},"
        f" {_forcing(system.own_forcing)}; SI units"
    )
    if system.frame is not None:
        say(f"moving grounds: {listed(_grounds(system.frame))}")
    for table in _tables(checked):
        say("")
        print_table(table)
    say("")
    print_facts(findings(checked))


def _forcing(forcing: Forcing) -> str:
    """The kinds of forces, in words."""
    kinds = [
        *(["constant force"] if forcing.constant.any() else []),
        *([counted(forcing.frequency.size, "harmonic")] if forcing.frequency.size else []),
        *([f"sampled force to {forcing.end:g} s"] if forcing.sampled is not None else []),
    ]
    return f"forcing: {listed(kinds)}"


def _grounds(frame: MovingFrame) -> Iterator[str]:
    """Names of moving grounds, each with the form of its motion."""
    grounds = frame.grounds
    for k, name in enumerate(grounds.names):
        harmonics = grounds.owner.count(k)
        yield f"{name} ({counted(harmonics, 'harmonic') if harmonics else 'a table'})"


class _Excitation(NamedTuple):
    """A constant force, or a harmonic of a force or of a ground; ``frequency`` is in rad/s."""

    name: str
    amplitude: float
    frequency: float


def _excitations(system: System) -> Iterator[_Excitation]:
    """All excitations: constants, harmonics of forces, then harmonics of grounds."""
    frame, forcing = system.frame, system.own_forcing
    for name, value in zip(system.coordinates, forcing.constant.tolist(), strict=True):
        if value:
            yield _Excitation(f"{_FORCE}{name}", value, 0.0)
    moving = [(forcing, [f"{_FORCE}{name}" for name in system.coordinates])]
    if frame is not None:
        grounds = frame.grounds
        moving.append((grounds.motion, [f"ground {name}" for name in grounds.names]))
    for motion, names in moving:
        amplitudes = np.hypot(motion.cosine, motion.sine)
        for k, i in np.argwhere(amplitudes).tolist():
            yield _Excitation(names[i], float(amplitudes[k, i]), float(motion.frequency[k]))


def _tables(checked: ModelCheck) -> Iterator[TextTable]:
    """Forces and grounds, frequencies without damping, modes with damping, contacts."""
    length = checked.system.unit if checked.system.unit in UNITS else ""
    of_force, of_mass = (unit_of(each, length) if length else "" for each in ("N", "kg"))
    excitations = [
        (
            name,
            f"{amplitude:.6g} {of_force if name.startswith(_FORCE) else length}".rstrip(),
            *(f"{x:.6g}" if x else "" for x in (omega, omega / tau)),
        )
        for name, amplitude, omega in _excitations(checked.system)
    ]
    if excitations:
        yield _shortened(("excitation", "amplitude", "rad/s", "Hz"), excitations)
    undamped = [
        (str(i) if omega else f"{i} (rigid body)", f"{omega:.6g}", f"{omega / tau:.6g}")
        for i, omega in enumerate(checked.undamped, start=1)
    ]
    yield _shortened(("without damping", "rad/s", "Hz"), undamped)
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
    yield _shortened(("with damping", "rad/s", "Hz", "damping ratio", "s to 1/e"), modes)
    if checked.system.contacts:
        yield _contact_table(checked, length, of_mass)
    if checked.declared:
        declared = [
            (each.name, f"{each.value:.6g}", f"{deviation:.3g}", each.unit, _use(each, deviation))
            for each, deviation in checked.declared
        ]
        headings = ("parameter", "value", "deviation", "unit", "an observer takes it")
        yield TextTable(headings, declared, words=headings[-2:])


def _use(parameter: ModelParameter, deviation: float) -> str:
    """What an observer makes of a parameter with this deviation."""
    if not deviation:
        return "as exact"
    return "as uncertain" if is_observed(parameter.name) else "as exact: only identify learns it"


def _contact_table(checked: ModelCheck, length: str, of_mass: str) -> TextTable:
    """The contacts: gap, restitution, effective mass, and the motion of the gap."""
    system, motion = checked.system, forced_motion(checked.system)
    computed = np.transpose([checked.effective_mass, motion.rest, motion.swing, motion.speed])
    rows = [
        (
            contact.name,
            f"{contact.gap:g}",
            law.text,
            *(f"{x:.4g}" if isfinite(x) else "" for x in of_contact),
        )
        for contact, law, of_contact in zip(
            system.contacts, system.rebounds, computed.tolist(), strict=True
        )
    ]
    speed = f"{length}/s" if length else ""
    headings = (
        ("contact", ""),
        ("gap", length),
        ("restitution", ""),
        ("eff. mass", of_mass),
        ("under load", length),
        ("swing", length),
        ("at" if speed else "at speed", speed),
    )
    return _shortened([f"{name} [{unit}]" if unit else name for name, unit in headings], rows)


def _shortened(headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> TextTable:
    """A table; of a long one the first and the last rows."""
    if (left_out := len(rows) - 2 * _ENDS) > 1:
        gap = (f"... {left_out} more in --json", *[""] * (len(headings) - 1))
        rows = [*rows[:_ENDS], gap, *rows[-_ENDS:]]
    return TextTable(headings, rows)
