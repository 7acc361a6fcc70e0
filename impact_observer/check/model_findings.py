# SPDX-License-Identifier: Apache-2.0
"""Remarks on a checked model: each a fact with its consequence for an observer."""

from collections.abc import Iterator, Sequence
from math import degrees, radians, tau

import numpy as np

from impact_observer.check.forced_motion import forced_motion
from impact_observer.check.model_check import ModelCheck
from impact_observer.draw.reports import ReportLine, counted, figure, listed
from impact_observer.filter.uncertainty import suggested_deviation
from impact_observer.model import System
from impact_observer.model.parameter_places import key_of
from impact_observer.model.system import unit_of
from impact_observer.states import Vector

_SHOWN = 3
"""Most remarks of one kind, and most terms of a list, that are shown."""
_LARGE_ANGLE = 2.0
"""Gap of a stop that is doubted, rad: most degrees that are taken for rad are more."""


def findings(checked: ModelCheck) -> list[ReportLine]:
    """All remarks on a model; remarks on the impact law come first."""
    return [
        *_impact_law(checked),
        *_grounds(checked.system),
        *_closing(checked),
        *_modes(checked),
        *_unseen(checked),
        *_angles(checked.system),
        *_phases(checked),
        *_forced(checked.system),
        *_size(checked.system),
    ]


def _impact_law(checked: ModelCheck) -> Iterator[ReportLine]:
    """Whether an impact can raise V."""
    system = checked.system
    yield from _rebounds(system)
    if checked.nonexpansive is None and all(law.is_affine for law in system.rebounds):
        yield ReportLine(
            "warning",
            "Whether an impact can raise V is not decided: too many sets of contacts to look at."
            " One restitution for all contacts would settle the question.",
        )
    elif checked.nonexpansive and system.m:
        law = "No impact raises V, or adds kinetic energy, whichever contacts close together."
        yield ReportLine("ok", law)
    for growth in checked.growths[:_SHOWN]:
        yield ReportLine(
            "warning",
            f"{_contacts(system, growth.contacts)} can close together, with restitution"
            f" {_restitutions(system, growth.contacts)}: an impact of these alone can raise V by a"
            f" factor of up to {growth.factor:.4g}, though never the plant's own energy. Give"
            " contacts that close together one restitution.",
        )
    if (more := len(checked.growths) - _SHOWN) > 0:
        sets = counted(more, "other set")
        yield ReportLine("warning", f"An impact of {sets} of contacts can raise V too.")


def _rebounds(system: System) -> Iterator[ReportLine]:
    """What the rebound laws of single contacts mean, and those that depend on the speed."""
    for law, name in zip(system.rebounds, system.contact_names, strict=True):
        if remark := law.remark(name):
            yield ReportLine(*remark)
    if system.m > 1 and not all(law.is_affine for law in system.rebounds):
        yield ReportLine(
            "warning",
            "Restitution depends on the speed: where such a contact closes together with others,"
            " no proof excludes that V rises, and no bound is certified from then on.",
        )


def _grounds(system: System) -> Iterator[ReportLine]:
    """Grounds that move nothing."""
    if system.frame is None:
        return
    grounds = system.frame.grounds
    effects = np.vstack([grounds.stiffness, grounds.damping, grounds.factors])
    for k in np.flatnonzero(~effects.any(axis=0)):
        name = grounds.names[k]
        yield ReportLine(
            "warning",
            f"Ground {name} moves nothing: no spring, damper or stop is attached to it.",
        )


def _closing(checked: ModelCheck) -> Iterator[ReportLine]:
    """Positions outside the stops, and contacts that depend on each other."""
    system, sets = checked.system, checked.redundant.sets
    if not checked.feasible:
        yield ReportLine("warning", "Every position is inside some stop: no plant can start.")
        return
    if not checked.has_clearance:
        yield ReportLine(
            "warning",
            "No position is clear of all stops: some contact never opens. With unequal"
            " restitution there an impact may have no solution, which ends a run with an error.",
        )
    for contacts in sets[:_SHOWN]:
        unequal = len({float(system.eps[i]) for i in contacts}) > 1
        rule = "; of unequal restitutions the larger counts"
        yield ReportLine(
            "note",
            f"{_contacts(system, contacts)} depend on each other and can close together: how they"
            " share an impulse is not unique, the motion is unique"
            f"{rule if unequal and checked.has_clearance else ''}.",
        )
    if (more := len(sets) - _SHOWN) > 0:
        yield ReportLine("note", f"So do {counted(more, 'other set')} of contacts.")
    if not checked.redundant.decided:
        yield ReportLine(
            "note",
            "Whether more contacts that close together depend on each other is not decided: too"
            " many sets to look at. The motion is unique either way.",
        )


