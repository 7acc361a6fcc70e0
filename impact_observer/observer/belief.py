"""What an observer carries from one event to the next, and what a law is told of an event."""

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from itertools import takewhile
from types import MappingProxyType
from typing import ClassVar, NamedTuple

import numpy as np

from impact_observer.dynamics import ImpactLaw
from impact_observer.events import Contacts, Kind, Ruling
from impact_observer.model import Forcing
from impact_observer.observer.ensemble import Differences, Ensemble
from impact_observer.states import Matrix, Vector

_NOTHING: Mapping[int, float] = MappingProxyType({})


class Known(NamedTuple):
    """A state and how surely it is known.

    Attributes:
        x: the estimate (q, u), shape (2n,).
        slow: what stays between events, shape (k,): the parameters theta that are learnt, then,
            where it is unknown, what the sensor's stamps are late by.
        root: a square root ``S`` of the covariance ``S S^T`` of (q, u, slow), shape (2n + k, any).
        apart: (q, u, slow) of replicas that began elsewhere, less the estimate's, one a column,
            shape (2n + k, N - 1).
        closed: contacts that are closed.
        parameters: how many are learnt, k or k - 1.
    """

    x: Vector
    slow: Vector
    root: Matrix
    apart: Matrix
    closed: Contacts = ()
    parameters: int = 0

    @classmethod
    def of(cls, replicas: Matrix, root: Matrix, closed: Contacts = ()) -> "Known":
        """With nothing slow, or with an offset of 0 where ``root`` has a row for it.

        Args:
            replicas: states (q, u), shape (N, 2n), the estimate first.
            root: as of ``Known``.
            closed: likewise.
        """
        size = replicas.shape[1]
        apart = np.zeros((len(root), len(replicas) - 1))
        apart[:size] = (replicas[1:] - replicas[0]).T
        return cls(replicas[0], np.zeros(len(root) - size), root, apart, closed)

    @property
    def theta(self) -> Vector:
        """The estimate's parameters, shape (p,)."""
        return np.asarray(self.slow[: self.parameters])

    @property
    def offset(self) -> float:
        """What the sensor's stamps are late by to the estimate, s."""
        p = self.parameters
        return float(self.slow[p]) if self.slow.size > p else 0.0

    @property
    def ensemble(self) -> Ensemble:
        """The states of all replicas."""
        return Ensemble(self.x, Differences(self.apart[: self.x.size]))

    @property
    def is_finite(self) -> bool:
        """Whether the states of all replicas are."""
        if not math.isfinite(self.x.dot(self.x)):
            return False
        return not self.apart.size or bool(np.isfinite(self.apart).all())

    def carried(self, x: Vector, map_: Matrix, turn: Matrix | None = None) -> "Known":
        """What ``map_`` makes of errors, and ``x`` of the estimate itself.

        Args:
            x: the estimate (q, u) afterwards, shape (2n,).
            map_: shape (2n, 2n).
            turn: how the state changes with the parameters, shape (2n, p); None where it does not.
        """
        root = carried(self.root, 0, map_, turn)
        apart = carried(self.apart, 0, map_, turn)
        return Known(x, self.slow, root, apart, self.closed, self.parameters)


def carried(errors: Matrix, first: int, map_: Matrix, turn: Matrix | None = None) -> Matrix:
    """What a map of states makes of errors of more than a state.

    Args:
        errors: one a column, shape (d, any); after the state's rows come the parameters'.
        first: of the state's rows.
        map_: shape (2n, 2n).
        turn: how the state changes with the parameters, shape (2n, p); None where it does not.
    """
    found: Matrix
    if len(errors) == len(map_):
        found = map_.dot(errors)
        return found
    last, found = first + len(map_), errors.copy()
    found[first:last] = map_.dot(errors[first:last])
    if turn is not None:
        found[first:last] += turn.dot(errors[last : last + turn.shape[1]])
    return found


