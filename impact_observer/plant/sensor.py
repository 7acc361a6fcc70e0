"""Impacts as a real sensor tells them: late, jittered, missed, spurious, of the wrong contact.

One order of things, from the stop to the listener:

1. *Feeling*, contact by contact. An IMPACT or CLOSE below ``threshold`` is not felt; any other is
   ``missed`` with a probability; and none is felt within ``dead_time`` after one that the same
   contact has felt. What is not felt is not told, and begins no dead time. ``spurious`` impacts
   are felt like true ones: they begin a dead time, and are lost in one.
2. *Naming*. A felt impact is ``mislabelled`` with a probability: another contact is named, each
   with the same chance. The dead time stays that of the contact that was hit. A spurious impact
   is of any contact anyway.
3. *Lasting contact*. A CLOSE is an impact like any other: where it is not felt the contact stays
   closed and nobody hears of it. An OPEN is no impact: it is told if and only if its CLOSE was,
   by the name that its CLOSE was told by, whatever the dead time. With ``impacts_only`` a CLOSE
   is told as IMPACT, and no OPEN at all.
4. *Counting*. What is told of one instant is one event. Sequence numbers count events in the
   order of their instants; an event of which nothing is left has none, so that what a sensor
   does not feel leaves no gap.
5. *Stamping*. The instant, plus ``delay``, plus a normal ``jitter``, read on a clock that is
   ``clock_offset`` ahead at the epoch and gains ``clock_drift`` a second, rounded to a multiple
   of ``quantisation``. Stamps can so be in another order than sequence numbers. The epoch that an
   event carries is the plant's own.
6. *Sending*. An event arrives ``delay`` after its instant and an exponential time of mean
   ``transport`` later, whatever its stamp. Arrivals can so be in yet another order.

Whatever draws has a random stream of its own, and draws whether or not anything becomes of it:
switching one trouble on changes no draw of another.
"""

import heapq
import math
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind, Switch
from impact_observer.model import System
from impact_observer.plant.switching import Switching
from impact_observer.sensor_faults import SENSOR_FAULTS
from impact_observer.stamps import MAX_STAMP, from_seconds, seconds_between

_STREAMS = 7
"""Random streams of a sensor; another trouble that draws takes one more, at the end."""


@dataclass(frozen=True, slots=True)
class SensorModel:
    """What is wrong with a sensor of impacts; nothing, unless told. The module says how it acts.

    Attributes:
        delay: by which it notices, stamps and sends late, s.
        jitter: standard deviation of its stamps, s; normal.
        quantisation: its stamps are multiples of this, s, in whole nanoseconds; 0 for 1 ns.
        dead_time: so long after a felt impact the same contact feels nothing, s.
        missed: probability that an impact is not felt.
        spurious: impacts that it invents, 1/s; Poisson, of any contact.
        mislabelled: probability that another contact is named.
        clock_offset: by which its clock is ahead of the plant's at the epoch, s.
        clock_drift: by which its clock is too fast, s/s.
        threshold: approach speed below which an impact is not felt, m/s.
        impacts_only: whether CLOSE is told as IMPACT, and OPEN never.
        transport: mean of the exponential time that an event is on its way, s.
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
            UsageError: one is not a number, or out of its range in ``SENSOR_FAULTS``.
        """
        for fault in SENSOR_FAULTS:
            fault.check(getattr(self, fault.name), "sensor")

    @property
    def faults(self) -> dict[str, float | bool]:
        """What is wrong, by name; empty for an ideal sensor."""
        values = ((field.name, getattr(self, field.name)) for field in fields(self))
        return {name: value if value is True else float(value) for name, value in values if value}

    def check(self, system: System) -> None:
        """Raise unless this can be the sensor of ``system``.

        Raises:
            UsageError: it names other contacts where there is one, or invents impacts of none.
        """
        for name, least in (("mislabelled", 2), ("spurious", 1)):
            if getattr(self, name) and system.m < least:
                raise UsageError(
                    f"sensor {name}: {getattr(self, name):g} found; expected 0, or a model with"
                    f" {least} contacts or more: {system.name} has {system.m}"
                )


