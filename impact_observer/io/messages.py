# SPDX-License-Identifier: Apache-2.0
"""Conversions between our values and messages, with exact stamps and finite numbers.

``rosbags`` and ``rclpy`` have message classes of their own, with the same attribute names and
keyword arguments. :class:`Messages` takes either, so that the messages of a node and of a bag are
equal byte for byte. Reading needs the attributes only. Each field is converted and checked by its
type in the definition of the message.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from rosbags.interfaces import Nodetype

from impact_observer.errors import ImpactObserverError
from impact_observer.events import (
    REVISED,
    ImpactEstimate,
    ImpactEvent,
    Kind,
    MeasurementVerdict,
    Ruling,
    SmoothedImpact,
    Switch,
    Verdict,
)
from impact_observer.io import interfaces
from impact_observer.io.typestores import typestore
from impact_observer.observer.misfit import EXPLAINED
from impact_observer.stamps import MAX_STAMP, NS_PER_S, text
from impact_observer.states import Estimate, Vector, frozen

AnyMessage: TypeAlias = Any
"""A message, or a message class, of ``rosbags`` or of ``rclpy``: they have no common base."""
_Value = TypeVar("_Value")
_LARGEST = {"uint32": 2**32 - 1, "uint64": 2**64 - 1}
_MOST_SWITCHES, _LONGEST_NAME, _LONGEST_FRAME = 100, 256, 4096
"""Most contacts of an event; longest name of a contact, and of the frame, bytes."""


class MessageError(ImpactObserverError, ValueError):
    """A value that no message may carry, or a message without a valid value."""


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """The state of coordinates at a ``stamp`` (ns); mirrors ``sensor_msgs/JointState``.

    Coordinates ``q`` (m or rad) and velocities ``u`` have the shape (n,).
    """

    stamp: int
    names: tuple[str, ...]
    q: Vector
    u: Vector

    def ordered(self, names: tuple[str, ...]) -> "JointState":
        """The same state with its coordinates in the order of ``names``.

        Raises:
            MessageError: its coordinates are others.
        """
        if sorted(self.names) != sorted(names):
            raise MessageError(f"names {', '.join(self.names)}; expected {', '.join(names)}")
        order = [self.names.index(name) for name in names]
        return JointState(self.stamp, names, self.q[order], self.u[order])


@dataclass(frozen=True, slots=True, eq=False)
class EstimateError:
    """Estimate minus truth at a ``stamp`` (ns); mirrors ``impact_observer_msgs/EstimateError``.

    ``v`` is the Lyapunov distance, J; the errors have the shape (n,), SI units.
    """

    stamp: int
    law: str
    v: float
    names: tuple[str, ...]
    position_error: Vector
    velocity_error: Vector


class LiveSample(NamedTuple):
    """The force of an input or joint at a stamp (ns), N, or N m of a joint that turns."""

    name: str
    stamp: int
    value: float


_TYPES: dict[type, str] = {
    Switch: interfaces.CONTACT_SWITCH,
    ImpactEvent: interfaces.IMPACT_EVENT,
    Verdict: interfaces.EVENT_VERDICT,
    MeasurementVerdict: interfaces.MEASUREMENT_VERDICT,
    SmoothedImpact: interfaces.SMOOTHED_IMPACT,
    ImpactEstimate: interfaces.IMPACT_ESTIMATE,
    Estimate: interfaces.OBSERVER_STATE,
    EstimateError: interfaces.ESTIMATE_ERROR,
    JointState: interfaces.JOINT_STATE,
}
"""The message type of each value."""
_FIELDS = {
    "stamp": "header",
    "names": "name",
    "q": "position",
    "u": "velocity",
    "ruling": "verdict",
}
"""Fields that are called otherwise in messages."""
_KINDS: dict[str, type[IntEnum]] = {"kind": Kind, "verdict": Ruling}
"""Fields whose numbers have names."""


class Messages:
    """Makes messages of our values, from given message classes.

    Every method raises :class:`MessageError`, one line with the field's name, for a stamp that a
    message cannot carry (it must be after 0 and before 2038), for a number that is not finite,
    for a counter out of range, and for arrays whose length does not fit the names.
    """

    def __init__(
        self, classes: Callable[[str], AnyMessage], floats: Callable[[Vector], object]
    ) -> None:
        """``classes`` finds a class by the name of its type; ``floats`` makes a ``float64[]``."""
        self.classes = classes
        self._floats = floats
        for kind in _TYPES:  # takes a fifth of a second, which the first event must not
            _mirrored(kind)

    def time(self, stamp: int, field: str = "Time") -> AnyMessage:
        """``stamp`` (ns, or 0 for "unknown") as ``builtin_interfaces/Time``."""
        _check_stamp(field, stamp, earliest=0)
        seconds, nanoseconds = divmod(int(stamp), NS_PER_S)
        return self.classes(interfaces.TIME)(sec=seconds, nanosec=nanoseconds)

    def clock(self, stamp: int) -> AnyMessage:
        """``stamp`` (ns) as ``rosgraph_msgs/Clock``."""
        return self._message(interfaces.CLOCK, clock=stamp)

    def pulse(self, stamp: int) -> AnyMessage:
        """An index pulse of a drive, as ``std_msgs/Header``."""
        return self._header("Header.stamp", stamp)

    def model(self, model: str) -> AnyMessage:
        """A model file's text as ``std_msgs/String``."""
        return self._message(interfaces.STRING, data=model)

    def of(self, value: Any, **others: object) -> AnyMessage:  # noqa: ANN401 (by its type)
        """A value of this package as its message; ``others`` are fields that the value lacks."""
        kind: type = type(value)
        values = {field: getattr(value, name) for name, field in _mirrored(kind).items()}
        return self._message(_TYPES[kind], **values, **others)

    # Callers name what they make; values with the fields of their message need no more than that.
    event = smoothed_impact = impact_estimate = measurement_verdict = of
    joint_state = estimate_error = of

    def verdict(self, verdict: Verdict, latency: float = 0.0) -> AnyMessage:
        """A verdict; ``latency`` is the time from stamp to application, s."""
        return self.of(verdict, latency=latency)

    def estimate(self, estimate: Estimate, names: Sequence[str]) -> AnyMessage:
        """``estimate`` as ``impact_observer_msgs/ObserverState``; ``names`` of coordinates."""
        learned, values, deviations = [*zip(*estimate.parameters, strict=True)] or ((), (), ())
        return self.of(
            estimate,
            name=names,
            parameter_name=learned,
            parameter=values,
            parameter_deviation=deviations,
        )

    def joint_state_of(self, estimate: AnyMessage) -> AnyMessage:
        """Returns the state in an ``ObserverState`` as ``sensor_msgs/JointState``."""
        return self.classes(interfaces.JOINT_STATE)(
            header=estimate.header,
            name=estimate.name,
            position=estimate.position,
            velocity=estimate.velocity,
            effort=self._floats(np.empty(0)),
        )

    def joints(self, stamp: int, names: Sequence[str], **columns: ArrayLike) -> AnyMessage:
        """Numbers of joints as ``sensor_msgs/JointState``: position, velocity, effort, or some."""
        return self._message(interfaces.JOINT_STATE, header=stamp, name=names, **columns)

    def bound(self, estimate: Estimate) -> AnyMessage:
        """The certified bound of ``estimate``'s V, as an error without coordinates."""
        nothing = np.empty(0)
        return self.of(
            EstimateError(estimate.stamp, estimate.law, estimate.bound, (), nothing, nothing)
        )

    def misfit(self, estimate: Estimate, node: str) -> AnyMessage:
        """The misfit of an estimate, or that there is none, as the ``node`` diagnoses it."""
        status = self.classes(interfaces.DIAGNOSTIC)(
            level=1 if estimate.misfit else 0,
            name=f"{node}: impacts",
            message=estimate.misfit or EXPLAINED,
            hardware_id="",
            values=[],
        )
        return self._message(interfaces.DIAGNOSTICS, header=estimate.stamp, status=[status])

    def _header(self, field: str, stamp: int) -> AnyMessage:
        """A header with a stamp, which must not be 0."""
        _check_stamp(field, stamp)
        return self.classes(interfaces.HEADER)(stamp=self.time(stamp), frame_id="")

    def _message(self, type_name: str, **values: Any) -> AnyMessage:  # noqa: ANN401 (by the type)
        """A message of ``values`` by field: stamps in ns, arrays; arrays left out are empty."""
        made = dict[str, object]()
        for name, (field, of_type) in _fields(type_name).items():
            value = values.get(name, ())
            if of_type == interfaces.HEADER:
                value = self._header(f"{field}.stamp", value)
            elif of_type == interfaces.TIME:
                value = self.time(value, field)
            elif of_type == "float64[]":
                count = _count(name, len(value), values) if name in values else 0
                value = self._floats(_numbers(field, value, count).reshape(-1))
            elif of_type.endswith("[]"):
                value = [self.of(each) if type(each) in _TYPES else each for each in value]
            elif of_type.startswith("uint"):
                value = _counter(field, value, of_type)
            elif of_type == "float64":
                value = _number(field, value)
            made[name] = bool(value) if of_type == "bool" else value
        return self.classes(type_name)(**made)


