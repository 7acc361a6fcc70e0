# SPDX-License-Identifier: Apache-2.0
"""Whether a model explains recorded impact times as well as their clock allows."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from impact_observer.identify.residuals import (
    DOUBTED,
    REJECTED,
    independence,
    lags_of,
    probability_of_size,
)
from impact_observer.identify.scatter_hypothesis import may_scatter
from impact_observer.model.time_shift import NO_SHIFT, TimeShift

if TYPE_CHECKING:
    from impact_observer.identify.identification import Identification


@dataclass(frozen=True, slots=True)
class FitCheck:
    """Tests of the shifts of the stamps against a declared clock.

    Attributes:
        size: probability of shifts this large under the declared clock error; None without one.
        large: whether shifts are large and no clock error is declared.
        white: probability of autocorrelations this large of independent shifts (Ljung and Box,
            On a measure of lack of fit in time series models, 1978).
        lags: of the autocorrelations.
        by_contact: by name: impacts, mean and rms of their shifts, s.
        worst: the contact of the largest rms.
        odd: names of the sensors whose errors are too large.
        missed: names of parameters that were not free and explain more than chance does.
        shift: by how much the motion may be early or late; none where there is no motion, or
            white errors of the clock explain the shifts.
    """

    size: float | None
    large: bool
    white: float
    lags: int
    by_contact: dict[str, tuple[int, float, float]]
    worst: str
    odd: tuple[str, ...] = ()
    missed: tuple[str, ...] = ()
    shift: TimeShift = NO_SHIFT

    @property
    def fits(self) -> bool:
        """Whether no test rejects the model, of stamps or of sensors."""
        size = 1.0 if self.size is None else self.size
        odd = self.large or self.odd or self.missed
        return min(self.white, size) >= REJECTED and not odd


def check_fit(fitted: "Identification") -> FitCheck:
    """Test the shifts and the sensors of a fitted model.

    Under the right model the shifts are the errors of a clock: independent, and of its size. Where
    impulses scatter the innovations of the gaps are.
    """
    shifts, errors = fitted.shifts, fitted.residuals
    names = sorted({name for each in fitted.contacts for name in each})
    by_contact = {}
    for name in names:
        own = shifts[[name in each for each in fitted.contacts]]
        by_contact[name] = (own.size, float(np.mean(own)), float(np.sqrt(np.mean(own**2))))
    size = None
    if fitted.declared:
        size = probability_of_size(errors, fitted.clock, fitted.redundancy)
    found = FitCheck(
        size=size,
        large=fitted.large,
        white=independence(errors, fitted.clock if fitted.declared else None),
        lags=lags_of(errors),
        by_contact=by_contact,
        worst=max(names, key=lambda name: by_contact[name][2]),
        odd=tuple(each.name for each in fitted.sensors if not each.fits),
        missed=fitted.missed,
    )
    chance = min(independence(errors), 1.0 if size is None else size)
    if not fitted.converged or (found.fits and chance >= DOUBTED):
        return found
    return replace(found, shift=TimeShift.of(shifts, fitted.stamps))


def rejections(fitted: "Identification", check: FitCheck) -> Iterator[str]:
    """Why a ``check`` says that a fitted model does not fit, a line each; none where it fits."""
    if check.large:
        yield (
            f"the shifts of {fitted.rms:.2g} s rms are too large for a clock: declare the error of"
            " the stamps (--clock-error) where it is"
        )
    if check.white < REJECTED:
        is_tried = may_scatter(fitted.recording.problem(fitted.family))
        scatter = "was tried, and rejected" if is_tried else "needs more impacts to be tried"
        yield (
            "shifts of successive stamps depend on each other, which errors of a clock do not"
            f" (chance {check.white:.1g}); a restitution that scatters from hit to hit {scatter}"
        )
    if check.size is not None and check.size < REJECTED:
        yield f"the shifts exceed the error of the clock (chance {check.size:.1g})"
    if check.missed:
        yield f"the shifts have a part that others would explain: {', '.join(check.missed)}"
