# SPDX-License-Identifier: Apache-2.0
"""The plant by time stepping: a second integrator, independent of the first.

``docs/theory/method.md`` says how the steps of Moreau's scheme become events.
"""

import math
from dataclasses import dataclass

import numpy as np

from impact_observer.dynamics.contact.moreau import MoreauScheme, TimeStep
from impact_observer.errors import UsageError
from impact_observer.model import System
from impact_observer.model.live_signals import refused
from impact_observer.plant.switching import Switching, switches
from impact_observer.stamps import MAX_STAMP, NS_PER_S, Instant, whole_stamp
from impact_observer.states import Stamps, Vector


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A position in the sequence of steps: between step ``done`` and the next one.

    Attributes:
        k: number of steps done since the epoch.
        done: the last step done; before the first step, a step without motion.
        coming: the next step.
    """

    k: int
    done: TimeStep
    coming: TimeStep

    def next(self, scheme: MoreauScheme) -> "_Place":
        """The place one step later."""
        after = scheme.step(self.k + 1, self.coming.q, self.coming.u)
        return _Place(self.k + 1, self.coming, after)


class TimeSteppingPlant:
    """The master system with ordinary unilateral contacts, one step at a time.

    The interface is that of ``Plant``. Memory does not grow: ``states`` repeats the steps.

    Attributes:
        system: the simulated system.
        epoch: stamp of ``t = 0`` of the forcing and of the initial state, ns.
        step: length of the steps, ns; step ``k`` ends at ``epoch + k step`` exactly.
        closed: contacts that are closed in the present phase, as indices.
    """

    closed: tuple[int, ...]
    _next: Switching | None
    _start: _Place
    _ahead: _Place
    _behind: _Place

    def __init__(
        self, system: System, position: Vector, velocity: Vector, *, epoch: int, step: float
    ) -> None:
        """Start at ``epoch`` (ns) from ``position`` and ``velocity``, shape (n,) each.

        The ``step`` (s) is rounded to whole nanoseconds.

        Raises:
            UsageError: a state of the wrong size, not finite, or inside a stop; a step that is not
                finite or shorter than 1 ns.
            ImpactLawError: the law has no solution in the first step.
        """
        refused(system, "the integrator moreau")
        q, u = system.checked_start(position, velocity)
        self.system = system
        self.epoch = epoch = whole_stamp(epoch, "epoch")
        if not math.isfinite(step) or round(step * NS_PER_S) < 1:
            raise UsageError(f"step: is {step:g} s; expected at least 1e-09 s")
        self.step = round(step * NS_PER_S)
        self.closed = ()
        self._scheme = MoreauScheme(system, self.step / NS_PER_S)
        nothing = TimeStep(q, u, u, np.zeros(system.m), ())
        self._begin(_Place(0, nothing, self._scheme.step(0, q, u)))

    @property
    def known_until(self) -> int:
        """The latest stamp: this plant has no live signals."""
        return MAX_STAMP

    def next_switching(self, limit: int) -> Switching | None:
        """The next switching if its stamp is not after ``limit`` (ns).

        A second call before ``cross`` costs nothing.

        Raises:
            ImpactLawError: the law has no solution in a step that begins up to ``limit``.
        """
        while self._next is None and self._stamp(self._ahead.k + 1) <= limit:
            self._ahead = self._ahead.next(self._scheme)
            self._next = self._switching(self._ahead)
        coming = self._next
        return coming if coming is not None and coming.instant.stamp <= limit else None

    def cross(self, switching: Switching) -> None:
        """Go on after ``switching``, which must be the one that ``next_switching`` returned."""
        assert switching is self._next, "only the next switching can be crossed"
        self.closed = switching.closed
        self._begin(self._ahead)

    def states(self, stamps: Stamps) -> Vector:
        """States (q, u) in the present phase at ``stamps`` (ns), shape (samples, 2n).

        At the end of a step they are the scheme's, after its impulses: at a switching's stamp the
        state is after it. Within a step the velocity is linear and the position its integral.
        In a step that ends with an impact the velocity goes linearly to that before the impact and
        the position linearly to that at the impact. A stamp before the phase counts as its start;
        beyond its end the contacts stay as in its last step. The cost is that of the steps passed;
        stamps that go back repeat the phase from its start.
        """
        steps = np.maximum((stamps - self.epoch) // self.step, self._start.k)
        inside = np.maximum(stamps - self.epoch - steps * self.step, 0) / self.step
        states = np.empty((stamps.size, 2 * self.system.n))
        ascending = np.argsort(steps, kind="stable")
        numbers, first = np.unique(steps[ascending], return_index=True)
        for k, at in zip(numbers.tolist(), np.split(ascending, first[1:]), strict=False):
            if self._behind.k > k:
                self._behind = self._start
            while self._behind.k < k:
                self._behind = self._behind.next(self._scheme)
            states[at] = self._within(self._behind, inside[at])
        return self.system.from_frame(stamps - self.epoch, states)

    def _begin(self, place: _Place) -> None:
        self._start = self._behind = self._ahead = place
        self._next = None

    def _stamp(self, k: int) -> int:
        return self.epoch + k * self.step

    def _within(self, place: _Place, part: Vector) -> Vector:
        """States after each ``part``, in [0, 1), of the step that begins at ``place``."""
        q, u, end = place.done.q, place.done.u, place.coming
        part = part[:, None]
        if set(end.closed) <= set(self.closed):
            position = q + self._scheme.h * part * (u + part / 2 * (end.u - u))
            return np.hstack([position, u + part * (end.u - u)])
        return np.hstack([q + part * (end.q - q), u + part * (end.free - u)])

    def _switching(self, place: _Place) -> Switching | None:
        """The switching at ``place``, by the rule in ``docs/theory/method.md``."""
        done, coming, was_closed = place.done, place.coming, set(self.closed)
        closing = was_closed.union(done.closed)
        hit, hit_next = closing > was_closed, not closing.issuperset(coming.closed)
        staying = was_closed.union(coming.closed) if hit_next else set(coming.closed)
        closed = tuple(sorted(closing & staying))
        if not hit and closed == self.closed:
            return None
        contacts = tuple(sorted(closing)) if hit else ()
        return Switching(
            instant=Instant(self._stamp(place.k)),
            contacts=contacts,
            closed=closed,
            held=tuple(i for i in closed if coming.impulses[i] > 0),
            before=np.concatenate([done.q, done.free if hit else done.u]),
            after=np.concatenate([done.q, done.u]),
            switches=switches(self.system, self.closed, contacts, closed),
        )
