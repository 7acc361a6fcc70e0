# SPDX-License-Identifier: Apache-2.0
"""The event-driven plant: exact flow from one change of its contacts to the next."""

from functools import lru_cache, partial

import numpy as np

from impact_observer.dynamics import (
    KEPT,
    End,
    Grip,
    ImpactLaw,
    Phase,
    PhaseMotion,
    Phases,
    RootSearch,
    Watch,
    Watched,
    ended,
    persistent_contacts,
)
from impact_observer.errors import DynamicsError, ImpactLawError, UsageError
from impact_observer.model.live_signals import LiveSignals, refused
from impact_observer.model.model_source import ModelSource, model_of
from impact_observer.plant.switching import Switching, switches
from impact_observer.plant.zeno import (
    COLLAPSED,
    NEGLIGIBLE,
    AccumulationDetector,
    ZenoCutoff,
)
from impact_observer.stamps import MAX_STAMP, Elapsed, Instant, text, whole_stamp
from impact_observer.states import Stamps, Vector

_INSTANT = 1e-4
"""Longest phase that counts as an instant, relative to the shortest flight."""
_MOST = 1_000
"""Contact changes at one instant that count as endless."""


class Plant:
    """The master system with ordinary unilateral contacts, one phase at a time.

    Attributes:
        system: the simulated system.
        epoch: stamp of ``t = 0`` of the forcing and of the initial state, ns.
        closed: indices of the contacts that are closed in the present phase.
    """

    _watch: Watch
    _motion: PhaseMotion
    _search: RootSearch
    _next: Switching | None

    def __init__(
        self,
        system: ModelSource,
        position: Vector | None = None,
        velocity: Vector | None = None,
        *,
        epoch: int,
        live: LiveSignals | None = None,
        phases: Phases | None = None,
    ) -> None:
        """Start at ``epoch`` (ns) from ``position`` and ``velocity``, shape (n,) each.

        ``system`` may be a model, or the path of a model file; its initial state is taken where
        neither is given. ``live`` are the signals of the system, known at the epoch, where it has
        live ones; ``phases`` those of another plant of the same system, prepared already.

        Raises:
            ModelError: the model file is wrong, or has no initial state that could be taken.
            UsageError: no model, or a state of the wrong size, not finite, or inside a stop.
            ImpactLawError: contacts are closed at the start and their impact has no solution.
        """
        model = model_of(system, "Plant")
        system = model.system
        if position is None or velocity is None:
            if position is not velocity:
                raise UsageError("Plant: position or velocity is missing; expected both, or none")
            position, velocity = model.initial_state()
        epoch = whole_stamp(epoch, "epoch")
        if live is None:
            refused(system, "a plant without signals")
        else:
            live.follow(epoch)
        self._live = live
        q, u = system.checked_start(position, velocity)
        self.system = system
        self.epoch = epoch
        self._law = ImpactLaw(system)
        self._phases = Phases(system) if phases is None else phases
        self._zeno = ZenoCutoff(self._phases)
        self._accumulation = AccumulationDetector(self._zeno.shortest)
        self._instant_changes = 0
        self._watch_of = lru_cache(KEPT)(self._watched)
        self._switches = lru_cache(KEPT)(partial(switches, system))
        self.restart(epoch, np.concatenate([q, u]))

    def restart(self, stamp: int, x: Vector) -> None:
        """Go on from the state ``x`` (q, u) in the system's frame at ``stamp``, ns; all is open.

        Raises:
            ImpactLawError: contacts are closed there and their impact has no solution.
        """
        system, start, (q, u) = self.system, Instant(stamp), np.split(x, 2)
        self._begin(start, x, Grip((), ()))
        if touching := system.closed_at(q):
            switching = self._impact(start, x, touching)
            closing = np.any(system.contact_speed(u)[list(touching)] < 0)
            if closing or switching.closed:
                self._next = switching
            else:  # the contacts separate; only rounding in the gaps is removed
                self._begin(start, switching.after, Grip((), ()))

    def next_switching(self, limit: int) -> Switching | None:
        """The next switching of the contacts, if its stamp is not after ``limit`` (ns).

        A second call before ``cross`` costs nothing.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: changes of contacts at one instant never end.
        """
        limit = min(limit, self.known_until)
        if self._next is None:
            self._next = self._end(limit)
        coming = self._next
        return coming if coming is not None and coming.instant.stamp <= limit else None

    @property
    def known_until(self) -> int:
        """The last stamp up to which all live signals are known, ns; the plant stops there.

        Reading this value uses the samples that have arrived.
        """
        if self._live is None:
            return MAX_STAMP
        self._live.follow(self.epoch)
        self._live.forget_before(self._start.stamp)
        return self._live.known_until - 1

    def cross(self, switching: Switching) -> None:
        """Go on after ``switching``, which must be the one that ``next_switching`` returned."""
        assert switching is self._next, "only the next switching can be crossed"
        self._begin(switching.instant, switching.after, Grip(switching.closed, switching.held))

    def states(self, stamps: Stamps) -> Vector:
        """States (q, u) in the present phase at ``stamps`` (ns), shape (samples, 2n).

        A stamp equal to the last switching's is after it, however its instant was rounded.
        """
        s = (stamps - self._start.stamp) * 1e-9 - self._start.remainder
        states = self._motion.states(np.maximum(s, 0.0))
        if (started := s <= 0).any():
            states[started] = self._state
        return self.system.from_frame(stamps - self.epoch, states)

    def _begin(self, instant: Instant, x: Vector, grip: Grip) -> None:
        self._start = instant
        self.closed = grip.closed
        opened = tuple(i for i in range(self.system.m) if i not in grip.closed)
        self._phase = self._phases.phase(grip.held)
        self._watch = self._watch_of(self._phase, opened)
        self._state = x
        self._motion = self._phase.start(self._time(instant), x)
        self._search = RootSearch(self._watch.guards, self._motion)
        self._next = None

    def _time(self, instant: Instant) -> Elapsed:
        return Elapsed(instant.stamp - self.epoch, instant.remainder)

    def _watched(self, phase: Phase, opened: tuple[int, ...]) -> Watch:
        """The guard functions of a phase: gaps of the contacts ``opened``, and loads."""
        return Watched.gaps(self.system, opened).and_also(Watched.loads(phase)).along(phase)

    def _end(self, limit: int) -> Switching | None:
        """The end of the phase, if its stamp is not after ``limit`` (ns)."""
        crossing = self._search.first(self._start.until(limit) + 0.5e-9)
        if crossing is None or (instant := self._start.shifted_by(crossing[0])).stamp > limit:
            return None
        s, which = crossing
        x, crossed = self._motion.state(s), self._watch.crossed(which)
        self._check_progress(s, instant)
        if hit := self._hit(x, crossed):
            return self._impact(instant, x, tuple(sorted({*self.closed, *hit})))
        switching, phase = self._switched(instant, x, x, (), self.closed), self._phase
        if switching.held != phase.held:
            return switching
        # The load falls too slowly to see its sign, but it may not be negative.
        grip = ended(self._phases, phase, self.closed, crossed[End.LOAD])
        return self._gripped(instant, x, switching.after, (), grip)

    def _hit(self, x: Vector, crossed: dict[End, set[int]]) -> set[int]:
        """The contacts that impact at ``x``.

        A gap that is zero and opens is no impact, where a load ends a phase at its start.
        """
        hit, n = crossed[End.GAP], self.system.n
        if not (hit and crossed[End.LOAD]):
            return hit
        opens = self.system.contact_speed(x[n:]) > self._phases.speed_tolerance(x[n:])
        return {i for i in hit if not opens[i]}

    def _check_progress(self, s: float, instant: Instant) -> None:
        """Raise where contacts change again and again at one instant."""
        self._instant_changes = (
            self._instant_changes + 1 if s <= _INSTANT * self._zeno.shortest else 0
        )
        if self._instant_changes > _MOST:
            raise DynamicsError(
                f"contacts {', '.join(self.system.contact_names)}: {_MOST} changes at stamp"
                f" {text(instant.stamp)} s and no end"
            )

    def _impact(self, instant: Instant, x: Vector, contacts: tuple[int, ...]) -> Switching:
        """The impact of ``contacts``; plastic where their impacts accumulate."""
        n, u = self.system.n, x[self.system.n :]
        try:
            velocity = self._law.velocity_after(u, contacts)
            energy, found, share = self._energy(u), self._accumulation, NEGLIGIBLE
            found.record(instant, contacts, energy)
            accumulating = found.accumulating(instant)
            if not accumulating and found.collapses(contacts):
                is_pressed = self._zeno.is_pressed(self._time(instant), x, contacts)
                accumulating, share = () if is_pressed else contacts, COLLAPSED
            if accumulating:
                near = {*contacts, *(i for i in self.system.closed_at(x[:n]) if i in accumulating)}
                plastic = self._law.plastic.velocity_after(u, tuple(sorted(near)))
                if found.negligible(energy - self._energy(plastic), share):
                    velocity, contacts = plastic, tuple(sorted(near))
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(instant.stamp)} s: {error}") from None
        after = np.concatenate([self._phases.projection.position_after(x[:n], contacts), velocity])
        resting = self._zeno.resting(self._time(instant), after, contacts, x[n:])
        return self._switched(instant, x, after, contacts, resting)

    def _energy(self, u: Vector) -> float:
        return float(u.dot(self._phases.inertia(u))) / 2

    def _switched(
        self,
        instant: Instant,
        before: Vector,
        after: Vector,
        contacts: tuple[int, ...],
        resting: tuple[int, ...],
    ) -> Switching:
        """The switching in which ``resting`` contacts, with ``gamma = 0``, stay closed or open."""
        if resting:
            after = self._phases.stopped(after, resting)
        grip = persistent_contacts(self._phases, (), self._time(instant), after, resting)
        return self._gripped(instant, before, after, contacts, grip)

    def _gripped(
        self,
        instant: Instant,
        before: Vector,
        after: Vector,
        contacts: tuple[int, ...],
        grip: Grip,
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
