"""What an observer node hears and says, as bytes: without message objects.

At a kilohertz, to make message objects, to look at each field and to convert them takes longer
than the estimate itself. The bytes of two estimates of one shape (OMG CDR, little endian) differ
in numbers only, whose places are found once (``io/state_blocks.py``). Subscribers cannot tell the
difference. What is not as usual goes the usual way.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from math import isqrt
from struct import Struct
from struct import error as StructError  # noqa: N812 (its own name says nothing)
from typing import TypeAlias, cast

import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io.interfaces import IMPACT_EVENT, JOINT_STATE, OBSERVER_STATE
from impact_observer.io.messages import EventMessage, JointState, MessageError, read_event
from impact_observer.io.state_blocks import layout_of
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.stamps import MAX_STAMP, NS_PER_S
from impact_observer.states import Estimate, Vector

_START = b"\x00\x01\x00\x00"
"""The header of a serialized message, little endian; places are aligned from behind it."""
_MOST_FORMS = 64
"""Shapes that are kept: closed contacts come and go."""
_TIME = Struct("<iI")
_HEADER = Struct("<iII")
"""Of an event: its stamp and the length of its frame."""
_EVENT = Struct("<QIiII")
"""Number, episode, epoch, how many switches."""
_LENGTH = Struct("<I")
_KINDS = {int(kind): kind for kind in Kind}
_SURROUNDINGS = Struct("<d?7xdQiI")
"""Convergence, synchronized, offset of the clock, number and stamp of the last event."""


_Shape: TypeAlias = tuple[str, tuple[str, ...], int, tuple[str, ...]]
"""Law, closed contacts, numbers of the covariance, names of what is learnt."""


class _Form:
    """A message of one shape, whose numbers are put in anew."""

    def __init__(self, type_name: str, example: bytes) -> None:
        layout = layout_of(type_name, example)
        assert layout is not None, "a message of ROS has one"
        self._data, self._layout = bytearray(example), layout
        self._q = _numbers(self._data, layout.q, layout.n)
        self._u = _numbers(self._data, layout.u, layout.n)

    def packed(self, estimate: Estimate) -> bytes:
        """The message with the numbers of an estimate of this shape."""
        data, layout = self._data, self._layout
        _TIME.pack_into(data, layout.stamp, *divmod(estimate.stamp, NS_PER_S))
        self._q[:], self._u[:] = estimate.q, estimate.u
        if layout.covariance is not None and layout.convergence is not None:
            if estimate.covariance.size:
                entries = estimate.covariance.ravel()
                _numbers(data, layout.covariance, entries.size)[:] = entries
            _SURROUNDINGS.pack_into(
                data,
                layout.convergence,
                estimate.convergence,
                estimate.synchronized,
                estimate.clock_offset,
                estimate.last_sequence,
                *divmod(estimate.last_event, NS_PER_S),
            )
        if estimate.parameters and layout.learnt is not None and layout.deviations is not None:
            _, values, deviations = zip(*estimate.parameters, strict=True)
            _numbers(data, layout.learnt, len(values))[:] = values
            _numbers(data, layout.deviations, len(deviations))[:] = deviations
        return bytes(data)


def read_impact(data: bytes) -> ImpactEvent:
    """The event in a serialized ``impact_observer_msgs/ImpactEvent``.

    Raises:
        MessageError: as :func:`~impact_observer.io.messages.read_event`, or no such message.
    """
    try:
        event = _read_impact(data)
    except (StructError, LookupError, ValueError):
        event = None
    if event is not None:
        return event
    try:
        message = deserialize_message(data, message_class(IMPACT_EVENT))
    except rclpy_implementation.RMWError:
        raise MessageError(f"{len(data)} bytes that are no {IMPACT_EVENT}; left out") from None
    return read_event(cast("EventMessage", message))


def _read_impact(data: bytes) -> ImpactEvent | None:
    """The same; None where it is not as usual.

    Raises:
        StructError, LookupError, ValueError: likewise.
    """
    seconds, nanoseconds, length = _HEADER.unpack_from(data, len(_START))
    at = len(_START) + _HEADER.size + length
    at += (len(_START) - at) % 8
    sequence, episode, since, and_nanoseconds, count = _EVENT.unpack_from(data, at)
    switches = _read_switches(data[at + _EVENT.size :], count)
    stamp, epoch = seconds * NS_PER_S + nanoseconds, since * NS_PER_S + and_nanoseconds
    known = data.startswith(_START[:2]) and max(nanoseconds, and_nanoseconds) < NS_PER_S
    if not (known and 0 < stamp <= MAX_STAMP and 0 <= epoch <= MAX_STAMP):
        return None
    return ImpactEvent(stamp, switches, sequence, episode, epoch)


@lru_cache(_MOST_FORMS)
def _read_switches(data: bytes, count: int) -> tuple[Switch, ...]:
    """The ``count`` switches of an event: few contacts switch in few ways.

    Raises:
        StructError, LookupError, ValueError: they are not as usual.
    """
    switches, at = [], 0
    for _ in range(count):
        at += -at % 4
        (length,) = _LENGTH.unpack_from(data, at)
        end = at + _LENGTH.size + length
        switches.append(Switch(data[at + _LENGTH.size : end - 1].decode(), _KINDS[data[end]]))
        at = end + 1
    return tuple(switches)


class Serialized:
    """Makes the messages of estimates of one system."""

    def __init__(self, names: tuple[str, ...]) -> None:
        """Begin.

        Args:
            names: of the coordinates, n of them.
        """
        self._names = names
        self._forms = lru_cache(_MOST_FORMS)(self._forms_of)

    def of(self, estimate: Estimate) -> Iterator[bytes]:
        """An estimate as ``impact_observer_msgs/ObserverState``, then ``sensor_msgs/JointState``.

        Each is made when it is asked for: who waits for the first does not wait for the second.

        Raises:
            MessageError: as :class:`~impact_observer.io.messages.Messages`.
        """
        if not _is_plain(estimate, len(self._names)):
            return iter(self._converted(estimate))
        learnt = tuple([name for name, _, _ in estimate.parameters])
        shape = estimate.law, estimate.closed, estimate.covariance.size, learnt
        return (form.packed(estimate) for form in self._forms(shape))

    def _forms_of(self, shape: _Shape) -> tuple[_Form, _Form]:
        """The messages of a shape, converted once."""
        law, closed, entries, learnt = shape
        zeros, told = np.zeros(len(self._names)), tuple((name, 0.0, 0.0) for name in learnt)
        covariance = np.zeros((isqrt(entries),) * 2)
        example = Estimate(1, law, zeros, zeros, covariance, closed, parameters=told)
        state, joints = self._converted(example)
        return _Form(OBSERVER_STATE, state), _Form(JOINT_STATE, joints)

    def _converted(self, estimate: Estimate) -> tuple[bytes, bytes]:
        """The same by message objects."""
        known = JointState(estimate.stamp, self._names, estimate.q, estimate.u)
        make = ros_messages()
        state, joints = make.estimate(estimate, self._names), make.joint_state(known)
        return serialize_message(state), serialize_message(joints)


def _is_plain(estimate: Estimate, n: int) -> bool:
    """Whether there is nothing in it that would be refused."""
    covariance = estimate.covariance
    scalars = [estimate.convergence, estimate.clock_offset]
    scalars += estimate.q.tolist() + estimate.u.tolist()
    scalars += [number for _, *two in estimate.parameters for number in two]
    return (
        0 < estimate.stamp <= MAX_STAMP
        and 0 <= estimate.last_event <= MAX_STAMP
        and 0 <= estimate.last_sequence < 2**64
        and estimate.q.size == estimate.u.size == n
        and all(map(math.isfinite, scalars))
        and covariance.size in {0, 4 * n * n}
        and (not covariance.size or bool(np.isfinite(covariance).all()))
    )


def _numbers(data: bytearray, begin: int, count: int) -> Vector:
    """The numbers that stand in ``data`` from ``begin`` on, to be written to."""
    return np.frombuffer(data, "<f8", count, begin)
