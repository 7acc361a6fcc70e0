# SPDX-License-Identifier: Apache-2.0
"""A fitted model in words, in tables, as JSON and as a model file."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.optimize import approx_fprime

from impact_observer import __version__
from impact_observer.draw.reports import (
    ReportLine,
    TextTable,
    counted,
    figure,
    listed,
    print_facts,
    print_table,
)
from impact_observer.events import Kind
from impact_observer.identify.fit_check import FitCheck, check_fit
from impact_observer.identify.identification import Identification
from impact_observer.identify.model_edit import changes
from impact_observer.identify.prior import chance_of
from impact_observer.identify.recorded_impacts import Hit
from impact_observer.identify.residuals import DOUBTED, REJECTED, UNDECLARED
from impact_observer.identify.search import combination
from impact_observer.identify.sensor_fit import SensorFit
from impact_observer.identify.unreported import dead_time_of, has_rows
from impact_observer.identify.written_uncertainty import written_uncertainty
from impact_observer.model import ParameterUncertainty, parse_model
from impact_observer.model.declared_deviations import without_deviations
from impact_observer.model.free_parameters import OFFSET, is_observed, is_phase
from impact_observer.model.model_file import VERDICT, ModelText, edited, load_yaml
from impact_observer.model.parameter_uncertainty import KEY
from impact_observer.output_files import replacing
from impact_observer.plain_text import say
from impact_observer.stamps import from_seconds, seconds_between, text
from impact_observer.states import Vector

_CORRELATED = 0.9
"""Least correlation of two parameters that is printed."""
_MANY = 0.25
"""Share of outliers among the impacts above which a declared clock error is named."""
_SPARE = 4
"""Least surplus of stamps over unknowns that shows errors of a clock or a model."""
_LARGEST_CLOCK = 0.1
"""Shifts above which no clock makes them, s."""
_OF_INTERVALS = 0.02
"""Shifts over the median time between impacts above which no clock makes them."""
_NO_OTHER = (
    " No other parameter alone makes the model fit: look at --plot, declare the clock's error as"
    " --clock-error if it is larger, or change the model (docs/troubles.md)."
)
"""What follows where no parameter is found that would make a model fit."""
_SHOWN = 6
"""Most rejected or inserted impacts that are printed."""


def _initial_state(fitted: Identification) -> Vector:
    """The initial state (q, u) of the motion that fits, shape (2n,), also where stops move."""
    episode = fitted.recording.episode
    at = np.array([episode.start - episode.epoch])
    states = fitted.family.system_at(fitted.values).from_frame(at, fitted.start[None])
    return np.asarray(states[0])


def _inside(fitted: Identification) -> str:
    """Why the initial state is wrong if a body is inside a stop; else empty."""
    system = fitted.family.system_at(fitted.values)
    names = [system.contact_names[i] for i in system.penetrated(fitted.start[: system.n])]
    if not names:
        return ""
    episode = fitted.recording.episode
    first, second = (key.stamp for key in episode.keys[:2])
    remedy = "--initial-state cannot write it"
    ahead = first - max((second - first) // 10, 1)
    if not system.depends_on_time and episode.epoch != ahead:
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


def _initial_errors(fitted: Identification) -> Vector:
    """Standard errors of ``_initial_state``, shape (2n,)."""
    return np.asarray(np.sqrt(np.diag(fitted.covariance))[: fitted.start.size])


class _TurningPoint(NamedTuple):
    """Where a single body turns that flies under a constant force alone.

    Attributes:
        name: what is measured, such as ``height where it turns``.
        value: the coordinate, or the gap where stops move, m.
        error: its standard error, m.
    """

    name: str
    value: float
    error: float


def _turning_point(fitted: Identification) -> _TurningPoint | None:
    """Where a single body turns; None unless the model is one that flies under a constant force.

    Above a stop that moves that is the gap then; None if the body turns before the start or after
    the first impact, where it may have been held.
    """
    family, recording, n = fitted.family, fitted.recording, fitted.family.system.n
    system = family.system_at(fitted.values)
    own, moves = system.own_forcing, system.frame is not None
    forced = own.depends_on_time or system.live is not None
    if (
        n > 1
        or forced
        or fitted.lost.any()
        or system.K.any()
        or system.C.any()
        or not own.constant.any()
    ):
        return None
    first, hit = next(each for each in recording.hits() if each[1])
    (name,), contact = system.coordinates, system.contact_names[hit[0]]

    def turned(x: Vector) -> tuple[float, float]:
        """The coordinate where the body turns, m, and when, s after the start."""
        a = own.constant.item() / family.coefficients_at(x[2:]).M.item()
        return float(x[0] - x[1] ** 2 / (2.0 * a)), float(-x[1] / a)

    def distance(x: Vector) -> float:
        height, after = turned(x)
        if not moves:
            return height
        there = family.system_at(x[2:])
        at = np.array([from_seconds(recording.start + after)])
        return float(there.gap(np.array([height]))[hit[0]] + there.gap_motion(at)[0, hit[0]])

    at = np.concatenate([_initial_state(fitted), fitted.values])
    until = seconds_between(recording.episode.start, first)
    if moves and not 0.0 <= turned(at)[1] <= until:
        return None
    slope = approx_fprime(at, distance)
    covariance = fitted.covariance[: at.size, : at.size]
    what = f"gap of {contact}" if moves else name
    error = float(np.sqrt(slope @ covariance @ slope))
    return _TurningPoint(f"{what} where it turns", distance(at), error)


def restitution_scatter(fitted: Identification) -> dict[str, float]:
    """Standard deviation of the restitution of a hit by contact; empty if none is learned."""
    if not fitted.scatter:
        return {}
    hit = {name for each in fitted.contacts for name in each}
    values = zip(fitted.system.contact_names, fitted.system.eps.tolist(), strict=True)
    return {k: (1 + eps) * fitted.scatter for k, eps in values if k in hit}


def for_json(fitted: Identification, check: FitCheck) -> dict[str, object]:
    """The values of ``--json``, in SI units."""
    family, recording = fitted.family, fitted.recording
    names = family.system.contact_names
    turn = _turning_point(fitted) if fitted.converged else None
    return {
        "name": family.system.name,
        "converged": fitted.converged,
        "widened": fitted.widened,
        "widened_because": [*_reasons(fitted, check)] if fitted.widened > 1.0 else [],
        "held_back": fitted.held_back
        and {**fitted.held_back._asdict(), "carries_over": fitted.carries_over},
        "fits": check.fits and fitted.converged,
        "others": {
            each.name: {
                "value": each.value,
                "unit": each.unit,
                "residual": each.rms,
                "fits": each.fits,
                "parameters": dict(zip(family.names, each.values.tolist(), strict=True)),
            }
            for each in fitted.others
        },
        "parameters": {
            each.name: {
                "given": each.value,
                "value": value,
                "standard_error": error if fitted.converged else None,
                "unit": each.unit,
                "at_bound": each.name in fitted.bounded,
            }
            for each, value, error in zip(
                family.parameters, fitted.values.tolist(), fitted.errors.tolist(), strict=True
            )
        },
        "priors": {
            each.name: {"deviation": each.deviation, "innovation": each.innovation}
            for each in fitted.prior_shifts
        },
        "restitution_scatter": restitution_scatter(fitted),
        "correlation": fitted.correlation.tolist(),
        "unknown": list(fitted.undetermined),
        "singular_values": fitted.singular.tolist(),
        "initial_state": _initial_state(fitted).tolist(),
        "initial_state_error": (
            [
                None if lost else error
                for lost, error in zip(fitted.lost, _initial_errors(fitted).tolist(), strict=True)
            ]
            if fitted.converged
            else None
        ),
        "initial_state_covariance": (
            fitted.covariance[: fitted.start.size, : fitted.start.size].tolist()
            if fitted.converged and not fitted.lost.any()
            else None
        ),
        "initial_state_seconds": recording.start,
        "turning_point": turn and [turn.value, turn.error],
        "clock_error": float(fitted.clock),
        "clock_error_declared": fitted.declared,
        "clock_error_with_all_accepted": fitted.accepted,
        "doubted": fitted.doubted,
        "unsearched": fitted.unsearched,
        "reached": fitted.reached
        and {"impacts": fitted.reached.moments, "seconds": fitted.reached.end},
        "residual": fitted.rms,
        "degrees_of_freedom": fitted.freedom,
        "impacts": len(fitted.shifts),
        "rejected": [[stamp, names[i]] for stamp, i in sorted(recording.rejected_events)],
        "inserted": [[stamp, names[i]] for stamp, i in sorted(recording.inserted)],
        "mislabelled": [
            [stamp, names[named], names[i]]
            for (stamp, i), named in sorted(recording.counted_for_others.items())
        ],
        "settled": [[stamp, names[i]] for stamp, i in sorted(recording.settled)],
        "probability_of_size": check.size,
        "probability_of_whiteness": check.white,
        "largest_shift": check.shift.largest,
        "contacts": {
            name: {"impacts": count, "mean": mean, "rms": rms}
            for name, (count, mean, rms) in check.by_contact.items()
        },
        "worst_contact": check.worst,
        "sensors": [*map(_sensor_for_json, fitted.sensors)],
        "shifts": {
            "seconds": fitted.stamps.tolist(),
            "shift": fitted.shifts.tolist(),
            "contacts": [list(each) for each in fitted.contacts],
        },
    }


def _sensor_for_json(fit: SensorFit) -> dict[str, object]:
    """How the samples of a sensor fit, as values of ``--json``."""
    own = asdict(fit)
    del own["sensor"]
    return {"name": fit.name, **own, "fits": fit.fits}


def print_parameters(fitted: Identification, check: FitCheck) -> None:
    """Print the fitted parameters and how well they are determined."""
    _print(
        fitted,
        check,
        _parameter_table(fitted),
        [
            _about_start(fitted),
            *_about_fit(fitted),
            *_about_errors(fitted, check),
            *_about_parameters(fitted),
        ],
    )


def print_check(fitted: Identification, check: FitCheck) -> None:
    """Print how well each contact's impacts fit, and whether the model is rejected.

    Where no motion explains the impacts, there is nothing to tell of single contacts.
    """
    if not fitted.converged:
        print_facts([*_verdict(fitted, check), *_about_search(fitted)])
        return
    rows = [
        (name, str(count), f"{mean:.3g}", f"{rms:.3g}")
        for name, (count, mean, rms) in check.by_contact.items()
    ]
    table = TextTable(("contact", "impacts", "mean [s]", "rms [s]"), rows)
    _print(fitted, check, table, [*_about_fit(fitted), *_about_check(fitted, check)])


def _print(
    fitted: Identification, check: FitCheck, table: TextTable, remarks: Iterable[ReportLine]
) -> None:
    """Print what speaks against the model, a table, and remarks."""
    if verdict := [*_verdict(fitted, check)]:
        print_facts(verdict)
        say("")
    print_table(table)
    say("")
    print_facts(remarks)


def _about_others(fitted: Identification) -> str:
    """The parameters with which the model fits; empty for none."""
    fits = [
        f"{each.name} ({f'{each.value:.7g} {each.unit}'.rstrip()}; then"
        f" {figure(each.rms, 's')} rms)"
        for each in fitted.others
        if each.fits
    ]
    is_large = any(each.rms > UNDECLARED for each in fitted.others if each.fits)
    and_clock = ", and --clock-error declared" if is_large and not fitted.declared else ""
    text = f" The model fits if one of these is free, too{and_clock}: {listed(fits)}."
    return text if fits else ""


def _remedy(fitted: Identification, check: FitCheck) -> str:
    """What a model needs that does not fit."""
    if others := _about_others(fitted):
        return others
    if replace(check, large=False).fits:
        return (
            f" If the sensor jitters so much, declare --clock-error {figure(fitted.rms)};"
            " otherwise look at --plot, or change the model (docs/troubles.md)."
        )
    return _NO_OTHER


def _verdict(fitted: Identification, check: FitCheck) -> Iterator[ReportLine]:
    """Reasons not to use the values; none where the model may be right."""
    if not fitted.converged:
        yield ReportLine(
            "error",
            "The model does not fit: no motion of the model explains these stamps. Do not use"
            " these values; they have no standard errors. Begin with other values, free other"
            " parameters, or take a part by --duration (docs/troubles.md)."
            f"{_about_first_part(fitted)}"
            f"{_about_dead_time(fitted)}{_about_others(fitted)}{_without_a_fit(fitted)}",
        )
    elif not check.fits:
        stamps = counted(len(fitted.shifts), "stamp")
        yield ReportLine(
            "error",
            f"The model does not fit: {stamps} differ from its impacts by"
            f" {figure(fitted.rms, 's')} rms{_declared(fitted)}:"
            f" {'; '.join(_reasons(fitted, check))}.{_remedy(fitted, check)}"
            f"{_without_a_fit(fitted)}",
        )
    if fitted.converged and not fitted.carries_over:
        text = "The model does not carry over to the impacts that were held back."
        yield ReportLine("warning", text)


def _without_a_fit(fitted: Identification) -> str:
    """What to do with a model that declares how wrong its numbers may be; else empty."""
    if fitted.recording.prior is None:
        return ""
    return (
        " observe and smooth need no fit: these take the declared deviations, and learn a"
        " restitution that scatters from hit to hit."
    )


def _about_dead_time(fitted: Identification) -> str:
    """What to do where the sensor reports only the first edges of rows of bounces."""
    recording, family = fitted.recording, fitted.family
    if not has_rows(recording, family.system):
        return ""
    names = [each.name for each in family.parameters if is_observed(each.name)]
    learned = f" --estimate-parameters {','.join(names)}" if names else ""
    return (
        " The sensor reports first edges of rows of bounces: observe --law minimum-variance"
        f"{learned} follows these from event to event, and needs no fit of all."
    )


def _about_first_part(fitted: Identification) -> str:
    """How many of the first impacts a motion explains, and how long these take; or empty."""
    reached = fitted.reached
    if reached is None:
        return ""
    seconds = np.ceil((reached.end - fitted.recording.start) * 1e3) / 1e3
    impacts = counted(reached.moments, "impact")
    return f" A motion explains the first {impacts}, which take {seconds:.10g} s: fit these alone."


def _may_be_a_clock(fitted: Identification) -> bool:
    """Whether the shifts are small enough for errors of some clock."""
    between = float(np.median(np.diff(fitted.stamps))) if fitted.stamps.size > 1 else 0.0
    return fitted.rms <= min(_LARGEST_CLOCK, _OF_INTERVALS * between)


def _parameter_table(fitted: Identification) -> TextTable:
    """Parameters, the start, and the height at which a single body turns."""
    rows = []
    undetermined = {name for direction in fitted.undetermined for name in direction}
    priors = {each.name: each.deviation for each in fitted.prior_shifts}
    for parameter, value, error in zip(
        fitted.family.parameters, fitted.values, fitted.errors, strict=True
    ):
        shown, spread = f"{value:.10g}", f"{error:.2g}" if fitted.converged else ""
        if parameter.name in undetermined:
            shown, spread = "not determined", ""
        elif parameter.name in fitted.bounded and fitted.converged:
            spread = "at its bound"
        given = f"{parameter.value:.6g}"
        if (deviation := priors.get(parameter.name)) is not None:
            given += f" +- {deviation:.2g}"
        rows.append((parameter.name, given, shown, spread, parameter.unit))
    system = fitted.family.system
    names = [(f"{name} at the start", system.unit) for name in system.coordinates]
    names += [(f"d{name}/dt at the start", system.speed_unit) for name in system.coordinates]
    states = zip(names, _initial_state(fitted), _initial_errors(fitted), fitted.lost, strict=True)
    for (name, unit), value, error, lost in states:
        shown, spread = f"{value:.10g}", f"{error:.2g}" if fitted.converged else ""
        rows.append((name, "", *(("not determined", "") if lost else (shown, spread)), unit))
    if fitted.converged and (turn := _turning_point(fitted)):
        rows.append((turn.name, "", f"{turn.value:.10g}", f"{turn.error:.2g}", system.unit))
    headings = ("parameter", "given", "identified", "standard error", "unit")
    return TextTable(headings, rows, words=("unit",))


def _about_start(fitted: Identification) -> ReportLine:
    """The instant of the initial state, and whether a body is inside a stop then."""
    if fitted.recording.start:
        return ReportLine("note", f"The start is {fitted.recording.start:.9g} s after the epoch.")
    episode = fitted.recording.episode
    ahead = seconds_between(episode.start, episode.keys[0].stamp)
    before = f"{ahead:.6g} s before the first impact" if ahead else "the first impact"
    where = f"The start is {before}."
    wrong = _inside(fitted) if fitted.converged else ""
    return ReportLine("warning", f"{where} But {wrong}.") if wrong else ReportLine("note", where)


def _about_search(fitted: Identification) -> Iterator[ReportLine]:
    """How many impacts were searched for a motion, where that is not all."""
    if fitted.unsearched:
        first = len(fitted.recording.episode.keys)
        yield ReportLine(
            "note",
            f"Only the first {first} impacts were searched. Of the {fitted.unsearched} others"
            " eight parts of 32 were fitted, and no motion explains any.",
        )


def _about_fit(fitted: Identification) -> Iterator[ReportLine]:
    """How well stamps and samples fit, and which impacts were rejected or inserted."""
    stamps = counted(len(fitted.shifts), "stamp")
    yield ReportLine(
        "note",
        f"{stamps} differ from the model's impacts by {figure(fitted.rms, 's')} rms"
        f"{_declared(fitted)}.",
    )
    if scatter := restitution_scatter(fitted):
        sizes = [f"{value:.2g} at {name}" for name, value in scatter.items()]
        yield ReportLine(
            "note",
            "The fit has a restitution that scatters from hit to hit, by"
            f" {listed(sizes)}, learned from the impacts. Standard errors allow for the scatter.",
        )
    yield from _about_search(fitted)
    for each in fitted.sensors:
        yield _about_sensor(each)
        if each.doubt:
            yield ReportLine("warning", f"{each.doubt[0].upper()}{each.doubt[1:]}.")
    unknowns = 2 * fitted.family.system.n + fitted.family.size
    is_short = not fitted.sensors and len(fitted.shifts) < unknowns + _SPARE
    if is_short:
        yield ReportLine(
            "warning",
            f"{stamps} are few for {unknowns} unknowns, the start among"
            " them: record more impacts, or free fewer parameters.",
        )
    impacts = len(fitted.shifts) + len(fitted.recording.rejected)
    many, shifts = fitted.doubted >= _MANY * impacts, min(fitted.accepted, fitted.rms)
    too_small = fitted.declared and fitted.clock < shifts
    if too_small and many and not is_short and _may_be_a_clock(fitted):
        yield ReportLine(
            "warning",
            f"--clock-error {fitted.clock:.3g} makes outliers: up to {fitted.doubted}"
            f" impacts were rejected or inserted, {impacts} are recorded. The shifts say"
            f" {figure(shifts, 's')}: leave --clock-error out or declare"
            " this value, unless the model is wrong.",
        )
    if fitted.recording.rejected:
        yield _hits(fitted, fitted.recording.rejected_events, "rejected as spurious")
    if fitted.recording.inserted:
        dead = len(fitted.recording.in_dead_time)
        known = f" ({dead} of them in the dead time)" if dead else ""
        yield _hits(fitted, fitted.recording.inserted, f"inserted as missed{known}")
    if others := fitted.recording.counted_for_others:
        names = fitted.family.system.contact_names
        own = frozenset(others)
        yield _hits(fitted, own, "reported for another contact", lambda hit: names[others[hit]])
    yield from _about_rows(fitted)
    if settled := len(fitted.recording.settled):
        yield ReportLine(
            "note",
            f"{counted(settled, 'impact')} left out: in bounces that settle, flights"
            " are as short as the stamps are wrong, so one closing stands for each row.",
        )


def _about_rows(fitted: Identification) -> Iterator[ReportLine]:
    """What the motion has and the sensor does not report."""
    rows, hits = fitted.recording.rows, len(fitted.recording.row_hits)
    openings = sum(kind is Kind.OPEN for key in rows for _, kind in key.switches)
    closings = len(fitted.recording.bouncing)
    if hits:
        where = " inside its dead time"
        if closings:
            kind = "IMPACT" if fitted.recording.is_debounced else "CLOSE"
            where = f" of rows of bounces, of which {counted(closings, kind)} report the first"
        bounces = counted(hits, "impact")
        yield ReportLine("note", f"{bounces}{where} follow from the motion; none is an outlier.")
    if fitted.recording.is_debounced and (lasts := dead_time_of(fitted.recording)):
        yield ReportLine(
            "note",
            f"The sensor is debounced: bounces up to {lasts:.2g} s after an event are not"
            " reported; observe and smooth need a --dead-time that is a little longer.",
        )
    elif openings:
        text = f"{counted(openings, 'OPEN')} not reported: the contact opens where its load ends."
        yield ReportLine("note", text)


def _declared(fitted: Identification) -> str:
    """The declared clock error, to be put behind another deviation; empty where none is."""
    return f"; {figure(fitted.clock, 's')} was declared" if fitted.declared else ""


def _about_sensor(fit: SensorFit) -> ReportLine:
    """How well the samples of a sensor fit."""
    samples = f"{counted(fit.samples, 'sample')} of {fit.name}"
    words = [f"{samples} differ from the motion by {figure(fit.rms)} rms"]
    words.append(f"{figure(fit.deviation)} was declared")
    words += [f"{fit.near} near impacts are left out"] * (fit.near > 0)
    words += [f"{fit.rejected} are rejected by the gate"] * (fit.rejected > 0)
    return ReportLine("note", "; ".join(words) + ".")


def _about_errors(fitted: Identification, check: FitCheck) -> Iterator[ReportLine]:
    """Why standard errors are widened, and how well the model predicts impacts held back."""
    if fitted.converged and fitted.widened > 1.0:
        reasons = "; ".join(_reasons(fitted, check))
        factor = figure(fitted.widened)
        yield ReportLine(
            "note", f"Standard errors are widened by a factor of {factor}: {reasons}."
        )
    if not fitted.converged or not fitted.family.size:
        return
    held = fitted.held_back
    if held is None:
        yield ReportLine("note", "No impacts were held back for a check: too few.")
        return
    yield ReportLine(
        "ok" if fitted.carries_over else "note",
        f"Checked on the last {counted(held.impacts, 'impact')}: residuals"
        f" {figure(held.residual, 's')} (fitted part {figure(held.fitted, 's')}"
        f"{_declared(fitted)}). The values are from all impacts.",
    )


def _reasons(fitted: Identification, check: FitCheck) -> Iterator[str]:
    """Reasons why the shifts are not white errors of the clock."""
    if check.size is not None and check.size < DOUBTED:
        yield f"shifts are {fitted.rms / fitted.clock:.3g} times the declared clock error"
    if check.large:
        yield f"shifts are above {figure(UNDECLARED, 's')}, and no --clock-error is declared"
    if check.white < DOUBTED:
        yield f"neighbouring shifts are correlated (probability {check.white:.2g})"
    if check.missed:
        yield f"another {listed(check.missed, _SHOWN, ' or ')} explains a part of the shifts"
    for fit in fitted.sensors:
        if fit.size < DOUBTED:
            ratio = fit.rms / fit.deviation
            yield f"errors of {fit.name} are {ratio:.3g} times the declared deviation"
    if not (fitted.declared or check.large):
        yield "without --clock-error an error of the model looks like one of the clock"


def _hits(
    fitted: Identification,
    hits: frozenset[Hit],
    outcome: str,
    reported: Callable[[Hit], str] | None = None,
) -> ReportLine:
    """The contacts and instants (s since the epoch) of impacts with one outcome.

    ``reported`` gives the names that their events have, if these are others.
    """
    names, epoch = fitted.family.system.contact_names, fitted.recording.episode.epoch
    instants = (
        f"{names[hit[1]]} at {seconds_between(epoch, hit[0]):.3f} s"
        + (f" (as {reported(hit)})" if reported else "")
        for hit in sorted(hits)
    )
    text = f"{counted(len(hits), 'impact')} {outcome}: {listed(instants, _SHOWN)}."
    return ReportLine("note", text)


def _about_parameters(fitted: Identification) -> Iterator[ReportLine]:
    """Which parameters are not determined, at a bound, or correlated."""
    for direction in fitted.undetermined:
        terms = combination(direction)
        text = f"Not determined by these impacts: {terms}. Hold one of them fixed."
        yield ReportLine("warning", text)
    for name in fitted.bounded:
        yield ReportLine(
            "warning",
            f"{name} ended at its bound: the model may be wrong. If the bound is its value, write"
            " the value into the model and leave the name out of --free.",
        )
    yield from _about_prior(fitted)
    if fitted.converged and fitted.family.size:
        text = "Standard errors hold if the model is right in all that was not free."
        yield ReportLine("note", text)
    names, correlation = fitted.family.names, fitted.correlation
    if OFFSET in names and fitted.converged:
        late = float(fitted.values[names.index(OFFSET)])
        yield ReportLine(
            "note",
            f"{OFFSET} is not written, as no model has one: `detect --latency {late:.6g}` takes"
            f" the offset from the stamps, and `observe --clock-offset-error {abs(late):.2g}`"
            " estimates the offset.",
        )
    for i in range(len(names)):
        for j in range(i):
            if abs(correlation[i, j]) > _CORRELATED:
                text = f"{names[j]} and {names[i]} are correlated by {correlation[i, j]:.3f}."
                yield ReportLine("note", text)


def _about_prior(fitted: Identification) -> Iterator[ReportLine]:
    """Which deviations were priors, what impacts add to these, and what contradicts them."""
    if not (shifts := fitted.prior_shifts) or not fitted.converged:
        return
    text = f"Declared deviations are priors of {listed([each.name for each in shifts])}."
    if fitted.refuted is not None:
        text = "The model fits without its declared deviations, and not with them as priors."
    elif little := [each.name for each in shifts if each.is_little]:
        text += f" These impacts say little of {listed(little)}."
    yield ReportLine("note" if fitted.refuted is None else "warning", text)
    if chance_of(shifts) < DOUBTED:
        worst = max(shifts, key=lambda each: abs(each.innovation))
        yield ReportLine(
            "warning",
            f"{worst.name} is {abs(worst.innovation):.2g} deviations from its declared value:"
            " declare a larger deviation, or none, if the value was a guess; else the model is"
            " wrong in something that is not free.",
        )


def _about_check(fitted: Identification, check: FitCheck) -> Iterator[ReportLine]:
    """The tests of size and whiteness, and whether the model fits."""
    if check.size is not None:
        yield ReportLine(
            "note",
            "A model that is right gives shifts as large as these with probability"
            f" {check.size:.2g}; below {REJECTED:g} a model does not fit.",
        )
    yield ReportLine(
        "note",
        "A model that is right gives neighbouring shifts as correlated as these with"
        f" probability {check.white:.2g} ({counted(check.lags, 'lag')}).",
    )
    if check.fits and fitted.converged:
        yield ReportLine("ok", "The model fits.")
    else:
        worst = listed([check.worst, *check.odd])
        yield ReportLine("error", f"The model does not fit; worst: {worst}.")


def why_useless(fitted: Identification) -> str:
    """Why values are not written into a model, whether or not it fits; empty where they are.

    A phase that is not determined is written with a deviation of half a turn.
    """
    if not fitted.converged:
        return "no motion explains these impacts"
    if left := [each for each in fitted.undetermined if not all(map(is_phase, each))]:
        return f"not determined: {listed(map(combination, left))}"
    errors = zip(fitted.family.parameters, fitted.errors.tolist(), strict=True)
    if vague := [
        f"{p.name} +- {error:.2g}"
        for p, error in errors
        if error > p.deviation_range[1] and not is_phase(p.name)
    ]:
        return f"not determined: {listed(vague)}"
    return f"at a bound: {listed(fitted.bounded)}" if fitted.bounded else ""


def write_model(
    fitted: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool
) -> str:
    """Write :func:`model_text`; the initial state only if determined and outside all stops.

    Returns:
        A phrase that names the part that was left out; empty if the file is complete.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    wrong = "is inside a stop" if _inside(fitted) else ""
    wrong = "these impacts do not determine" if fitted.lost.any() else wrong
    text = model_text(fitted, given, bag, output, initial=initial and not wrong)
    with replacing(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return f"without the initial state, which {wrong}" if initial and wrong else ""


def model_text(
    fitted: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool = False
) -> str:
    """The given model file with the fitted values, in its own form, with covariance and verdict.

    Args:
        fitted: the fitted model.
        given: the file it was fitted from.
        bag: the recording.
        output: the file that will hold the text; named in errors.
        initial: whether to write the initial state too.

    Raises:
        ModelError: the fitted values make no valid model.
    """
    document = cast("dict[str, Any]", load_yaml(given.text))
    rows = zip(fitted.family.names, fitted.values.tolist(), fitted.errors.tolist(), strict=True)
    check = check_fit(fitted)
    shift = check.shift if check.shift.largest else ()
    provenance: dict[str, object] = {
        **dict(zip(VERDICT, (check.fits, float(fitted.rms), *shift), strict=False)),
        "package": "impact_observer",
        "version": __version__,
        "identified_from": str(bag),
        "clock_error": float(fitted.clock),
        "parameters": {name: {"value": v, "standard_error": error} for name, v, error in rows},
    }
    if "provenance" in document:
        provenance["before"] = document["provenance"]
    plain = without_deviations(document).document
    entries = changes(plain, fitted.family, fitted.values)
    before = document.get(KEY)
    known = before and ParameterUncertainty(tuple(before["names"]), before["covariance"])
    if uncertainty := written_uncertainty(fitted, known):
        entries[KEY,] = uncertainty.document
    if initial:
        q, u = np.split(_initial_state(fitted), 2)
        entries["initial_state",] = {"position": q.tolist(), "velocity": u.tolist()}
    text = edited(given.text, {**entries, ("provenance",): provenance})
    parse_model(*given._replace(text=text, source=str(output)))
    return text
