# SPDX-License-Identifier: Apache-2.0
"""A fitted model as a table, as JSON, as a picture and as a model file."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from scipy import linalg, special

from impact_observer import __version__
from impact_observer.batch.identification import Identification
from impact_observer.batch.model_edit import changes
from impact_observer.batch.verdict import UNLIKELY
from impact_observer.draw.reports import (
    ReportLine,
    TextTable,
    counted,
    figure,
    listed,
    print_facts,
    print_table,
)
from impact_observer.errors import UsageError
from impact_observer.io.bag_part import TimeZero
from impact_observer.model import ParameterUncertainty, parse_model
from impact_observer.model.fit_verdict import NO_SHIFT, VERDICT, TimeShift
from impact_observer.model.free_parameters import OFFSET, is_phase
from impact_observer.model.model_file import ModelText
from impact_observer.model.parameter_uncertainty import KEY
from impact_observer.model.parameters_in_file import without_deviations
from impact_observer.model.yaml_text import edited, load_yaml
from impact_observer.output_files import replacing
from impact_observer.states import Matrix

_RATIOS = "-scale", "-amplitude"
"""Ends of the kinds of parameters whose value is 1 in any model file."""
_HALF_TURN = np.pi * (1 - 1e-9)
"""Largest deviation of a phase, rad, below the one that a model file may have by rounding."""
_REMARKS = 3
"""Most remarks after the verdict."""
_SPARE = 4
"""Least surplus of stamps over unknowns that shows errors of a clock or a model."""
_TOLD = 0.5
"""Deviation after a fit over that of the prior, below which impacts tell a parameter."""
_USUAL = 0.95
"""Part of the predicted errors of stamps that are not larger than what a misfit is told to be."""
_MARKERS = "o^sDvx+*"


def why_useless(found: Identification) -> str:
    """Why values are not written into a model, whether or not it fits; empty where they are."""
    if found.found.is_lost or not found.fit.is_settled:
        return "no motion explains these impacts"
    if found.undetermined:
        return f"not determined: {listed(found.undetermined)}"
    return f"at a bound: {listed(found.bounded)}" if found.bounded else ""


def shift_of(found: Identification) -> TimeShift:
    """By how much a motion of the fitted model may be early or late; none where it fits."""
    late, moments = found.fit.predicted, found.fit.problem.moments
    if found.verdict.fits or late.size < 2:
        return NO_SHIFT
    usual = float(np.quantile(np.abs(late), _USUAL))
    return TimeShift(usual, float(np.mean(moments.flights[1:])))


def report(found: Identification) -> Iterator[ReportLine]:
    """The verdict, and at most three remarks on the numbers, warnings first."""
    verdict = found.verdict
    if verdict.fits:
        yield ReportLine("ok", "The model fits.")
    else:
        yield ReportLine("error", f"The model does not fit: {'; '.join(verdict.reasons)}.")
    remarks = [*_warnings(found), *_notes(found)]
    yield from remarks[:_REMARKS]


def doubts(found: Identification) -> Iterator[str]:
    """Yield why numbers may be wrong though the model fits, a line each."""
    stamps, unknowns = found.fit.residuals.size, found.start.size + found.family.size
    if not found.fit.problem.samples and unknowns < stamps < unknowns + _SPARE:
        yield f"{counted(stamps, 'stamp')} are few for {unknowns} unknowns, the start among them"
    known = {} if found.prior is None else found.prior.deviation_by_name
    for each, value in zip(found.family.parameters, found.values.tolist(), strict=True):
        far = abs(value - each.value) / (known.get(each.name) or np.inf)
        if special.erfc(far / np.sqrt(2)) < UNLIKELY:
            yield (
                f"{each.name} {value:.4g} is {far:.2g} declared deviations from {each.value:.4g}:"
                " another number may be wrong, or many impacts are missing"
            )


def _warnings(found: Identification) -> Iterator[ReportLine]:
    """Yield why numbers may be wrong."""
    if found.undetermined:
        yield ReportLine("warning", f"Not determined: {listed(found.undetermined)}.")
    if found.bounded:
        yield ReportLine(
            "warning", f"At a bound, so the model may be wrong: {listed(found.bounded)}."
        )
    if inside := found.family.near(found.values).penetrated(found.start[: found.family.system.n]):
        contact = found.run.system.contact_names[inside[0]]
        yield ReportLine("warning", f"The start is inside the stop {contact!r}.")
    for doubt in doubts(found):
        yield ReportLine("warning", f"{doubt}.")


def _notes(found: Identification) -> Iterator[ReportLine]:
    """Yield the likeliest cause of a misfit, errors, rejected and inserted impacts, samples."""
    verdict, fit, names = found.verdict, found.fit, found.family.names
    for each in found.causes[:1]:
        end = "the model fits" if each.fits else "it explains more, and does not fit either"
        value = figure(each.value, deviation=each.error)
        yield ReportLine("note", f"With {each.name} {value} (given {each.given:.6g}) {end}.")
    if OFFSET in names:
        late = float(found.values[names.index(OFFSET)])
        yield ReportLine("note", f"{OFFSET} is not written: `detect --latency {late:.6g}` has it.")
    clock = "" if verdict.declared is None else f", {figure(verdict.declared, 's')} is expected"
    rms = float(np.sqrt(np.mean(np.square(fit.residuals)))) if fit.residuals.size else 0.0
    scatter = f"; rebounds scatter by {verdict.scatter:.2g}" if verdict.scatter else ""
    yield ReportLine(
        "note",
        f"{counted(fit.residuals.size, 'stamp')} differ from the motion by {figure(rms, 's')}"
        f" rms{clock}{scatter}.",
    )
    for line in _about_events(found):
        yield ReportLine("note", line)


def _about_events(found: Identification) -> Iterator[str]:
    """Yield lines on the events that are rejected or inserted, and on samples."""
    moments = found.fit.problem.moments
    inserted = [each for each in moments.each if not each.is_measured]
    rejected = [each for each in found.run.verdicts(moments) if each.ruling.name == "REJECTED"]
    counts = {"rejected as spurious": len(rejected), "inserted as missed": len(inserted)}
    if any(counts.values()):
        told = (f"{counted(n, 'impact')} {what}" for what, n in counts.items() if n)
        yield f"{', '.join(told)}."
    for each in _sensors(found):
        samples = f"{counted(each['samples'], 'sample')} of {each['name']}"
        declared = f"{figure(each['deviation'])} is declared"
        yield f"{samples} differ by {figure(each['rms'])} rms; {declared}."


def _sensors(found: Identification) -> Iterator[dict[str, Any]]:
    """Yield how many samples of each sensor count, and by how much these differ."""
    fit = found.fit
    for index, sensor in enumerate(fit.problem.samples):
        own = fit.sample_errors[fit.samples.sensor == index]
        rms = float(np.sqrt(np.mean(np.square(own)))) if own.size else 0.0
        yield {
            "name": sensor.measurement.name,
            "samples": int(own.size),
            "near": len(sensor.t) - int(own.size),
            "rms": rms,
            "deviation": sensor.deviation,
        }


def print_report(found: Identification, *, is_check: bool = False) -> None:
    """Print the verdict, and unless ``is_check`` the table of parameters."""
    lines = [*report(found)]
    print_facts((each.kind, each.text) for each in lines[:1])
    if not is_check:
        print_table(_table(found))
    print_facts((each.kind, each.text) for each in lines[1:])


def _table(found: Identification) -> TextTable:
    """Return parameters and the start."""
    system, d = found.family.system, found.start.size
    given = {} if found.prior is None else found.prior.deviation_by_name
    rows = []
    for each, value, error in zip(
        found.family.parameters, found.values.tolist(), found.errors.tolist(), strict=True
    ):
        declared = figure(each.value, deviation=given.get(each.name, 0.0))
        rows.append((each.name, declared, f"{value:.10g}", f"{error:.2g}", each.unit))
    errors = np.sqrt(np.diag(found.covariance))[:d].tolist()
    start = initial_state(found).tolist()
    for name, unit, value, error in zip(
        system.state_names, system.state_units, start, errors, strict=True
    ):
        rows.append((f"{name} at the start", "", f"{value:.10g}", f"{error:.2g}", unit))
    headings = "parameter", "given", "identified", "standard error", "unit"
    return TextTable(headings, rows, words=("unit",))


def initial_state(found: Identification) -> Matrix:
    """The initial state (q, u), shape (2n,), also where stops move."""
    at = np.array([found.run.start - found.run.epoch])
    system = found.family.system_at(found.values)
    return np.asarray(system.from_frame(at, found.start[None])[0])


def for_json(found: Identification) -> dict[str, Any]:
    """The results with plain numbers."""
    verdict, moments = found.verdict, found.fit.problem.moments
    rows = zip(found.family.parameters, found.values.tolist(), found.errors.tolist(), strict=True)
    return {
        "fits": verdict.fits,
        "reasons": list(verdict.reasons),
        "causes": [{"name": c.name, "value": c.value, "fits": c.fits} for c in found.causes],
        "clock": verdict.clock,
        "declared_clock": verdict.declared,
        "scatter": verdict.scatter,
        "model_error": verdict.model,
        "size": verdict.size,
        "white": verdict.white,
        "impacts": int(moments.row_moment.size),
        "inserted": sum(not each.is_measured for each in moments.each),
        "rejected": sum(v.ruling.name == "REJECTED" for v in found.run.verdicts(moments)),
        "rms": found.fit.rms,
        "converged": found.fit.is_settled,
        "parameters": {
            each.name: {
                "given": each.value,
                "value": value,
                "standard_error": error,
                "unit": each.unit,
            }
            for each, value, error in rows
        },
        "sensors": [{**each} for each in _sensors(found)],
        "covariance": found.covariance.tolist(),
        "initial_state": initial_state(found).tolist(),
        "shifts": {
            "stamp": [float(moments.each[k].t) for k in moments.row_moment.tolist()],
            "shift": found.fit.residuals.tolist(),
        },
    }


def fit_picture(found: Identification, *, title: str, zero: TimeZero) -> Figure:
    """Errors of the stamps over time, with a band of two standard deviations of the clock."""
    chart = Figure(figsize=(8.0, 4.0), layout="constrained")
    axes, moments = chart.add_subplot(), found.fit.problem.moments
    t = np.array([float(moments.each[k].t) for k in moments.row_moment.tolist()])
    names = found.run.system.contact_names
    for number, contact in enumerate(sorted({*moments.row_contact.tolist()})):
        own = moments.row_contact == contact
        axes.plot(
            t[own],
            found.fit.residuals[own],
            linestyle="",
            marker=_MARKERS[number % len(_MARKERS)],
            color=str(0.6 * number / max(len(names) - 1, 1)),
            label=names[contact],
        )
    band = 2 * found.verdict.clock
    axes.axhspan(-band, band, color="0.9", label="2 standard deviations", zorder=0)
    axes.set_xlabel(zero.axis)
    axes.set_ylabel("model's impact minus stamp [s]")
    axes.set_title(title, fontsize="medium", loc="left", pad=20)
    axes.grid(visible=True, which="major", color="0.85")
    axes.legend(
        fontsize="small", ncols=4, frameon=False, loc="lower right", bbox_to_anchor=(1.0, 1.0)
    )
    return chart


def numbers_told(found: Identification) -> int:
    """How many combinations of the parameters the impacts made known better than their prior."""
    known, names = found.prior, found.family.names
    own = [j for j, name in enumerate(names) if known is not None and name in known.names]
    if known is None or not own:
        return len(names)
    which = [known.names.index(names[j]) for j in own]
    rows = np.add(own, found.start.size)
    before = known.covariance[np.ix_(which, which)]
    ratios = linalg.eigvalsh(found.covariance[np.ix_(rows, rows)], before)
    return len(names) - len(own) + int(np.sum(ratios < _TOLD**2))


def write_model(
    found: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool
) -> str:
    """Write :func:`model_text`; the initial state only if it is outside all stops.

    Returns:
        A phrase that names the part that was left out; empty if the file is complete.

    Raises:
        UsageError: the file may not be written.
        OutputError: the disk is full or gone.
    """
    system = found.family.near(found.values)
    is_inside = bool(system.penetrated(found.start[: system.n]))
    text = model_text(found, given, bag, output, initial=initial and not is_inside)
    with replacing(output) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return "without the initial state, which is inside a stop" if initial and is_inside else ""


def model_text(
    found: Identification, given: ModelText, bag: Path, output: Path, *, initial: bool = False
) -> str:
    """The given model file with the fitted values, in its own form, with covariance and verdict.

    Args:
        found: the fitted model.
        given: the file that the model was fitted from.
        bag: the recording.
        output: the file that will hold the text; named in errors.
        initial: whether to write the initial state too; that of ``given`` goes where the fitted
            values put it inside a stop.

    Raises:
        ModelError: the fitted values make no valid model.
    """
    document = cast("dict[str, Any]", load_yaml(given.text))
    rows = zip(found.family.names, found.values.tolist(), found.errors.tolist(), strict=True)
    shift = shift_of(found)
    shown = (found.verdict.fits, found.fit.rms, *(shift if shift.largest else ()))
    provenance: dict[str, object] = {
        **dict(zip(VERDICT, shown, strict=False)),
        "package": "impact_observer",
        "version": __version__,
        "identified_from": str(bag),
        "clock_error": found.verdict.clock,
        "scatter": found.verdict.scatter,
        "model_error": found.verdict.model,
        "parameters": {name: {"value": v, "standard_error": error} for name, v, error in rows},
    }
    if "provenance" in document:
        provenance["before"] = document["provenance"]
    plain, model = without_deviations(document).document, parse_model(*given)
    entries = changes(plain, model.places, found.family, found.values)
    before = document.get(KEY)
    known = before and ParameterUncertainty(tuple(before["names"]), before["covariance"])
    if uncertainty := _written_uncertainty(found, known):
        entries[KEY,] = uncertainty.document
    if initial:
        q, u = np.split(initial_state(found), 2)
        entries["initial_state",] = {"position": q.tolist(), "velocity": u.tolist()}
    elif model.position is not None and model.velocity is not None:
        try:
            found.family.system_at(found.values).checked_start(model.position, model.velocity)
        except UsageError:  # inside a stop
            entries["initial_state",] = None
    text = edited(given.text, {**entries, ("provenance",): provenance})
    parse_model(*given._replace(text=text, source=str(output)))
    return text


def _written_uncertainty(
    found: Identification, given: ParameterUncertainty | None
) -> ParameterUncertainty | None:
    """Return the covariance of the fitted parameters, and of those that were not fitted.

    The clock's offset belongs to the sensor and is left out. The deviation of a phase is at most
    half a turn; a ratio is relative to the file that is written.
    """
    names, d = found.family.names, found.start.size
    own = [j for j, name in enumerate(names) if name != OFFSET]
    is_ratio = [names[j].partition(".")[0].endswith(_RATIOS) for j in own]
    ratios = np.where(is_ratio, found.values[own], 1.0)
    turns = [found.errors[j] / _HALF_TURN if is_phase(names[j]) else 1.0 for j in own]
    unit = ratios * np.maximum(turns, 1.0)
    rows = [d + j for j in own]
    blocks = [found.covariance[np.ix_(rows, rows)] / np.outer(unit, unit)]
    known = [names[j] for j in own]
    if given is not None:
        kept = [i for i, name in enumerate(given.names) if name not in names]
        known += [given.names[i] for i in kept]
        blocks.append(given.covariance[np.ix_(kept, kept)])
    if not known:
        return None
    stamps = [key.stamp for key in found.run.keys]
    fitted_to = (min(stamps), max(stamps)) if own else None
    return ParameterUncertainty(tuple(known), linalg.block_diag(*blocks), fitted_to)


def refuse_scales_of_parts(free: Collection[str], known: ParameterUncertainty | None) -> None:
    """Check that no deviation is ``known`` of a part of what is ``free``, or of its whole.

    Raises:
        UsageError: such as a stiffness with a deviation beside a free scale of all stiffness.
    """
    for name in (each for each in (known.names if known else ()) if each not in free):
        kind = name.partition(".")[0]
        for each in free:
            other = each.partition(".")[0]
            if other in (f"{kind}-scale", kind.removesuffix("-scale")) and other != kind:
                raise UsageError(
                    f"--free {each}: the model declares a deviation of {name}; free {name}, or"
                    " leave its deviation out of the model"
                )
