# SPDX-License-Identifier: Apache-2.0
"""Simulated messages of the sensors beside the impacts."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.dynamics import mechanism_of
from impact_observer.events import Contacts
from impact_observer.io.interfaces import JOINT_STATE, absolute
from impact_observer.io.measured_samples import number_in
from impact_observer.io.messages import AnyMessage, Messages, bag_messages
from impact_observer.io.typestores import blank
from impact_observer.message_fields import FieldPath
from impact_observer.model.measurement import Measurement
from impact_observer.model.multibody import Multibody
from impact_observer.observer.samples import SensorSample
from impact_observer.plant import Run
from impact_observer.sensor_faults import MEASUREMENT_RATE
from impact_observer.stamps import NS_PER_S, from_seconds
from impact_observer.states import Stamps, Vector

_TYPES = {
    "data": "std_msgs/msg/Float64",
    "range": "sensor_msgs/msg/Range",
    "vector": "geometry_msgs/msg/Vector3Stamped",
    "point": "geometry_msgs/msg/PointStamped",
    "linear_acceleration": "sensor_msgs/msg/Imu",
    "angular_velocity": "sensor_msgs/msg/Imu",
    "wrench": "geometry_msgs/msg/WrenchStamped",
    "twist": "geometry_msgs/msg/TwistStamped",
    "pose": "geometry_msgs/msg/PoseStamped",
}
"""The message type that has a field, by the first part of its path."""
_HALF_STEP = 1000
"""Half the distance of the instants by which speeds of the frame are differentiated, ns."""
_STREAM = 1923
"""Stream of random numbers, other than that of the sensor of impacts."""


class SimulatedMessage(NamedTuple):
    """A message of a sensor on an absolute topic, received at ``arrival``, ns."""

    arrival: int
    topic: str
    message: AnyMessage


def type_of(measurement: Measurement) -> str:
    """The type of the messages that a simulated sensor publishes.

    Raises:
        UsageError: by file and key: no type that is known has such a field, or a header.
    """
    if measurement.joint:
        return JOINT_STATE
    type_name = _TYPES.get(str(measurement.path()[0]))
    if type_name is None:
        wanted = f"expected one that begins with {', '.join(_TYPES)}"
        raise measurement.wrong("field", f"{measurement.field} cannot be simulated; {wanted}")
    if type_name == _TYPES["data"] and measurement.stamp == "header":
        raise measurement.wrong(
            "stamp", f"header found, but {type_name} has none; expected receive"
        )
    number_in(blank(type_name), measurement)
    return type_name


class SampleSimulation:
    """The sensors of a plant; their random numbers follow from the seed and the instants.

    ``types`` are those of the messages by absolute topic.
    """

    def __init__(
        self,
        measurements: Sequence[Measurement],
        system: Multibody,
        rate: float,
        seed: int,
        make: Messages | None = None,
    ) -> None:
        """Sensors of ``system`` at a ``rate`` (Hz); ``make`` makes messages, None those of a bag.

        Raises:
            UsageError: by file and key, where the system lacks a name, or a sensor cannot be
                simulated; or the rate is out of its range.
        """
        MEASUREMENT_RATE.check(rate)
        for each in measurements:
            each.check(system)
        self._declared, self._system, self._rate = tuple(measurements), system, rate
        self._mechanism = mechanism_of(system)
        self._make = make or bag_messages()
        self._new = blank if make is None else lambda kind: self._make.classes(kind)()
        self._random = np.random.default_rng([seed, _STREAM])
        self.types: dict[str, str] = {}
        for each in measurements:
            topic, kind = absolute(each.topic), type_of(each)
            if self.types.setdefault(topic, kind) != kind:
                both = f"{self.types[topic]} and {kind}"
                raise each.wrong("topic", f"{topic} would have the types {both}; expected one")

    def stamps(self, epoch: int, last: int) -> Stamps:
        """Stamps of the samples from the epoch to ``last``, ns."""
        count = int((last - epoch) / NS_PER_S * self._rate) + 1
        return np.array([self.stamp(epoch, k) for k in range(count)], dtype=np.int64)

    def stamp(self, epoch: int, k: int) -> int:
        """Stamp of the ``k``-th samples, ns; samples at the epoch have the number 0."""
        return epoch + round(k / self._rate * NS_PER_S)

    def messages_at(
        self, stamp: int, epoch: int, x: Vector, closed: Contacts
    ) -> Iterator[SimulatedMessage]:
        """Messages of all sensors for the state (q, u), shape (2n,), at ``stamp`` (ns).

        Joints with efforts share the messages of a topic, which have the efforts, too.
        """
        efforts = self._efforts(stamp - epoch)
        together = dict[object, list[tuple[Measurement, float, int]]]()
        for k, (sample, arrival) in enumerate(self.sampled(stamp, epoch, x, closed)):
            declared = self._declared[sample.sensor]
            is_shared = bool(efforts and declared.joint)
            key = (absolute(declared.topic), declared.quantity, declared.delay) if is_shared else k
            together.setdefault(key, []).append((declared, sample.value, arrival))
        for group in together.values():
            declared, value, arrival = group[0]
            topic, time = absolute(declared.topic), stamp + from_seconds(declared.delay)
            if declared.joint:
                names = [each.joint for each, _, _ in group]
                columns: dict[str, list[float]] = {declared.quantity: [v for _, v, _ in group]}
                if efforts:
                    columns["effort"] = [efforts[name] for name in names]
                message = self._make.joints(time, names, **columns)
            else:
                message = self._new(self.types[topic])
                if hasattr(message, "header"):
                    message.header.stamp = self._make.time(time)
                _put(message, declared.path(), value)
            yield SimulatedMessage(arrival, topic, message)

    def sampled(
        self, stamp: int, epoch: int, x: Vector, closed: Contacts
    ) -> Iterator[tuple[SensorSample, int]]:
        """Samples of all sensors for a state, each with its time of reception, ns."""
        values = self._true_values(stamp - epoch, x, closed)
        for index, (declared, true) in enumerate(zip(self._declared, values, strict=True)):
            noise = float(self._random.normal())
            self._random.random(2)  # so that a seed gives the samples of 0.3.0
            value = true + declared.deviation * noise
            yield SensorSample(index, stamp, value), stamp + from_seconds(declared.delay)

    def _true_values(self, instant: int, x: Vector, closed: Contacts) -> Iterator[float]:
        """What the sensors measure without noise in a state, ``instant`` ns since the epoch."""
        n, system = self._system.n, self._system
        framed = system.to_frame(np.array([instant]), x[None])
        for each in self._declared:
            value = each.offset
            if each.gap:
                contact = system.contact_names.index(each.gap)
                value += float(self._mechanism.gaps(framed).g[0, contact])
            motions = [(each.position, x[:n]), (each.velocity, x[n:])]
            if each.acceleration:
                rates = self._mechanism.rates([instant / NS_PER_S], framed, closed)[0, n:]
                motions.append((each.acceleration, rates + self._pull(instant)))
            for coefficients, motion in motions:
                by_name = dict(zip(system.coordinates, motion, strict=True))
                value += sum(factor * by_name[name] for name, factor in coefficients.items())
            yield float(value)

    def _efforts(self, instant: int) -> dict[str, float]:
        """Torques and forces of the drives of joints with encoders, N m or N, by joint."""
        if not self._system.has_encoders:
            return {}
        tau = self._system.forcing(instant / NS_PER_S).tolist()
        return dict(zip(self._system.coordinates, tau, strict=True))

    def _pull(self, instant: int) -> Vector:
        """Acceleration of the frame in which no stop moves, shape (n,)."""
        around = np.array([instant - _HALF_STEP, instant + _HALF_STEP])
        before, after = self._system.from_frame(around, np.zeros((2, 2 * self._system.n)))
        pull: Vector = (after - before)[self._system.n :] / (2e-9 * _HALF_STEP)
        return pull


def samples_of_run(simulation: SampleSimulation, run: Run) -> list[SensorSample]:
    """Samples of all sensors on a run whose stamps are stamps of samples."""
    return [sample for at in _states(run) for sample, _ in simulation.sampled(*at)]


def simulated_samples(simulation: SampleSimulation, run: Run) -> list[SimulatedMessage]:
    """The messages of all sensors on a run of a plant, in order of arrival."""
    messages = (message for at in _states(run) for message in simulation.messages_at(*at))
    return sorted(messages, key=lambda each: each.arrival)


def _states(run: Run) -> Iterator[tuple[int, int, Vector, Contacts]]:
    """Arguments of ``SampleSimulation.sampled`` and ``messages_at`` at each stamp of a run."""
    closed, switchings = tuple[int, ...](), [*run.switchings][::-1]
    for stamp, x in zip(run.stamps.tolist(), run.states, strict=True):
        while switchings and switchings[-1].instant.stamp <= stamp:
            closed = switchings.pop().closed
        yield stamp, run.epoch, x, closed


def _put(message: AnyMessage, path: FieldPath, value: float) -> None:
    """Set the number at ``path``, all of whose parts are names."""
    *outer, last = map(str, path)
    for name in outer:
        message = getattr(message, name)
    setattr(message, last, value)
