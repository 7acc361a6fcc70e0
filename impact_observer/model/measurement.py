# SPDX-License-Identifier: Apache-2.0
"""Sensors that measure a linear function of the state, and the file that declares them."""

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import UNSET, Meta, UnsetType

from impact_observer.errors import ModelError, UsageError
from impact_observer.message_fields import FieldPath, parse_path
from impact_observer.model.document import Keys, Name, NotNegative, Number, Positive, converted
from impact_observer.model.multibody import Multibody
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_file_or_sample

KINDS = POSITION, VELOCITY, _ = ("position", "velocity", "acceleration")
MOST = 1000
"""Largest number of sensors in a file."""
_MANY_REJECTED = 0.1
"""Share of rejected samples of a doubtful sensor."""
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
Coefficients: TypeAlias = tuple[tuple[str, float], ...]
"""Names of coordinates, each with a number."""
_Short = Annotated[float, Meta(ge=0.0, le=10.0)]
"""A time, s, up to the longest ``history`` of an observer."""


class _SensorKeys(Keys, frozen=True, kw_only=True):
    """The keys of a sensor in a file; what they mean says ``Measurement``."""

    name: Name
    topic: Name
    joint: Name = ""
    quantity: Name = ""
    field: Name = ""
    position: dict[str, Number] | UnsetType = UNSET
    velocity: dict[str, Number] | UnsetType = UNSET
    acceleration: dict[str, Number] | UnsetType = UNSET
    gap: Name = ""
    offset: Number = 0.0
    deviation: NotNegative
    delay: _Short = 0.0
    blanking: _Short = 0.0
    gate: Positive = 5.0
    timeout: Positive = 1.0
    stamp: Literal["header", "receive"] | None = None


class _SensorFile(Keys, frozen=True, kw_only=True):
    measurements: Annotated[tuple[_SensorKeys, ...], Meta(min_length=1, max_length=MOST)]


