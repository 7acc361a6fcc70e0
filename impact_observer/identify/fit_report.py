# SPDX-License-Identifier: Apache-2.0
"""A fitted model in words, in tables, as JSON and as a model file."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast

import numpy as np
from rich.table import Table
from scipy.optimize import approx_fprime

from impact_observer import __version__
from impact_observer.draw.text_tables import plain_table, print_report
from impact_observer.identify.fit_check import FitCheck
from impact_observer.identify.identification import Identification
from impact_observer.identify.model_edit import changes
from impact_observer.identify.recorded_impacts import Hit
from impact_observer.identify.residuals import REJECTED
from impact_observer.identify.search import combination
from impact_observer.identify.sensor_fit import SensorFit
from impact_observer.model import System, parse_model
from impact_observer.model.model_file import ModelText, edited, load_yaml
from impact_observer.stamps import seconds_between, text
from impact_observer.states import Vector

_CORRELATED = 0.9
"""Correlation of two parameters above which it is printed."""
_MANY = 0.25
"""Share of outliers among the impacts above which a declared clock error is named."""
_SPARE = 4
"""Least number of stamps beyond the unknowns that tell of errors of a clock or a model."""
_OTHER = 100.0
"""Shifts, in declared clock errors, above which the times may be another rig's or unit's."""
_LARGEST_CLOCK = 0.1
"""Shifts above which no clock makes them, s."""
_OF_INTERVALS = 0.02
"""The same, in median times between impacts."""
_SHOWN = 6
"""Most rejected or inserted impacts that are printed."""


def _initial_state(found: Identification) -> Vector:
    """Of the motion that fits, (q, u), shape (2n,), also where stops move."""
    episode = found.recording.episode
    at = np.array([episode.start - episode.epoch])
    states = found.family.system_at(found.values).from_frame(at, found.start[None])
    return np.asarray(states[0])


def _inside(found: Identification) -> str:
    """What is wrong with the initial state where a body is inside a stop; empty elsewhere."""
    system = found.family.system_at(found.values)
    names = [system.contact_names[i] for i in system.penetrated(found.start[: system.n])]
    if not names:
        return ""
    episode = found.recording.episode
    first, second = (key.stamp for key in episode.keys[:2])
    remedy = "--initial-state cannot write it"
    if not system.depends_on_time:
        ahead = first - max((second - first) // 10, 1)
        epoch = text(ahead).rstrip("0").rstrip(".")
        remedy = f"repeat import or detect with --epoch {epoch}, shortly before it"
    ahead_of_first = seconds_between(episode.start, first)
    where = (
        f"inside the stop {names[0]!r}: it holds {ahead_of_first:.3g} s before the first impact,"
        " where the rig moved otherwise"
        if ahead_of_first
        else f"on the stop {names[0]!r}, as good as inside"
    )
    return f"the initial state is {where}; {remedy}"


def _initial_errors(found: Identification) -> Vector:
    """Standard errors of ``_initial_state``, shape (2n,)."""
    return np.asarray(np.sqrt(np.diag(found.covariance))[: found.start.size])


def _turning_point(found: Identification) -> tuple[float, float] | None:
    """Where a body that flies alone turns, and its standard error: ``q - u^2 / 2a``.

    None where something else moves, or pulls than a constant force.
    """
    family, n = found.family, found.family.system.n
    system = family.system_at(found.values)
    moved = system.depends_on_time or system.guides or system.live is not None
    if n > 1 or moved or system.K.any() or system.C.any() or not system.forcing.constant.any():
        return None

    def height(x: Vector) -> float:
        a = system.forcing.constant.item() / family.at(x[2:]).M.item()
        return float(x[0] - x[1] ** 2 / (2.0 * a))

    at = np.concatenate([_initial_state(found), found.values])
    slope = approx_fprime(at, height)
    covariance = found.covariance[: at.size, : at.size]
    return height(at), float(np.sqrt(slope @ covariance @ slope))


def for_json(found: Identification, check: FitCheck) -> dict[str, object]:
    """What ``--json`` prints; SI units."""
    family, recording = found.family, found.recording
    names = family.system.contact_names
    return {
        "name": family.system.name,
        "converged": found.converged,
        "widened": found.widened,
        "widened_because": [*_reasons(found, check)] if found.widened > 1.0 else [],
        "held_back": found.held_back
        and {**found.held_back._asdict(), "carries_over": found.held_back.carries_over},
        "fits": check.fits and found.converged,
        "parameters": {
            each.name: {
                "given": each.value,
                "value": value,
                "standard_error": error if found.converged else None,
                "unit": each.unit,
                "at_bound": each.name in found.bounded,
            }
            for each, value, error in zip(
                family.parameters, found.values.tolist(), found.errors.tolist(), strict=True
            )
        },
        "correlation": found.correlation.tolist(),
        "unknown": list(found.undetermined),
        "singular_values": found.singular.tolist(),
        "initial_state": _initial_state(found).tolist(),
        "initial_state_error": _initial_errors(found).tolist() if found.converged else None,
        "initial_state_covariance": (
            found.covariance[: found.start.size, : found.start.size].tolist()
            if found.converged
            else None
        ),
        "initial_state_seconds": recording.start,
        "turning_point": _turning_point(found) if found.converged else None,
        "clock_error": float(found.clock),
        "clock_error_declared": found.declared,
        "clock_error_with_all_accepted": found.accepted,
        "doubted": found.doubted,
        "residual": found.rms,
        "degrees_of_freedom": found.freedom,
        "impacts": len(found.shifts),
        "rejected": [[stamp, names[i]] for stamp, i in sorted(recording.rejected)],
        "inserted": [[stamp, names[i]] for stamp, i in sorted(recording.inserted)],
        "settled": [[stamp, names[i]] for stamp, i in sorted(recording.settled)],
        "probability_of_size": check.size,
        "probability_of_whiteness": check.white,
        "contacts": {
            name: {"impacts": count, "mean": mean, "rms": rms}
            for name, (count, mean, rms) in check.by_contact.items()
        },
        "worst_contact": check.worst,
        "sensors": [{**asdict(each), "fits": each.fits} for each in found.sensors],
        "shifts": {
            "seconds": found.stamps.tolist(),
            "shift": found.shifts.tolist(),
            "contacts": [list(each) for each in found.contacts],
        },
    }


def print_parameters(found: Identification, check: FitCheck) -> None:
    """Print the fitted parameters and how well they are determined."""
    lines = [*_about_fit(found), *_about_errors(found, check), *_about_parameters(found)]
    print_report(_parameter_table(found), [_about_start(found), *lines], above=_verdict(found))


def print_check(found: Identification, check: FitCheck) -> None:
    """Print how well each contact's impacts fit, and whether the model is rejected."""
    table = plain_table("contact", "impacts", "mean [s]", "rms [s]", names={"contact"})
    for name, (count, mean, rms) in check.by_contact.items():
        table.add_row(name, str(count), f"{mean:.3g}", f"{rms:.3g}")
    print_report(table, [*_about_fit(found), *_about_check(found, check)], above=_verdict(found))


