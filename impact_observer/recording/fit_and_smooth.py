# SPDX-License-Identifier: Apache-2.0
"""Fits a model to the impacts in a bag, and smooths the motion with the fitted model."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.linalg import block_diag

from impact_observer import __version__
from impact_observer.batch import fit_report
from impact_observer.batch.identification import Identification, identify
from impact_observer.batch.smooth_bag import BagSmoothing, smooth_bag
from impact_observer.errors import DynamicsError, IdentificationError
from impact_observer.events import ImpactEvent
from impact_observer.io.observed_bag import events_from
from impact_observer.io.reader import BagReader
from impact_observer.model import Model, parse_model
from impact_observer.model.fit_verdict import FITS
from impact_observer.model.free_parameters import parameters_beside, parametric_family
from impact_observer.model.model_file import ModelText
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.model.parametric_family import Coefficients, ParametricFamily
from impact_observer.model.yaml_text import edited
from impact_observer.observer import Options
from impact_observer.observer.uncertainty import suggested_deviation
from impact_observer.stamps import seconds_between
from impact_observer.states import Matrix

_PHASES = "forcing-phase", "ground-phase"
"""Kinds of parameters that are free where the epoch is unknown."""
_STATES = 40
"""Smoothed states in the mean time between two impacts."""
_MOST = 200_000
"""Smoothed states of a recording."""


@dataclass(frozen=True, slots=True)
class FitTask:
    """What is to be fitted.

    Attributes:
        recording: what the user gave.
        bag: with the impacts of the recording.
        text: of the model file.
        model: the model.
        knows_epoch: whether the user or the recording says the epoch; else phases are free.
        epoch: stamp of ``t = 0``, ns; 0 for that of the bag.
        clock_error: standard deviation of a stamp, s; negative to estimate the deviation.
        mislabelled: probability that an impact is reported for another contact.
        resolution: of printed times, or the time between samples, s; 0 if unknown.
    """

    recording: Path
    bag: Path
    text: ModelText
    model: Model
    knows_epoch: bool
    epoch: int = 0
    clock_error: float = -1.0
    mislabelled: float = Options.mislabelled
    resolution: float = 0.0

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the parameters to identify: with a deviation, or phases without an epoch."""
        known = self.model.uncertainty
        names = () if known is None else known.names
        return (*names, *(name for name in self._phases if name not in names))

    @property
    def prior(self) -> ParameterUncertainty | None:
        """Deviations of the given values; of phases none that was found for another epoch."""
        known = self.model.uncertainty
        return None if known is None else known.without(self._phases)

    @property
    def _phases(self) -> list[str]:
        """Names of the phases that are free because nothing says the epoch."""
        if self.knows_epoch:
            return []
        every = parameters_beside(parametric_family(self.model.system, (), self.model.elements))
        return [each.name for each in every if each.name.startswith(_PHASES)]

    def shifting_together(self, family: ParametricFamily) -> tuple[ParametricFamily, Matrix]:
        """The family in which all unknown phases of one frequency change by the same.

        These phases are known up to the epoch, so a single number is unknown.

        Args:
            family: the parameters ``free``.

        Returns:
            The family of r parameters, and the change of each parameter of ``family`` by a unit
            of each of the r, shape (p, r).
        """
        unknown = {*self._phases}
        rows = dict[str | float, list[int]]()
        for k, each in enumerate(family.parameters):
            frequency = float(each.effect.phase @ family.system.forcing.frequency)
            rows.setdefault(frequency if each.name in unknown else each.name, []).append(k)
        changes, parameters = np.zeros((family.size, len(rows))), list(family.parameters)
        for j, own in enumerate(rows.values()):
            changes[own, j] = 1.0
            phase = np.sum([parameters[k].effect.phase for k in own], axis=0)
            if len(own) > 1:
                effect = Coefficients.change(family.system, phase=phase)
                parameters[own[0]] = replace(parameters[own[0]], effect=effect)
        first = tuple(parameters[own[0]] for own in rows.values())
        return ParametricFamily(family.system, first), changes