@cache
def bag_messages() -> Messages:
    """Makes messages of the classes of ``rosbags``, to be written to a bag."""
    return Messages(typestore().types.__getitem__, np.array)


def read(kind: type[_Value], message: AnyMessage) -> _Value:
    """The value of a ``kind`` in its message, or in a message with the same fields.

    Raises:
        MessageError: its stamp is not after 0, a number is not finite or unknown, or there is not
            one number for each name.
    """
    return kind(**_values(kind, message))


def read_event(message: AnyMessage) -> ImpactEvent:
    """The event in a message.

    Raises:
        MessageError: its stamp is not after 0, the kind of a switch is unknown, or it exceeds a
            limit.
    """
    longest = max((len(each.contact.encode()) for each in message.switches), default=0)
    for number, most, what in (
        (len(message.switches), _MOST_SWITCHES, "switches"),
        (longest, _LONGEST_NAME, "bytes in the name of a contact"),
        (len(message.header.frame_id.encode()), _LONGEST_FRAME, "bytes in the name of its frame"),
    ):
        if number > most:
            raise MessageError(f"{number} {what}; expected at most {most}")
    return read(ImpactEvent, message)


def read_verdict(message: AnyMessage) -> tuple[Verdict, float]:
    """The verdict in a message, and the latency, s.

    Raises:
        MessageError: its stamp is not after 0, the ruling is unknown, or a number is not finite.
    """
    verdict = read(Verdict, message)
    revises = verdict.reason.startswith(REVISED)
    return verdict._replace(revises=revises), float(message.latency)