IDEAL = SensorModel()
"""A sensor with which nothing is wrong."""


class SensorMessage(NamedTuple):
    """A message of a sensor.

    Attributes:
        event: what it says.
        arrival: when it is heard, ns, by the plant's clock; not before the instant it tells of.
    """

    event: ImpactEvent
    arrival: int


class SensorSimulation:
    """A sensor at work: told what the contacts do, it says what arrives, and when.

    Memory is bounded by the messages that are under way.
    """

    def __init__(
        self,
        sensor: SensorModel,
        system: System,
        *,
        epoch: int,
        last: int | None = None,
        seed: int = 0,
        episode: int = 0,
    ) -> None:
        """Begin at ``epoch``.

        Args:
            sensor: what is wrong with it.
            system: whose contacts it feels.
            epoch: stamp of ``t = 0``, ns.
            last: stamp after which it invents nothing, ns; None for never.
            seed: of everything random in it, not negative.
            episode: of the plant; each has its own draws.

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
        self._dead = from_seconds(sensor.dead_time)
        self._tick = max(from_seconds(sensor.quantisation), 1)
        root = np.random.SeedSequence(seed, spawn_key=(episode,))
        draws = [np.random.Generator(np.random.PCG64(child)) for child in root.spawn(_STREAMS)]
        self._missing, self._naming, self._inventing = draws[:3]
        self._true, self._spurious = _Marks(*draws[3:5]), _Marks(*draws[5:])
        self._sequence = 0
        self._felt: dict[int, int] = {}
        self._names: dict[int, str] = {}
        self._under_way: list[tuple[int, int, ImpactEvent]] = []
        self._waited = 0.0
        self._next_spurious = self._invention()

    @property
    def next_stamp(self) -> int | None:
        """Before which nothing arrives but what is felt until then, ns; None for never."""
        arrival = self._under_way[0][0] if self._under_way else math.inf
        soonest = min(arrival, self._next_spurious)
        return None if math.isinf(soonest) else int(soonest)

    def detect(self, switching: Switching) -> None:
        """Tell what the contacts do next; what arrives then or later has not been asked for."""
        if not switching.switches:
            return
        stamp = switching.instant.stamp
        self._invent(stamp - 1)
        approach = -self._system.contact_speed(switching.before[self._system.n :])
        marks = self._true.drawn()
        told = []
        for switch in switching.switches:
            i = self._index[switch.contact]
            told.append(self._told(stamp, i, switch.kind, max(float(approach[i]), 0.0)))
        # Two contacts that hit at once may go by one name: that is one switch.
        if switches := tuple(dict.fromkeys(filter(None, told))):
            self._send(stamp, switches, marks)

    def due(self, now: int) -> list[SensorMessage]:
        """What arrives up to ``now`` (ns) and was not told before, in the order of arrival.

        All that the contacts do up to ``now`` must have been felt.
        """
        self._invent(now)
        arrived = []
        while self._under_way and self._under_way[0][0] <= now:
            arrival, _, event = heapq.heappop(self._under_way)
            arrived.append(SensorMessage(event, arrival))
        return arrived

    def _told(self, stamp: int, i: int, kind: Kind, approach: float) -> Switch | None:
        """What is told of contact ``i`` that switches with the speed ``approach``, m/s."""
        told = not self._sensor.impacts_only
        if kind is Kind.OPEN:
            name = self._names.pop(i, None)
            return Switch(name, Kind.OPEN) if told and name is not None else None
        name = self._name(i)
        missed = self._missing.random() < self._sensor.missed
        if missed or approach < self._sensor.threshold or self._is_dead(i, stamp):
            return None
        self._felt[i] = stamp
        if kind is Kind.CLOSE:
            self._names[i] = name
        return Switch(name, kind if told else Kind.IMPACT)

    def _name(self, i: int) -> str:
        """The contact that is named where ``i`` is hit."""
        names = self._system.contact_names
        wrong, other = self._naming.random(2)
        if wrong < self._sensor.mislabelled:
            i = (i + 1 + int(other * (len(names) - 1))) % len(names)
        return names[i]

    def _is_dead(self, i: int, stamp: int) -> bool:
        """Whether contact ``i`` was felt too short a time before ``stamp``."""
        return i in self._felt and stamp - self._felt[i] < self._dead

    def _invent(self, until: int) -> None:
        """Feel what never was, up to the stamp ``until``."""
        while self._next_spurious <= until:
            stamp, marks = int(self._next_spurious), self._spurious.drawn()
            i = int(self._inventing.random() * self._system.m)
            if not self._is_dead(i, stamp):
                self._felt[i] = stamp
                self._send(stamp, (Switch(self._system.contact_names[i]),), marks)
            self._next_spurious = self._invention()

    def _invention(self) -> float:
        """The stamp of the next spurious impact; infinite where there is none."""
        if not self._sensor.spurious:
            return math.inf
        self._waited += self._inventing.standard_exponential() / self._sensor.spurious
        stamp = self._epoch + from_seconds(self._waited)
        return stamp if stamp <= self._last else math.inf

    def _send(self, stamp: int, switches: tuple[Switch, ...], marks: tuple[float, float]) -> None:
        """Put an event of the instant ``stamp`` on its way."""
        jitter, transport = marks
        self._sequence += 1
        seen = self._clock(stamp + from_seconds(self._sensor.delay + self._sensor.jitter * jitter))
        event = ImpactEvent(seen, switches, self._sequence, self._episode, self._epoch)
        arrival = stamp + from_seconds(self._sensor.delay + self._sensor.transport * transport)
        heapq.heappush(self._under_way, (arrival, self._sequence, event))

    def _clock(self, stamp: int) -> int:
        """What the sensor's clock shows at ``stamp``: above zero, and what a message can carry."""
        gained = self._sensor.clock_drift * seconds_between(self._epoch, stamp)
        shown = stamp + from_seconds(self._sensor.clock_offset + gained) + self._tick // 2
        latest = MAX_STAMP // self._tick
        return min(max(shown // self._tick, 1), latest) * self._tick


class _Marks:
    """What chance does to one message after the other: its jitter and its way."""

    def __init__(self, jitter: np.random.Generator, transport: np.random.Generator) -> None:
        self._jitter = jitter
        self._transport = transport

    def drawn(self) -> tuple[float, float]:
        """A standard normal and a standard exponential number."""
        return self._jitter.standard_normal(), self._transport.standard_exponential()


def simulate_sensor(
    sensor: SensorModel,
    system: System,
    switchings: Iterable[Switching],
    *,
    epoch: int,
    last: int,
    seed: int = 0,
    episode: int = 0,
) -> tuple[SensorMessage, ...]:
    """What ``sensor`` tells of a whole run.

    Args:
        sensor: what is wrong with it.
        system: what moved.
        switchings: all that its contacts did, in their order.
        epoch: stamp of ``t = 0``, ns.
        last: stamp of the run's end, ns: nothing is spurious after it, messages may arrive later.
        seed: of everything random, not negative.
        episode: of the plant; each has its own draws.

    Returns:
        Every message, in the order of arrival; with an ideal sensor that of the instants.

    Raises:
        UsageError: the sensor cannot be one of ``system``.
    """
    sensing = SensorSimulation(sensor, system, epoch=epoch, last=last, seed=seed, episode=episode)
    for switching in switchings:
        sensing.detect(switching)
    sensed = sensing.due(last)
    while (stamp := sensing.next_stamp) is not None:
        sensed += sensing.due(stamp)
    return tuple(sensed)