class Note(NamedTuple):
    """What a law made of one contact in one event, or inserted itself.

    Attributes:
        event: stamp (ns) and sequence of the event with which it was noted.
        stamp: when it was, ns: of the event, but for what was inserted.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty when all is as it should be.
        innovation: in standard deviations; -1 where there is none.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0

    @property
    def is_inserted(self) -> bool:
        """Whether the law inserted it."""
        return self.ruling is Ruling.INSERTED

    @property
    def gist(self) -> tuple[object, ...]:
        """What it says, but for figures."""
        return self.event, self.contact, self.ruling, self.reason[:5]


class Unheard(NamedTuple):
    """A switching that was predicted and not heard.

    Attributes:
        contact: index.
        kind: how it switches.
        ago: when, seconds before the event that came then.
        surety: depth that the contact would have reached without it, in standard deviations.
    """

    contact: int
    kind: Kind
    ago: float
    surety: float


class Hypothesis(NamedTuple):
    """One way in which the events may have come about, and what follows from it.

    Attributes:
        known: the state, and how surely.
        clock: standard deviation of a stamp, s.
        weight: logarithm of its probability.
        notes: what it makes of the latest events, in their order.
        sunk: contacts of which something is below zero that must not be, with the logarithm of
            the probability that this is an error of the estimate.
        unheard: what has switched unheard since the last event.
    """

    known: Known
    clock: float
    weight: float = 0.0
    notes: tuple[Note, ...] = ()
    sunk: Mapping[int, float] = _NOTHING
    unheard: tuple[Unheard, ...] = ()

    @property
    def whole_weight(self) -> float:
        """Its weight, and that of what it has fallen through."""
        return self.weight + sum(self.sunk.values()) if self.sunk else self.weight

    def knowing(self, known: Known) -> "Hypothesis":
        """The same account, with the state as it is ``known``."""
        return Hypothesis(known, self.clock, self.weight, self.notes, self.sunk, self.unheard)

    def weighing(self, weight: float) -> "Hypothesis":
        """The same, with another ``weight``."""
        return Hypothesis(self.known, self.clock, weight, self.notes, self.sunk, self.unheard)

    def noted(self, event: tuple[int, int]) -> list[Note]:
        """Its notes on the contacts of ``event``, which is the latest."""
        latest = takewhile(lambda note: note.event == event, reversed(self.notes))
        return [note for note in latest if not note.is_inserted][::-1]


class Fallback(NamedTuple):
    """Where to begin anew if nothing is believed any more.

    Attributes:
        x: (q, u) of a replica that never goes far astray, shape (2n,).
        reach: the largest that each of its numbers was, or may have been at first, shape (2n,).
    """

    x: Vector
    reach: Vector


class Belief(NamedTuple):
    """What a law takes for possible at one instant.

    Attributes:
        ensemble: the estimate, and replicas that began elsewhere.
        root: a square root ``S`` of the estimate's covariance ``S S^T``, shape (2n, 2n); None for
            a law that has none.
        bound: certified upper bound of V, J; None where nothing is certified.
        refuted: whether events have contradicted what was declared: the bound came below zero.
        innovations: of the event before it, by contact: how far the estimate's gap was from
            zero, in standard deviations.
        applied: whether the law took the event for what it is said to be.
        offset: what the sensor's stamps are believed to be late by, s.
        learnt: what was learnt besides the state: name, value, standard deviation, SI units.
        hypotheses: for a law that carries several, the likeliest first; none for others. The
            estimate is that of the first, the covariance that of all together.
        fallback: where such a law begins anew; None for others.
    """

    ensemble: Ensemble
    root: Matrix | None = None
    bound: float | None = None
    refuted: bool = False
    innovations: Mapping[int, float] = _NOTHING
    applied: bool = True
    offset: float = 0.0
    learnt: tuple[tuple[str, float, float], ...] = ()
    hypotheses: tuple[Hypothesis, ...] = ()
    fallback: Fallback | None = None

    @property
    def x(self) -> Vector:
        """The estimate (q, u), shape (2n,)."""
        return self.ensemble.x

    @property
    def replicas(self) -> Matrix:
        """States (q, u), shape (N, 2n), the estimate first."""
        return self.ensemble.replicas


class Touch(NamedTuple):
    """What the plant's contacts do at one instant, as far as a law is told.

    Attributes:
        t: the instant, s since the epoch.
        before: contacts with ``chi = 1`` until now.
        hit: contacts that impact now; none where contacts only open.
        closed: contacts with ``chi = 1`` from now on.
        stamp: of the event, ns; 0 where nobody asks.
        sequence: of the event.
    """

    t: float
    before: Contacts
    hit: Contacts
    closed: Contacts
    stamp: int = 0
    sequence: int = 0

    @classmethod
    def of(
        cls,
        t: float,
        before: Contacts,
        switches: Collection[tuple[int, Kind]],
        *,
        stamp: int = 0,
        sequence: int = 0,
    ) -> "Touch":
        """What an event at ``t`` means while the contacts ``before`` are closed.

        Args:
            t: s since the epoch.
            before: contacts with ``chi = 1`` until now.
            switches: contacts and how they switch. An impact that is one instant says too that its
                contact is not closed afterwards: an ``OPEN`` was lost.
            stamp: of the event, ns; 0 where nobody asks.
            sequence: of the event.
        """
        if not before and len(switches) == 1:
            ((contact, kind),) = switches
            if kind is Kind.IMPACT:  # as nearly always
                return cls(t, before, (contact,), before, stamp, sequence)
        hit = {contact for contact, kind in switches if kind is not Kind.OPEN}
        stay = {contact for contact, kind in switches if kind is Kind.CLOSE}
        opened = {contact for contact, kind in switches if kind is Kind.OPEN}
        closed = ({*before} - (hit - stay) | stay) - opened
        return cls(t, before, tuple(sorted(hit)), tuple(sorted(closed)), stamp, sequence)

    def after(self, before: Contacts) -> "Touch":
        """The same event where other contacts were closed before it."""
        if before == self.before:
            return self
        stay = set(self.closed) & set(self.hit) | set(before) - set(self.hit)
        opened = set(self.before) - set(self.closed)
        return self._replace(before=before, closed=tuple(sorted(stay - opened)))

    @property
    def opened(self) -> Contacts:
        """Contacts that were closed and are no more."""
        return tuple(i for i in self.before if i not in self.closed)

    @property
    def contacts(self) -> Contacts:
        """All of which the event speaks: those that hit, and those that open."""
        opened = self.opened
        return tuple(sorted({*self.hit, *opened})) if opened else self.hit

    @property
    def active(self) -> Contacts:
        """Contacts with ``chi = 1`` at this instant: closed ones take part in every impact."""
        return tuple(sorted({*self.before, *self.hit})) if self.before else self.hit

    def telling(self, held: Contacts, forcing: Forcing) -> Contacts:
        """The contacts that say something: those that hit, or one alone that opens by itself.

        Its load has come down to zero, unless the force jumps.

        Args:
            held: contacts that took the loads until now.
            forcing: of the system.
        """
        if self.hit:
            return self.hit
        opened = self.opened
        jumps = forcing.sampled is not None and forcing.sampled.hold == "previous"
        return opened if len(opened) == 1 and opened[0] in held and not jumps else ()

    def pressed(self, newton: ImpactLaw, gamma: Vector) -> Contacts:
        """The contacts that take an impulse; those that stay closed have no speed afterwards.

        Args:
            newton: the impact law.
            gamma: speeds of those hit, shape (len(hit),), m/s; see ``ImpactLaw.pressed``.

        Raises:
            ImpactLawError: the law has no solution on these contacts.
        """
        taking = newton.pressed(self.active, self.hit, gamma)
        stay = set(self.before) & set(self.closed)
        return tuple(sorted({*taking, *stay})) if stay else taking


class Course(ABC):
    """How a belief goes on until the next event; a function of time alone.

    Attributes:
        is_plain: whether it has neither ``root`` nor ``closed``: nothing but the state changes.
    """

    is_plain: ClassVar[bool] = False

    @abstractmethod
    def state(self, s: float) -> Vector:
        """The estimate (q, u), shape (2n,), ``s`` seconds after the start."""

    def states(self, s: Vector) -> Matrix:
        """``state`` after each of ``s`` seconds, in every bit, shape (samples, 2n)."""
        return np.array([self.state(at) for at in s.tolist()])

    @abstractmethod
    def belief(self, s: float) -> Belief:
        """The whole belief ``s`` seconds after the start."""

    def root(self, s: float) -> Matrix | None:
        """``Belief.root`` after ``s`` seconds, without the other replicas."""
        del s
        return None

    def closed(self, s: float) -> Contacts | None:
        """Contacts that the estimate holds closed after ``s`` seconds; None for those told."""
        del s
        return None
