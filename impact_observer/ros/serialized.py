# SPDX-License-Identifier: Apache-2.0
"""Impact events and estimates as serialized messages, without message objects.

Message objects would take half of a node's time at 1 kHz. Two estimates with the same law, names
and closed contacts differ in numbers only: an example is serialized once, and numbers are written
into its bytes (OMG CDR, little endian). Everything unusual is converted through message objects.
"""

from collections.abc import Iterator
from functools import lru_cache
from math import isfinite, isqrt
from struct import Struct
from struct import error as StructError  # noqa: N812 (its own name is too general)
from typing import TypeAlias

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.io.interfaces import IMPACT_EVENT
from impact_observer.io.messages import JointState, MessageError, MessageLimits, read_event
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.stamps import MAX_STAMP, NS_PER_S
from impact_observer.states import Estimate, Vector

_CDR_HEADER = b"\x00\x01\x00\x00"
"""Of a little endian message; fields are aligned from behind it."""
_MAX_CACHED = 64
"""Shapes of estimates, and lists of switches, that are kept."""
_TIME = Struct("<iI")
_HEADER = Struct("<iII")
"""Of an event: stamp, length of the frame's name."""
_EVENT = Struct("<QIiII")
"""Sequence, episode, epoch, number of switches."""
_LENGTH = Struct("<I")
_KINDS = {int(kind): kind for kind in Kind}
_SCALARS = Struct("<d?7xdQiI")
"""Of an estimate: convergence, synchronized, clock offset, last sequence, last event."""
_CONVERGENCE = 1.2345678901234567e-287
"""A number whose bytes show its place in an example message."""

_Shape: TypeAlias = tuple[str, tuple[str, ...], int, tuple[str, ...]]
"""Law, closed contacts, size of the covariance, names of the parameters."""


def read_impact(data: bytes, limits: MessageLimits | None = None) -> ImpactEvent:
    """The event in a serialized ``impact_observer_msgs/ImpactEvent``; None for the usual limits.

    Raises:
        MessageError: the bytes are no such message, have invalid values, or exceed a limit.
    """
    limits = limits or MessageLimits()
    if len(data) > limits.size:
        raise MessageError(
            f"{len(data)} bytes; max_switches, max_name and max_frame allow {limits.size};"
            " left out"
        )
    event = None
    try:
        event = _read_usual_impact(data, limits)
    except (StructError, IndexError):  # the deserializer writes a line of its own on it
        if data.startswith(_CDR_HEADER[:2]):
            raise MessageError(f"{len(data)} bytes that are no {IMPACT_EVENT}; left out") from None
    except (LookupError, ValueError):
        pass
    if event is not None:
        return event
    try:
        message = deserialize_message(data, message_class(IMPACT_EVENT))
    except RuntimeError:  # rclpy's own class has no public name
        raise MessageError(f"{len(data)} bytes that are no {IMPACT_EVENT}; left out") from None
    return read_event(message, limits)


def _read_usual_impact(data: bytes, limits: MessageLimits) -> ImpactEvent | None:
    """The event in a valid message within the limits; None, or such an error, for any other.

    Raises:
        StructError, LookupError, ValueError: the message is invalid.
    """
    seconds, nanoseconds, length = _HEADER.unpack_from(data, len(_CDR_HEADER))
    at = len(_CDR_HEADER) + _HEADER.size + length
    at += (len(_CDR_HEADER) - at) % 8
    sequence, episode, epoch_s, epoch_ns, count = _EVENT.unpack_from(data, at)
    if count > len(data):
        raise IndexError
    if count > limits.max_switches or length > limits.max_frame:
        return None
    switches = _read_switches(data[at + _EVENT.size :], count, limits.max_name)
    stamp, epoch = seconds * NS_PER_S + nanoseconds, epoch_s * NS_PER_S + epoch_ns
    if not data.startswith(_CDR_HEADER[:2]) or max(nanoseconds, epoch_ns) >= NS_PER_S:
        return None
    if not (0 < stamp <= MAX_STAMP and 0 <= epoch <= MAX_STAMP):
        return None
    return ImpactEvent(stamp, switches, sequence, episode, epoch)


@lru_cache(_MAX_CACHED)
def _read_switches(data: bytes, count: int, max_name: int) -> tuple[Switch, ...]:
    """The ``count`` switches at the end of an event; cached, as few differ.

    Raises:
        StructError, LookupError, ValueError: the bytes are invalid.
    """
    switches, at = [], 0
    for _ in range(count):
        at += -at % 4
        (length,) = _LENGTH.unpack_from(data, at)
        end = at + _LENGTH.size + length
        if not 0 < length <= max_name + 1:  # a zero ends it
            raise ValueError
        switches.append(Switch(data[at + _LENGTH.size : end - 1].decode(), _KINDS[data[end]]))
        at = end + 1
    return tuple(switches)