def _modes(checked: ModelCheck) -> Iterator[ReportLine]:
    """Rigid-body modes, damping, and resonances."""
    if count := len(checked.rigid):
        shapes = "; ".join(_shape(checked.system, each) for each in checked.rigid[:_SHOWN])
        yield ReportLine(
            "note",
            f"K is singular, {counted(count, 'rigid-body mode')}: {shapes}"
            f"{', ...' * (count > _SHOWN)}. V is a seminorm: V does not see such a displacement.",
        )
    if checked.damped:
        slowest = -max([*checked.modes.real, *checked.rates])
        yield ReportLine(
            "ok",
            "All motion is damped: V falls between impacts too,"
            f" in the slowest mode by a factor e in {figure(0.5 / slowest, 's')}.",
        )
    else:
        undamped = [f"{mode.imag:.4g} rad/s" for mode in checked.modes if mode.real == 0]
        free = ["rigid-body motion"] if 0 in checked.rates else []
        yield ReportLine(
            "note",
            f"Without damping: {listed([*free, *undamped], _SHOWN + 1)}. V need not vanish: only"
            " impacts reduce V in this motion.",
        )
    for harmonic, frequency in checked.resonances:
        yield ReportLine(
            "warning",
            f"Harmonic {harmonic + 1} of the forcing, {frequency:g} rad/s, is at the"
            " frequency of an undamped mode: without impacts its amplitude grows without bound.",
        )


def _unseen(checked: ModelCheck) -> Iterator[ReportLine]:
    """Modes in which no contact moves."""
    system = checked.system
    if not system.m:
        yield ReportLine(
            "warning", "The model has no contacts: no event ever corrects an estimate."
        )
        return
    for value, shape in checked.unseen[:_SHOWN]:
        if value.imag:
            mode = f"the mode at {value.imag:.4g} rad/s"
        elif value.real:
            mode = f"the mode that decays at {-value.real:.4g} 1/s"
        else:
            mode = "the rigid-body mode"
        fate = "only damping reduces the error" if value.real else "the error stays"
        yield ReportLine(
            "warning",
            f"No contact moves in {mode}, {_shape(system, shape)}: no impact ever corrects an"
            f" error in this mode; {fate}.",
        )
    if (more := len(checked.unseen) - _SHOWN) > 0:
        yield ReportLine("warning", f"No contact moves in {counted(more, 'other mode')} either.")
    if not checked.unseen:
        yield ReportLine(
            "ok",
            "Every mode moves some contact. One impact gives one number for each contact that"
            f" closes, of {2 * system.n}; enough impacts determine the whole state.",
        )


def _angles(system: System) -> Iterator[ReportLine]:
    """Stops at angles that hardly anybody means in rad."""
    for contact in system.contacts if system.unit == "rad" else ():
        gap = contact.gap
        if abs(gap) > _LARGE_ANGLE:
            yield ReportLine(
                "warning",
                f"{contact.name} has a gap of {gap:.4g} rad, which is {degrees(gap):.4g} degrees."
                f" If {gap:.4g} degrees are meant, write unit: deg: it converts all angles.",
            )


def _phases(checked: ModelCheck) -> Iterator[ReportLine]:
    """Phases beyond a turn, which hardly anybody means in rad."""
    for place, phase in checked.phases:
        if abs(phase) > tau:
            yield ReportLine(
                "warning",
                f"{key_of(place)} is {phase:g}, more than a turn. Phases are in rad, also with"
                f" unit: deg: if {phase:g} degrees are meant, write {radians(phase):.7g}.",
            )