def read_estimate(message: AnyMessage) -> tuple[tuple[str, ...], Estimate]:
    """The coordinates' names and the estimate in a message.

    Raises:
        MessageError: its stamp is not after 0, a number is not finite, or lengths do not fit.
    """
    values, names = _values(Estimate, message), tuple(message.parameter_name)
    learned = (
        _numbers(f"ObserverState.{each}", getattr(message, each), len(names)).tolist()
        for each in ("parameter", "parameter_deviation")
    )
    side = 2 * len(message.name) if values["covariance"].size else 0
    values["covariance"] = values["covariance"].reshape(side, side)
    parameters = tuple(zip(names, *learned, strict=True))
    return tuple(message.name), Estimate(**values, parameters=parameters)


def read_efforts(message: AnyMessage) -> list[LiveSample]:
    """The samples of forces in a ``sensor_msgs/JointState``.

    Raises:
        MessageError: its stamp is not after 0, or there is not one effort for each name.
    """
    stamp = read_stamp("JointState.header.stamp", message.header.stamp)
    if len(message.effort) != len(message.name):
        found = f"{len(message.effort)} numbers for {len(message.name)} names"
        raise MessageError(f"JointState.effort: {found}; expected one each")
    forces = zip(message.name, message.effort, strict=True)
    return [LiveSample(str(name), stamp, float(value)) for name, value in forces]


def read_pulse(message: AnyMessage) -> int:
    """The stamp of an index pulse, a ``std_msgs/Header``, ns; MessageError where it is 0."""
    return read_stamp("Header.stamp", message.stamp)


def read_stamp(field: str, time: AnyMessage, earliest: int = 1) -> int:
    """The stamp in the ``field`` of a message, ns; ``earliest`` is 0 where it may be unknown.

    Raises:
        MessageError: the stamp is before ``earliest``, or its nanoseconds are 1e9 or more.
    """
    if not 0 <= time.nanosec < NS_PER_S:
        raise MessageError(f"{field}.nanosec is {time.nanosec}; expected less than {NS_PER_S}")
    stamp = int(time.sec) * NS_PER_S + int(time.nanosec)
    _check_stamp(field, stamp, earliest=earliest)
    return stamp


