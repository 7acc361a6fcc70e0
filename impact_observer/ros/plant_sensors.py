# SPDX-License-Identifier: Apache-2.0
"""What sensors beside the impacts measure on a plant that runs, and pulses of its drive."""

import heapq
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count

import numpy as np
from rclpy.node import Node

from impact_observer.errors import UsageError
from impact_observer.events import Contacts
from impact_observer.io.interfaces import PHASE_REFERENCE, SENSORS
from impact_observer.io.messages import AnyMessage
from impact_observer.io.recordings import index_pulses
from impact_observer.io.simulated_samples import SampleFaults, SampleSimulation, SimulatedMessage
from impact_observer.model import System
from impact_observer.model.live_signals import refused
from impact_observer.model.measurement import Measurement
from impact_observer.ros.message_classes import message_class, ros_messages
from impact_observer.ros.qos import qos_profile
from impact_observer.states import Vector


class PlantPulses:
    """Index pulses of a plant's own drive, which turns at its nominal speed."""

    def __init__(self, node: Node, system: System, *, wanted: bool) -> None:
        """A publisher of pulses, if they are ``wanted``.

        Raises:
            UsageError: nothing of the ``system`` turns with a drive, or something else is live.
        """
        self._system, self._publisher, self._next = system, None, -1
        if not wanted:
            return
        if system.live is None or not system.live.nominal:
            raise UsageError(
                f"parameter publish_pulses: nothing of {system.name} turns with a drive; expected"
                " a model whose forces have an order, or false"
            )
        refused(system, "a plant with publish_pulses")
        self._publisher = node.create_publisher(
            message_class(PHASE_REFERENCE.type),
            PHASE_REFERENCE.name,
            qos_profile(PHASE_REFERENCE.quality),
        )

    def start(self, epoch: int, last: int) -> None:
        """Begin at an ``epoch``, up to the stamp ``last``, ns."""
        self._pulses = index_pulses(self._system, epoch, last) if self._publisher else iter(())
        self._next = next(self._pulses, -1)

    @property
    def next_stamp(self) -> int | None:
        """When the next pulse is due, ns; None for none."""
        return None if self._next < 0 else self._next

    def publish(self, last: int) -> None:
        """Publish the pulses up to ``last``, ns."""
        while 0 <= self._next <= last:
            assert self._publisher is not None, "there are pulses"
            self._publisher.publish(ros_messages().pulse(self._next))
            self._next = next(self._pulses, -1)


class PlantSensors:
    """Sensors of a plant: their samples are those of ``simulate`` with the same seed."""

    def __init__(
        self,
        node: Node,
        measurements: Sequence[Measurement],
        system: System,
        faults: SampleFaults,
        seed: int,
    ) -> None:
        """Publishers of what ``measurements`` of a ``system`` declare, best effort.

        Raises:
            UsageError: by file and key, where one cannot be simulated.
        """
        self._made = partial(SampleSimulation, measurements, system, faults, seed, _new)
        self._simulation, self._any = self._made(), bool(measurements)
        quality = qos_profile(SENSORS)
        self._publishers = {
            topic: node.create_publisher(message_class(kind), topic, quality)
            for topic, kind in self._simulation.types.items()
        }
        self.start(0)

    def start(self, epoch: int) -> None:
        """Begin at an ``epoch``, ns; what is in transit is lost."""
        self._simulation, self._epoch, self._next = self._made(), epoch, 0
        self._transit: list[tuple[int, int, SimulatedMessage]] = []
        self._order = count()

    @property
    def next_stamp(self) -> int | None:
        """When something is due next, ns; None without sensors."""
        if not self._any:
            return None
        arrival = self._transit[0][0] if self._transit else self._sample_stamp
        return min(self._sample_stamp, arrival)

    def publish(self, last: int, state: Callable[[int], Vector], closed: Contacts) -> None:
        """Take samples up to ``last``, ns, and publish those that have arrived by then.

        ``state`` is (q, u) at a stamp while contacts are ``closed``.
        """
        while self._any and (stamp := self._sample_stamp) <= last:
            for each in self._simulation.at(stamp, self._epoch, state(stamp), closed):
                heapq.heappush(self._transit, (each.arrival, next(self._order), each))
            self._next += 1
        while self._transit and self._transit[0][0] <= last:
            _, _, each = heapq.heappop(self._transit)
            self._publishers[each.topic].publish(_of_ros(each.message))

    @property
    def _sample_stamp(self) -> int:
        """Of the next samples, ns."""
        return self._simulation.stamp(self._epoch, self._next)


def _new(type_name: str) -> AnyMessage:
    return message_class(type_name)()


def _of_ros(message: AnyMessage) -> AnyMessage:
    """A message with lists for arrays of numpy."""
    for name in ("position", "velocity"):
        if isinstance(values := getattr(message, name, None), np.ndarray):
            setattr(message, name, values.tolist())
    return message
