# SPDX-License-Identifier: Apache-2.0
"""A simulated sensor of impacts: latency, jitter, missed, spurious and mislabelled impacts.

A contact with a sensor of its own has other latency, jitter and missed impacts. How the faults
act, in which order: ``docs/commands.md``. Each draws from a random stream of its own, whether or
not the number is used: one fault changes no draw of another.
"""

import heapq
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model.contact_sensors import NO_SENSORS, ContactSensor, ContactSensors
from impact_observer.model.multibody import Multibody
from impact_observer.plant.switching import Switching
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

    def check(self, system: Multibody, sensors: ContactSensors = NO_SENSORS) -> None:
        """Raise unless this can be the sensor of ``system``, with own ``sensors`` of contacts.

        Raises:
            UsageError: mislabelled impacts of a single contact, or spurious ones of none.
        """
        count = system.m - [*sensors.values()].count(None)
        for name, least in (("mislabelled", 2), ("spurious", 1)):
            if getattr(self, name) and count < least:
                raise UsageError(
                    f"sensor {name}: {getattr(self, name):g} found; expected 0, or a model with"
                    f" {least} contacts or more: {system.name} has {count}"
                )


IDEAL = SensorModel()
"""A sensor without faults."""


class _ContactErrors(NamedTuple):
    """Errors of the sensor of one contact.

    Attributes:
        jitter: standard deviation of the stamps, s.
        missed: probability of a missed detection; 1 without a sensor.
        delay: of the stamps, s, of any sign.
        draws: stream of its jitter; None where contacts share a draw.
    """

    jitter: float
    missed: float
    delay: float
    draws: np.random.Generator | None


