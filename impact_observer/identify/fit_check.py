# Copyright 2026 impact_observer developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Whether a model explains recorded impact times as well as their clock allows."""

from dataclasses import dataclass

import numpy as np

from impact_observer.identify.identification import Identification
from impact_observer.identify.residuals import (
    REJECTED,
    independence,
    lags_of,
    probability_of_size,
)


@dataclass(frozen=True, slots=True)
class FitCheck:
    """Tests of the shifts of the stamps against a declared clock.

    Attributes:
        size: probability of shifts this large under the declared clock error; None without one.
        white: probability of autocorrelations this large of independent shifts (Ljung and Box,
            On a measure of lack of fit in time series models, 1978).
        lags: of the autocorrelations.
        by_contact: by name: impacts, mean and rms of their shifts, s.
        worst: the contact of the largest rms.
        odd: names of the sensors whose errors are too large, or correlated.
    """

    size: float | None
    white: float
    lags: int
    by_contact: dict[str, tuple[int, float, float]]
    worst: str
    odd: tuple[str, ...] = ()

    @property
    def fits(self) -> bool:
        """Whether no test rejects the model, of stamps or of sensors."""
        size = 1.0 if self.size is None else self.size
        return min(self.white, size) >= REJECTED and not self.odd


def check_fit(found: Identification) -> FitCheck:
    """Check the fitted model.

    Under the right model the shifts are the errors of a clock: independent, and of its size.
    """
    shifts = found.shifts
    names = sorted({name for each in found.contacts for name in each})
    by_contact = {}
    for name in names:
        own = shifts[[name in each for each in found.contacts]]
        by_contact[name] = (own.size, float(np.mean(own)), float(np.sqrt(np.mean(own**2))))
    size = None
    if found.declared:
        size = probability_of_size(shifts, found.clock, found.freedom)
    return FitCheck(
        size=size,
        white=independence(shifts),
        lags=lags_of(shifts),
        by_contact=by_contact,
        worst=max(names, key=lambda name: by_contact[name][2]),
        odd=tuple(each.name for each in found.sensors if not each.fits),
    )