class _Template:
    """A message of one shape, into which numbers are written."""

    def __init__(self, data: bytes, example: Estimate) -> None:
        """Find the numbers of the ``example`` in its serialized message."""
        self._data = bytearray(data)
        names = example.parameters
        values, deviations = (np.array([each[i] for each in names]) for i in (1, 2))
        self._q, self._u = self._place(example.q), self._place(example.u)
        self._covariance = self._place(example.covariance.ravel())
        self._values, self._deviations = self._place(values), self._place(deviations)
        self._scalars = data.find(np.float64(_CONVERGENCE).tobytes())

    def _place(self, numbers: Vector) -> Vector | None:
        """A writable view of these numbers in the message; None where it has none."""
        begin = self._data.find(numbers.tobytes()) if numbers.size else -1
        return None if begin < 0 else np.frombuffer(self._data, "<f8", numbers.size, begin)

    def filled(self, estimate: Estimate) -> bytes:
        """The message with the numbers of an estimate of this shape."""
        _TIME.pack_into(self._data, len(_CDR_HEADER), *divmod(estimate.stamp, NS_PER_S))
        for place, numbers in ((self._q, estimate.q), (self._u, estimate.u)):
            if place is not None:
                place[:] = numbers
        if self._covariance is not None:
            self._covariance[:] = estimate.covariance.ravel()
        if self._values is not None and self._deviations is not None:
            self._values[:] = [value for _, value, _ in estimate.parameters]
            self._deviations[:] = [deviation for *_, deviation in estimate.parameters]
        if self._scalars >= 0:
            _SCALARS.pack_into(
                self._data,
                self._scalars,
                estimate.convergence,
                estimate.synchronized,
                estimate.clock_offset,
                estimate.last_sequence,
                *divmod(estimate.last_event, NS_PER_S),
            )
        return bytes(self._data)


class EstimateSerializer:
    """Serializes the estimates of one system."""

    def __init__(self, names: tuple[str, ...]) -> None:
        """Take the ``names`` of the n coordinates."""
        self._names = names
        self._templates = lru_cache(_MAX_CACHED)(self._make_templates)

    def messages(self, estimate: Estimate) -> Iterator[bytes]:
        """An estimate as ``impact_observer_msgs/ObserverState``, then ``sensor_msgs/JointState``.

        Each is made when it is requested, so that the first can be published before.

        Raises:
            MessageError: as :class:`~impact_observer.io.messages.Messages`.
        """
        if not _is_valid(estimate, len(self._names)):
            return iter(self._convert(estimate))
        parameters = tuple([name for name, _, _ in estimate.parameters])
        shape = estimate.law, estimate.closed, estimate.covariance.size, parameters
        return (template.filled(estimate) for template in self._templates(shape))

    def _make_templates(self, shape: _Shape) -> tuple[_Template, _Template]:
        """Both messages of a shape, with numbers that cannot be mistaken for each other."""
        law, closed, entries, names = shape
        n, m = len(self._names), len(names)
        numbers = np.random.default_rng(0).uniform(1e-300, 1e-299, 2 * n + entries + 2 * m)
        q, u, covariance, values, deviations = np.split(
            numbers, np.cumsum([n, n, entries, m]).tolist()
        )
        example = Estimate(
            1,
            law,
            q,
            u,
            covariance.reshape((isqrt(entries),) * 2),
            closed,
            _CONVERGENCE,
            parameters=tuple(zip(names, values.tolist(), deviations.tolist(), strict=True)),
        )
        state, joints = self._convert(example)
        return _Template(state, example), _Template(joints, example)

    def _convert(self, estimate: Estimate) -> tuple[bytes, bytes]:
        """Both messages by message objects."""
        make = ros_messages()
        joints = JointState(estimate.stamp, self._names, estimate.q, estimate.u)
        state = make.estimate(estimate, self._names)
        return serialize_message(state), serialize_message(make.joint_state(joints))


def _is_valid(estimate: Estimate, n: int) -> bool:
    """Whether a message can carry the estimate of ``n`` coordinates."""
    size = estimate.covariance.size
    parameters = [number for _, *two in estimate.parameters for number in two]
    scalars = [
        estimate.convergence,
        estimate.clock_offset,
        *estimate.q.tolist(),
        *estimate.u.tolist(),
    ]
    return (
        0 < estimate.stamp <= MAX_STAMP
        and 0 <= estimate.last_event <= MAX_STAMP
        and 0 <= estimate.last_sequence < 2**64
        and estimate.q.size == estimate.u.size == n
        and size in {0, 4 * n * n}
        and all(map(isfinite, (*scalars, *parameters)))
        and (not size or bool(np.isfinite(estimate.covariance).all()))
    )
