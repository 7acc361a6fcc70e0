# SPDX-License-Identifier: Apache-2.0
"""The samples of a running plant's sensors beside the impacts."""

import heapq
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count

from impact_observer.events import Contacts
from impact_observer.io.interfaces import SENSORS
from impact_observer.io.simulated_samples import SampleSimulation, SimulatedMessage
from impact_observer.model.measurement import Measurement
from impact_observer.model.multibody import Multibody
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.topics import message_class, qos_profile
from impact_observer.states import Vector


class PlantSensors:
    """Sensors of a plant, with the samples of ``simulate`` for the same seed."""

    def __init__(
        self,
        node: BaseNode,
        measurements: Sequence[Measurement],
        system: Multibody,
        rate: float,
        seed: int,
    ) -> None:
        """Make a best-effort publisher for each of the ``measurements``, taken at a ``rate``, Hz.

        Raises:
            UsageError: by file and key, if a sensor cannot be simulated.
        """
        self._make_simulation = partial(
            SampleSimulation,
            measurements,
            system,
            rate,
            seed,
            node.make,
        )
        self._has_sensors = bool(measurements)
        quality = qos_profile(SENSORS)
        self.start(0)
        self._publishers = {
            topic: node.create_publisher(message_class(kind), topic, quality)
            for topic, kind in self._simulation.types.items()
        }

    def start(self, epoch: int) -> None:
        """Begin at an ``epoch``, ns; samples in transit are lost."""
        self._simulation, self._epoch, self._next = self._make_simulation(), epoch, 0
        self._transit: list[tuple[int, int, SimulatedMessage]] = []
        self._order = count()

    @property
    def next_stamp(self) -> int | None:
        """Stamp of the next sample or the next arrival, ns; None without sensors."""
        if not self._has_sensors:
            return None
        arrival = self._transit[0][0] if self._transit else self._sample_stamp
        return min(self._sample_stamp, arrival)

    def publish(self, last: int, state: Callable[[int], Vector], closed: Contacts) -> None:
        """Take samples up to ``last``, ns, and publish those that have arrived by then.

        ``state`` is (q, u) at a stamp while contacts are ``closed``.
        """
        while self._has_sensors and (stamp := self._sample_stamp) <= last:
            for each in self._simulation.messages_at(stamp, self._epoch, state(stamp), closed):
                heapq.heappush(self._transit, (each.arrival, next(self._order), each))
            self._next += 1
        while self._transit and self._transit[0][0] <= last:
            _, _, each = heapq.heappop(self._transit)
            self._publishers[each.topic].publish(each.message)

    @property
    def _sample_stamp(self) -> int:
        """Stamp of the next samples, ns."""
        return self._simulation.stamp(self._epoch, self._next)
