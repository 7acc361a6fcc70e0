# SPDX-License-Identifier: Apache-2.0
"""How far declared deviations of parameters limit what the impacts determine."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from impact_observer.draw.reports import TextTable, figure
from impact_observer.events import ImpactEvent
from impact_observer.model import Model
from impact_observer.model.measurement import Measurement
from impact_observer.model.parameter_uncertainty import ParameterUncertainty
from impact_observer.observer import Observer, Options, make_observer, replay_batches
from impact_observer.observer.samples import SensorSample
from impact_observer.states import Vector


class ParameterLimit(NamedTuple):
    """The deviations of (q, u) in the last flights of a recording, shape (2n,), SI units.

    Attributes:
        exact: of an observer whose parameters are exact.
        declared: of an observer with the declared deviations.
    """

    exact: Vector
    declared: Vector

    @property
    def for_json(self) -> dict[str, list[float]]:
        """The values of ``--json``."""
        return {"exact": self.exact.tolist(), "declared": self.declared.tolist()}

    def table(self, model: Model) -> TextTable:
        """Both side by side."""
        system, numbers = model.system, (self.exact.tolist(), self.declared.tolist())
        columns = zip(system.state_names, *numbers, system.state_units, strict=True)
        rows = [(name, figure(one), figure(other), unit) for name, one, other, unit in columns]
        headings = ("deviation of", "parameters exact", "as declared", "unit")
        title = "minimum-variance in the last flights, without and with the model's deviations:"
        return TextTable(headings, rows, title, words=("unit",))


def parameter_limit(
    model: Model,
    events: Sequence[ImpactEvent],
    options: Options,
    *,
    measurements: Sequence[Measurement] = (),
    samples: Sequence[SensorSample] = (),
    give: Callable[[Observer], object] = lambda _: None,
) -> ParameterLimit | None:
    """The deviations that an observer reaches on ``events``, with and without those declared.

    None if the ``model`` declares none, or if fewer than two events are applied. ``give`` gives an
    observer the recorded samples of live inputs.
    """
    known = model.uncertainty
    if known is None or not known.deviations.any():
        return None
    exact = ParameterUncertainty(known.names, np.zeros_like(known.covariance))
    found = list[Vector]()
    for own in (replace(model, uncertainty=exact), model):
        chosen = replace(options, law="minimum-variance", ensemble=1)
        observer = make_observer(own, chosen, measurements=measurements)
        give(observer)
        nothing = np.empty(0, dtype=np.int64)
        for _ in replay_batches(observer, events, nothing, rejects=True, samples=samples):
            pass
        if (sources := observer.deviation_sources()) is None:
            return None
        found.append(sources.deviations)
    return ParameterLimit(*found)
