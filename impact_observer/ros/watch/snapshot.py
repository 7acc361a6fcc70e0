# SPDX-License-Identifier: Apache-2.0
"""What `watch` shows at one moment: immutable values, no ROS. `--json` prints their fields."""

from dataclasses import dataclass

from impact_observer.events import Verdict


@dataclass(frozen=True, slots=True)
class TopicRate:
    """How often the messages of a topic arrive.

    Attributes:
        topic: the absolute name.
        count: messages so far.
        rate: of arrival, Hz of wall time; None before there is one.
        latency: median from stamp to arrival, s, by the clock of the stamps; None without stamps.
        silent: since the last message, s of wall time.
    """

    topic: str
    count: int
    rate: float | None
    latency: float | None
    silent: float


@dataclass(frozen=True, slots=True)
class StateLine:
    """A coordinate or a velocity.

    Attributes:
        name: of the coordinate.
        unit: m or m/s.
        estimate: its estimate.
        truth: its true value at the same stamp; None where there is none.
        deviation: the estimate's standard deviation; None for a law without covariance.
    """

    name: str
    unit: str
    estimate: float
    truth: float | None = None
    deviation: float | None = None


@dataclass(frozen=True, slots=True)
class SensorLine:
    """A sensor beside the impacts.

    Attributes:
        name: of the sensor.
        level: of its diagnostics: 0 ok, 1 warning, 2 error.
        message: of its diagnostics.
    """

    name: str
    level: int
    message: str


@dataclass(frozen=True, slots=True)
class EstimateHistory:
    """A quantity over the last seconds.

    Attributes:
        now: its last value; None before there is one.
        values: one per time bin, the last bin is the present; None before the first value.
        seconds: the time that the bins cover, s.
    """

    now: float | None = None
    values: tuple[float | None, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class ObserverSnapshot:
    """One observer.

    Attributes:
        name: of its node, absolute.
        law: its law; empty before its first state.
        epoch: stamp of ``t = 0`` of its events, ns; 0 before an event with one.
        stamp: of the lines, ns; 0 before the first state.
        lines: coordinates, then velocities; without truth where none has their stamp.
        distance: V, J.
        source: who computes V: ``monitor``, or ``here``; empty where V is not available.
        convergence: largest V distance between replicas, J; -1 for a single replica.
        synchronized: whether the replicas have converged; None before the first state.
        obstacle: why they have not, as by the last diagnostics; empty where that is unknown.
        bound: certified bound of V, J; -1 where none is certified, None before a message.
        closed: contacts that the replica holds closed.
        learned: estimated parameters: name, value, standard deviation, SI units.
        verdicts: the last ones with the latency of each, s, newest first.
        counts: verdicts so far by ruling.
        health: level (0 ok, 1 warning, 2 error) and message of its diagnostics; None before.
        flows: rates of its topics.
        sensors: what is measured beside the impacts.
    """

    name: str
    law: str = ""
    epoch: int = 0
    stamp: int = 0
    lines: tuple[StateLine, ...] = ()
    distance: EstimateHistory = EstimateHistory()
    source: str = ""
    convergence: EstimateHistory = EstimateHistory()
    synchronized: bool | None = None
    obstacle: str = ""
    bound: float | None = None
    closed: tuple[str, ...] = ()
    learned: tuple[tuple[str, float, float], ...] = ()
    verdicts: tuple[tuple[Verdict, float], ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    health: tuple[int, str] | None = None
    flows: tuple[TopicRate, ...] = ()
    sensors: tuple[SensorLine, ...] = ()


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The plant and all observers.

    Attributes:
        clock: now, by the clock of the stamps, ns.
        simulated: whether that is ``/clock``.
        epoch: stamp of ``t = 0``, ns; 0 before an event with one, or when plants differ.
        model: its name; empty where no plant publishes it and none was named.
        truth: whether a plant publishes true states.
        impacts: events so far.
        last_impact: stamp, ns, and contacts of the last one; None before.
        observers: the observers, by name.
        flows: rates of topics that belong to no single observer.
        trouble: the last message that could not be read; empty for none.
        merged: topics on which several nodes publish, so that what is shown is a mixture.
    """

    clock: int
    simulated: bool = False
    epoch: int = 0
    model: str = ""
    truth: bool = False
    impacts: int = 0
    last_impact: tuple[int, str] | None = None
    observers: tuple[ObserverSnapshot, ...] = ()
    flows: tuple[TopicRate, ...] = ()
    trouble: str = ""
    merged: tuple[str, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether no message has arrived."""
        return not self.flows and not any(each.flows for each in self.observers)
