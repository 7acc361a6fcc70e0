# SPDX-License-Identifier: Apache-2.0
"""Sensors that measure a linear function of the state, and the file that declares them."""

import re
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import msgspec
from msgspec import Meta

from impact_observer.errors import ModelError, UsageError
from impact_observer.message_fields import FieldPath, parse_path
from impact_observer.model.document import (
    Keys,
    Name,
    NotNegative,
    Number,
    Positive,
    check_names,
    converted,
)
from impact_observer.model.multibody import Multibody
from impact_observer.model.yaml_text import load_yaml
from impact_observer.resources import read_file_or_sample

KINDS = POSITION, VELOCITY, _ = ("position", "velocity", "acceleration")
MOST = 1000
"""Largest number of sensors in a file."""
_MANY_REJECTED = 0.1
"""Share of rejected samples of a doubtful sensor."""
_TOPIC = re.compile(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)
Coefficients: TypeAlias = dict[str, Number]
"""Numbers by the names of coordinates."""
_Short = Annotated[float, Meta(ge=0.0, le=10.0)]
"""A time, s, up to the longest ``history`` of an observer."""


class _Source(Keys, frozen=True):
    """Where the numbers of a sensor come from."""

    name: Name
    topic: Name
    joint: Name = ""
    quantity: Literal["", "position", "velocity"] = ""


class Measurement(_Source, frozen=True, kw_only=True):
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
        origin: text before a key in errors, such as ``rig.yaml: measurements[0].``; no key of a
            file.

    Raises:
        ModelError: keys that do not go together.
    """

    field: Name = ""
    position: Coefficients = msgspec.field(default_factory=dict)
    velocity: Coefficients = msgspec.field(default_factory=dict)
    acceleration: Coefficients = msgspec.field(default_factory=dict)
    gap: Name = ""
    offset: Number = 0.0
    deviation: NotNegative
    delay: _Short = 0.0
    blanking: _Short = 0.0
    gate: Positive = 5.0
    timeout: Positive = 1.0
    stamp: Literal["header", "receive"] | None = None
    origin: str = msgspec.field(default="", name="\xa0")

    def __post_init__(self) -> None:
        """Check what does not depend on the system."""
        if not _TOPIC.fullmatch(self.topic):
            problem = f"{self.topic!r} found; expected a name such as /rig/encoder"
            raise ModelError("topic", problem)
        self._check_source()
        self._check_function()

    @property
    def encoded(self) -> tuple[str, float] | None:
        """The coordinate whose position alone it measures, and its coefficient; None if none."""
        if len(self.position) != 1 or self.velocity or self.acceleration:
            return None
        return next(iter(self.position.items()))

    def _check_source(self) -> None:
        """Raise ModelError unless exactly one of joint and field names the number of a message."""
        if bool(self.joint) == bool(self.field):
            pair = "both joint and field" if self.joint else "neither joint nor field"
            raise ModelError("field", f"{pair} found; expected one of them")
        if bool(self.joint) != bool(self.quantity):
            found = self.quantity or "nothing"
            wanted = f"{POSITION} or {VELOCITY} of a joint" if self.joint else "none beside field"
            raise ModelError("quantity", f"{found} found; expected {wanted}")
        if self.field:
            try:
                parse_path(self.field)
            except ValueError as error:
                raise ModelError("field", str(error)) from None

    def _check_function(self) -> None:
        """Raise ModelError unless either coefficients or a gap are given."""
        if self.joint and not (self.given or self.gap):
            msgspec.structs.force_setattr(self, self.quantity, {self.joint: 1.0})
        if bool(self.given) == bool(self.gap):
            kind = next(iter(self.given), POSITION)
            kinds = f"{kind} and gap" if self.gap else "no position, velocity, acceleration, gap"
            wanted = "expected coefficients by coordinate, or the gap of a contact"
            raise ModelError(kind, f"{kinds} found; {wanted}")
        for kind, coefficients in self.given.items():
            for coordinate, value in coefficients.items():
                if not value:
                    raise ModelError(f"{kind}.{coordinate}", "0 found; expected another number")

    @property
    def given(self) -> dict[str, Coefficients]:
        """The coefficients of those of position, velocity and acceleration that it measures."""
        parts = {kind: getattr(self, kind) for kind in KINDS}
        return {kind: part for kind, part in parts.items() if part}

    def wrong(self, key: str, problem: str) -> UsageError:
        """The error that names the file, the ``key`` and the ``problem``."""
        return UsageError(" ".join(f"{self.origin}{key}: {problem}".split()))

    def path(self) -> FieldPath:
        """The parts of ``field``."""
        return parse_path(self.field)

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
        for kind, coefficients in self.given.items():
            for coordinate in coefficients:
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


class _SensorFile(Keys, frozen=True):
    measurements: Annotated[tuple[Measurement, ...], Meta(min_length=1, max_length=MOST)]


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
        sensors = converted(load_yaml(text), _SensorFile).measurements
        check_names("measurements", [each.name for each in sensors], member=".name")
    except ModelError as error:
        raise UsageError(f"{source}: {error}") from None
    return tuple(
        msgspec.structs.replace(each, origin=f"{source}: measurements[{i}].")
        for i, each in enumerate(sensors)
    )
