# SPDX-License-Identifier: Apache-2.0
"""What a model check means for an observer: sentences, each a fact with its consequence."""

from collections.abc import Iterator, Sequence
from math import tau
from typing import NamedTuple

import numpy as np

from impact_observer.check.findings import listed, times
from impact_observer.check.forced_motion import forced_motion
from impact_observer.check.model_check import ModelCheck, largest_kept
from impact_observer.estimation.uncertainty import suggested_deviation
from impact_observer.model import System
from impact_observer.states import Vector

_SHOWN = 3
"""Most findings of one kind, and most terms of a list, that are shown."""


class ModelFinding(NamedTuple):
    """A fact with its consequence.

    Attributes:
        kind: ``ok``, ``note`` or ``warning``.
        text: one or two sentences.
    """

    kind: str
    text: str


def findings(checked: ModelCheck) -> list[ModelFinding]:
    """All findings, those on the impact law first."""
    return [
        *_impact_law(checked),
        *_friction(checked.system),
        *_grounds(checked.system),
        *_closing(checked),
        *_modes(checked),
        *_unseen(checked),
        *_forced(checked.system),
        *_size(checked.system),
    ]


def _impact_law(checked: ModelCheck) -> Iterator[ModelFinding]:
    system = checked.system
    yield from _by_speed(system)
    if checked.nonexpansive is None and not system.curved:
        yield ModelFinding(
            "warning",
            "Whether an impact can raise V is not decided: too many sets of contacts to look at."
            " One restitution for all contacts would settle it.",
        )
    elif checked.nonexpansive and system.m:
        law = "No impact raises V, or adds kinetic energy, whichever contacts close together."
        yield ModelFinding("ok", law)
    for each in checked.growths[:_SHOWN]:
        yield ModelFinding(
            "warning",
            f"{_contacts(system, each.contacts)} can close together, with restitution"
            f" {_restitutions(system, each.contacts)}: an impact of these alone can raise V by a"
            f" factor of up to {each.factor:.4g}, though the plant's own energy never. Give"
            " contacts that close together one restitution.",
        )
    if (more := len(checked.growths) - _SHOWN) > 0:
        yield ModelFinding(
            "warning", f"{times(more, 'other set')} of contacts found can do so too."
        )


def _by_speed(system: System) -> Iterator[ModelFinding]:
    """Restitutions that depend on the speed of approach."""
    for i in sorted(system.curved):
        curve, name = system.contacts[i].curve, system.contact_names[i]
        if curve is not None and not curve.is_nonexpansive:
            yield ModelFinding(
                "warning",
                f"Restitution of {name}: eps(v) v has a slope outside [-1, 1], so an impact of"
                f" {name} alone can raise V, and no bound is certified. Give a table that changes"
                " less steeply with the speed.",
            )
        elif curve is not None:
            yield ModelFinding(
                "ok", f"No impact of {name} alone raises V: eps(v) v never rises faster than v."
            )
    if system.curved and system.m > 1:
        yield ModelFinding(
            "warning",
            "Restitution depends on the speed: where such a contact closes together with others,"
            " it is not proved that V does not rise, and no bound is certified from then on.",
        )


def _friction(system: System) -> Iterator[ModelFinding]:
    """What friction of guides leaves of an error."""
    if not system.guides:
        return
    names = listed([repr(each.name) for each in system.guides], _SHOWN)
    kept = largest_kept(system)
    most = "" if kept is None else f", here up to {kept:.3g} J where nothing else holds them"
    yield ModelFinding(
        "note",
        f"Friction in {names} never raises V, but does not attract: two replicas that stick at"
        f" different places keep 1/2 dq' K dq{most}. Only impacts, or slip, reduce it.",
    )


