"""What an observer carries from one event to the next, and what a law is told of an event."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from impact_observer.dynamics import ImpactLaw
from impact_observer.events import Contacts, Kind
from impact_observer.model import Forcing
from impact_observer.states import Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """What a law takes for possible at one instant.

    Attributes:
        replicas: states (q, u), shape (N, 2n): the estimate, and others that began elsewhere.
        root: a square root ``S`` of the estimate's covariance ``S S^T``, shape (2n, 2n); None for
            a law that has none.
        bound: certified upper bound of V, J; None where nothing is certified.
        refuted: whether events have contradicted what was declared: the bound came below zero.
        innovations: of the event before it, by contact: how far the estimate's gap was from
            zero, in standard deviations.
    """

    replicas: Matrix
    root: Matrix | None = None
    bound: float | None = None
    refuted: bool = False
    innovations: Mapping[int, float] = field(default_factory=dict)

    @property
    def x(self) -> Vector:
        """The estimate (q, u), shape (2n,)."""
        return np.asarray(self.replicas[0])


@dataclass(frozen=True, slots=True)
class Touch:
    """What the plant's contacts do at one instant, as far as a law is told.

    Attributes:
        t: the instant, s since the epoch.
        before: contacts with ``chi = 1`` until now.
        hit: contacts that impact now; none where contacts only open.
        closed: contacts with ``chi = 1`` from now on.
    """

    t: float
    before: Contacts
    hit: Contacts
    closed: Contacts

    @classmethod
    def of(cls, t: float, before: Contacts, switches: Iterable[tuple[int, Kind]]) -> "Touch":
        """What an event at ``t`` means while the contacts ``before`` are closed.

        Args:
            t: s since the epoch.
            before: contacts with ``chi = 1`` until now.
            switches: contacts and how they switch. An impact that is one instant says too that its
                contact is not closed afterwards: an ``OPEN`` was lost.
        """
        kinds = {kind: set[int]() for kind in Kind}
        for contact, kind in switches:
            kinds[kind].add(contact)
        hit = kinds[Kind.IMPACT] | kinds[Kind.CLOSE]
        closed = (set(before) - kinds[Kind.IMPACT] | kinds[Kind.CLOSE]) - kinds[Kind.OPEN]
        return cls(t, before, tuple(sorted(hit)), tuple(sorted(closed)))

    @property
    def active(self) -> Contacts:
        """Contacts with ``chi = 1`` at this instant: closed ones take part in every impact."""
        return tuple(sorted({*self.before, *self.hit}))

    def telling(self, held: Contacts, forcing: Forcing) -> Contacts:
        """The contacts that say something: those that hit, or one alone that opens by itself.

        Its load has come down to zero, unless the force jumps.

        Args:
            held: contacts that took the loads until now.
            forcing: of the system.
        """
        if self.hit:
            return self.hit
        opened = tuple(i for i in self.before if i not in self.closed)
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
        return tuple(sorted({*taking, *(set(self.before) & set(self.closed))}))


class Course(ABC):
    """How a belief goes on until the next event; a function of time alone."""

    @abstractmethod
    def state(self, s: float) -> Vector:
        """The estimate (q, u), shape (2n,), ``s`` seconds after the start."""

    @abstractmethod
    def belief(self, s: float) -> Belief:
        """The whole belief ``s`` seconds after the start."""

    def root(self, s: float) -> Matrix | None:
        """``Belief.root`` after ``s`` seconds, without the other replicas."""
        del s
        return None