class _Sent(NamedTuple):
    """What a sensor sends, in the order of sending.

    Attributes:
        time: of sending, ns.
        order: among messages of one time.
        stamp: that it reports, ns.
        switches: that it reports.
        arrival: ns.
    """

    time: int
    order: int
    stamp: int
    switches: tuple[Switch, ...]
    arrival: int


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
        system: Multibody,
        *,
        sensors: ContactSensors = NO_SENSORS,
        epoch: int,
        last: int | None = None,
        seed: int = 0,
        episode: int = 0,
    ) -> None:
        """Begin at ``epoch``, the stamp of ``t = 0``, ns.

        Contacts have the errors of ``sensor``, or their own ones in ``sensors``. After ``last``
        (ns; None for no end) no impact is spurious. All draws follow from ``seed``,
        not negative, and from the ``episode`` of the plant.

        Raises:
            UsageError: the sensor cannot be one of ``system``.
        """
        sensor.check(system, sensors)
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
        draws = [np.random.Generator(np.random.PCG64(each)) for each in root.spawn(7 + system.m)]
        self._missed_draws, self._label_draws, self._spurious_draws = draws[:3]
        self._true_timing, self._spurious_timing = draws[3:5], draws[5:7]
        self._errors = [
            _errors_of(sensor, sensors.get(name, _SHARED), each)
            for name, each in zip(system.contact_names, draws[7:], strict=True)
        ]
        self._reporting = [
            i for i, name in enumerate(self._index) if sensors.get(name, _SHARED) is not None
        ]
        self._sequence = self._order = 0
        self._to_send: list[_Sent] = []
        self._last_detected: dict[int, int] = {}
        self._reported_closed: dict[int, str] = {}
        self._in_transport: list[tuple[int, int, ImpactEvent]] = []
        self._spurious_time = 0.0
        self._next_spurious = self._draw_next_spurious()

    @property
    def next_stamp(self) -> int | None:
        """Stamp of the next sending, arrival or spurious impact, ns, if nothing switches first.

        None without any ahead.
        """
        arrival = self._in_transport[0][0] if self._in_transport else math.inf
        sent = self._to_send[0].time if self._to_send else math.inf
        soonest = min(arrival, sent, self._next_spurious)
        return None if math.isinf(soonest) else int(soonest)

    def detect(self, switching: Switching) -> None:
        """Take the plant's next switching; ``due`` has not been asked for its stamp or later."""
        if not switching.switches:
            return
        stamp = switching.instant.stamp
        self._send_spurious(stamp - 1)
        approach = -self._system.contact_speeds(switching.before)
        jitter, transport = _drawn_timing(self._true_timing)
        # Sensors that say the same instant report in one message.
        reported = dict[tuple[int, float], list[Switch]]()
        for switch in switching.switches:
            i = self._index[switch.contact]
            errors = self._errors[i]
            drawn = jitter if errors.draws is None else errors.draws.standard_normal()
            found = self._reported(stamp, i, switch.kind, max(float(approach[i]), 0.0))
            if found is not None:
                late = from_seconds(errors.delay + errors.jitter * drawn)
                reported.setdefault((late, errors.delay), []).append(found)
        for (late, delay), switches in reported.items():
            # Two contacts that hit at once may be reported under one name: that is one switch.
            self._send(stamp, late, delay, tuple(dict.fromkeys(switches)), transport)

    def due(self, now: int) -> list[SensorMessage]:
        """Messages that arrive up to ``now`` (ns) and were not returned before, by arrival.

        All switchings up to ``now`` must have been passed to ``detect``.
        """
        self._send_spurious(now)
        while self._to_send and self._to_send[0].time <= now:
            sent = heapq.heappop(self._to_send)
            self._sequence += 1
            event = ImpactEvent(
                sent.stamp, sent.switches, self._sequence, self._episode, self._epoch
            )
            heapq.heappush(self._in_transport, (sent.arrival, self._sequence, event))
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
        missed = self._missed_draws.random() < self._errors[i].missed
        if missed or approach < self._sensor.threshold or self._is_dead(i, stamp):
            return None
        self._last_detected[i] = stamp
        if kind is Kind.CLOSE:
            self._reported_closed[i] = name
        return Switch(name, kind if persistent else Kind.IMPACT)

    def _label(self, i: int) -> str:
        wrong, other = self._label_draws.random(2)
        if wrong < self._sensor.mislabelled and i in self._reporting:
            place, count = self._reporting.index(i), len(self._reporting)
            i = self._reporting[(place + 1 + int(other * (count - 1))) % count]
        return self._system.contact_names[i]

    def _is_dead(self, i: int, stamp: int) -> bool:
        return i in self._last_detected and stamp - self._last_detected[i] < self._dead_time

    def _send_spurious(self, until: int) -> None:
        while self._next_spurious <= until:
            stamp = int(self._next_spurious)
            jitter, transport = _drawn_timing(self._spurious_timing)
            i = self._reporting[int(self._spurious_draws.random() * len(self._reporting))]
            if not self._is_dead(i, stamp):
                self._last_detected[i] = stamp
                delay, switch = self._errors[i].delay, Switch(self._system.contact_names[i])
                late = from_seconds(delay + self._errors[i].jitter * jitter)
                self._send(stamp, late, delay, (switch,), transport)
            self._next_spurious = self._draw_next_spurious()

    def _draw_next_spurious(self) -> float:
        """The stamp of the next spurious impact; infinite where there is none."""
        if not self._sensor.spurious:
            return math.inf
        self._spurious_time += self._spurious_draws.standard_exponential() / self._sensor.spurious
        stamp = self._epoch + from_seconds(self._spurious_time)
        return stamp if stamp <= self._last else math.inf

    def _send(
        self, stamp: int, late: int, delay: float, switches: tuple[Switch, ...], transport: float
    ) -> None:
        """Send at ``stamp`` and the ``delay``, s, what is stamped ``late`` ns after ``stamp``.

        Nothing is sent before its instant, and ``transport`` is a draw.
        """
        self._order += 1
        delay, shown = max(delay, 0.0), self._clock(stamp + late)
        sent = stamp + from_seconds(delay)
        arrival = stamp + from_seconds(delay + self._sensor.transport * transport)
        heapq.heappush(self._to_send, _Sent(sent, self._order, shown, switches, arrival))

    def _clock(self, stamp: int) -> int:
        """The sensor's clock at ``stamp``, within the stamps that a message can carry."""
        gained = self._sensor.clock_drift * seconds_between(self._epoch, stamp)
        shown = stamp + from_seconds(self._sensor.clock_offset + gained) + self._tick // 2
        latest = MAX_STAMP // self._tick
        return min(max(shown // self._tick, 1), latest) * self._tick


_SHARED = ContactSensor()
"""A sensor with the errors of all contacts."""


def _errors_of(
    sensor: SensorModel, own: ContactSensor | None, draws: np.random.Generator
) -> _ContactErrors:
    """Errors of a contact with its ``own`` sensor, or without any."""
    if own is None:
        return _ContactErrors(0.0, 1.0, 0.0, None)
    given = own.given()
    return _ContactErrors(
        given.get("clock_error", sensor.jitter),
        given.get("missed", sensor.missed),
        given.get("latency", sensor.delay),
        draws if given else None,
    )


def _drawn_timing(draws: Sequence[np.random.Generator]) -> tuple[float, float]:
    """Draws for a message: a standard normal jitter, an exponential transport time."""
    jitter, transport = draws
    return jitter.standard_normal(), transport.standard_exponential()


def simulate_sensor(
    sensor: SensorModel,
    system: Multibody,
    switchings: Iterable[Switching],
    *,
    sensors: ContactSensors = NO_SENSORS,
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
        sensor, system, sensors=sensors, epoch=epoch, last=last, seed=seed, episode=episode
    )
    for switching in switchings:
        simulation.detect(switching)
    messages = simulation.due(last)
    while (stamp := simulation.next_stamp) is not None:
        messages += simulation.due(stamp)
    return tuple(messages)
