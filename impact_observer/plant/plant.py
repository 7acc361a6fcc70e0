"""The event-driven plant: exact flow from impact to impact."""

from dataclasses import dataclass

import numpy as np

from impact_observer.dynamics import Closing, ContactSearch, ImpactLaw, flow_of
from impact_observer.errors import ImpactLawError, LastingContactError, UsageError
from impact_observer.events import ImpactEvent, Switch
from impact_observer.model import System
from impact_observer.stamps import Instant, seconds_between, text
from impact_observer.states import Stamps, Vector

_SHORTEST_FLIGHT = 1e-8
"""Time between two impacts of a contact below which they accumulate, s."""


@dataclass(frozen=True, slots=True, eq=False)
class Impact:
    """Contacts that hit at one instant.

    Attributes:
        instant: when.
        contacts: indices of all contacts that are closed at the instant.
        before: state (q, u-), shape (2n,).
        after: state (q, u+), shape (2n,).
    """

    instant: Instant
    contacts: tuple[int, ...]
    before: Vector
    after: Vector


class Plant:
    """The master system with ordinary unilateral contacts, one phase at a time.

    Attributes:
        system: what moves.
        epoch: stamp of ``t = 0`` of the forcing and of the initial state, ns.
    """

    _closing: Closing | None
    _next: Impact | None
    _windows: int

    def __init__(self, system: System, position: Vector, velocity: Vector, *, epoch: int) -> None:
        """Start at ``epoch`` (ns) from ``position`` and ``velocity``, shape (n,) each.

        Raises:
            UsageError: a state of the wrong size, not finite, or inside a stop.
            LastingContactError: a contact is closed at the start and stays so.
        """
        q, u = system.checked_state(position, velocity)
        self.system = system
        self.epoch = epoch
        self._law = ImpactLaw(system)
        self._search = ContactSearch(system)
        self._flow = flow_of(system)
        gap = system.gap(q)
        for i in system.penetrated(q):
            raise UsageError(
                f"position: is inside the stop {system.contact_names[i]!r} (gap {gap[i]:g});"
                " expected gap >= 0"
            )
        touching = tuple(np.flatnonzero(gap <= 0).tolist())
        self._begin(Instant(epoch), np.concatenate([q, u]), touching, u)

    def next_impact(self, limit: int) -> Impact | None:
        """The next impact if its stamp is not after ``limit`` (ns).

        Asking again, with any limit, costs nothing where it has been looked already.

        Raises:
            LastingContactError: a contact stays closed, or impacts accumulate.
            ImpactLawError: the impact law has no solution.
        """
        horizon, window = self._start.until(limit) + 0.5e-9, self._search.window
        # Whole windows from the phase's start: what is found does not depend on who asks when.
        while self._closing is None and self._windows * window <= horizon:
            start, self._windows = self._windows * window, self._windows + 1
            stop = self._windows * window
            self._closing = self._search.first_closing(self._motion, stop, start)
        if self._closing is None or self._start.after(self._closing.s).stamp > limit:
            return None
        if self._next is None:
            self._next = self._impact(self._closing)
        return self._next

    def cross(self, impact: Impact) -> None:
        """Go on after ``impact``, which must be the one that ``next_impact`` told."""
        assert impact is self._next, "only the next impact can be crossed"
        before = impact.before[self.system.n :]
        self._begin(impact.instant, impact.after, impact.contacts, before)

    def states(self, stamps: Stamps) -> Vector:
        """States (q, u) in the present phase at ``stamps`` (ns), shape (samples, 2n).

        A stamp equal to the last impact's is after it, however the impact was rounded.
        """
        s = (stamps - self._start.stamp) * 1e-9 - self._start.remainder
        return self._motion.states(np.maximum(s, 0.0))

    def _begin(
        self, instant: Instant, x: Vector, touching: tuple[int, ...], before: Vector
    ) -> None:
        """Begin a phase at ``instant`` from state ``x``; velocities were ``before``."""
        self._start = instant
        self._motion = self._flow.start(self._time(instant), x)
        self._windows = 0
        self._closing = None
        self._next = None
        rounding = 1e-12 * (np.abs(self.system.W).T @ np.abs(before))
        self._refuse_lasting_contact(instant, x, touching, rounding)

    def _time(self, instant: Instant) -> float:
        """Seconds since the epoch."""
        return seconds_between(self.epoch, instant.stamp) + instant.remainder

    def _impact(self, closing: Closing) -> Impact:
        n, contacts = self.system.n, closing.contacts
        instant = self._start.after(closing.s)
        before = self._motion.state(closing.s)
        try:
            velocity = self._law.velocity_after(before[n:], contacts)
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(instant.stamp)} s: {error}") from None
        return Impact(instant, contacts, before, np.concatenate([before[:n], velocity]))

    def _refuse_lasting_contact(
        self, instant: Instant, x: Vector, touching: tuple[int, ...], rounding: Vector
    ) -> None:
        """Raise where a contact does not get away from its stop; ``rounding`` is of its speed."""
        system = self.system
        q, u = x[: system.n], x[system.n :]
        gamma = system.contact_speed(u)
        load = system.forcing(self._time(instant)) - system.C @ u - system.K @ q
        acceleration = system.W.T @ np.linalg.solve(system.M, load)
        for i in touching:
            falls_back = 2 * max(gamma[i], 0.0) <= -acceleration[i] * _SHORTEST_FLIGHT
            if gamma[i] >= -rounding[i] and acceleration[i] < 0 and falls_back:
                raise LastingContactError(
                    f"contact {system.contact_names[i]!r}: closes for good, or its impacts"
                    f" accumulate, at stamp {text(instant.stamp)} s"
                    f" (t = {self._time(instant):.9f} s); lasting contact is not supported yet"
                )


def event_of(
    impact: Impact, system: System, *, sequence: int, episode: int, epoch: int
) -> ImpactEvent:
    """What an ideal sensor tells of ``impact``: contacts and the stamp, rounded to 1 ns."""
    switches = tuple(Switch(system.contact_names[i]) for i in impact.contacts)
    return ImpactEvent(impact.instant.stamp, switches, sequence, episode, epoch)