def _verdict(found: Identification) -> Iterator[str]:
    """What speaks against the model: nothing, or why its values are not to be used."""
    if not found.converged:
        yield (
            "The model does not fit: no motion of it explains these stamps. Do not use these"
            " values; they have no standard errors. Begin with other values, or free other"
            f" parameters (docs/misfit.md).{_about_time(found.family.system)}"
        )
    if found.declared and found.rms > _OTHER * found.clock and not _may_be_a_clock(found):
        yield (
            f"WARNING: the shifts of the stamps, {found.rms:.3g} s rms, are no errors of a clock"
            f" with {found.clock:.3g} s: is the model that of the rig, and --time-unit that of"
            " the times that were imported?"
        )
    if found.converged and found.held_back and not found.held_back.carries_over:
        yield "WARNING: the model does not carry over to the impacts that were held back."


def _may_be_a_clock(found: Identification) -> bool:
    """Whether the shifts are small enough for errors of some clock."""
    between = float(np.median(np.diff(found.stamps))) if found.stamps.size > 1 else 0.0
    return found.rms <= min(_LARGEST_CLOCK, _OF_INTERVALS * between)


def _parameter_table(found: Identification) -> Table:
    headings = ("parameter", "given", "identified", "standard error", "unit")
    table = plain_table(*headings, names={"parameter", "unit"})
    undetermined = {name for each in found.undetermined for name in each}
    for each, value, error in zip(
        found.family.parameters, found.values, found.errors, strict=True
    ):
        shown, own = f"{value:.10g}", f"{error:.2g}"
        if each.name in undetermined:
            shown, own = "not determined", ""
        if each.name in found.bounded:
            own = "at its bound"
        own = own if found.converged else ""
        table.add_row(each.name, f"{each.value:.6g}", shown, own, each.unit)
    system = found.family.system
    rows = [(f"{name} at the start", system.unit) for name in system.coordinates]
    rows += [(f"d{name}/dt at the start", system.speed_unit) for name in system.coordinates]
    states = zip(rows, _initial_state(found), _initial_errors(found), strict=True)
    for (name, unit), value, error in states:
        own = f"{error:.2g}" if found.converged else ""
        table.add_row(name, "", f"{value:.10g}", own, unit)
    if found.converged and (turn := _turning_point(found)):
        (name,), (value, error) = system.coordinates, turn
        table.add_row(f"{name} where it turns", "", f"{value:.10g}", f"{error:.2g}", system.unit)
    return table


