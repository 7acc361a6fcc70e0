# SPDX-License-Identifier: Apache-2.0
"""The event-driven plant: one phase of motion after the other.

A phase has closed contacts, a motion, and guards: the gaps of the open contacts and the loads of
the closed ones. It ends where the first guard falls below zero:

- a gap: an impact of all contacts that are closed then, by Newton's law. It is plastic where
  impacts accumulate. Contacts that come back at once rest (``zeno.py``);
- a load: contacts open.

Then accelerations decide which contacts stay closed, and the next phase begins. A phase without
length is allowed, an endless row of them is an error.
"""

from functools import lru_cache, partial
from typing import NamedTuple, cast

import numpy as np

from impact_observer.dynamics.mechanism import (
    Grip,
    GuardedMotion,
    PhaseEnd,
    mechanism_of,
)
from impact_observer.errors import DynamicsError, ImpactLawError, UsageError
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.model.live_signals import LiveSignals, refused
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.multibody import Multibody, is_multibody, multibody_of
from impact_observer.plant.switching import Switching, switches
from impact_observer.plant.zeno import (
    COLLAPSED,
    NEGLIGIBLE,
    SHORT,
    AccumulationDetector,
    is_pressed,
    resting,
)
from impact_observer.stamps import MAX_STAMP, Elapsed, Instant, text, whole_stamp
from impact_observer.states import Stamps, Vector

_INSTANT = 1e-4
"""Longest phase that counts as an instant, relative to the shortest flight."""
_MOST = 1_000
"""Contact changes at one instant that count as endless."""


class PlantPhase(NamedTuple):
    """A phase of the plant.

    Attributes:
        start: when it begins.
        x: state at its start in the frame in which no stop moves, shape (2n,).
        grip: the closed contacts.
        motion: the motion with its guards.
    """

    start: Instant
    x: Vector
    grip: Grip
    motion: GuardedMotion


