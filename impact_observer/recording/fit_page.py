# SPDX-License-Identifier: Apache-2.0
"""The page of a fit: the files in its folder, and the lines that are printed."""

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from impact_observer.batch.fit_report import doubts, numbers_told
from impact_observer.check.model_check import check_model
from impact_observer.compare.bag_export import impact_rows
from impact_observer.compare.table_files import write_table
from impact_observer.draw.pictures import save
from impact_observer.draw.reports import counted, figure
from impact_observer.errors import ModelError, UsageError
from impact_observer.events import ImpactEstimate, Ruling
from impact_observer.io import interfaces
from impact_observer.io.bag_files import SIGNAL_FILES, storage_of
from impact_observer.io.bag_part import FILE_ZERO, TimeZero, time_zero
from impact_observer.io.observed_bag import events_from
from impact_observer.io.reader import BagReader
from impact_observer.model import Model, parse_model
from impact_observer.model.free_parameters import with_unit
from impact_observer.model.model_file import ModelText, model_text
from impact_observer.model.system import refuse_squares, unit_of
from impact_observer.output_files import check_outputs, temporary_beside
from impact_observer.recording.before_the_fit import (
    check_times,
    doubtful_contacts,
    long_contacts,
    model_warnings,
)
from impact_observer.recording.fit_and_smooth import FitTask, FittedRecording, fit_bag
from impact_observer.recording.impacts_in_recording import RecordedImpacts, Task, read_recording
from impact_observer.recording.recording_picture import (
    PlottedMotion,
    PlottedSignal,
    recording_picture,
    signal_picture,
)
from impact_observer.recording.sources_file import read_fit_sources, sources_text
from impact_observer.stamps import seconds_between

_STATES = f"/{interfaces.OBSERVER_STATES.name_under(interfaces.SMOOTHER)}"
_IMPACTS = interfaces.SMOOTHED_ESTIMATES.topic
_NUMBERS, _DOUBTS = 5, 3
"""Identified numbers and doubts that are printed, each a line."""


@dataclass(frozen=True, slots=True)
class Page:
    """What a fit has to say.

    Attributes:
        fits: whether the model explains the impacts.
        lines: at most 15, to be printed after the fit.
    """

    fits: bool
    lines: Sequence[str]


def fit_recording(
    recording: Path,
    model: str,
    folder: Path,
    *,
    sources: Path | None = None,
    zero: int | None = None,
    epoch: int | None = None,
    clock_error: float = -1.0,
    say: Callable[[str], None] = lambda _: None,
    show: Callable[[str], None] = lambda _: None,
    step: Callable[[str, float, float], None] = lambda _what, _done, _total: None,
) -> Page:
    """Fit a model to a recording and write ``folder``; a model that does not fit writes it too.

    Args:
        recording: a sound, a table of a signal or of times, or a bag.
        model: the model file, or the name of a sample.
        folder: is made; it holds ``fitted.yaml``, ``impacts.csv``, ``motion.png``, the bag
            ``smoothed`` and, where impacts were found in a signal, ``sources.yaml``.
        sources: a file of sensors, and of the form of a table.
        zero: stamp of time 0 of a file that is no bag, ns; None for the usual one.
        epoch: stamp of ``t = 0``, ns; None where the user gives none.
        clock_error: standard deviation of a stamp, s; negative to estimate the deviation.
        say: receives lines to be printed before the fit begins: what is in doubt, and how the
            impacts were found. ``motion.png`` then shows the signal alone.
        show: receives what is being done.
        step: receives what is being done, and how much of how much is done.

    Raises:
        UsageError, BagError: the inputs cannot be used, or the folder exists.
        NotLinearError: the model is a robot.
    """
    check_outputs([(folder, ())])
    if recording.suffix.lower() not in SIGNAL_FILES:
        storage_of(recording)
    given = model_text(model)
    read = parse_model(*given)
    refuse_squares(read.system, "fit")  # a robot has no system
    if not read.noticed:
        raise UsageError(f"{model}: no contact found; expected a stop that sensors notice")
    declared = read_fit_sources(sources)
    with temporary_beside(folder) as place:
        known = Task(recording, read, declared.sources, declared.form, zero, epoch)
        checked = check_model(read)
        for text in (*model_warnings(checked), *([read.misfit] if read.misfit else [])):
            say(f"warning: {text}")
        impacts = read_recording(known, place, show)
        with BagReader(impacts.bag) as reader:
            events = events_from(reader, impacts.epoch)
        check_times(checked, events, recording)
        for text in impacts.lines:
            say(text)
        if read.uncertainty is not None and read.uncertainty.is_fitted_to(e.stamp for e in events):
            say(f"warning: {model}: fitted to these impacts, which count twice now")
        for text in impacts.doubts:
            say(f"doubt: {text}")
        for text in (*long_contacts(events), *doubtful_contacts(read, events)):
            say(f"warning: {text}")
        task = FitTask(
            recording=recording,
            bag=impacts.bag,
            text=_in_one_file(given, read),
            model=read,
            knows_epoch=impacts.knows_epoch,
            epoch=impacts.epoch,
            clock_error=clock_error,
            mislabelled=impacts.mislabelled,
            resolution=impacts.resolution,
        )
        with _new_folder(folder):
            if impacts.sources:
                _write_detection(impacts, folder, read.system.name)
                say(f"{folder / 'motion.png'}: the signal, with the peaks that are impacts")
            fit = fit_bag(task, folder / "fitted.yaml", folder / "smoothed", show=show, step=step)
            hits = _write(fit, impacts, folder)
    return Page(fit.fits, [*_lines(task, fit, hits, folder)])


