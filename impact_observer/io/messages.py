# SPDX-License-Identifier: Apache-2.0
"""Conversions between our values and messages, with exact stamps and finite numbers.

``rosbags`` and ``rclpy`` have message classes of their own, with the same attribute names and
keyword arguments. :class:`Messages` takes either, so that the messages of a node and of a bag are
equal byte for byte. Reading needs the attributes only.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

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

_MAX_UINT32 = 2**32 - 1
_MAX_UINT64 = 2**64 - 1
AnyMessage: TypeAlias = Any
"""A message, or a message class, of ``rosbags`` or of ``rclpy``: they have no common base."""
_Kinds = TypeVar("_Kinds", bound=IntEnum)
_Mirrored = TypeVar("_Mirrored", Verdict, SmoothedImpact, ImpactEstimate, MeasurementVerdict)
"""Values with the fields of their messages."""


class MessageError(ImpactObserverError, ValueError):
    """A value that no message may carry, or a message without a valid value."""


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """A state at a stamp; mirrors ``sensor_msgs/JointState``.

    Attributes:
        stamp: when the state holds, ns.
        names: the coordinates' names, n of them.
        q: coordinates, shape (n,), m or rad.
        u: velocities, shape (n,), m/s or rad/s.
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
    """The error of an estimate; mirrors ``impact_observer_msgs/EstimateError``.

    Attributes:
        stamp: when both states hold, ns.
        law: name of the observer's law.
        v: Lyapunov distance V, J.
        names: of the n coordinates.
        q: estimate minus truth, shape (n,), m or rad.
        u: estimate minus truth, shape (n,), m/s or rad/s.
    """

    stamp: int
    law: str
    v: float
    names: tuple[str, ...]
    q: Vector
    u: Vector


