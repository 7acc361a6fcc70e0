# SPDX-License-Identifier: Apache-2.0
"""The declaration of one sensor: its contact, its topic, and how impacts are detected."""

import dataclasses
import math
import re
from dataclasses import dataclass, replace

from impact_observer.errors import UsageError
from impact_observer.message_fields import parse_path

SWITCH, PEAK, ARRIVAL = "switch", "peak", "arrival"
KINDS = (SWITCH, PEAK, ARRIVAL)
DIRECTIONS = ("both", "up", "down")
INSTANTS = ("top", "onset")
STAMPS = ("header", "receive")
_CHOICES = {"kind": KINDS, "direction": DIRECTIONS, "instant": INSTANTS, "stamp": STAMPS}
LONGEST = 10.0
"""The longest time that may be declared, s: the longest ``history`` of an observer."""

BOOL, IMU = "std_msgs/msg/Bool", "sensor_msgs/msg/Imu"
_DEFAULT_KINDS = {
    BOOL: SWITCH,
    IMU: PEAK,
    "std_msgs/msg/Empty": ARRIVAL,
    "std_msgs/msg/Header": ARRIVAL,
}
"""The default kind of a sensor, by the type of its topic."""
_IMU_BASELINE = 1.0
"""Default ``baseline`` of an accelerometer, s. The mean over this time removes gravity;
an impact of some milliseconds changes the mean by less than a percent of its peak."""
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_DEFAULTS: dict[str, dict[str, object]] = {  # and which keys go with each kind
    SWITCH: {
        "field": "data",
        "threshold": 0.5,
        "hysteresis": 0.0,
        "dead_time": 0.005,
        "min_contact_duration": 0.05,
        "inverted": False,
    },
    PEAK: {
        "field": "data",
        "threshold": None,
        "hysteresis": None,  # half the threshold
        "direction": "both",
        "instant": "top",
        "baseline": 0.0,
        "dead_time": 0.02,
        "decay": 0.0,
    },
    ARRIVAL: {"dead_time": 0.0},
}


