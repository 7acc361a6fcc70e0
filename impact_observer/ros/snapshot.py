"""What one look at a running plant and its observers shows: immutable values, no ROS."""

from dataclasses import dataclass

from impact_observer.events import Verdict


@dataclass(frozen=True, slots=True)
class TopicRate:
    """How the messages of a topic come.

    Attributes:
        topic: the absolute name.
        count: messages so far.
        rate: of their arrival, Hz of wall time; None before there is one.
        latency: from stamp to arrival by the clock of the stamps, s, a median; None without
            stamps.
        silent: since the last one, s of wall time.
    """

    topic: str
    count: int
    rate: float | None
    latency: float | None
    silent: float


@dataclass(frozen=True, slots=True)
class Line:
    """A coordinate or a velocity.

    Attributes:
        name: of the coordinate.
        unit: m or m/s.
        estimate: its estimate.
        truth: its true value at the same stamp; None where it is not known.
        deviation: the estimate's standard deviation; None for a law without.
    """

    name: str
    unit: str
    estimate: float
    truth: float | None = None
    deviation: float | None = None


@dataclass(frozen=True, slots=True)
class EstimateHistory:
    """A quantity over the last seconds.

    Attributes:
        now: its last value; None before there is one.
        values: one a time bin, the last bin is now; None where nothing was known yet.
        seconds: what the bins cover, s.
    """

    now: float | None = None
    values: tuple[float | None, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class ObserverGlance:
    """One observer.

    Attributes:
        name: of its node, absolute.
        law: its law; empty before its first state.
        epoch: stamp of ``t = 0`` of its events, ns; 0 while none has told it.
        stamp: when the lines hold, ns; 0 before the first state.
        lines: coordinates, then velocities; estimates only where no truth has their stamp.
        distance: V, J.
        source: who tells V: ``monitor``, or ``here`` where it is computed; empty for nobody.
        convergence: largest V distance between replicas, J; -1 while there is one only.
        synchronized: whether they have agreed; None before the first state.
        bound: certified bound of V, J; -1 where nothing is certified, None where nothing is said.
        closed: contacts that the replica holds closed.
        parameters: what is estimated besides the state: name, value, standard deviation, SI units.
        verdicts: the last ones with the latency of each, s, newest first.
        counts: verdicts so far by ruling.
        health: level (0 ok, 1 warning, 2 error) and message of its diagnostics; None before.
        flows: its topics.
    """

    name: str
    law: str = ""
    epoch: int = 0
    stamp: int = 0
    lines: tuple[Line, ...] = ()
    distance: EstimateHistory = EstimateHistory()
    source: str = ""
    convergence: EstimateHistory = EstimateHistory()
    synchronized: bool | None = None
    bound: float | None = None
    closed: tuple[str, ...] = ()
    parameters: tuple[tuple[str, float, float], ...] = ()
    verdicts: tuple[tuple[Verdict, float], ...] = ()
    counts: tuple[tuple[str, int], ...] = ()
    health: tuple[int, str] | None = None
    flows: tuple[TopicRate, ...] = ()


@dataclass(frozen=True, slots=True)
class Glance:
    """Everything.

    Attributes:
        clock: now, by the clock of the stamps, ns.
        simulated: whether that is ``/clock``.
        epoch: stamp of ``t = 0``, ns; 0 while no event has told it, or plants have several.
        model: its name; empty while no plant has told it and none was named.
        truth: whether a plant publishes true states.
        impacts: events so far.
        last_impact: stamp, ns, and contacts of the last one; None before.
        observers: the observers, by name.
        flows: topics that no single observer owns.
        trouble: the last message that could not be understood; empty for none.
    """

    clock: int
    simulated: bool = False
    epoch: int = 0
    model: str = ""
    truth: bool = False
    impacts: int = 0
    last_impact: tuple[int, str] | None = None
    observers: tuple[ObserverGlance, ...] = ()
    flows: tuple[TopicRate, ...] = ()
    trouble: str = ""

    @property
    def is_empty(self) -> bool:
        """Whether nobody has been heard."""
        return not self.flows and not any(each.flows for each in self.observers)