class Messages:
    """Makes messages of our values, from given message classes.

    Every method raises :class:`MessageError`, one line with the field's name, for a stamp that a
    message cannot carry (it must be after 0 and before 2038), for a number that is not finite,
    for a counter out of range, and for arrays whose length does not fit the names.
    """

    def __init__(
        self,
        classes: Callable[[str], AnyMessage],
        floats: Callable[[Vector], object],
    ) -> None:
        """Use these message classes.

        Args:
            classes: finds a message class by its type name, such as ``std_msgs/msg/String``.
            floats: converts an array of shape (k,) to the value of a ``float64[]`` field.
        """
        self._classes = classes
        self._floats = floats

    def time(self, stamp: int) -> AnyMessage:
        """``stamp`` (ns, or 0 for "unknown") as ``builtin_interfaces/Time``."""
        _check_stamp("Time", stamp, earliest=0)
        seconds, nanoseconds = divmod(int(stamp), NS_PER_S)
        return self._classes(interfaces.TIME)(sec=seconds, nanosec=nanoseconds)

    def clock(self, stamp: int) -> AnyMessage:
        """``stamp`` (ns) as ``rosgraph_msgs/Clock``."""
        return self._classes(interfaces.CLOCK)(clock=self.time(stamp))

    def model(self, model: str) -> AnyMessage:
        """A model file's text as ``std_msgs/String``."""
        return self._classes(interfaces.STRING)(data=model)

    def event(self, event: ImpactEvent) -> AnyMessage:
        """``event`` as ``impact_observer_msgs/ImpactEvent``."""
        _check_counter("ImpactEvent.sequence", event.sequence, _MAX_UINT64)
        _check_counter("ImpactEvent.episode", event.episode, _MAX_UINT32)
        _check_stamp("ImpactEvent.epoch", event.epoch, earliest=0)
        new_switch = self._classes(interfaces.CONTACT_SWITCH)
        return self._classes(interfaces.IMPACT_EVENT)(
            header=self._header("ImpactEvent", event.stamp),
            sequence=event.sequence,
            episode=event.episode,
            epoch=self.time(event.epoch),
            switches=[new_switch(contact=s.contact, kind=int(s.kind)) for s in event.switches],
        )

    def verdict(self, verdict: Verdict, latency: float = 0.0) -> AnyMessage:
        """A verdict as ``impact_observer_msgs/EventVerdict``.

        ``latency`` is the time from stamp to application, s.
        """
        latency = _number("EventVerdict.latency", latency)
        return self._mirror(interfaces.EVENT_VERDICT, verdict, "revises", latency=latency)

    def smoothed_impact(self, impact: SmoothedImpact) -> AnyMessage:
        """``impact`` as ``impact_observer_msgs/SmoothedImpact``."""
        reported = self.time(impact.reported)
        return self._mirror(interfaces.SMOOTHED_IMPACT, impact, "reported", reported=reported)

    def impact_estimate(self, impact: ImpactEstimate) -> AnyMessage:
        """``impact`` as ``impact_observer_msgs/ImpactEstimate``."""
        return self._mirror(interfaces.IMPACT_ESTIMATE, impact)

    def measurement_verdict(self, verdict: MeasurementVerdict) -> AnyMessage:
        """``verdict`` as ``impact_observer_msgs/MeasurementVerdict``."""
        return self._mirror(interfaces.MEASUREMENT_VERDICT, verdict)

    def _mirror(
        self, type_name: str, value: _Mirrored, without: str = "", **others: object
    ) -> AnyMessage:
        """A ``value`` as the message with the same fields.

        Args:
            type_name: of the message.
            value: its field ``stamp`` is the header's, its ``ruling`` is called ``verdict``.
            without: a field that the message does not have, or not so.
            others: fields of the message that the value does not have, or not so.
        """
        name, own = type_name.rpartition("/")[2], value._asdict()
        own.pop(without, None)
        header, ruling = self._header(name, own.pop("stamp")), own.pop("ruling", None)
        fields = {key: _checked(f"{name}.{key}", each) for key, each in own.items()}
        if ruling is not None:
            fields["verdict"] = int(ruling)
        return self._classes(type_name)(header=header, **fields, **others)

    def estimate(self, estimate: Estimate, names: Sequence[str]) -> AnyMessage:
        """``estimate`` as ``impact_observer_msgs/ObserverState``; ``names`` of coordinates."""
        n = len(names)
        _check_counter("ObserverState.last_sequence", estimate.last_sequence, _MAX_UINT64)
        _check_stamp("ObserverState.last_event", estimate.last_event, earliest=0)
        entries = 4 * n * n if estimate.covariance.size else 0
        parameters = [each for _, each, _ in estimate.parameters]
        deviations = [each for _, _, each in estimate.parameters]
        learned = len(parameters)
        return self._classes(interfaces.OBSERVER_STATE)(
            header=self._header("ObserverState", estimate.stamp),
            law=estimate.law,
            name=list(names),
            position=self._array("ObserverState.position", estimate.q, n),
            velocity=self._array("ObserverState.velocity", estimate.u, n),
            covariance=self._array("ObserverState.covariance", estimate.covariance, entries),
            closed=list(estimate.closed),
            convergence=_number("ObserverState.convergence", estimate.convergence),
            synchronized=bool(estimate.synchronized),
            clock_offset=_number("ObserverState.clock_offset", estimate.clock_offset),
            last_sequence=estimate.last_sequence,
            last_event=self.time(estimate.last_event),
            parameter_name=[name for name, _, _ in estimate.parameters],
            parameter=self._array("ObserverState.parameter", parameters, learned),
            parameter_deviation=self._array(
                "ObserverState.parameter_deviation", deviations, learned
            ),
        )

    def joint_state_of(self, estimate: AnyMessage) -> AnyMessage:
        """Returns the state in an ``ObserverState`` as ``sensor_msgs/JointState``."""
        return self._classes(interfaces.JOINT_STATE)(
            header=estimate.header,
            name=estimate.name,
            position=estimate.position,
            velocity=estimate.velocity,
            effort=self._floats(np.empty(0)),
        )

    def joint_state(self, state: JointState) -> AnyMessage:
        """``state`` as ``sensor_msgs/JointState``, without efforts."""
        return self._joints(state.stamp, state.names, position=state.q, velocity=state.u)

    def positions(self, stamp: int, names: Sequence[str], values: ArrayLike) -> AnyMessage:
        """Numbers by name as the positions of ``sensor_msgs/JointState``, without velocities."""
        return self._joints(stamp, names, position=values)

    def forces(self, stamp: int, forces: Mapping[str, float]) -> AnyMessage:
        """Forces of inputs by name, N, as ``sensor_msgs/JointState`` with efforts only."""
        return self._joints(stamp, [*forces], effort=[*forces.values()])

    def _joints(self, stamp: int, names: Sequence[str], **given: ArrayLike) -> AnyMessage:
        """A ``sensor_msgs/JointState`` with the ``given`` fields, of a number for each name."""
        header = self._header("JointState", stamp)
        fields = {
            key: self._array(f"JointState.{key}", given[key], len(names))
            if key in given
            else self._floats(np.empty(0))
            for key in ("position", "velocity", "effort")
        }
        return self._classes(interfaces.JOINT_STATE)(header=header, name=list(names), **fields)

    def estimate_error(self, error: EstimateError) -> AnyMessage:
        """``error`` as ``impact_observer_msgs/EstimateError``."""
        n = len(error.names)
        return self._classes(interfaces.ESTIMATE_ERROR)(
            header=self._header("EstimateError", error.stamp),
            law=error.law,
            v=_number("EstimateError.v", error.v),
            name=list(error.names),
            position_error=self._array("EstimateError.position_error", error.q, n),
            velocity_error=self._array("EstimateError.velocity_error", error.u, n),
        )

    def bound(self, estimate: Estimate) -> AnyMessage:
        """The certified bound of ``estimate``'s V, as an error without coordinates."""
        empty = frozen(np.empty(0))
        error = EstimateError(estimate.stamp, estimate.law, estimate.bound, (), empty, empty)
        return self.estimate_error(error)

    def misfit(self, estimate: Estimate, node: str) -> AnyMessage:
        """The misfit of an estimate, or that there is none, as the ``node`` diagnoses it."""
        status = self._classes(interfaces.DIAGNOSTIC)(
            level=1 if estimate.misfit else 0,
            name=f"{node}: impacts",
            message=estimate.misfit or EXPLAINED,
            hardware_id="",
            values=[],
        )
        header = self._header("DiagnosticArray", estimate.stamp)
        return self._classes(interfaces.DIAGNOSTICS)(header=header, status=[status])

    def pulse(self, stamp: int) -> AnyMessage:
        """An index pulse of a drive."""
        return self._header("Header", stamp)

    def _header(self, kind: str, stamp: int) -> AnyMessage:
        """A header with a stamp, which must not be 0."""
        _check_stamp(f"{kind}.header.stamp", stamp)
        return self._classes(interfaces.HEADER)(stamp=self.time(stamp), frame_id="")

    def _array(self, field: str, values: ArrayLike, count: int) -> object:
        """The value of a ``float64[]`` field of ``count`` finite numbers, row by row."""
        return self._floats(_numbers(field, values, count).reshape(-1))