def _in_one_file(given: ModelText, model: Model) -> ModelText:
    """Return the text of a model with what it names of other files."""
    try:
        parse_model(given.text, given.source)
    except ModelError:
        return ModelText(model.text(), given.source)
    return given


def _write(fit: FittedRecording, impacts: RecordedImpacts, folder: Path) -> list[ImpactEstimate]:
    """Write table and picture; return the estimates of impacts."""
    system, word = fit.model.system, "fits" if fit.fits else "does not fit"
    with BagReader(folder / "smoothed") as reader:
        zero = TimeZero(impacts.zero, FILE_ZERO) if impacts.zero else time_zero(reader)
        (rows,) = impact_rows(reader, [_IMPACTS], lambda *_: None, zero)
        words = {**rows.words, "model": [word] * rows.stamps.size}
        write_table(folder / "impacts.csv", [rows._replace(words=words)])
        hits = [*reader.impact_estimates(_IMPACTS)]
        states = reader.observer_states(_STATES, system.coordinates)
    deviations = states.deviations[:, : system.n]
    motion = PlottedMotion(system.coordinates, states.stamps, states.q, deviations)
    units = system.unit, unit_of("J", system.unit)
    title, signals = f"{system.name} {word}", _signals(impacts)
    picture = recording_picture(signals, motion, hits, zero=zero.stamp, units=units, title=title)
    save(picture, folder / "motion.png")
    return hits


def _signals(impacts: RecordedImpacts) -> list[PlottedSignal]:
    """Return the signals in which the impacts were found."""
    return [*map(PlottedSignal, impacts.sources, impacts.traces, impacts.refused)]


def _write_detection(impacts: RecordedImpacts, folder: Path, name: str) -> None:
    """Write the sensors, and the picture of their signals alone."""
    text = sources_text(impacts.sources)
    (folder / "sources.yaml").write_text(text, encoding="utf-8")
    title = f"{name} is being fitted"
    picture = signal_picture(_signals(impacts), zero=impacts.zero or impacts.epoch, title=title)
    save(picture, folder / "motion.png")


@contextmanager
def _new_folder(folder: Path) -> Iterator[None]:
    """Make ``folder``, and remove it where the fit ends early: the command can be repeated."""
    folder.mkdir()
    try:
        yield
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _lines(
    task: FitTask,
    fit: FittedRecording,
    hits: Sequence[ImpactEstimate],
    folder: Path,
) -> Iterator[str]:
    """Return the lines that tell what was fitted, and what is in doubt."""
    yield _verdict(task, fit, hits)
    yield from _numbers(task, fit)
    yield from _motion(fit, hits)
    for doubt in [*_doubts(task, fit)][:_DOUBTS]:
        yield f"doubt: {doubt}"
    names = ", ".join(sorted(each.name for each in folder.iterdir()))
    yield f"{folder}: {names}"


