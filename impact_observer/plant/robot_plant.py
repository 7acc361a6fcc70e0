# SPDX-License-Identifier: Apache-2.0
"""The plant of a robot: motion from one change of its contacts to the next."""

from functools import partial

import numpy as np

from impact_observer.errors import DynamicsError, ImpactLawError
from impact_observer.events import Contacts
from impact_observer.plant.robot_flight import GuardSet, RobotFlight, held_state
from impact_observer.plant.robot_rest import RobotRest
from impact_observer.plant.switching import Switching, switches
from impact_observer.plant.zeno import COLLAPSED, NEGLIGIBLE, AccumulationDetector
from impact_observer.robots.robot import Robot
from impact_observer.stamps import MAX_STAMP, Elapsed, Instant, text, whole_stamp
from impact_observer.states import Matrix, Stamps, Vector

_MOST = 1_000
"""Contact changes at one instant that count as endless."""
_INSTANT = 1e-4
"""Longest phase that counts as an instant, relative to the shortest flight."""
_LOAD = 1e-11
"""Load below zero that counts as rounding, relative to the largest of the phase's start."""


class RobotPlant:
    """A robot with ordinary unilateral contacts, one phase at a time.

    The interface is that of ``Plant``.

    Attributes:
        system: the robot.
        epoch: stamp of ``t = 0`` of the forcing and of the initial state, ns.
        closed: indices of the contacts that are closed in the present phase.
    """

    closed: Contacts
    _next: Switching | None
    _crossing: tuple[float, int] | None

    def __init__(self, robot: Robot, position: Vector, velocity: Vector, *, epoch: int) -> None:
        """Start at ``epoch`` (ns) from ``position`` and ``velocity``, shape (n,) each.

        Raises:
            UsageError: a state of the wrong size, not finite, or inside a plane.
            ImpactLawError: contacts are closed at the start and their impact has no solution.
        """
        q, u = robot.checked_start(position, velocity)
        self.system = robot
        self.epoch = whole_stamp(epoch, "epoch")
        self._rest = RobotRest(robot)
        self._accumulation = AccumulationDetector(self._rest.shortest)
        self._instant_changes = 0
        start = Instant(self.epoch)
        self._begin(start, np.concatenate([q, u]), ())
        if touching := robot.closed_at(q):
            switching = self._impact(start, self._state, touching)
            closing = np.any(robot.contact_speeds(self._state)[list(touching)] < 0)
            if closing or switching.closed:
                self._next = switching
            else:  # the contacts separate; only rounding in the gaps is removed
                self._begin(start, switching.after, ())

    @property
    def known_until(self) -> int:
        """The latest stamp: this plant has no live signals."""
        return MAX_STAMP

    def next_switching(self, limit: int) -> Switching | None:
        """The next switching of the contacts, if its stamp is not after ``limit`` (ns).

        A second call before ``cross`` costs nothing.

        Raises:
            ImpactLawError: the impact law has no solution.
            DynamicsError: the motion cannot be computed, or changes of contacts never end.
        """
        if self._next is None:
            self._next = self._soon(limit)
        coming = self._next
        return coming if coming is not None and coming.instant.stamp <= limit else None

    def cross(self, switching: Switching) -> None:
        """Go on after ``switching``, which must be the one that ``next_switching`` returned."""
        assert switching is self._next, "only the next switching can be crossed"
        self._begin(switching.instant, switching.after, switching.closed)

    def states(self, stamps: Stamps) -> Vector:
        """States (q, u) in the present phase at ``stamps`` (ns), shape (samples, 2n).

        A stamp equal to the last switching's is after it, however its instant was rounded.
        """
        s = np.maximum((stamps - self._start.stamp) * 1e-9 - self._start.remainder, 0.0)
        found = self._flight.states(s)
        if s.size:
            self._flight.forget_before(float(s.min()))
        return found

    def _begin(self, instant: Instant, x: Vector, closed: Contacts) -> None:
        self._start, self._state, self.closed = instant, x, closed
        time = Elapsed(instant.stamp - self.epoch, instant.remainder)
        self._flight = RobotFlight(self.system, time, x, closed)
        self._opened = tuple(i for i in range(self.system.m) if i not in closed)
        robot, loads = self.system, np.zeros(0)
        if closed:
            n, tau = robot.n, self._flight.torques(0.0)
            loads = robot.loads(x[:n], x[n:], tau, closed)
        tolerance = np.concatenate(
            [
                self._rest.lowest[list(self._opened)],
                np.full(len(closed), _LOAD * float(np.max(np.abs(loads), initial=0.0))),
            ]
        )
        self._guards = GuardSet(self._guard_values, tolerance)
        self._crossing = None
        self._next = None

    def _guard_values(self, states: Matrix, times: Vector) -> Matrix:
        """Gaps, and loads of closed contacts."""
        robot, n = self.system, self.system.n
        values = np.empty((self._guards.tolerance.size, times.size))
        for k, (x, s) in enumerate(zip(states.T, times.tolist(), strict=True)):
            gaps = robot.gaps(x[:n], self._opened)
            values[: gaps.size, k] = gaps
            if self.closed:
                tau = self._flight.torques(s)
                values[gaps.size :, k] = robot.loads(x[:n], x[n:], tau, self.closed)
        return values

    def _soon(self, limit: int) -> Switching | None:
        """The next switching, if it is computed or its stamp is not after ``limit`` (ns)."""
        if self._crossing is None:
            until = self._start.until(limit) + 0.5e-9
            self._crossing = self._flight.first_crossing(self._guards, until)
        return self._end(limit)

    def _end(self, limit: int) -> Switching | None:
        """The end of the phase, if it is computed and its stamp is not after ``limit`` (ns)."""
        if self._crossing is None or self._start.shifted_by(self._crossing[0]).stamp > limit:
            return None
        s, which = self._crossing
        instant, x = self._start.shifted_by(s), self._flight.state(s)
        self._check_progress(s, instant)
        opened = len(self._opened)
        if which < opened:
            return self._impact(instant, x, tuple(sorted({*self.closed, self._opened[which]})))
        released = self.closed[which - opened]
        x = held_state(self.system, x, self.closed)
        kept = tuple(i for i in self.closed if i != released)
        tau = self._flight.torques(s)
        return self._switched(instant, x, x, (), self._rest.staying(x, tau, kept))

    def _impact(self, instant: Instant, x: Vector, contacts: Contacts) -> Switching:
        """The impact of ``contacts``; plastic where their impacts accumulate."""
        robot, n = self.system, self.system.n
        q, u = x[:n], x[n:]
        energy, found, share = partial(robot.kinetic_energy, q), self._accumulation, NEGLIGIBLE
        try:
            velocity = robot.velocity_after(q, u, contacts)
            found.record(instant, contacts, energy(u))
            accumulating = found.accumulating(instant)
            if not accumulating and found.collapses(contacts):
                accumulating, share = contacts, COLLAPSED
            if accumulating:
                near = (*contacts, *(i for i in robot.closed_at(q) if i in accumulating))
                near = tuple(sorted({*near}))
                plastic = robot.velocity_after(q, u, near, plastic=True)
                if found.negligible(energy(u) - energy(plastic), share):
                    velocity, contacts = plastic, near
        except ImpactLawError as error:
            raise ImpactLawError(f"at {text(instant.stamp)} s: {error}") from None
        after = np.concatenate([robot.projected(q, contacts), velocity])
        tau = self._torques(instant)
        resting = self._rest.resting(after, tau, contacts, x)
        if resting:
            after = held_state(robot, after, resting)
            resting = self._rest.staying(after, tau, resting)
        return self._switched(instant, x, after, contacts, resting)

    def _torques(self, instant: Instant) -> Vector:
        return self._flight.torques(self._start.until(instant.stamp) + instant.remainder)

    def _switched(
        self, instant: Instant, before: Vector, after: Vector, contacts: Contacts, closed: Contacts
    ) -> Switching:
        return Switching(
            instant=instant,
            contacts=contacts,
            closed=closed,
            held=closed,
            before=before,
            after=after,
            switches=switches(self.system, self.closed, contacts, closed),
        )

    def _check_progress(self, s: float, instant: Instant) -> None:
        """Raise where contacts change again and again at one instant."""
        is_instant = s <= _INSTANT * self._rest.shortest
        self._instant_changes = self._instant_changes + 1 if is_instant else 0
        if self._instant_changes > _MOST:
            raise DynamicsError(
                f"contacts {', '.join(self.system.contact_names)}: {_MOST} changes at stamp"
                f" {text(instant.stamp)} s and no end"
            )