def _grounds(system: System) -> Iterator[ModelFinding]:
    """Grounds that move nothing."""
    if system.frame is None:
        return
    grounds = system.frame.grounds
    effects = np.vstack([grounds.stiffness, grounds.damping, grounds.factors])
    for k in np.flatnonzero(~effects.any(axis=0)):
        text = (
            f"Ground {grounds.names[k]} moves nothing: no spring, damper, stop or guide is on it."
        )
        yield ModelFinding("warning", text)


def _closing(checked: ModelCheck) -> Iterator[ModelFinding]:
    system, sets = checked.system, checked.redundant.sets
    if not checked.feasible:
        yield ModelFinding("warning", "Every position is inside some stop: no plant can start.")
        return
    if not checked.has_clearance:
        yield ModelFinding(
            "warning",
            "No position is clear of all stops: some contact never opens. With unequal"
            " restitution there an impact may have no solution, which ends a run with an error.",
        )
    for contacts in sets[:_SHOWN]:
        unequal = len({float(system.eps[i]) for i in contacts}) > 1
        rule = "; of unequal restitutions the larger counts"
        yield ModelFinding(
            "note",
            f"{_contacts(system, contacts)} depend on each other and can close together: how they"
            " share an impulse is not unique, the motion is"
            f"{rule if unequal and checked.has_clearance else ''}.",
        )
    if (more := len(sets) - _SHOWN) > 0:
        yield ModelFinding("note", f"So do {times(more, 'other set')} of contacts found.")
    if not checked.redundant.decided:
        yield ModelFinding(
            "note",
            "Whether more contacts that close together depend on each other is not decided: too"
            " many sets to look at. The motion is unique either way.",
        )


def _modes(checked: ModelCheck) -> Iterator[ModelFinding]:
    """Rigid-body modes, damping, and resonances."""
    if count := len(checked.rigid):
        shapes = "; ".join(_shape(checked.system, each) for each in checked.rigid[:_SHOWN])
        yield ModelFinding(
            "note",
            f"K is singular, {times(count, 'rigid-body mode')}: {shapes}"
            f"{', ...' * (count > _SHOWN)}. V is a seminorm: it does not see such a displacement.",
        )
    if checked.damped:
        slowest = -max([*checked.modes.real, *checked.rates])
        yield ModelFinding(
            "ok",
            "All motion is damped: V falls between impacts too,"
            f" in the slowest mode by a factor e in {0.5 / slowest:.3g} s.",
        )
    else:
        undamped = [f"{mode.imag:.4g} rad/s" for mode in checked.modes if mode.real == 0]
        free = ["rigid-body motion"] if 0 in checked.rates else []
        yield ModelFinding(
            "note",
            f"Without damping: {listed([*free, *undamped], _SHOWN + 1)}. V need not vanish: only"
            " impacts reduce it there.",
        )
    for harmonic, frequency in checked.resonances:
        yield ModelFinding(
            "warning",
            f"Harmonic {harmonic + 1} of the forcing, {frequency:g} rad/s, is at the"
            " frequency of an undamped mode: without impacts its amplitude grows without bound.",
        )


def _unseen(checked: ModelCheck) -> Iterator[ModelFinding]:
    system = checked.system
    if not system.m:
        yield ModelFinding("warning", "There are no contacts: no event ever corrects an estimate.")
        return
    for value, shape in checked.unseen[:_SHOWN]:
        if value.imag:
            what = f"the mode at {value.imag:.4g} rad/s"
        elif value.real:
            what = f"the mode that decays at {-value.real:.4g} 1/s"
        else:
            what = "the rigid-body mode"
        fate = "only damping reduces it" if value.real else "it stays"
        yield ModelFinding(
            "warning",
            f"No contact moves in {what}, {_shape(system, shape)}: no impact ever corrects an"
            f" error in it; {fate}.",
        )
    if (more := len(checked.unseen) - _SHOWN) > 0:
        yield ModelFinding("warning", f"No contact moves in {more} other modes either.")
    if not checked.unseen:
        yield ModelFinding(
            "ok",
            "Every mode moves some contact. One impact gives one number for each contact that"
            f" closes, of {2 * system.n}; enough of them determine the whole state.",
        )


