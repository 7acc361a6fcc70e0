# SPDX-License-Identifier: Apache-2.0
"""How the samples of a sensor fit the motion that explains a recording."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from impact_observer.identify.problem import Problem, Solution
from impact_observer.identify.residuals import DOUBTED, REJECTED
from impact_observer.model.measurement import Measurement


@dataclass(frozen=True, slots=True)
class SensorFit:
    """The samples of one sensor under a fitted motion.

    Attributes:
        sensor: its declaration.
        samples: how many were compared.
        near: how many were left out near impacts.
        rejected: how many its gate rejected.
        deviation: of its noise, as declared, in its unit.
        rms: of the errors over their degrees of freedom, in its unit.
        size: probability of errors this large under the declared deviation.
    """

    sensor: Measurement
    samples: int
    near: int
    rejected: int
    deviation: float
    rms: float
    size: float

    @property
    def name(self) -> str:
        """Name of the sensor."""
        return self.sensor.name

    @property
    def doubt(self) -> str:
        """The warning that the sensor contradicts impacts and model; empty if it does not."""
        every = self.samples + self.near + self.rejected
        return self.sensor.doubt(every, self.rejected)

    @property
    def fits(self) -> bool:
        """Whether the size of the errors does not reject the model."""
        return self.size >= REJECTED

    @property
    def widening(self) -> float:
        """Factor of the standard errors: 1 where white noise of its size explains the errors."""
        return self.rms / self.deviation if self.size < DOUBTED else 1.0


def sensor_fits(problem: Problem, solution: Solution) -> tuple[SensorFit, ...]:
    """How the samples of each sensor fit."""
    fits = []
    rows = zip(problem.sensors, solution.shot.sensors, solution.errors, strict=True)
    for each, own, rms in rows:
        errors, size = own.errors, 1.0
        if errors.size:
            squares = float(np.sum((errors / each.deviation) ** 2))
            freedom = squares * (each.deviation / rms) ** 2 if rms else 1.0
            size = float(stats.chi2.sf(squares, max(freedom, 1.0)))
        fits.append(
            SensorFit(
                each.sensor,
                errors.size,
                each.near,
                each.rejected,
                each.deviation,
                rms,
                size,
            )
        )
    return tuple(fits)
