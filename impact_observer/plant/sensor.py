# SPDX-License-Identifier: Apache-2.0
"""A simulated sensor of impacts: latency, jitter, missed, spurious and mislabelled impacts.

How the faults act, in which order: ``docs/commands.md``. Each draws from a random stream of its
own, whether or not the number is used: one fault changes no draw of another.
"""

import heapq
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.plant.switching import Switching
from impact_observer.robots.robot import Robot
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP, from_seconds, seconds_between


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The faults of a sensor of impacts; none by default.

    Attributes:
        delay: latency of detection, in stamp and arrival, s.
        jitter: standard deviation of the normal error of stamps, s.
        quantisation: step of the stamps, s, in whole nanoseconds; 0 for 1 ns.
        dead_time: time after a detected impact without another at the same contact, s.
        missed: probability that an impact, also one that stays closed, is not detected.
        spurious: rate of false positives, 1/s; Poisson, of any contact.
        mislabelled: probability that another contact is reported.
        clock_offset: lead of the sensor's clock over the plant's clock at the epoch, s.
        clock_drift: rate error of the sensor's clock, positive if too fast, s/s.
        threshold: approach speed below which an impact is not detected, m/s.
        impacts_only: whether CLOSE is reported as IMPACT, and OPEN never.
        transport: mean of the exponential time from sender to receiver, s.
    """

    delay: float = 0.0
    jitter: float = 0.0
    quantisation: float = 0.0
    dead_time: float = 0.0
    missed: float = 0.0
    spurious: float = 0.0
    mislabelled: float = 0.0
    clock_offset: float = 0.0
    clock_drift: float = 0.0
    threshold: float = 0.0
    impacts_only: bool = False
    transport: float = 0.0

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            UsageError: a value is not a number, or out of the range in ``SENSOR_FAULTS``.
        """
        for fault in SENSOR_FAULTS:
            fault.check(getattr(self, fault.name), "sensor")

    @property
    def faults(self) -> dict[str, float | bool]:
        """The faults that are not zero, by name; empty for an ideal sensor."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: value if value is True else float(value) for name, value in values if value}

    @property
    def is_random(self) -> bool:
        """Whether events depend on a seed; the transport time changes arrivals only."""
        return bool(self.jitter or self.missed or self.spurious or self.mislabelled)

    def check(self, system: System | Robot) -> None:
        """Raise unless this can be the sensor of ``system``.

        Raises:
            UsageError: mislabelled impacts of a single contact, or spurious ones of none.
        """
        for name, least in (("mislabelled", 2), ("spurious", 1)):
            if getattr(self, name) and system.m < least:
                raise UsageError(
                    f"sensor {name}: {getattr(self, name):g} found; expected 0, or a model with"
                    f" {least} contacts or more: {system.name} has {system.m}"
                )


IDEAL = SensorModel()
"""A sensor without faults."""


class SensorMessage(NamedTuple):
    """A message of a sensor.

    Attributes:
        event: the reported event.
        arrival: time of reception by the plant's clock, ns; not before the event's instant.
    """

    event: ImpactEvent
    arrival: int


class SensorSimulation:
    """A sensor that follows a plant: switchings go in, messages come out when they arrive.

    Memory is bounded by the messages in transport.
    """

    def __init__(
        self,
        sensor: SensorModel,
        system: System | Robot,
        *,
        epoch: int,
        last: int | None = None,
        seed: int = 0,
        episode: int = 0,
    ) -> None:
        """Begin at ``epoch``, the stamp of ``t = 0``, ns.

        After ``last`` (ns; None for no end) no impact is spurious. All draws follow from ``seed``,
        not negative, and from the ``episode`` of the plant.

        Raises:
            UsageError: the sensor cannot be one of ``system``.
        """
        sensor.check(system)
        if epoch + from_seconds(sensor.clock_offset) <= 0:
            raise UsageError(
                f"sensor clock_offset: {sensor.clock_offset:g} s found; expected more than"
                f" {-epoch / 1e9:g} s, as stamps start above zero: choose a later epoch"
            )
        self._sensor = sensor
        self._system = system
        self._index = {name: i for i, name in enumerate(system.contact_names)}
        self._epoch = epoch
        self._last = math.inf if last is None else last
        self._episode = episode
        self._dead_time = from_seconds(sensor.dead_time)
        self._tick = max(from_seconds(sensor.quantisation), 1)
        root = np.random.SeedSequence(seed, spawn_key=(episode,))
        # A new fault that draws takes one more stream, at the end.
        draws = [np.random.Generator(np.random.PCG64(child)) for child in root.spawn(7)]
        self._missed_draws, self._label_draws, self._spurious_draws = draws[:3]
        self._true_timing, self._spurious_timing = draws[3:5], draws[5:]
        self._sequence = 0
        self._last_detected: dict[int, int] = {}
        self._reported_closed: dict[int, str] = {}
        self._in_transport: list[tuple[int, int, ImpactEvent]] = []
        self._spurious_time = 0.0
        self._next_spurious = self._draw_next_spurious()

    @property
    def next_stamp(self) -> int | None:
        """Stamp of the next arrival or spurious impact, if the plant does not switch first, ns.

        None without an arrival or spurious impact ahead.
        """
        arrival = self._in_transport[0][0] if self._in_transport else math.inf
        soonest = min(arrival, self._next_spurious)
        return None if math.isinf(soonest) else int(soonest)

    def detect(self, switching: Switching) -> None:
        """Take the plant's next switching; ``due`` has not been asked for its stamp or later."""
        if not switching.switches:
            return
        stamp = switching.instant.stamp
        self._send_spurious(stamp - 1)
        approach = -self._system.contact_speeds(switching.before)
        timing = _drawn_timing(self._true_timing)
        reported = []
        for switch in switching.switches:
            i = self._index[switch.contact]
            reported.append(self._reported(stamp, i, switch.kind, max(float(approach[i]), 0.0)))
        # Two contacts that hit at once may be reported under one name: that is one switch.
        if switches := tuple(dict.fromkeys(filter(None, reported))):
            self._send(stamp, switches, timing)

    def due(self, now: int) -> list[SensorMessage]:
        """Messages that arrive up to ``now`` (ns) and were not returned before, by arrival.

        All switchings up to ``now`` must have been passed to ``detect``.
        """
        self._send_spurious(now)
        arrived = []
        while self._in_transport and self._in_transport[0][0] <= now:
            arrival, _, event = heapq.heappop(self._in_transport)
            arrived.append(SensorMessage(event, arrival))
        return arrived

    def _reported(self, stamp: int, i: int, kind: Kind, approach: float) -> Switch | None:
        persistent = not self._sensor.impacts_only
        if kind is Kind.OPEN:
            name = self._reported_closed.pop(i, None)
            return Switch(name, Kind.OPEN) if persistent and name is not None else None
        name = self._label(i)
        missed = self._missed_draws.random() < self._sensor.missed
        if missed or approach < self._sensor.threshold or self._is_dead(i, stamp):
            return None
        self._last_detected[i] = stamp
        if kind is Kind.CLOSE:
            self._reported_closed[i] = name
        return Switch(name, kind if persistent else Kind.IMPACT)

    def _label(self, i: int) -> str:
        names = self._system.contact_names
        wrong, other = self._label_draws.random(2)
        if wrong < self._sensor.mislabelled:
            i = (i + 1 + int(other * (len(names) - 1))) % len(names)
        return names[i]

    def _is_dead(self, i: int, stamp: int) -> bool:
        return i in self._last_detected and stamp - self._last_detected[i] < self._dead_time

    def _send_spurious(self, until: int) -> None:
        while self._next_spurious <= until:
            stamp, timing = int(self._next_spurious), _drawn_timing(self._spurious_timing)
            i = int(self._spurious_draws.random() * self._system.m)
            if not self._is_dead(i, stamp):
                self._last_detected[i] = stamp
                self._send(stamp, (Switch(self._system.contact_names[i]),), timing)
            self._next_spurious = self._draw_next_spurious()

    def _draw_next_spurious(self) -> float:
        """The stamp of the next spurious impact; infinite where there is none."""
        if not self._sensor.spurious:
            return math.inf
        self._spurious_time += self._spurious_draws.standard_exponential() / self._sensor.spurious
        stamp = self._epoch + from_seconds(self._spurious_time)
        return stamp if stamp <= self._last else math.inf

    def _send(self, stamp: int, switches: tuple[Switch, ...], timing: tuple[float, float]) -> None:
        jitter, transport = timing
        self._sequence += 1
        shown = self._clock(
            stamp + from_seconds(self._sensor.delay + self._sensor.jitter * jitter)
        )
        event = ImpactEvent(shown, switches, self._sequence, self._episode, self._epoch)
        arrival = stamp + from_seconds(self._sensor.delay + self._sensor.transport * transport)
        heapq.heappush(self._in_transport, (arrival, self._sequence, event))

    def _clock(self, stamp: int) -> int:
        """The sensor's clock at ``stamp``, within the stamps that a message can carry."""
        gained = self._sensor.clock_drift * seconds_between(self._epoch, stamp)
        shown = stamp + from_seconds(self._sensor.clock_offset + gained) + self._tick // 2
        latest = MAX_STAMP // self._tick
        return min(max(shown // self._tick, 1), latest) * self._tick


def _drawn_timing(draws: Sequence[np.random.Generator]) -> tuple[float, float]:
    """Draws for a message: a standard normal jitter, an exponential transport time."""
    jitter, transport = draws
    return jitter.standard_normal(), transport.standard_exponential()


def simulate_sensor(
    sensor: SensorModel,
    system: System | Robot,
    switchings: Iterable[Switching],
    *,
    epoch: int,
    last: int,
    seed: int = 0,
    episode: int = 0,
) -> tuple[SensorMessage, ...]:
    """The messages that ``sensor`` sends of a whole run that ends at ``last`` (ns).

    Arguments as of ``SensorSimulation``. Messages may arrive after the end.

    Returns:
        Every message, in the order of arrival; with an ideal sensor that of the instants.

    Raises:
        UsageError: the sensor cannot be one of ``system``.
    """
    simulation = SensorSimulation(
        sensor, system, epoch=epoch, last=last, seed=seed, episode=episode
    )
    for switching in switchings:
        simulation.detect(switching)
    messages = simulation.due(last)
    while (stamp := simulation.next_stamp) is not None:
        messages += simulation.due(stamp)
    return tuple(messages)