def _about_start(found: Identification) -> str:
    """Where the initial state holds."""
    if found.recording.start:
        return f"The start is {found.recording.start:.9g} s after the epoch."
    named = found.recording.episode.start == found.recording.episode.keys[0].stamp
    where = "The start is the first impact." if named else "The start is the epoch."
    return f"{where} But {wrong}." if (wrong := _inside(found)) else where


def _about_fit(found: Identification) -> Iterator[str]:
    declared = f"; {found.clock:.3g} s was declared" if found.declared else ""
    off = f"differ from the model's impacts by {found.rms:.3g} s rms"
    yield f"{len(found.shifts)} stamps {off}{declared}."
    yield from map(_about_sensor, found.sensors)
    unknowns = 2 * found.family.system.n + found.family.size
    is_short = not found.sensors and len(found.shifts) < unknowns + _SPARE
    if is_short:
        yield (
            f"WARNING: {len(found.shifts)} stamps are few for {unknowns} unknowns, the start among"
            " them: record more impacts, or free fewer parameters."
        )
    impacts = len(found.shifts) + len(found.recording.rejected)
    many = found.doubted >= _MANY * impacts
    if found.declared and many and not is_short and _may_be_a_clock(found):
        yield (
            f"WARNING: --clock-error {found.clock:.3g} makes outliers: up to {found.doubted}"
            f" impacts were rejected or inserted, {impacts} are recorded. The shifts say"
            f" {min(found.accepted, found.rms):.3g} s: leave it out or declare that, unless the"
            " model is wrong."
        )
    if found.recording.rejected:
        yield _listed(found, found.recording.rejected, "rejected as spurious")
    if found.recording.inserted:
        dead = len(found.recording.in_dead_time)
        known = f" ({dead} of them in the dead time)" if dead else ""
        yield _listed(found, found.recording.inserted, f"inserted as missed{known}")
    if found.recording.settled:
        yield (
            f"{len(found.recording.settled)} impacts left out: in bounces that settle, flights"
            " are as short as the stamps are wrong, so one closing stands for each row."
        )


def _about_time(system: System) -> str:
    """What to ask where forces or grounds are harmonic; empty elsewhere."""
    frame, phases = system.frame, ["forcing-phase"] * bool(system.own_forcing.frequency.size)
    if frame is not None:
        phases += ["ground-phase"] * bool(frame.grounds.motion.frequency.size)
    if not phases:
        return ""
    free = " or ".join(phases)
    return f" Is the epoch right (free {free} to see)? Is every frequency in rad/s?"


def _about_sensor(each: SensorFit) -> str:
    """How well the samples of a sensor fit."""
    known = "was declared" if each.is_declared else "is learned"
    words = [f"{each.samples} samples of {each.name} differ from the motion by {each.rms:.3g} rms"]
    words.append(f"{each.deviation:.3g} {known}")
    words += [f"{each.near} near impacts are left out"] * (each.near > 0)
    words += [f"{each.rejected} are rejected by the gate"] * (each.rejected > 0)
    return "; ".join(words) + "."


def _about_errors(found: Identification, check: FitCheck) -> Iterator[str]:
    """Why standard errors are widened, and how the model does on what was held back."""
    if found.converged and found.widened > 1.0:
        reasons = "; ".join(_reasons(found, check))
        yield f"Standard errors are widened by a factor of {found.widened:.3g}: {reasons}."
    if not found.converged or not found.family.size:
        return
    held = found.held_back
    if held is None:
        yield "No impacts were held back for a check."
        return
    declared = f"; {found.clock:.3g} s was declared" if found.declared else ""
    yield (
        f"Checked on the last {held.impacts} impacts: residuals {held.residual:.3g} s (fitted part"
        f" {held.fitted:.3g} s{declared}). The values are from all impacts."
    )