def _forced(system: System) -> Iterator[ModelFinding]:
    """What follows from the numbers and no rig does: mostly mm taken for m, or Hz for rad/s."""
    motion, names = forced_motion(system), system.contact_names
    for i in motion.never_reached()[:_SHOWN]:
        moved = abs(float(motion.sag[i])) + float(motion.swing[i])
        yield ModelFinding(
            "warning",
            f"{names[i]} is hardly ever reached: constant and harmonic forces move its gap of"
            f" {motion.rest[i]:.3g} {system.unit} by {moved:.3g} at most. Are all numbers in SI"
            " units?",
        )
    for i in motion.not_reached_alone()[:_SHOWN]:
        yield ModelFinding(
            "note",
            f"Excitations alone do not reach {names[i]}: they move its gap of"
            f" {motion.rest[i]:.3g} {system.unit} by {motion.swing[i]:.3g} at most. Impacts may"
            " end once the start is forgotten.",
        )
    for i in motion.too_fast()[:_SHOWN]:
        yield ModelFinding(
            "warning",
            f"Without impacts the gap of {names[i]} changes at up to {motion.speed[i]:.3g} m/s:"
            " are all lengths in m, and frequencies in rad/s?",
        )
    for i in motion.never_left()[:_SHOWN]:
        yield ModelFinding(
            "warning",
            f"What rests on {names[i]} never leaves it: constant forces press it on by"
            f" {motion.pull[i]:.3g} m/s^2, harmonic ones and grounds shake it by"
            f" {motion.shake[i]:.3g} m/s^2 only. Frequencies are in rad/s: 2 pi times Hz.",
        )
    for omega, where in motion.odd_frequencies(system)[:_SHOWN]:
        yield ModelFinding(
            "note",
            f"The excitation of {omega:.4g} rad/s is far {where} mode. If {omega:.4g} was meant in"
            f" Hz, write {tau * omega:.4g}; if in revolutions a minute, {omega * tau / 60:.4g}.",
        )


def _size(system: System) -> Iterator[ModelFinding]:
    """A default that is of another size than the rig."""
    if not (suggested := suggested_deviation(system)):
        return
    q, *_, u = suggested.split(",")
    given = suggested if system.n <= _SHOWN else f"{q} for each position, {u} for each velocity"
    yield ModelFinding(
        "note",
        f"Observers begin with standard deviations of 1 {system.unit} and 1 {system.speed_unit},"
        " but the size of this rig is another one. Where you know no better, give"
        f" --deviation {given} (initial_deviation of the node): with a faulty sensor the estimate"
        " settles some dozens of events earlier.",
    )


def _contacts(system: System, contacts: Sequence[int]) -> str:
    """``Contacts a, b and c``; of a long list the first names and how many more there are."""
    names = [system.contact_names[i] for i in contacts]
    if len(names) > 2 * _SHOWN:
        names = [*names[:_SHOWN], f"{len(names) - _SHOWN} more"]
    return f"Contacts {', '.join(names[:-1])} and {names[-1]}"


def _restitutions(system: System, contacts: Sequence[int]) -> str:
    """The coefficients of few contacts, the range of many."""
    values = system.eps[list(contacts)]
    if len(values) > 2 * _SHOWN:
        return f"{min(values):g} to {max(values):g}"
    return ", ".join(f"{value:g}" for value in values)


def _shape(system: System, shape: Vector) -> str:
    """The largest entries of a mode's shape, by coordinate."""
    largest = sorted(range(system.n), key=lambda i: -abs(shape[i]))[: 2 * _SHOWN]
    shown = [f"{system.coordinates[i]} {shape[i]:.3g}" for i in sorted(largest) if shape[i]]
    more = int(sum(shape != 0)) - len(shown)
    return f"({', '.join(shown)}{f' and {more} more' if more else ''})"
