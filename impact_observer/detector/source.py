"""One sensor as its user declares it: topic, contact, and how it tells of an impact."""

import dataclasses
import math
import re
from dataclasses import dataclass, replace

from impact_observer.detector.fields import parse_path
from impact_observer.errors import UsageError

SWITCH, PEAK, ARRIVAL = "switch", "peak", "arrival"
KINDS = (SWITCH, PEAK, ARRIVAL)
DIRECTIONS = ("both", "up", "down")
STAMPS = ("header", "receive")
LONGEST = 10.0
"""The longest time that may be declared, s; as far back as an observer applies events."""

BOOL, IMU = "std_msgs/msg/Bool", "sensor_msgs/msg/Imu"
_USUAL = {
    BOOL: SWITCH,
    IMU: PEAK,
    "std_msgs/msg/Empty": ARRIVAL,
    "std_msgs/msg/Header": ARRIVAL,
}
"""What a topic of such a type is, unless it is said."""
_GRAVITY = 1.0
"""Time constant of the mean that is taken from an accelerometer's signal, s: gravity goes, and
what an impact of some milliseconds adds to the mean stays below a percent of its peak."""
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
_KEYS = {
    SWITCH: ("field", "threshold", "hysteresis", "dead_time", "min_contact_duration", "inverted"),
    PEAK: ("field", "threshold", "hysteresis", "direction", "baseline", "dead_time"),
    ARRIVAL: ("dead_time",),
}
_DEFAULTS: dict[str, dict[str, object]] = {
    SWITCH: {
        "field": "data",
        "threshold": 0.5,
        "hysteresis": 0.0,
        "dead_time": 0.005,
        "min_contact_duration": 0.05,
        "inverted": False,
    },
    PEAK: {"direction": "both", "baseline": 0.0, "dead_time": 0.02},
    ARRIVAL: {"dead_time": 0.0},
}


@dataclass(frozen=True, slots=True)
class Source:
    """A sensor of one contact; what is None is decided once the topic's type is known.

    Attributes:
        contact: name of the contact in the model.
        topic: where the sensor publishes.
        kind: ``switch``, ``peak`` or ``arrival``.
        field: path of what is looked at in a message, such as ``wrench.force.z`` or ``data[3]``;
            of a vector it is the norm.
        threshold: closed from here on, or a peak above; in the field's own unit.
        hysteresis: how far below the threshold it opens, or a peak ends; same unit.
        direction: of peaks, ``both`` (the magnitude), ``up`` or ``down``.
        baseline: time constant of the running mean that is subtracted, s; 0 for none.
        dead_time: after an event, in which there is no other, s.
        latency: known delay of the stamps, subtracted from them, s.
        min_contact_duration: after which a closed switch is a contact that lasts, s; 0 for at
            once.
        inverted: whether the switch is closed when its value is low.
        stamp: ``header`` or ``receive``; None for the header's where there is one.
        origin: what errors put before a key, such as ``rig.yaml: sources[0].``.
    """

    contact: str
    topic: str
    kind: str | None = None
    field: str | None = None
    threshold: float | None = None
    hysteresis: float | None = None
    direction: str | None = None
    baseline: float | None = None
    dead_time: float | None = None
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
        for key, choices in (("kind", KINDS), ("direction", DIRECTIONS), ("stamp", STAMPS)):
            value = getattr(self, key)
            if value is not None and value not in choices:
                raise self.wrong(key, f"{value!r} found; expected one of {', '.join(choices)}")
        self._check_numbers()
        if self.field is not None:
            self.path()

    def _check_numbers(self) -> None:
        """Raise unless every number that is given is one that can be used."""
        for key in ("baseline", "dead_time", "latency", "min_contact_duration"):
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
        """The error that names the file, the ``key`` and the ``problem``."""
        return UsageError(" ".join(f"{self.origin}{key}: {problem}".split()))

    def path(self) -> tuple[str | int, ...]:
        """The parts of ``field``.

        Raises:
            UsageError: it is no path.
        """
        try:
            return parse_path(self.field or "")
        except ValueError as error:
            raise self.wrong("field", str(error)) from None

    def complete(self, type_name: str) -> "Source":
        """The same with everything decided, now that the topic's type is known.

        Args:
            type_name: of the topic's messages, such as ``std_msgs/msg/Bool``.

        Raises:
            UsageError: something is missing, or does not go with the kind.
        """
        kind = self.kind or _USUAL.get(type_name) or (PEAK if self.threshold is not None else "")
        if not kind:
            wanted = f"expected one of {', '.join(KINDS)}, or a threshold, which makes it a peak"
            raise self.wrong("kind", f"is missing, as {self.topic} is {type_name}; {wanted}")
        for key in {*_KEYS[SWITCH], *_KEYS[PEAK]} - {*_KEYS[kind]}:
            if getattr(self, key) is not None:
                raise self.wrong(key, f"does not go with kind {kind}; leave it out")
        usual = dict(_DEFAULTS[kind])
        if kind == PEAK:
            usual |= self._usual_peak(type_name)
        missing = {key: value for key, value in usual.items() if getattr(self, key) is None}
        whole = replace(self, kind=kind, **missing)  # type: ignore[arg-type]
        whole.check_together()
        return whole

    def _usual_peak(self, type_name: str) -> dict[str, object]:
        """What is usual where a threshold is known; an accelerometer is freed of gravity."""
        if self.threshold is None:
            raise self.wrong("threshold", "is missing; expected a number in the field's own unit")
        if self.threshold <= 0:
            raise self.wrong("threshold", f"{self.threshold:g} found; of a peak it is above 0")
        usual: dict[str, object] = {"hysteresis": self.threshold / 2}
        if type_name == IMU:
            return usual | {"field": "linear_acceleration", "baseline": _GRAVITY}
        return usual | {"field": "data"}

    def check_together(self) -> None:
        """Raise unless the numbers of a source that is complete go together.

        Raises:
            UsageError: naming the one that does not.
        """
        if self.kind == PEAK and not self.number("hysteresis") < self.number("threshold"):
            problem = f"{self.hysteresis:g} found; expected less than the threshold"
            raise self.wrong("hysteresis", f"{problem}, {self.threshold:g}")
        if self.kind == SWITCH and 0 < self.number("min_contact_duration") < self.number(
            "dead_time"
        ):
            problem = f"{self.min_contact_duration:g} found; expected 0, or at least the dead time"
            raise self.wrong("min_contact_duration", f"{problem}, {self.dead_time:g} s")

    def number(self, key: str) -> float:
        """A number of a source that is complete."""
        return float(getattr(self, key))

    def scalar(self, values: tuple[float, ...]) -> float:
        """The one number of the field.

        Raises:
            UsageError: it is a vector, which is neither up nor down, open nor closed.
        """
        if len(values) != 1:
            problem = f"{self.field} found, a vector of {len(values)}; name one of its numbers"
            raise self.wrong("field", problem)
        return values[0]
