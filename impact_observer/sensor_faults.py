"""What can be wrong with a sensor of impacts, cheap to import where it can be chosen."""

import math
from typing import NamedTuple

from impact_observer.errors import UsageError


class SensorFault(NamedTuple):
    """One thing that can be wrong; 0 or False is an ideal sensor.

    Attributes:
        name: a field of ``plant.Sensor``.
        meaning: one line, without the unit.
        unit: SI unit; empty for none.
        low: least value allowed.
        high: largest value allowed; 0 for a trouble that is there or not.
    """

    name: str
    meaning: str
    unit: str = ""
    low: float = 0.0
    high: float = 0.0

    @property
    def ideal(self) -> float | bool:
        """The value of an ideal sensor."""
        return False if self.high == 0 else 0.0

    @property
    def limits(self) -> str:
        """The values allowed, in words."""
        if self.high == 0:
            return "true or false"
        return f"{self.low:g} to {self.high:g} {self.unit}".rstrip()

    def check(self, value: float | bool) -> None:
        """Raise unless ``value`` is one of those allowed.

        Raises:
            UsageError: naming the trouble, the value and what is expected.
        """
        flag = self.high == 0
        fits = isinstance(value, bool) == flag and math.isfinite(value)
        if not fits or not (flag or self.low <= value <= self.high):
            raise UsageError(f"sensor {self.name}: {value} found; expected {self.limits}")


SENSOR_FAULTS = (
    SensorFault("delay", "by which it notices, stamps and sends late", "s", high=10.0),
    SensorFault("jitter", "standard deviation of its stamps", "s", high=1.0),
    SensorFault("quantisation", "stamps are rounded to a multiple", "s", high=1.0),
    SensorFault("dead_time", "a contact is not felt so long after it was", "s", high=10.0),
    SensorFault("missed", "probability that an impact is not felt", high=1.0),
    SensorFault("spurious", "impacts that it invents, of any contact", "1/s", high=1e4),
    SensorFault("mislabelled", "probability that another contact is named", high=1.0),
    SensorFault("clock_offset", "by which its clock is ahead", "s", low=-3600.0, high=3600.0),
    SensorFault("clock_drift", "by which its clock is too fast", "s/s", low=-0.1, high=0.1),
    SensorFault("threshold", "approach speed below which nothing is felt", "m/s", high=1e6),
    SensorFault("impacts_only", "CLOSE is told as IMPACT, OPEN never"),
    SensorFault("transport", "mean of an exponential time on the way", "s", high=10.0),
)
"""In the order of ``plant.Sensor``."""