@cache
def bag_messages() -> Messages:
    """Makes messages of the classes of ``rosbags``, to be written to a bag."""
    return Messages(typestore().types.__getitem__, np.array)


def read_stamp(field: str, time: AnyMessage, earliest: int = 1) -> int:
    """The stamp of a message, ns.

    Args:
        field: its name in the error.
        time: the message's field.
        earliest: the smallest stamp allowed, ns; 0 where a stamp may be unknown.

    Raises:
        MessageError: the stamp is before ``earliest``, or its nanoseconds are 1e9 or more.
    """
    if not 0 <= time.nanosec < NS_PER_S:
        raise MessageError(f"{field}.nanosec is {time.nanosec}; expected less than {NS_PER_S}")
    stamp = int(time.sec) * NS_PER_S + int(time.nanosec)
    _check_stamp(field, stamp, earliest=earliest)
    return stamp


_MOST_SWITCHES, _LONGEST_NAME, _LONGEST_FRAME = 100, 256, 4096
"""Most contacts of an event; longest name of a contact, and of the frame, bytes."""


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
    return ImpactEvent(
        stamp=read_stamp("ImpactEvent.header.stamp", message.header.stamp),
        switches=tuple(
            Switch(switch.contact, _member(Kind, f"ImpactEvent.switches[{i}].kind", switch.kind))
            for i, switch in enumerate(message.switches)
        ),
        sequence=int(message.sequence),
        episode=int(message.episode),
        epoch=read_stamp("ImpactEvent.epoch", message.epoch, earliest=0),
    )


def read_verdict(message: AnyMessage) -> tuple[Verdict, float]:
    """The verdict in a message, and the latency, s.

    Raises:
        MessageError: its stamp is not after 0, the ruling is unknown, or a number is not finite.
    """
    verdict = _read_mirrored(Verdict, interfaces.EVENT_VERDICT, message)
    revises = verdict.reason.startswith(REVISED)
    return verdict._replace(revises=revises), float(message.latency)