class Plant:
    """The master system with ordinary unilateral contacts, one phase at a time.

    Attributes:
        system: the simulated system.
        mechanism: how it moves.
        epoch: stamp of ``t = 0`` of the forcing and of the initial state, ns.
    """

    def __init__(
        self,
        system: Multibody | ModelSource,
        position: Vector | None = None,
        velocity: Vector | None = None,
        *,
        epoch: int,
        live: LiveSignals | None = None,
    ) -> None:
        """Start at ``epoch`` (ns) from ``position`` and ``velocity``, shape (n,) each.

        ``system`` may be a model, or the path of a model file; its initial state is taken where
        neither is given. ``live`` are the signals of the system, known at the epoch, where it has
        live ones.

        Raises:
            ModelError: the model file is wrong, or has no initial state that could be taken.
            UsageError: no model, or a state of the wrong size, not finite, or inside a stop.
            ImpactLawError: contacts are closed at the start and their impact has no solution.
        """
        given, system = system, _system_of(system)
        if position is None or velocity is None:
            if position is not velocity:
                raise UsageError("Plant: position or velocity is missing; expected both, or none")
            position, velocity = model_of(given, "Plant").initial_state()
        self.epoch = whole_stamp(epoch, "epoch")
        self._live = live
        if live is not None:
            live.follow(self.epoch)
        elif system.plant_inputs is not None:
            refused(cast(System, system), "a plant without signals")
        x = np.concatenate(system.checked_start(position, velocity))
        self.system, self.mechanism = system, mechanism_of(system)
        self._shortest = SHORT * self.mechanism.timescale
        self._accumulation = AccumulationDetector(self._shortest)
        self._instant_changes = 0
        self._switches = lru_cache(partial(switches, system.contact_names))
        self._next: Switching | None = None
        self._phase = self._begun(Instant(self.epoch), x, Grip((), ()))
        self._touch(x)

    @property
    def closed(self) -> Contacts:
        """Indices of the contacts that are closed in the present phase."""
        return self._phase.grip.closed

    @property
    def known_until(self) -> int:
        """The last stamp up to which all live signals are known, ns; the plant stops there.

        Reading this value uses the samples that have arrived.
        """
        if self._live is None:
            return MAX_STAMP
        self._live.follow(self.epoch)
        self._live.forget_before(self._phase.start.stamp)
        return self._live.known_until - 1

    def next_switching(self, limit: int) -> Switching | None:
        """The next switching of the contacts, if its stamp is not after ``limit`` (ns).

        A second call before ``cross`` costs nothing.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: the motion cannot be computed, or changes of contacts never end.
        """
        limit = min(limit, self.known_until)
        if self._next is None:
            start = self._phase.start
            end = self._phase.motion.end(start.until(limit) + 0.5e-9)
            if end is None or (instant := start.shifted_by(end.s)).stamp > limit:
                return None
            self._next = self._ended(instant, end)
        return self._next if self._next.instant.stamp <= limit else None

    def cross(self, switching: Switching) -> None:
        """Go on after ``switching``, which must be the one that ``next_switching`` returned."""
        assert switching is self._next, "only the next switching can be crossed"
        grip = Grip(switching.closed, switching.held)
        self._phase, self._next = self._begun(switching.instant, switching.after, grip), None

    def states(self, stamps: Stamps) -> Vector:
        """States (q, u) in the present phase at ``stamps`` (ns), shape (samples, 2n).

        A stamp equal to the last switching's is after it, however its instant was rounded.
        """
        start = self._phase.start
        s = (stamps - start.stamp) * 1e-9 - start.remainder
        states = self._phase.motion.states(np.maximum(s, 0.0))
        if (started := s <= 0).any():
            states[started] = self._phase.x
        return self.system.from_frame(stamps - self.epoch, states)

    def _begun(self, start: Instant, x: Vector, grip: Grip) -> PlantPhase:
        return PlantPhase(start, x, grip, self.mechanism.motion(self._time(start), x, grip))

    def _time(self, instant: Instant) -> Elapsed:
        return Elapsed(instant.stamp - self.epoch, instant.remainder)

    def _touch(self, x: Vector) -> None:
        """At the start, contacts that touch hit, or are about to open."""
        system, start = self.system, self._phase.start
        touching = system.closed_at(x[: system.n])
        if not touching:
            return
        switching = self._impact(start, x, touching)
        if np.any(system.contact_speeds(x)[list(touching)] < 0) or switching.closed:
            self._next = switching
        else:  # the contacts separate; only rounding in the gaps is removed
            self._phase = self._begun(start, switching.after, Grip((), ()))

    def _ended(self, instant: Instant, end: PhaseEnd) -> Switching:
        """The switching at the end of the phase."""
        self._check_progress(end.s, instant)
        x, closed = self._phase.motion.state(end.s), self.closed
        if hit := self._hit(x, end):
            return self._impact(instant, x, tuple(sorted({*closed, *hit})))
        after = self.mechanism.stopped(x, closed)
        ending = self._phase.grip, end.loads
        grip = self.mechanism.grip(self._time(instant), after, closed, ending=ending)
        return self._switched(instant, x, after, (), grip)

    def _hit(self, x: Vector, end: PhaseEnd) -> frozenset[int]:
        """The contacts that impact at ``x``.

        A gap that is zero and opens is no impact, where a load ends a phase at its start.
        """
        if not (end.gaps and end.loads):
            return end.gaps
        still = self.mechanism.pressing(self._time(self._phase.start), x).still(self._kinetic(x))
        opens = self.system.contact_speeds(x) > still
        return frozenset(i for i in end.gaps if not opens[i])

    def _check_progress(self, s: float, instant: Instant) -> None:
        """Raise where contacts change again and again at one instant."""
        self._instant_changes = self._instant_changes + 1 if s <= _INSTANT * self._shortest else 0
        if self._instant_changes > _MOST:
            raise DynamicsError(
                f"contacts {', '.join(self.system.contact_names)}: {_MOST} changes at stamp"
                f" {text(instant.stamp)} s and no end"
            )

    def _impact(self, instant: Instant, x: Vector, contacts: Contacts) -> Switching:
        """The impact of ``contacts``; plastic where their impacts accumulate."""
        mechanism, t, energy = self.mechanism, self._time(instant), self._kinetic(x)
        try:
            after = mechanism.struck(x, contacts)
            self._accumulation.record(instant, contacts, energy)
            near, share = self._collapsing(instant, x, contacts)
            if near:
                plastic = mechanism.struck(x, near, plastic=True)
                if self._accumulation.negligible(energy - self._kinetic(plastic), share):
                    after, contacts = plastic, near
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(instant.stamp)} s: {error}") from None
        here, gamma = mechanism.pressing(t, after), self.system.contact_speeds(after)
        rest = resting(here, gamma, here.still(energy), contacts, self._shortest)
        if not rest:
            return self._switched(instant, x, after, contacts, Grip((), ()))
        after = mechanism.stopped(after, rest)
        return self._switched(instant, x, after, contacts, mechanism.grip(t, after, rest))

    def _collapsing(
        self, instant: Instant, x: Vector, contacts: Contacts
    ) -> tuple[Contacts, float]:
        """Contacts that a plastic impact might bring to rest; share of energy that it may take."""
        accumulation, share = self._accumulation, NEGLIGIBLE
        accumulating = accumulation.accumulating(instant)
        if not accumulating and accumulation.collapses(contacts):
            here = self.mechanism.pressing(self._time(instant), x)
            if not is_pressed(here, here.still(self._kinetic(x)), contacts, self._shortest):
                accumulating, share = contacts, COLLAPSED
        if not accumulating:
            return (), share
        touching = self.system.closed_at(x[: self.system.n])
        near = {*contacts, *(i for i in touching if i in accumulating)}
        return tuple(sorted(near)), share

    def _kinetic(self, x: Vector) -> float:
        return float(self.mechanism.kinetic(x))

    def _switched(
        self, instant: Instant, before: Vector, after: Vector, contacts: Contacts, grip: Grip
    ) -> Switching:
        return Switching(
            instant=instant,
            contacts=contacts,
            closed=grip.closed,
            held=grip.held,
            before=before,
            after=after,
            switches=self._switches(self.closed, contacts, grip.closed),
        )


def _system_of(source: Multibody | ModelSource) -> Multibody:
    """The system that a plant is given, or that of a model."""
    if is_multibody(source):
        return source
    return multibody_of(model_of(source, "Plant"))