def _verdict(task: FitTask, fit: FittedRecording, hits: Sequence[ImpactEstimate]) -> str:
    """Return the line that says whether the model fits, and how many impacts count."""
    count = {ruling: sum(each.ruling is ruling for each in hits) for ruling in Ruling}
    used = f"{counted(count[Ruling.APPLIED], 'impact')} used"
    used += f", {count[Ruling.REJECTED]} rejected" if count[Ruling.REJECTED] else ""
    used += f", {count[Ruling.INSERTED]} missed ones inserted" if count[Ruling.INSERTED] else ""
    found = fit.identification
    if found is None or fit.failure:
        return f"does not fit: {fit.failure}; {used}"
    residual = float(np.sqrt(np.mean(np.square(found.fit.residuals))))
    left = f"stamps differ from the motion by {residual:.2g} s rms"
    if found.verdict.declared is not None:
        why = "declared" if task.clock_error >= 0 else "their resolution"
        left += f" ({found.verdict.declared:.2g} s is {why})"
    if found.verdict.scatter:
        left += f", rebounds scatter by {found.verdict.scatter:.2g}"
    return f"{'fits' if fit.fits else 'does not fit'}: {left}; {used}"


def _numbers(task: FitTask, fit: FittedRecording) -> Iterator[str]:
    """Return a line for each identified number, restitutions first."""
    found = fit.identification
    if found is None or fit.failure:
        return
    known = task.prior
    given = {} if known is None else dict(zip(known.names, known.deviations.tolist(), strict=True))
    each = zip(found.family.parameters, found.values.tolist(), found.errors.tolist(), strict=True)
    lines = [
        f"{with_unit(p.name, task.model.system.unit)} {figure(value, deviation=error)}"
        f" (given {figure(p.value, deviation=given.get(p.name, 0.0))})"
        for p, value, error in sorted(each, key=lambda row: "restitution" not in row[0].name)
    ]
    yield from lines[:_NUMBERS]
    if len(lines) > _NUMBERS:
        yield f"{len(lines) - _NUMBERS} more numbers in fitted.yaml"
    if (told := numbers_told(found)) < len(lines):
        yield (
            f"the times tell {told} of these {len(lines)} numbers, or combinations of numbers; the"
            " rest is as given"
        )


def _motion(fit: FittedRecording, hits: Sequence[ImpactEstimate]) -> Iterator[str]:
    """Return a line on speeds and energies of all impacts."""
    own = [each for each in hits if each.ruling is not Ruling.REJECTED]
    if not own or fit.failure:
        return
    unit = fit.model.system.unit
    speed = np.array([each.speed_before for each in own])
    energy = np.array([each.energy_loss for each in own])
    error = float(np.median([each.speed_before_deviation for each in own]))
    seconds = seconds_between(min(e.stamp for e in own), max(e.stamp for e in own))
    power = f", {figure(float(energy.sum()) / seconds, 'W')}" if seconds else ""
    yield (
        f"speed before an impact: {np.min(speed):.3g} to {np.max(speed):.3g}, median"
        f" {figure(float(np.median(speed)), unit_of('m/s', unit), error)}; energy lost:"
        f" {figure(float(np.median(energy)), 'J')} an impact{power}"
    )


def _doubts(task: FitTask, fit: FittedRecording) -> Iterator[str]:
    """Return what makes the numbers or the motion doubtful, the worst first."""
    found = fit.identification
    if fit.failure:
        forces = [f"{each:.3g} Hz" for each in task.model.system.forcing.frequency / (2 * np.pi)]
        yield (
            "many impacts are false or missing (motion.png; `threshold` in a file for --sources),"
            " or a number is far off"
            + (f" (the model has forces of {', '.join(forces)})" if forces else "")
        )
    if found is not None and not fit.failure:
        yield from (*doubts(found), *found.verdict.reasons)
        if not fit.fits and found.verdict.declared is None:
            yield "soft hits may be stamped late, by more than others: --clock-error declares this"
    for cause in [] if found is None else [each for each in found.causes if each.fits][:1]:
        yield (
            f"with {cause.name} {cause.value:.4g} instead of {cause.given:.4g} the model fits: if"
            " this may be, give the number a deviation in the model file"
        )
    for run in fit.smoothing.runs:
        if run.misfit and (found is None or fit.fits):
            yield run.misfit
    yield from fit.smoothing.problems