@dataclass(frozen=True, slots=True)
class FittedRecording:
    """A model fitted to a recording, and the smoothed motion.

    Attributes:
        model: the fitted model, or the given one where no motion explains the impacts.
        text: of the model file.
        identification: None where the search found nothing, see ``failure``.
        failure: why there are no values; empty if there are.
        smoothing: of the recording with ``model``.
    """

    model: Model
    text: str
    identification: Identification | None
    failure: str
    smoothing: BagSmoothing

    @property
    def fits(self) -> bool:
        """Whether the model explains the impacts."""
        found = self.identification
        return not self.failure and found is not None and found.verdict.fits


def fit_bag(
    task: FitTask,
    output: Path,
    smoothed: Path,
    *,
    show: Callable[[str], None],
    step: Callable[[str, float, float], None],
) -> FittedRecording:
    """Identify what is uncertain in a model, write the fitted model, and smooth the recording.

    Args:
        task: what is to be fitted.
        output: the model file to write.
        smoothed: the bag to write.
        show: receives what is being done.
        step: receives what is being done, and how much of how much is done.

    Raises:
        UsageError, BagError: bag and model do not go together.
        DynamicsError: no motion at all can be smoothed.
    """
    with BagReader(task.bag) as reader:
        events = events_from(reader, task.epoch)
        events = [replace(each, epoch=each.epoch or task.epoch) for each in events]
        identification, failure = _identified(task, events, show)
        if identification is None or failure:
            text = _unexplained(task.text, task.recording)
        else:
            text = fit_report.model_text(identification, task.text, task.recording, output)
        output.write_text(text, encoding="utf-8")
        model = parse_model(text, str(output))
        smoothing = smooth_bag(
            reader,
            model,
            _options(task, model),
            smoothed,
            rate=_rate(events),
            known=None if identification is None else identification.found,
            text=text,
            progress=step,
        )
    return FittedRecording(model, text, identification, failure, smoothing)


def _identified(
    task: FitTask, events: list[ImpactEvent], show: Callable[[str], None]
) -> tuple[Identification | None, str]:
    """Return the identification, if there is one, and why its values are of no use, if so."""
    model = task.model
    family = parametric_family(replace(model.system, live=None), task.free, model.elements)
    together, changes = task.shifting_together(family)
    try:
        found = identify(
            together,
            events,
            clock=None if task.clock_error < 0 else task.clock_error,
            resolution=task.resolution,
            progress=lambda what: show(f"{family.system.name}: {what}"),
            mislabelled=task.mislabelled,
            prior=task.prior,
            sensors=model.sensors,
        )
    except (IdentificationError, DynamicsError) as error:
        return None, str(error)
    every = block_diag(np.eye(found.start.size), changes)
    found = replace(
        found,
        family=family,
        values=changes @ found.values,
        covariance=every @ found.covariance @ every.T,
    )
    return found, fit_report.why_useless(found)


def _unexplained(text: ModelText, recording: Path) -> str:
    """Return the text of a model with the mark that no motion explains a recording's impacts."""
    provenance: dict[str, object] = {
        FITS: False,
        "package": "impact_observer",
        "version": __version__,
        "identified_from": str(recording),
    }
    if before := parse_model(text.text, text.source, text.folder).provenance:
        provenance["before"] = before
    return edited(text.text, {("provenance",): provenance})


def _options(task: FitTask, model: Model) -> Options:
    """Return the options of the observer with which the recording is smoothed."""
    return Options(
        law="minimum-variance",
        initial_deviation=suggested_deviation(model.system) or Options.initial_deviation,
        clock_error=task.clock_error,
        mislabelled=task.mislabelled,
        epoch=task.epoch,
    )


def _rate(events: list[ImpactEvent]) -> float:
    """Return the rate of the smoothed states, Hz."""
    stamps = sorted({each.stamp for each in events})
    seconds = max(seconds_between(stamps[0], stamps[-1]), 1e-9)
    return min(_STATES * len(stamps), _MOST) / seconds