def _reasons(found: Identification, check: FitCheck) -> Iterator[str]:
    """What says that the shifts are not white errors of the clock."""
    if check.size is not None and check.size < REJECTED:
        yield f"shifts are {found.rms / found.clock:.3g} times the declared clock error"
    if check.white < REJECTED:
        yield "neighbouring shifts are correlated"
    for each in found.sensors:
        if each.size < REJECTED:
            times = each.rms / each.deviation
            yield f"errors of {each.name} are {times:.3g} times the declared deviation"
        if each.white < REJECTED:
            yield f"neighbouring errors of {each.name} are correlated"
    if not found.declared:
        yield "without --clock-error an error of the model looks like one of the clock"


def _listed(found: Identification, hits: frozenset[Hit], outcome: str) -> str:
    """The instants of some impacts since the epoch."""
    names, epoch = found.family.system.contact_names, found.recording.episode.epoch
    shown = [f"{names[i]} at {seconds_between(epoch, stamp):.3f} s" for stamp, i in sorted(hits)]
    more = len(shown) - _SHOWN
    times = ", ".join(shown[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
    return f"{len(hits)} impacts {outcome}: {times}."


def _about_parameters(found: Identification) -> Iterator[str]:
    """Which parameters are not determined, at a bound, or correlated."""
    for each in found.undetermined:
        yield f"Not determined by these impacts: {combination(each)}. Hold one of them fixed."
    for name in found.bounded:
        yield (
            f"{name} ended at its bound: the model may be wrong. If the bound is its value, write"
            f" that into the model and leave it out of --free.{_about_time(found.family.system)}"
        )
    if found.converged and found.family.size:
        yield "Standard errors hold if the model is right in all that was not free."
    names, correlation = found.family.names, found.correlation
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > _CORRELATED:
                yield f"{names[j]} and {names[i]} are correlated by {correlation[i, j]:.3f}."


def _about_check(found: Identification, check: FitCheck) -> Iterator[str]:
    if check.size is not None:
        yield (
            "A model that is right gives shifts as large as these with probability"
            f" {check.size:.2g}; below {REJECTED:g} it does not fit."
        )
    yield (
        "A model that is right gives neighbouring shifts as correlated as these with"
        f" probability {check.white:.2g} ({check.lags} lags)."
    )
    good = check.fits and found.converged
    worst = ", ".join([check.worst, *check.odd])
    yield "The model fits." if good else f"The model does not fit; worst: {worst}."


def write_model(
    found: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool
) -> str:
    """Write :func:`model_text`; the initial state only where it is outside all stops.

    Returns:
        What was left out, to be printed; empty if nothing was.
    """
    inside = initial and bool(_inside(found))
    text = model_text(found, given, bag, output, initial=initial and not inside)
    output.write_text(text, encoding="utf-8")
    return "without the initial state, which is inside a stop" if inside else ""


def model_text(
    found: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool = False
) -> str:
    """The given model file with the fitted values, in its own form, with provenance.

    Args:
        found: the fitted model.
        given: the file it was fitted from.
        bag: the recording.
        output: where the text will be; for errors.
        initial: whether to write the initial state too.

    Raises:
        ModelError: the fitted values make no valid model.
    """
    document = cast("dict[str, Any]", load_yaml(given.text))
    rows = zip(found.family.names, found.values.tolist(), found.errors.tolist(), strict=True)
    provenance: dict[str, object] = {
        "package": "impact_observer",
        "version": __version__,
        "identified_from": str(bag),
        "clock_error": float(found.clock),
        "parameters": {name: {"value": v, "standard_error": error} for name, v, error in rows},
    }
    if "provenance" in document:
        provenance["before"] = document["provenance"]
    entries = changes(document, found.family, found.values)
    if initial:
        q, u = np.split(_initial_state(found), 2)
        entries["initial_state",] = {"position": q.tolist(), "velocity": u.tolist()}
    text = edited(given.text, {**entries, ("provenance",): provenance})
    parse_model(*given._replace(text=text, source=str(output)))
    return text
