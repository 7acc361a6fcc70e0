"""Say what a model means for an observer: modes, contacts, and whether an impact can raise V."""

import argparse
import json as json_module
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from rich.table import Table

    from impact_observer.check.model_check import ModelCheck
    from impact_observer.model import Forcing, System
    from impact_observer.states import Vector

_WIDTH = 100
"""Columns where there is no terminal."""
_ENDS = 4
"""Rows shown at either end of a long table."""
_SHOWN = 3
"""Findings of one kind, and coordinates of one shape, that are shown."""


class ModelFinding(NamedTuple):
    """A fact with its consequence.

    Attributes:
        kind: ``ok``, ``note`` or ``warning``.
        text: one or two lines.
    """

    kind: str
    text: str


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add this subcommand's arguments to ``parser``."""
    parser.add_argument("model", metavar="FILE", help="a model file, or a sample: two_mass, ...")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")


def run(args: argparse.Namespace) -> int:
    """Run the subcommand."""
    return check(args.model, json=args.json)


def check(model: str | Path, *, json: bool = False) -> int:
    """Check a model and print what comes out.

    Args:
        model: a model file or a sample's name.
        json: print JSON instead of tables and words.

    Returns:
        0, also where there are warnings: the model is valid.

    Raises:
        UsageError, ModelError: the model cannot be read, or is none.
    """
    from impact_observer.check.model_check import check_model
    from impact_observer.model import read_model

    checked = check_model(read_model(model).system)
    if json:
        print(json_module.dumps(figures(checked), indent=2))
    else:
        print_check(checked)
    return 0


def figures(checked: "ModelCheck") -> dict[str, object]:
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
            {
                "name": c.name,
                "gap": c.gap,
                "restitution": c.restitution,
                "effective_mass": float(mass),
            }
            for c, mass in zip(system.contacts, checked.effective_mass, strict=True)
        ],
        "redundant": [_names(system, contacts) for contacts in checked.redundant.sets],
        "redundant_decided": checked.redundant.decided,
        "nonexpansive": checked.nonexpansive,
        "expansive": [
            {
                "contacts": _names(system, each.contacts),
                "factor": each.factor,
                "contact_speeds": [each.one.tolist(), each.two.tolist()],
            }
            for each in checked.growths
        ],
        "findings": [finding._asdict() for finding in findings(checked)],
    }


def findings(checked: "ModelCheck") -> list[ModelFinding]:
    """Every finding in plain words, those on the impact law first."""
    return [
        *_impact_law(checked),
        *_closing(checked),
        *_seminorm(checked),
        *_damping(checked),
        *_resonances(checked),
        *_unseen(checked),
    ]


def _impact_law(checked: "ModelCheck") -> Iterator[ModelFinding]:
    system = checked.system
    if checked.nonexpansive is None:
        yield ModelFinding(
            "warning",
            "Whether an impact can raise V is not decided: too many sets of contacts to look at."
            " One restitution for all contacts would settle it.",
        )
    elif checked.nonexpansive and system.m:
        yield ModelFinding(
            "ok",
            "No impact raises V, or adds kinetic energy, whichever contacts close together.",
        )
    for each in checked.growths[:_SHOWN]:
        yield ModelFinding(
            "warning",
            f"{_listed(system, each.contacts)} can close together, with restitution"
            f" {_restitutions(system, each.contacts)}: an impact of these alone can raise V by a"
            f" factor of up to {each.factor:.4g}, though the plant's own energy never. Give"
            " contacts that close together one restitution.",
        )
    if (more := len(checked.growths) - _SHOWN) > 0:
        yield ModelFinding(
            "warning", f"{_count(more, 'other set')} of contacts found can do so too."
        )


def _closing(checked: "ModelCheck") -> Iterator[ModelFinding]:
    system = checked.system
    if not checked.possible:
        yield ModelFinding("warning", "Every position is inside some stop: no plant can start.")
        return
    if not checked.roomy:
        yield ModelFinding(
            "warning",
            "No position is clear of all stops: some contact never opens. With unequal"
            " restitution there an impact may have no solution, which ends a run with an error.",
        )
    for contacts in checked.redundant.sets[:_SHOWN]:
        unequal = len({float(system.eps[i]) for i in contacts}) > 1
        yield ModelFinding(
            "note",
            f"{_listed(system, contacts)} depend on each other and can close together: how they"
            " share an impulse is not unique, the motion is"
            + (
                "; of unequal restitutions the larger counts."
                if unequal and checked.roomy
                else "."
            ),
        )
    if (more := len(checked.redundant.sets) - _SHOWN) > 0:
        yield ModelFinding("note", f"So do {_count(more, 'other set')} of contacts found.")
    if not checked.redundant.decided:
        yield ModelFinding(
            "note",
            "Whether more contacts that close together depend on each other is not decided: too"
            " many sets to look at. The motion is unique either way.",
        )


def _seminorm(checked: "ModelCheck") -> Iterator[ModelFinding]:
    if not len(checked.rigid):
        return
    count = len(checked.rigid)
    shapes = "; ".join(_shape(checked.system, each) for each in checked.rigid[:_SHOWN])
    yield ModelFinding(
        "note",
        f"K is singular, {count} rigid-body mode{'s' * (count > 1)}: {shapes}"
        f"{', ...' * (count > _SHOWN)}. V is a seminorm: it does not see such a displacement.",
    )


