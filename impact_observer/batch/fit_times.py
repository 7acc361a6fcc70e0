# SPDX-License-Identifier: Apache-2.0
"""``fit`` in Python: from seconds by contact to parameters, impacts and states as arrays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from impact_observer.arrays_of_states import StateArrays
from impact_observer.batch.identification import Identification, identify
from impact_observer.batch.smoothed_run import SmoothedRun
from impact_observer.batch.smoothing import smoothed_runs
from impact_observer.events import events_at
from impact_observer.model import Model, read_model
from impact_observer.model.free_parameters import parametric_family
from impact_observer.observer import Options
from impact_observer.observer.uncertainty import suggested_deviation
from impact_observer.stamps import nanoseconds
from impact_observer.states import Vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class ImpactArrays(NamedTuple):
    """Estimates of K impacts, in SI units; each array has the shape (K,).

    Attributes:
        seconds: since the epoch.
        contact: names.
        speed_before: of the contact.
        speed_before_deviation: standard deviation.
        impulse: in the direction of the contact.
        impulse_deviation: standard deviation.
        energy_loss: in the impact.
        energy_loss_deviation: standard deviation.
    """

    seconds: Vector
    contact: tuple[str, ...]
    speed_before: Vector
    speed_before_deviation: Vector
    impulse: Vector
    impulse_deviation: Vector
    energy_loss: Vector
    energy_loss_deviation: Vector


@dataclass(frozen=True, eq=False)
class FittedTimes:
    """A model fitted to impact times, and the motion.

    Attributes:
        found: the parameters and the verdict.
        run: the motion.
    """

    found: Identification
    run: SmoothedRun

    @property
    def fits(self) -> bool:
        """Whether the model explains the times; ``found.verdict.reasons`` say why not."""
        return self.found.verdict.fits

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Values and standard errors of the parameters by name, SI units."""
        pairs = zip(self.found.values.tolist(), self.found.errors.tolist(), strict=True)
        return dict(zip(self.found.family.names, pairs, strict=True))

    @property
    def impacts(self) -> ImpactArrays:
        """All impacts, in order."""
        every, epoch = [*self.run.impact_estimates()], self.run.run.epoch
        columns = (
            np.array([float(getattr(each, name)) for each in every])
            for name in ImpactArrays._fields[2:]
        )
        seconds = np.array([each.stamp - epoch for each in every]) * 1e-9
        return ImpactArrays(seconds, tuple(each.contact for each in every), *columns)

    def states(self, seconds: ArrayLike) -> StateArrays:
        """The states at instants since the epoch, s, ascending; none before the start."""
        epoch = self.run.run.epoch
        stamps = epoch + nanoseconds(seconds, "seconds")
        names = self.run.run.system.state_names
        return StateArrays.of(names, self.run.estimates(stamps), epoch)

    def plot(self) -> "Figure":
        """The motion from the start to the last impact, with bands of two deviations."""
        impacts = self.impacts.seconds
        begin = (self.run.start - self.run.run.epoch) * 1e-9
        seconds = np.linspace(begin, impacts[-1], 40 * impacts.size + 1)
        chart: Figure = self.states(seconds).plot()
        return chart


def fit(
    times: Mapping[str, ArrayLike] | ArrayLike,
    model: Model | str,
    *,
    free: Sequence[str] | None = None,
    clock_error: float | None = None,
) -> FittedTimes:
    """Fit a model to impact times, without a file.

    Args:
        times: of the impacts of each contact, or of the only one, s since the epoch, at which
            the time of forces is zero; free ``forcing-phase`` or ``ground-phase`` where nobody
            knows it.
        model: the model, a file, or the name of a sample.
        free: names of the parameters to identify; None for those that bear a deviation.
        clock_error: standard deviation of the times, s; None to estimate it.

    Raises:
        ModelError, UsageError: the model, the names or the times cannot be used.
        BagError: no time.
        IdentificationError: fewer times than unknowns, or no motion explains the times.
    """
    read = read_model(model) if isinstance(model, str) else model
    known = read.uncertainty
    epoch, events = events_at(times, read.system.contact_names)
    names = free if free is not None else () if known is None else known.names
    family = parametric_family(read.system, tuple(names), read.elements)
    found = identify(family, events, clock=clock_error, prior=known, sensors=read.sensors)
    options = Options(
        epoch=epoch,
        clock_error=-1.0 if clock_error is None else clock_error,
        initial_deviation=suggested_deviation(read.system) or Options.initial_deviation,
    )
    (run,) = smoothed_runs(read, events, options, known=found.found)
    return FittedTimes(found, run)
