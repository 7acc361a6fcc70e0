"""A bank of impact filters: each believes another account of the same events.

A sensor invents, misses and mislabels impacts. So at every event each hypothesis divides: the
event was what it says, or an impact of another contact, or nothing at all; and what the estimate
fell through before was an impact that nobody heard. Hypotheses are weighed by how likely each
makes the instants that came, and the unlikely ones are dropped: multiple hypothesis tracking
(Blackman and Popoli, Design and Analysis of Modern Tracking Systems, 1999, chapter 16). One that
has all events right soon predicts the next to the accuracy of the clock, and then nothing else
can compete.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy import special

from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.forecast import Dip, Flight, Forecast
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.hypotheses import Hypothesis, MissedSwitch, Note
from impact_observer.estimation.impact_filter import ImpactFilter
from impact_observer.estimation.likelihood import Likelihood
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.events import Kind, Ruling

RARE = 0.1
"""Spurious impacts of a contact, were all events spurious, in the inverse of the fastest rate."""
ANEW = math.log(2.5e-3)
"""Logarithm of the probability that is given to an estimate that is not what it believes to be."""
OTHER = math.log(0.01)
"""Logarithm of the probability that the clock is more, or less, accurate than was believed."""
SURPRISED = 3.0
"""Innovation, in standard deviations, from which on an estimate may be less sure than it says."""
WIDER = (3.0, 100.0)
"""How much wider than what an event contradicts a covariance is opened again."""
LEADING = -3.0
"""Logarithm of a probability, relative to the largest, of a hypothesis that is mended so."""
MOST = 64
"""Hypotheses that are carried on, besides new beginnings; twice as many while some divide."""
NEGLIGIBLE = -16.0
"""Logarithm of a probability, relative to the largest, of a hypothesis that is dropped."""
DEEP = 3
"""Notes, times the coordinates, by which two hypotheses must differ to be carried both."""
LIKELY = 0.5
"""Depth of a dip, in standard deviations, from which on it may have been an impact."""
SURE = 3.0
"""The same for one that is not over yet."""
_IMPACTS = 256
"""Impacts between two events that a hypothesis may insert."""
_REMEMBERED = 32
"""Notes that a hypothesis keeps, at least: what it makes of older events will not change."""
_FLIGHTS = 8
"""Flights of which the samples are kept, for hypotheses to share."""


Beginnings: TypeAlias = Callable[[], Sequence[Hypothesis]]
"""Makes what is believed where nothing that came before is; probabilities add up to one."""


class _Branch(NamedTuple):
    """What an event may have been.

    Attributes:
        weight: logarithm of its probability.
        make: makes the hypothesis of it.
        foretold: whether the event came when it was expected.
    """

    weight: float
    make: Callable[[], Hypothesis]
    expected: bool = False


class FilterBank:
    """Hypotheses of one system from event to event.

    Attributes:
        filter: what each of them does.
    """

    def __init__(
        self, filter_: ImpactFilter, uncertainty: Uncertainty, clocks: Sequence[float] = ()
    ) -> None:
        """Hypotheses that share ``filter_``, and doubt events as far as is declared.

        Args:
            filter_: what each of them does.
            uncertainty: what is declared.
            clocks: standard deviations of a stamp that are thought possible, s, ascending.
        """
        self.filter = filter_
        self._beside = {
            clock: (*clocks[max(i - 1, 0) : i], *clocks[i + 1 : i + 2])
            for i, clock in enumerate(clocks)
        }
        self._trusting = uncertainty.trusting
        # Events may be beyond doubt, and an estimate that has to learn its model not.
        self._sure = self._trusting and uncertainty.unknowns is None
        self._missed, self._heard = _logs(uncertainty.missed)
        self._mislabelled, _ = _logs(uncertainty.mislabelled)
        self._slow = -math.log(filter_.phases.scales.timescale)
        spurious, plain = _logs(uncertainty.spurious)
        self._spurious = spurious - plain + math.log(RARE) + self._slow
        self._deep = DEEP * filter_.system.n
        self._flight = lru_cache(_FLIGHTS)(Flight)

    def forecast(self, t: float, known: GaussianState) -> Forecast:
        """What ``known`` comes to from ``t`` (s since the epoch) on."""
        members = self.filter.members
        flight = self._flight(members.unmoved(self.filter.member(known)), t, known.closed)
        return Forecast(flight, self.filter.course(t, known), known, members, t)

    def predicted(
        self, hypotheses: Sequence[Hypothesis], t: float, s: float
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` of ``t`` (s since the epoch) ``s`` seconds later, the likeliest first.

        One that falls through a stop divides: into what it is, and into one that hit it.
        """
        if self._trusting:
            return tuple(h.knowing(self.filter.course(t, h.known).known(s)) for h in hypotheses)
        found: list[Hypothesis] = []
        best = -math.inf
        for each in sorted(hypotheses, key=_weight):
            found.extend(self._paths(each, t, s, best + NEGLIGIBLE))
            best = max(path.weight for path in found)
        found.sort(key=_weight)
        enough = found[0].weight + NEGLIGIBLE
        likely = [each for each in found[: 2 * MOST] if each.weight >= enough]
        return tuple(sorted(likely, key=lambda each: each.whole_weight, reverse=True))

    def _paths(self, h: Hypothesis, t: float, left: float, enough: float) -> Iterator[Hypothesis]:
        """What may have become of ``h`` from ``t`` on, ``left`` seconds later.

        Args:
            h: a hypothesis.
            t: s since the epoch.
            left: seconds.
            enough: logarithm of a probability below which nothing more is tried.
        """
        while True:
            forecast = self.forecast(t, h.known)
            dips = forecast.dips(left)
            over = sum(dip.unlikely for dip in dips if dip.over)
            sunk = {dip.contact: dip.unlikely for dip in dips if not dip.over}
            known = forecast.course.known(left)
            yield h._replace(known=known, weight=h.weight + over, sunk=sunk)
            likely = (dip for dip in dips if dip.depth > (LIKELY if dip.over else SURE))
            dip = next(likely, None)
            if dip is None or self._missed == -math.inf or len(h.missed) >= _IMPACTS:
                return
            at = forecast.root(dip)
            t, left = t + at, left - at
            known, kind = self.switched(t, forecast.course.known(at), dip)
            missed = (*h.missed, MissedSwitch(dip.contact, kind, left, dip.depth))
            weight = h.weight + self._missed + float(special.log_ndtr(dip.depth))
            if weight < enough:
                return
            h = h._replace(known=known, weight=weight, missed=missed)

    def switched(self, t: float, known: GaussianState, dip: Dip) -> tuple[GaussianState, Kind]:
        """What is known if a dip, at ``t``, was an impact or a release; and which it was.

        A contact that would leave its stop by less than is known of its gap rests on it.
        """
        closed = known.closed
        if dip.kind is Kind.OPEN:
            stay = tuple(i for i in closed if i != dip.contact)
            return self.filter.missed(ContactChange(t, closed, (), stay), known), Kind.OPEN
        change = ContactChange(t, closed, (dip.contact,), closed)
        after = self.filter.missed(change, known)
        if not self.filter.rests(t, dip.contact, after):
            return after, Kind.IMPACT
        left = max(self.filter.speed(dip.contact, after), 0.0)
        resting = change._replace(closed=tuple(sorted({*closed, dip.contact})))
        return self.filter.missed(resting, known, left), Kind.CLOSE

    def heard(
        self, change: ContactChange, hypotheses: Sequence[Hypothesis], anew: Beginnings
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` after an event, the likeliest first; their probabilities add up to one.

        Args:
            change: the event.
            hypotheses: just before it.
            anew: makes what to believe if nothing that came before can be.
        """
        leading = max(each.whole_weight for each in hypotheses) + LEADING
        branches = [
            branch
            for each in hypotheses
            for branch in self._branches(change, each, leads=each.whole_weight >= leading)
        ]
        branches.sort(key=lambda branch: branch.weight, reverse=True)
        enough = branches[0].weight + NEGLIGIBLE
        likely = [each for each in branches if each.weight >= enough][:MOST]
        made = [each.make() for each in likely]
        made = self._distinct([h for h in made if h.known.is_finite])
        if not (self._sure or branches[0].expected):
            made = sorted([*made, *self._anew(change, made, anew())], key=_weight)
        total = _total(made)
        return tuple(h.weighing(h.weight - total) for h in made)

    def _branches(self, change: ContactChange, h: Hypothesis, *, leads: bool) -> Iterator[_Branch]:
        """What the event may have been to ``h``."""
        here = change.after(h.known.closed)
        if not here.hit and here.before == here.closed:
            yield self._nothing(change, h, "its contact is not closed")
            return
        told, evidence = self._told(change, h, here, self._heard)
        yield told
        for clock in self._beside.get(h.clock, ()) if leads else ():
            yield self._told(change, h._replace(clock=clock), here, self._heard + OTHER)[0]
        depth = max(evidence.innovations.values(), default=-1.0)
        if self._spurious > -math.inf:
            far = f"{depth:.3g} deviations from what was to be expected"
            likelier = "" if depth > SURPRISED else "likelier than an impact "
            yield self._nothing(change, h, f"spurious: {likelier}{far}")
        if leads and depth > SURPRISED and not self._sure:
            for factor in WIDER:
                wider = self.filter.wider(h.known, factor * depth)
                reason = f"believed: the estimate is made {factor * depth:.3g} times less sure"
                yield self._told(change, h._replace(known=wider), here, ANEW, reason)[0]
        impact = len(change.hit) == 1 and here.before == here.closed
        if impact and self._mislabelled > -math.inf and not told.expected:
            yield from self._elsewhere(change, h)

    def _nothing(self, change: ContactChange, h: Hypothesis, reason: str) -> _Branch:
        """Nothing has happened."""
        odds = self._spurious if self._spurious > -math.inf else 0.0
        weight = h.whole_weight + len(change.contacts) * odds

        def make() -> Hypothesis:
            notes = _noted(h, change, (Ruling.REJECTED, reason), {})
            return Hypothesis(h.known, h.clock, weight, notes)

        return _Branch(weight, make)

    def _told(
        self,
        change: ContactChange,
        h: Hypothesis,
        here: ContactChange,
        chance: float,
        reason: str = "",
    ) -> tuple[_Branch, Likelihood]:
        """It was ``here`` that something happened, which had the logarithmic ``chance``."""
        evidence, after = self.filter.told(here, h.known, h.clock)
        contacts = here.contacts
        weight = h.weight + chance + evidence.density
        if h.sunk:
            weight += sum(each for i, each in h.sunk.items() if i not in contacts)

        def make() -> Hypothesis:
            judged = {
                said: evidence.innovations[i]
                for said, i in zip(change.contacts, contacts, strict=False)
                if i in evidence.innovations
            }
            notes = _noted(h, change, (Ruling.APPLIED, reason), judged)
            return Hypothesis(after(), h.clock, weight, notes)

        depth = max(evidence.innovations.values(), default=0.0)
        soon = evidence.density > len(contacts) * self._slow
        return _Branch(weight, make, soon and depth < SURPRISED), evidence

    def _elsewhere(self, change: ContactChange, h: Hypothesis) -> Iterator[_Branch]:
        """It was an impact of another contact."""
        system, closed = self.filter.system, h.known.closed
        others = [i for i in range(system.m) if i not in (*change.hit, *closed)]
        for i in others:
            here = change._replace(before=closed, hit=(i,), closed=closed)
            chance = self._mislabelled - math.log(len(others))
            reason = f"mislabelled: it was {system.contact_names[i]}"
            yield self._told(change, h, here, chance, reason)[0]

    def _anew(
        self, change: ContactChange, made: Sequence[Hypothesis], anew: Sequence[Hypothesis]
    ) -> Iterator[Hypothesis]:
        """New beginnings."""
        total = _total(made)
        ruling = (Ruling.APPLIED, "nothing before it is believed any more")
        notes = _before(change, made[0].notes) if made else ()
        for h in anew:
            begun = Hypothesis(h.known, h.clock, h.weight + total + ANEW, notes)
            yield begun._replace(notes=_noted(begun, change, ruling, {}))

    def _distinct(self, made: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The likeliest of those that make the same of the latest events, in order.

        What they made of older ones has told them nearly the same (N-scan pruning).
        """
        if len(made) == 1:
            return [*made]
        found: dict[object, Hypothesis] = {}
        for h in made:
            same = (h.clock, *(note.gist for note in h.notes[-self._deep :]))
            if same not in found or found[same].weight < h.weight:
                found[same] = h
        return sorted(found.values(), key=_weight)


def _logs(probability: float) -> tuple[float, float]:
    """Logarithms of a probability and of its complement."""
    return (math.log(probability) if probability else -math.inf), math.log1p(-probability)


def _total(hypotheses: Sequence[Hypothesis]) -> float:
    """Logarithm of the sum of probabilities; 0 where there is none."""
    return float(np.logaddexp.reduce([h.weight for h in hypotheses])) if hypotheses else 0.0


def _weight(h: Hypothesis) -> float:
    """To sort by: the likeliest first."""
    return -h.weight


def _before(change: ContactChange, notes: tuple[Note, ...]) -> tuple[Note, ...]:
    """``notes`` without those on the event itself."""
    event = (change.stamp, change.sequence)
    return tuple(n for n in notes if n.event != event or n.is_inserted)


def _noted(
    h: Hypothesis, change: ContactChange, ruling: tuple[Ruling, str], innovations: dict[int, float]
) -> tuple[Note, ...]:
    """The notes of ``h`` after an event: also of what it made of that, and inserted before."""
    event = (change.stamp, change.sequence)
    inserted = [
        Note(
            event,
            change.stamp - round(u.ago * 1e9),
            u.contact,
            Ruling.INSERTED,
            f"{u.kind.name} not heard: the estimate would be {u.surety:.3g} deviations beyond",
        )
        for u in h.missed
    ]
    told = [
        Note(event, change.stamp, i, *ruling, innovations.get(i, -1.0)) for i in change.contacts
    ]
    notes = (*h.notes, *inserted, *told)
    first = max(len(notes) - _REMEMBERED, 0)
    while first and notes[first - 1].event == notes[first].event:
        first -= 1  # an event's notes stay together
    return notes[first:]