def _damping(checked: "ModelCheck") -> Iterator[ModelFinding]:
    free = [f"{mode.frequency:.4g} rad/s" for mode in checked.modes if mode.decay == 0]
    if int(sum(checked.rates == 0)):
        free.insert(0, "rigid-body motion")
    if free:
        some = ", ".join(free[:_SHOWN]) + (f", {len(free) - _SHOWN} more" * (len(free) > _SHOWN))
        yield ModelFinding(
            "note",
            f"Without damping: {some}. V need not vanish: only impacts reduce it there.",
        )
        return
    slowest = -max([mode.decay for mode in checked.modes] + checked.rates.tolist())
    yield ModelFinding(
        "ok",
        "All motion is damped: V falls between impacts too,"
        f" in the slowest mode by a factor e in {0.5 / slowest:.3g} s.",
    )


def _resonances(checked: "ModelCheck") -> Iterator[ModelFinding]:
    for each in checked.resonances:
        yield ModelFinding(
            "warning",
            f"Harmonic {each.harmonic + 1} of the forcing, {each.frequency:g} rad/s, is at the"
            " frequency of an undamped mode: without impacts its amplitude grows without bound.",
        )


def _unseen(checked: "ModelCheck") -> Iterator[ModelFinding]:
    system = checked.system
    if not system.m:
        yield ModelFinding("warning", "There are no contacts: no event ever tells anything.")
        return
    for each in checked.unseen[:_SHOWN]:
        if each.frequency:
            what = f"the mode at {each.frequency:.4g} rad/s"
        elif each.decay:
            what = f"the mode that decays at {-each.decay:.4g} 1/s"
        else:
            what = "the rigid-body mode"
        fate = "only damping takes it away" if each.decay else "it stays"
        yield ModelFinding(
            "warning",
            f"No contact sees {what}, {_shape(system, each.shape)}: no law ever corrects an error"
            f" of it, {fate}.",
        )
    if (more := len(checked.unseen) - _SHOWN) > 0:
        yield ModelFinding("warning", f"No contact sees {more} other modes either.")
    if not checked.unseen:
        yield ModelFinding(
            "ok",
            "Every mode moves some contact. One impact tells one number a contact that closes,"
            f" of {2 * system.n}; enough of them can tell the whole state.",
        )


def _forcing(forcing: "Forcing") -> str:
    """What a forcing consists of, in words."""
    parts = [
        *(["constant force"] if forcing.constant.any() else []),
        *([_count(forcing.frequency.size, "harmonic")] if forcing.frequency.size else []),
        *([f"sampled force to {forcing.end:g} s"] if forcing.sampled is not None else []),
    ]
    return f"forcing: {', '.join(parts) or 'none'}"


def print_check(checked: "ModelCheck") -> None:
    """Print tables and findings."""
    from rich.console import Console
    from rich.table import Table

    width = None if sys.stdout.isatty() else _WIDTH
    console = Console(highlight=False, markup=False, width=width)
    system = checked.system
    console.print(
        f"{system.name}: {_count(system.n, 'coordinate')}, {_count(system.m, 'contact')},"
        f" {_forcing(system.forcing)}"
    )
    for table in _tables(checked):
        console.print()
        console.print(table)
    words = Table.grid(padding=(0, 2))
    words.add_column(no_wrap=True)
    words.add_column(overflow="fold")
    for finding in findings(checked):
        words.add_row(finding.kind, finding.text)
    console.print()
    console.print(words)


def _tables(checked: "ModelCheck") -> "Iterator[Table]":
    """Frequencies without damping, modes with it, contacts."""
    undamped = [
        (str(i), f"{omega:.6g}", _hertz(omega), "" if omega else "rigid body")
        for i, omega in enumerate(checked.undamped.tolist(), start=1)
    ]
    yield _table(("without damping", "rad/s", "Hz", ""), undamped)
    modes = [
        (
            str(i),
            f"{mode.frequency:.6g}",
            _hertz(mode.frequency),
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


def _table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> "Table":
    """A table, the middle of a long one left out."""
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for k, header in enumerate(headers):
        table.add_column(header, justify="right" if k and header else "left", overflow="fold")
    left_out = len(rows) - 2 * _ENDS
    for row in rows if left_out <= 1 else rows[:_ENDS]:
        table.add_row(*row)
    if left_out > 1:
        table.add_row(f"... {left_out} more in --json")
        for row in rows[-_ENDS:]:
            table.add_row(*row)
    return table


def _hertz(omega: float) -> str:
    from math import tau

    return f"{omega / tau:.6g}"


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _names(system: "System", contacts: Sequence[int]) -> list[str]:
    return [system.contact_names[i] for i in contacts]


def _listed(system: "System", contacts: Sequence[int]) -> str:
    """Names in words; of a long list its beginning."""
    names = _names(system, contacts)
    if len(names) > 2 * _SHOWN:
        names = [*names[:_SHOWN], f"{len(names) - _SHOWN} more"]
    return f"Contacts {', '.join(names[:-1])} and {names[-1]}"


def _restitutions(system: "System", contacts: Sequence[int]) -> str:
    """Of few contacts each, of many the range."""
    values = [float(system.eps[i]) for i in contacts]
    if len(values) > 2 * _SHOWN:
        return f"{min(values):g} to {max(values):g}"
    return ", ".join(f"{value:g}" for value in values)


def _shape(system: "System", shape: "Vector") -> str:
    """The largest entries of a shape."""
    order = sorted(range(system.n), key=lambda i: -abs(shape[i]))
    shown = sorted(i for i in order[: 2 * _SHOWN] if shape[i])
    rest = int(sum(shape != 0)) - len(shown)
    entries = [f"{system.coordinates[i]} {shape[i]:.3g}" for i in shown]
    return f"({', '.join(entries)}{f' and {rest} more' if rest else ''})"
