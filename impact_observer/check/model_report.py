# SPDX-License-Identifier: Apache-2.0
"""A model check as text with tables, and as values for ``--json``."""

from collections.abc import Iterable, Iterator, Sequence
from math import isfinite, tau
from typing import NamedTuple

import numpy as np
from rich.table import Table

from impact_observer.check.findings import times
from impact_observer.check.forced_motion import forced_motion
from impact_observer.check.model_check import ModelCheck
from impact_observer.check.model_findings import findings
from impact_observer.draw.text_tables import console, facts_table, plain_table
from impact_observer.model import Forcing, System
from impact_observer.model.grounds import MovingFrame
from impact_observer.states import Vector

_FORCE = "force on "
_FORCES = {"m": ("N", "kg"), "rad": ("N m", "kg m^2")}
"""Units of forces and masses, by that of the coordinates where it is known."""
_ENDS = 4
"""Rows shown at either end of a long table."""


def for_json(checked: ModelCheck) -> dict[str, object]:
    """What ``--json`` prints; SI units, contacts by name, None for what is not decided."""
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
        "excitations": [each._asdict() for each in _excitations(system)],
        "contacts": [
            {
                "name": c.name,
                "gap": c.gap,
                "restitution": c.curve.document if c.curve else c.restitution,
                "effective_mass": mass,
                "gap_under_load": rest,
                "swing": swing,
                "swing_speed": speed,
            }
            for c, mass, rest, swing, speed in zip(
                system.contacts,
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
                "contacts": names(each.contacts),
                "factor": each.factor,
                "contact_speeds": [each.one.tolist(), each.two.tolist()],
            }
            for each in checked.growths
        ],
        "findings": [finding._asdict() for finding in findings(checked)],
    }


def _finite(values: Vector) -> list[float | None]:
    """The values; None for what is not known, or grows without bound."""
    return [value if isfinite(value) else None for value in values.tolist()]


def print_check(checked: ModelCheck) -> None:
    """Print tables and findings."""
    output, system = console(100), checked.system
    output.print(
        f"{system.name}: {times(system.n, 'coordinate')}, {times(system.m, 'contact')},"
        f" {_forcing(system.own_forcing)}; SI units"
    )
    if system.frame is not None:
        output.print(f"moving grounds: {', '.join(_grounds(system.frame))}")
    for table in (*_tables(checked), facts_table(findings(checked))):
        output.print()
        output.print(table)


def _forcing(forcing: Forcing) -> str:
    parts = [
        *(["constant force"] if forcing.constant.any() else []),
        *([times(forcing.frequency.size, "harmonic")] if forcing.frequency.size else []),
        *([f"sampled force to {forcing.end:g} s"] if forcing.sampled is not None else []),
    ]
    return f"forcing: {', '.join(parts) or 'none'}"


def _grounds(frame: MovingFrame) -> Iterator[str]:
    """What moves, how, and which contacts with it."""
    grounds = frame.grounds
    for k, name in enumerate(grounds.names):
        harmonics = grounds.owner.count(k)
        yield f"{name} ({times(harmonics, 'harmonic') if harmonics else 'a table'})"


class _Excitation(NamedTuple):
    """A constant force, or a harmonic of a force or of a ground; ``frequency`` is in rad/s."""

    name: str
    amplitude: float
    frequency: float


def _excitations(system: System) -> Iterator[_Excitation]:
    """All of them: constants, harmonics of forces, then of grounds."""
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


def _tables(checked: ModelCheck) -> Iterator[Table]:
    """Forces and grounds, frequencies without damping, modes with damping, contacts."""
    length = checked.system.unit if checked.system.unit in _FORCES else ""
    of_force, of_mass = _FORCES.get(length, ("", ""))
    excitations = [
        (
            name,
            f"{amplitude:.6g} {of_force if name.startswith(_FORCE) else length}".rstrip(),
            *(f"{x:.6g}" if x else "" for x in (omega, omega / tau)),
        )
        for name, amplitude, omega in _excitations(checked.system)
    ]
    if excitations:
        yield _table(("excitation", "amplitude", "rad/s", "Hz"), excitations)
    undamped = [
        (str(i), f"{omega:.6g}", f"{omega / tau:.6g}", "" if omega else "rigid body")
        for i, omega in enumerate(checked.undamped, start=1)
    ]
    yield _table(("without damping", "rad/s", "Hz", ""), undamped)
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
    yield _table(("with damping", "rad/s", "Hz", "damping ratio", "s to 1/e"), modes)
    if contacts := checked.system.contacts:
        motion = forced_motion(checked.system)
        known = (checked.effective_mass, motion.rest, motion.swing, motion.speed)
        rows = [
            (
                c.name,
                f"{c.gap:g}",
                c.curve.text if c.curve else f"{c.restitution:g}",
                *(f"{x:.4g}" if isfinite(x) else "" for x in of_contact),
            )
            for c, of_contact in zip(contacts, np.transpose(known).tolist(), strict=True)
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
        yield _table([f"{name} [{unit}]" if unit else name for name, unit in headings], rows)


def _table(headings: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    """A table; of a long one the first and last rows."""
    table = plain_table(*headings, names=(headings[0], ""))
    if (left_out := len(rows) - 2 * _ENDS) > 1:
        rows = [*rows[:_ENDS], (f"... {left_out} more in --json",), *rows[-_ENDS:]]
    for row in rows:
        table.add_row(*row)
    return table