def _forced(system: System) -> Iterator[ReportLine]:
    """Numbers that no rig has: mostly mm taken for m, or Hz for rad/s."""
    motion, names = forced_motion(system), system.contact_names
    lengths = "angles in rad" if system.unit == "rad" else "lengths in m"
    acceleration = unit_of("m/s^2", system.unit)
    for i in motion.never_reached()[:_SHOWN]:
        moved = abs(float(motion.sag[i])) + float(motion.swing[i])
        yield ReportLine(
            "warning",
            f"{names[i]} is hardly ever reached: constant and harmonic forces move its gap of"
            f" {figure(motion.rest[i], system.unit)} by {moved:.3g} at most. Are all numbers in SI"
            " units?",
        )
    for i in motion.not_reached_alone()[:_SHOWN]:
        yield ReportLine(
            "note",
            f"Excitations alone do not reach {names[i]}: they move its gap of"
            f" {figure(motion.rest[i], system.unit)} by {motion.swing[i]:.3g} at most. Impacts may"
            " end once the start is forgotten.",
        )
    for i in motion.too_fast()[:_SHOWN]:
        yield ReportLine(
            "warning",
            f"Without impacts the gap of {names[i]} changes at up to"
            f" {figure(motion.speed[i], unit_of('m/s', system.unit))}: are all {lengths}, and"
            " frequencies in rad/s?",
        )
    for i in motion.never_returned_to()[:_SHOWN]:
        yield ReportLine(
            "warning",
            f"Constant forces pull away from {names[i]} with"
            f" {figure(-motion.pull[i], acceleration)}, and no spring brings a body back. Is the"
            " sign of the force right, and the order of the bodies of the stop?",
        )
    for i in motion.never_left()[:_SHOWN]:
        yield ReportLine(
            "warning",
            f"A body that rests on {names[i]} never leaves {names[i]}: constant forces press with"
            f" {figure(motion.pull[i], acceleration)}, harmonic forces and grounds shake with only"
            f" {figure(motion.shake[i], acceleration)}. Frequencies are in rad/s: 2 pi times Hz.",
        )
    for omega, place in motion.odd_frequencies(system)[:_SHOWN]:
        yield ReportLine(
            "note",
            f"The excitation of {omega:.4g} rad/s is far {place} mode. If {omega:.4g} was meant in"
            f" Hz, write {tau * omega:.4g}; if in revolutions a minute, {omega * tau / 60:.4g}.",
        )


def _size(system: System) -> Iterator[ReportLine]:
    """A default deviation that does not suit the size of the rig."""
    if not (suggested := suggested_deviation(system)):
        return
    q, *_, u = suggested.split(",")
    given = suggested if system.n <= _SHOWN else f"{q} for each position, {u} for each velocity"
    yield ReportLine(
        "note",
        f"Observers begin with standard deviations of 1 {system.unit} and 1 {system.speed_unit},"
        " which does not suit the size of this rig. Where you know no better, give"
        f" --deviation {given} (initial_deviation of the node): with a faulty sensor the estimate"
        " settles some dozens of events earlier.",
    )


def _contacts(system: System, contacts: Sequence[int]) -> str:
    """Names of contacts, such as ``Contacts a, b and c``."""
    return f"Contacts {listed([system.contact_names[i] for i in contacts], 2 * _SHOWN)}"


def _restitutions(system: System, contacts: Sequence[int]) -> str:
    """The coefficients of few contacts, the range of many."""
    values = system.eps[list(contacts)]
    if len(values) > 2 * _SHOWN:
        return f"{min(values):g} to {max(values):g}"
    return listed(f"{value:g}" for value in values)


def _shape(system: System, shape: Vector) -> str:
    """The largest entries of a mode's shape, by coordinate."""
    largest = sorted(range(system.n), key=lambda i: -abs(shape[i]))[: 2 * _SHOWN]
    shown = [f"{system.coordinates[i]} {shape[i]:.3g}" for i in sorted(largest) if shape[i]]
    more = int(sum(shape != 0)) - len(shown)
    return f"({', '.join(shown)}{f' and {more} more' if more else ''})"