def read_impact_estimate(message: AnyMessage) -> ImpactEstimate:
    """The estimate of an impact in a message.

    Raises:
        MessageError: its stamp is not after 0, the ruling is unknown, or a number is not finite.
    """
    return _read_mirrored(ImpactEstimate, interfaces.IMPACT_ESTIMATE, message)


def _read_mirrored(kind: type[_Mirrored], type_name: str, message: AnyMessage) -> _Mirrored:
    """The value in a message that ``Messages`` has made of it."""
    name, fields = type_name.rpartition("/")[2], dict[str, Any]()
    for key in kind._fields:
        if key == "stamp":
            fields[key] = read_stamp(f"{name}.header.stamp", message.header.stamp)
        elif key == "ruling":
            fields[key] = _member(Ruling, f"{name}.verdict", message.verdict)
        elif hasattr(message, key):
            fields[key] = _checked(f"{name}.{key}", getattr(message, key))
    return kind(**fields)


def read_estimate(message: AnyMessage) -> tuple[tuple[str, ...], Estimate]:
    """The coordinates' names and the estimate in a message.

    Raises:
        MessageError: its stamp is not after 0, a state is not finite, or lengths do not fit.
    """
    n = len(message.name)
    side = 2 * n if len(message.covariance) else 0
    covariance = _numbers("ObserverState.covariance", message.covariance, side * side)
    estimate = Estimate(
        stamp=read_stamp("ObserverState.header.stamp", message.header.stamp),
        law=message.law,
        q=frozen(_numbers("ObserverState.position", message.position, n)),
        u=frozen(_numbers("ObserverState.velocity", message.velocity, n)),
        covariance=frozen(covariance.reshape(side, side)),
        closed=tuple(message.closed),
        convergence=float(message.convergence),
        synchronized=bool(message.synchronized),
        clock_offset=float(message.clock_offset),
        parameters=tuple(
            zip(
                message.parameter_name,
                map(float, message.parameter),
                map(float, message.parameter_deviation),
                strict=True,
            )
        ),
        last_sequence=int(message.last_sequence),
        last_event=read_stamp("ObserverState.last_event", message.last_event, earliest=0),
    )
    return tuple(message.name), estimate


def read_joint_state(message: AnyMessage) -> JointState:
    """The state in a message.

    Raises:
        MessageError: its stamp is not after 0, a number is not finite, or there is not one
            position and one velocity for each name.
    """
    n = len(message.name)
    return JointState(
        stamp=read_stamp("JointState.header.stamp", message.header.stamp),
        names=tuple(message.name),
        q=frozen(_numbers("JointState.position", message.position, n)),
        u=frozen(_numbers("JointState.velocity", message.velocity, n)),
    )


class LiveSample(NamedTuple):
    """A sample of a force.

    Attributes:
        name: of the input or joint.
        stamp: time of validity, ns.
        value: N, or N m of a joint that turns.
    """

    name: str
    stamp: int
    value: float


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
    """The stamp of a ``std_msgs/Header``, at which the phase of the drive is zero, ns.

    Raises:
        MessageError: it is not after 0.
    """
    return read_stamp("Header.stamp", message.stamp)


def _check_stamp(field: str, stamp: int, earliest: int = 1) -> None:
    """Check that ``builtin_interfaces/Time`` can carry ``stamp`` (ns)."""
    if not earliest <= stamp <= MAX_STAMP:
        wanted = "more than 0" if earliest else "0 (unknown) or more"
        raise MessageError(
            f"{field} is {text(stamp)} s; expected {wanted}, at most {text(MAX_STAMP)} s"
        )


def _check_counter(field: str, value: int, highest: int) -> None:
    """Check that ``value`` fits an unsigned field."""
    if not 0 <= value <= highest:
        raise MessageError(f"{field} is {value}; expected 0 to {highest}")


def _checked(field: str, value: object) -> object:
    """The value of a field: a text, a truth, a counter or a finite number."""
    if isinstance(value, float):
        return _number(field, value)
    if isinstance(value, int) and not isinstance(value, bool):
        _check_counter(field, value, _MAX_UINT64)
    return value


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


def _member(kinds: type[_Kinds], field: str, value: int) -> _Kinds:
    """The member of an enumeration with a value, checked to exist."""
    try:
        return kinds(value)
    except ValueError:
        known = ", ".join(f"{kind.value} ({kind.name})" for kind in kinds)
        raise MessageError(f"{field} is {value}; expected {known}") from None