def _values(kind: type, message: AnyMessage) -> dict[str, Any]:
    """The fields of a value that are in its message."""
    known, values = _fields(_TYPES[kind]), dict[str, Any]()
    for key, name in _mirrored(kind).items():
        (field, of_type), value = known[name], getattr(message, name)
        if of_type == interfaces.HEADER:
            value = read_stamp(f"{field}.stamp", value.stamp)
        elif of_type == interfaces.TIME:
            value = read_stamp(field, value, earliest=0)
        elif of_type == "float64[]":
            count = _count(name, len(value), {"name": message.name})
            value = frozen(_numbers(field, value, count))
        elif of_type == interfaces.CONTACT_SWITCH + "[]":
            value = tuple(read(Switch, each) for each in value)
        elif of_type == "float64":
            value = _number(field, value)
        elif name in _KINDS:
            value = _member(_KINDS[name], field, value)
        values[key] = tuple(value) if of_type == "string[]" else value
    return values


@cache
def _mirrored(kind: type) -> dict[str, str]:
    """Names of the fields of a value that are in its message, and their names there."""
    own: Sequence[str] = getattr(kind, "_fields", ()) or [each.name for each in fields(kind)]
    named = {name: _FIELDS.get(name, name) for name in own}
    return {name: field for name, field in named.items() if field in _fields(_TYPES[kind])}


@cache
def _fields(type_name: str) -> dict[str, tuple[str, str]]:
    """Names of the fields of a message type, their names in errors, and types (``float64[]``)."""
    kind, (_, descriptions) = type_name.rpartition("/")[2], typestore().fielddefs[type_name]
    return {name: (f"{kind}.{name}", _name_of_type(each)) for name, each in descriptions}


def _name_of_type(description: Any) -> str:  # noqa: ANN401 (as rosbags describes it)
    node, detail = description
    if node is Nodetype.NAME:
        return str(detail)
    return str(detail[0]) if node is Nodetype.BASE else f"{_name_of_type(detail[0])}[]"


def _count(field: str, given: int, values: Mapping[str, Any]) -> int:
    """How many numbers an array must have that has ``given`` rows or numbers."""
    if field.startswith("parameter"):
        return len(values["parameter_name"])
    n = len(values["name"])
    if field == "covariance":  # of a law that has one
        return 4 * n * n if given else 0
    return n


def _check_stamp(field: str, stamp: int, earliest: int = 1) -> None:
    """Check that ``builtin_interfaces/Time`` can carry ``stamp`` (ns)."""
    if not earliest <= stamp <= MAX_STAMP:
        wanted = "more than 0" if earliest else "0 (unknown) or more"
        raise MessageError(
            f"{field} is {text(stamp)} s; expected {wanted}, at most {text(MAX_STAMP)} s"
        )


def _counter(field: str, value: int, of_type: str) -> int:
    """``value``, checked to fit an unsigned field."""
    highest = _LARGEST.get(of_type, 255)
    if not 0 <= value <= highest:
        raise MessageError(f"{field} is {value}; expected 0 to {highest}")
    return int(value)


def _number(field: str, value: float) -> float:
    """``value``, checked to be finite."""
    if not math.isfinite(value):
        raise MessageError(f"{field} is {value}; expected a finite number")
    return float(value)


def _numbers(field: str, values: ArrayLike, count: int) -> Vector:
    """``values``, checked to be ``count`` finite numbers."""
    array = np.asarray(values, dtype=np.float64)
    if array.size != count:
        raise MessageError(f"{field} has {array.size} numbers; expected {count}, as named")
    if array.size and not np.isfinite(array).all():
        i = int(np.flatnonzero(~np.isfinite(array))[0])
        raise MessageError(f"{field}[{i}] is {array.flat[i]}; expected finite numbers")
    return array


def _member(kinds: type[IntEnum], field: str, value: int) -> IntEnum:
    """The member of an enumeration with a value, checked to exist."""
    try:
        return kinds(value)
    except ValueError:
        known = ", ".join(f"{kind.value} ({kind.name})" for kind in kinds)
        raise MessageError(f"{field} is {value}; expected {known}") from None