@dataclass(frozen=True, slots=True)
class Source:
    """The declaration of the sensor of one contact.

    None stands for a default that :meth:`complete` fills in, as it depends on the topic's type.

    Attributes:
        contact: name of the contact in the model.
        topic: where the sensor publishes.
        kind: ``switch``, ``peak`` or ``arrival``.
        field: path of the number in a message, such as ``wrench.force.z`` or ``data[3]``; of a
            vector the norm is used.
        threshold: a switch is closed, or a signal is a peak, from this value on; in the field's
            own unit.
        hysteresis: a switch opens, or a peak ends, so far below the threshold; same unit.
        direction: of peaks, ``both`` (the magnitude), ``up`` or ``down``.
        instant: of peaks, the stamp is that of the ``top``, or of the ``onset``.
        baseline: time constant of the running mean that is subtracted, s; 0 for none.
        dead_time: the time after an event without another event, s.
        decay: time constant of the ringing after a peak, s; 0 for none. A peak counts only if it
            is ``RINGING`` times higher than what is left of the peak before.
        latency: delay of the stamps, which is subtracted, s; negative where stamps are early, such
            as minus half of the time for which impacts last.
        min_contact_duration: a closure that lasts longer is persistent contact, s; with 0
            every closure is.
        inverted: whether the switch is closed when its value is low.
        stamp: ``header`` or ``receive``; None for the header's where there is one.
        origin: put before a key in errors, such as ``rig.yaml: sources[0].``.
    """

    contact: str
    topic: str
    kind: str | None = None
    field: str | None = None
    threshold: float | None = None
    hysteresis: float | None = None
    direction: str | None = None
    instant: str | None = None
    baseline: float | None = None
    dead_time: float | None = None
    decay: float | None = None
    latency: float = 0.0
    min_contact_duration: float | None = None
    inverted: bool | None = None
    stamp: str | None = None
    origin: str = dataclasses.field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        for key in ("contact", "topic"):
            if not getattr(self, key):
                raise self.wrong(key, "is missing; expected a name")
        if not _TOPIC.fullmatch(self.topic):
            raise self.wrong("topic", f"{self.topic!r} found; expected a name such as /rig/switch")
        for key, choices in _CHOICES.items():
            value = getattr(self, key)
            if value is not None and value not in choices:
                raise self.wrong(key, f"{value!r} found; expected one of {', '.join(choices)}")
        self._check_numbers()
        if self.field is not None:
            self.path()

    def _check_numbers(self) -> None:
        """Raise if a number that is given is out of range."""
        if not abs(self.latency) <= LONGEST:
            wanted = f"expected -{LONGEST:g} to {LONGEST:g} s"
            raise self.wrong("latency", f"{self.latency:g} found; {wanted}")
        for key in ("baseline", "dead_time", "decay", "min_contact_duration"):
            value = getattr(self, key)
            if value is not None and not 0 <= value <= LONGEST:
                raise self.wrong(key, f"{value:g} found; expected 0 to {LONGEST:g} s")
        for key in ("threshold", "hysteresis"):
            value = getattr(self, key)
            if value is not None and not math.isfinite(value):
                raise self.wrong(key, f"{value:g} found; expected a finite number")
        if self.hysteresis is not None and self.hysteresis < 0:
            raise self.wrong("hysteresis", f"{self.hysteresis:g} found; expected 0 or more")

    def wrong(self, key: str, problem: str) -> UsageError:
        """Returns the error that names the file, the ``key`` and the ``problem``."""
        return UsageError(" ".join(f"{self.origin}{key}: {problem}".split()))

    def path(self) -> tuple[str | int, ...]:
        """Returns the parts of ``field``.

        Raises:
            UsageError: ``field`` is no path.
        """
        try:
            return parse_path(self.field or "")
        except ValueError as error:
            raise self.wrong("field", str(error)) from None

    def kind_on(self, type_name: str) -> str:
        """Returns the kind that is declared, or the default; empty where the type has none."""
        return (
            self.kind
            or _DEFAULT_KINDS.get(type_name)
            or (PEAK if self.threshold is not None else "")
        )

    def complete(self, type_name: str) -> "Source":
        """Returns the source with its defaults for messages of a type, ``std_msgs/msg/Bool``.

        Raises:
            UsageError: a key is missing, or does not go with the kind.
        """
        kind = self.kind_on(type_name)
        if not kind:
            wanted = f"expected one of {', '.join(KINDS)}, or a threshold, which makes it a peak"
            raise self.wrong("kind", f"is missing, as {self.topic} is {type_name}; {wanted}")
        for key in set().union(*_DEFAULTS.values()) - {*_DEFAULTS[kind]}:
            if getattr(self, key) is not None:
                raise self.wrong(key, f"does not go with kind {kind}; leave it out")
        defaults = dict(_DEFAULTS[kind])
        if kind == PEAK:
            defaults |= self._peak_defaults(type_name)
        missing = {key: value for key, value in defaults.items() if getattr(self, key) is None}
        complete = replace(self, kind=kind, **missing)  # type: ignore[arg-type]
        complete._check_together()  # noqa: SLF001 (of the same class)
        return complete

    def _peak_defaults(self, type_name: str) -> dict[str, object]:
        """Returns the defaults that depend on the threshold or on the type of the topic."""
        if self.threshold is None:
            raise self.wrong("threshold", "is missing; expected a number in the field's own unit")
        if self.threshold <= 0:
            raise self.wrong("threshold", f"{self.threshold:g} found; of a peak it is above 0")
        defaults: dict[str, object] = {"hysteresis": self.threshold / 2}
        if type_name == IMU:
            defaults |= {"field": "linear_acceleration", "baseline": _IMU_BASELINE}
        return defaults

    def _check_together(self) -> None:
        """Check the numbers of a complete source against each other."""
        if self.kind == PEAK and not self.number("hysteresis") < self.number("threshold"):
            problem = f"{self.hysteresis:g} found; expected less than the threshold"
            raise self.wrong("hysteresis", f"{problem}, {self.threshold:g}")
        if self.kind == SWITCH and 0 < self.number("min_contact_duration") < self.number(
            "dead_time"
        ):
            problem = f"{self.min_contact_duration:g} found; expected 0, or at least the dead time"
            raise self.wrong("min_contact_duration", f"{problem}, {self.dead_time:g} s")

    def number(self, key: str) -> float:
        """Returns a number of a complete source."""
        return float(getattr(self, key))

    @property
    def is_scalar(self) -> bool:
        """Whether the field of a complete source must be one number."""
        return self.kind == SWITCH or (self.kind == PEAK and self.direction != "both")

    def scalar(self, values: tuple[float, ...]) -> float:
        """Returns the number of a field that must not be a vector.

        Raises:
            UsageError: the field is a vector.
        """
        if len(values) != 1:
            problem = f"{self.field} found, a vector of {len(values)}; name one of its numbers"
            raise self.wrong("field", problem)
        return values[0]