@dataclass(frozen=True, slots=True)
class Measurement:
    """A sensor: ``y`` = a sum of coefficients times positions, velocities, ... + ``offset``.

    Attributes:
        name: name of the sensor in verdicts and diagnostics.
        topic: topic of the samples.
        joint: name of the joint in ``sensor_msgs/JointState``; empty where ``field`` is given.
        quantity: ``position`` or ``velocity`` of that joint.
        field: path of the number in a message, such as ``range`` or ``linear_acceleration.x``.
        position: coefficients by coordinate.
        velocity: coefficients by coordinate.
        acceleration: coefficients by coordinate.
        gap: name of the contact whose gap is measured; empty for none.
        offset: constant part of ``y``, in the unit of ``y``.
        deviation: standard deviation of the noise, in the unit of ``y``; 0 for an exact
            measurement.
        delay: delay of the stamps, s.
        blanking: time after an impact in which samples are not used, s.
        gate: largest normalised innovation of an accepted sample.
        timeout: longest time without a sample before a node warns, s.
        stamp: ``header`` or ``receive``; None for ``header`` if the message has a header.
        origin: text before a key in errors, such as ``rig.yaml: measurements[0].``.
    """

    name: str
    topic: str
    joint: str = ""
    quantity: str = ""
    field: str = ""
    position: Coefficients = ()
    velocity: Coefficients = ()
    acceleration: Coefficients = ()
    gap: str = ""
    offset: float = 0.0
    deviation: float = dataclasses.field(kw_only=True)
    delay: float = 0.0
    blanking: float = 0.0
    gate: float = 5.0
    timeout: float = 1.0
    stamp: str | None = None
    origin: str = dataclasses.field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        """Check all fields that do not depend on the system."""
        given = {
            each.name: getattr(self, each.name)
            for each in dataclasses.fields(self)
            if each.name != "origin" and getattr(self, each.name) != each.default
        }
        given |= {kind: dict(given[kind]) for kind in KINDS if kind in given}
        try:
            converted(given, _SensorKeys)
        except ModelError as error:
            raise self.wrong(error.key, error.problem) from None
        if not _TOPIC.fullmatch(self.topic):
            raise self.wrong(
                "topic", f"{self.topic!r} found; expected a name such as /rig/encoder"
            )
        self._check_source()
        self._check_function()

    @property
    def encoded(self) -> tuple[str, float] | None:
        """The coordinate whose position alone it measures, and its coefficient; None if none."""
        if len(self.position) != 1 or self.velocity or self.acceleration:
            return None
        return self.position[0]

    def _check_source(self) -> None:
        """Raise UsageError unless exactly one of joint and field names the number of a message."""
        if bool(self.joint) == bool(self.field):
            pair = "both joint and field" if self.joint else "neither joint nor field"
            raise self.wrong("field", f"{pair} found; expected one of them")
        if self.field and self.quantity:
            raise self.wrong("quantity", "does not go with field; leave it out")
        if self.joint and self.quantity not in (POSITION, VELOCITY):
            found = self.quantity or "nothing"
            raise self.wrong("quantity", f"{found} found; expected {POSITION} or {VELOCITY}")
        if self.field:
            self.path()

    def _check_function(self) -> None:
        """Raise UsageError unless either coefficients or a gap are given."""
        given = [kind for kind in KINDS if getattr(self, kind)]
        if self.joint and not (given or self.gap):
            object.__setattr__(self, self.quantity, ((self.joint, 1.0),))
            given = [self.quantity]
        if bool(given) == bool(self.gap):
            kinds = f"{given[0]} and gap" if given else "no position, velocity, acceleration, gap"
            wanted = "expected coefficients by coordinate, or the gap of a contact"
            raise self.wrong(given[0] if given else POSITION, f"{kinds} found; {wanted}")
        for kind in KINDS:
            for coordinate, value in getattr(self, kind):
                if not value:
                    raise self.wrong(f"{kind}.{coordinate}", "0 found; expected another number")

    def wrong(self, key: str, problem: str) -> UsageError:
        """The error that names the file, the ``key`` and the ``problem``."""
        return UsageError(" ".join(f"{self.origin}{key}: {problem}".split()))

    def path(self) -> FieldPath:
        """The parts of ``field``.

        Raises:
            UsageError: ``field`` is not a valid path.
        """
        try:
            return parse_path(self.field)
        except ValueError as error:
            raise self.wrong("field", str(error)) from None

    def doubt(self, samples: int, rejected: int) -> str:
        """The warning that samples contradict impacts and model; empty where they do not.

        Args:
            samples: their number.
            rejected: how many the gate rejects.
        """
        if not samples or rejected < _MANY_REJECTED * samples:
            return ""
        return (
            f"{self.name} contradicts the impacts and the model: {rejected} of {samples} samples"
            " are rejected; see docs/nodes.md"
        )

    def check(self, system: Multibody) -> None:
        """Check that the system has the named coordinates and the named contact.

        Raises:
            UsageError: a name is unknown; the error names file and key.
        """
        for kind in KINDS:
            for coordinate, _ in getattr(self, kind):
                if coordinate not in system.coordinates:
                    key = kind if coordinate != self.joint else "joint"
                    names = ", ".join(system.coordinates)
                    problem = f"{coordinate!r} is no coordinate of {system.name}; expected one of"
                    first = f"{kind}: {{{system.coordinates[0]}: 1}}"
                    remedy = f", or beside the joint which one it measures, such as {first}"
                    raise self.wrong(key, f"{problem} {names}{remedy if self.joint else ''}")
        if self.gap and self.gap not in system.contact_names:
            names = ", ".join(system.contact_names) or "none, as it has no contacts"
            problem = f"{self.gap!r} is no contact of {system.name}; expected one of {names}"
            raise self.wrong("gap", problem)


def read_measurements(path: str | Path | None) -> tuple[Measurement, ...]:
    """The sensors in a file, or in a sample file by its name, such as ``encoder``.

    Without a ``path`` (None or empty) the result has no sensors.

    Raises:
        UsageError: one line that names the file, the key and the expected value.
    """
    if not path:
        return ()
    wanted = "a file of measurements, or a sample"
    file, text = read_file_or_sample(path, "config/measurements", wanted)
    return parse_measurements(text, str(file))


def parse_measurements(text: str, source: str) -> tuple[Measurement, ...]:
    """The sensors in the ``text`` of a file; ``source`` is the name of the file in errors.

    Raises:
        UsageError: one line that names the source, the key and the expected value.
    """
    try:
        given = converted(load_yaml(text), _SensorFile).measurements
    except ModelError as error:
        raise UsageError(f"{source}: {error}") from None
    sensors = []
    for i, each in enumerate(given):
        keys = msgspec.structs.asdict(each)
        keys |= {kind: tuple((keys[kind] or {}).items()) for kind in KINDS}
        sensors.append(Measurement(**keys, origin=f"{source}: measurements[{i}]."))
        if each.name in [other.name for other in given[:i]]:
            raise sensors[i].wrong("name", f"{each.name!r} is taken already; names must differ")
    return tuple(sensors)
