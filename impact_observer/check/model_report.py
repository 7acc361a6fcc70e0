"""A model check as text with tables, and as figures for ``--json``."""

import sys
from collections.abc import Iterator, Sequence
from math import tau

from rich.console import Console
from rich.table import Table

from impact_observer.check.findings import times
from impact_observer.check.model_check import ModelCheck
from impact_observer.check.model_findings import contact_names, findings
from impact_observer.model import Forcing

_WIDTH = 100
"""Columns where there is no terminal."""
_ENDS = 4
"""Rows shown at either end of a long table."""


def figures(checked: ModelCheck) -> dict[str, object]:
    """What ``--json`` prints; SI units, contacts by name, None for what is not decided."""
    system = checked.system
    return {
        "name": system.name,
        "n": system.n,
        "m": system.m,
        "undamped_frequencies": checked.undamped.tolist(),
        "modes": [
            {
                "natural_frequency": mode.natural,
                "damped_frequency": mode.frequency,
                "damping_ratio": mode.damping_ratio,
                "decay": -mode.decay + 0.0,
            }
            for mode in checked.modes
        ],
        "real_eigenvalues": checked.rates.tolist(),
        "rigid_modes": checked.rigid.tolist(),
        "resonances": [
            {"harmonic": r.harmonic, "frequency": r.frequency} for r in checked.resonances
        ],
        "unseen": [
            {"decay": -u.decay + 0.0, "frequency": u.frequency, "shape": u.shape.tolist()}
            for u in checked.unseen
        ],
        "contacts": [
            {"name": c.name, "gap": c.gap, "restitution": c.restitution, "effective_mass": mass}
            for c, mass in zip(system.contacts, checked.effective_mass.tolist(), strict=True)
        ],
        "redundant": [contact_names(system, contacts) for contacts in checked.redundant.sets],
        "redundant_decided": checked.redundant.decided,
        "nonexpansive": checked.nonexpansive,
        "expansive": [
            {
                "contacts": contact_names(system, each.contacts),
                "factor": each.factor,
                "contact_speeds": [each.one.tolist(), each.two.tolist()],
            }
            for each in checked.growths
        ],
        "findings": [finding._asdict() for finding in findings(checked)],
    }


def print_check(checked: ModelCheck) -> None:
    """Print tables and findings."""
    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, width=width)
    system = checked.system
    console.print(
        f"{system.name}: {times(system.n, 'coordinate')}, {times(system.m, 'contact')},"
        f" {_forcing(system.forcing)}"
    )
    for table in _tables(checked):
        console.print()
        console.print(table)
    words = Table.grid(padding=(0, 2))
    words.add_column(no_wrap=True)
    words.add_column(overflow="fold")
    for finding in findings(checked):
        words.add_row(*finding)
    console.print()
    console.print(words)


def _forcing(forcing: Forcing) -> str:
    parts = [
        *(["constant force"] if forcing.constant.any() else []),
        *([times(forcing.frequency.size, "harmonic")] if forcing.frequency.size else []),
        *([f"sampled force to {forcing.end:g} s"] if forcing.sampled is not None else []),
    ]
    return f"forcing: {', '.join(parts) or 'none'}"


def _tables(checked: ModelCheck) -> Iterator[Table]:
    """Frequencies without damping, modes with damping, contacts."""
    undamped = [
        (str(i), f"{omega:.6g}", f"{omega / tau:.6g}", "" if omega else "rigid body")
        for i, omega in enumerate(checked.undamped.tolist(), start=1)
    ]
    yield _table(("without damping", "rad/s", "Hz", ""), undamped)
    modes = [
        (
            str(i),
            f"{mode.frequency:.6g}",
            f"{mode.frequency / tau:.6g}",
            f"{mode.damping_ratio:.4g}",
            f"{-1 / mode.decay:.4g}" if mode.decay else "never",
        )
        for i, mode in enumerate(checked.modes, start=1)
    ]
    modes += [
        ("overdamped" if rate else "free", "", "", "", f"{-1 / rate:.4g}" if rate else "never")
        for rate in reversed(checked.rates.tolist())
    ]
    yield _table(("with damping", "rad/s", "Hz", "damping ratio", "s to 1/e"), modes)
    if contacts := checked.system.contacts:
        rows = [
            (c.name, f"{c.gap:g}", f"{c.restitution:g}", f"{mass:.4g}")
            for c, mass in zip(contacts, checked.effective_mass.tolist(), strict=True)
        ]
        yield _table(("contact", "gap", "restitution", "effective mass"), rows)


def _table(headers: Sequence[str], rows: Sequence[tuple[str, ...]]) -> Table:
    """A table; of a long one the first and last rows."""
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for k, header in enumerate(headers):
        table.add_column(header, justify="right" if k and header else "left", overflow="fold")
    if (left_out := len(rows) - 2 * _ENDS) > 1:
        rows = [*rows[:_ENDS], (f"... {left_out} more in --json",), *rows[-_ENDS:]]
    for row in rows:
        table.add_row(*row)
    return table
