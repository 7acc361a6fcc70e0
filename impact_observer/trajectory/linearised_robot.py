# SPDX-License-Identifier: Apache-2.0
"""Flights and jumps of a robot with their derivatives by state, parameters and instants."""

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.robot_family import RobotFamily
from impact_observer.filter.robot_members import RobotMember
from impact_observer.filter.robot_motion import RobotMotion
from impact_observer.robots.robot_parameters import jump_by_parameters, loads_by_parameters
from impact_observer.states import Vector
from impact_observer.trajectory.linearised_system import (
    FlightEnd,
    Guard,
    TangentMap,
    TangentState,
)


class LinearisedRobot:
    """One robot of a family, in the place of a ``LinearisedSystem``.

    Attributes:
        family: the robots, which differ by parameters.
        moving: their motion between impacts.
    """

    def __init__(self, family: RobotFamily, theta: Vector, moving: RobotMotion) -> None:
        """Prepare the robot of ``family`` with the parameters ``theta``, shape (p,)."""
        self.family, self.moving = family, moving
        self._robot = family.robot_at(theta) if family.size else family.system
        self._member = RobotMember(self._robot, theta, moving)

    def begin(self, t: float, x: Vector, others: int = 0) -> TangentState:
        """As ``LinearisedSystem.begin``."""
        return TangentState(t, np.array(x), np.eye(x.size, x.size + self.family.size + others))

    def pressed(self, change: ContactChange, x: Vector) -> Contacts:
        """The contacts that take an impulse at a ``change``, before which the state is ``x``."""
        return self._member.pressed(change, x)

    def flow(self, t: float, x: Vector, s: float, closed: Contacts) -> TangentMap:
        """The state ``s`` seconds after, or before, the state ``x`` at ``t``."""
        moved, Phi = self.moving.moved(t, x, s, closed)
        return TangentMap(
            moved, Phi, self.moving.by_parameters(t, x, s, closed, self.family.names)
        )

    def guard(self, at: TangentState, contacts: Contacts, *, hit: bool) -> Guard:
        """The gaps of ``contacts`` that ``hit``, or the loads of closed ones that open."""
        measured = self._member.guard(at.closed, contacts, at.t, at.x, hit=hit)
        rates = self.moving.rates_at(at.t, at.x, at.closed)
        found = measured.expanded(rates, at.x, self.moving.forces(at.t))
        rows = measured.c @ at.X
        if not hit:
            tau, names, which = self.moving.forces(at.t)[0], self.family.names, at.closed
            loads = loads_by_parameters(self._robot, at.x, tau, names, which)
            own = slice(at.x.size, at.x.size + self.family.size)
            rows[:, own] += loads[[which.index(i) for i in contacts]]
        return Guard(measured, found.value, rows, -found.H[:, 0], found.E)

    def impact(self, x: Vector, pressed: Contacts, *, reflects: bool = False) -> TangentMap:
        """As ``LinearisedSystem.impact``."""
        mirror = self._member.mirror_about(x, pressed)
        mirror = mirror if reflects else mirror.soft
        Gamma = jump_by_parameters(self._robot, x, pressed, self.family.names)
        return TangentMap(mirror.landed(x), mirror.J, Gamma)

    def on_stops(self, x: Vector, closed: Contacts) -> TangentMap:
        """The state ``x`` with gaps and speeds of ``closed`` contacts zero."""
        rest = self._member.stopped(x, closed, np.zeros((len(closed), self.family.size)))
        return TangentMap(rest.x, rest.map_, rest.sensitivity)

    at_rest = on_stops

    def jump(
        self, at: TangentState, end: FlightEnd, *, is_measured: bool = False
    ) -> tuple[TangentMap, Vector]:
        """As ``LinearisedSystem.jump``."""
        t, x, _, before = at
        map_ = self.impact(x, end.pressed, reflects=is_measured)
        if end.held and not is_measured:
            map_ = self.at_rest(map_.x, end.held).preceded_by(map_)
        ahead = self.moving.rate_of(t, map_.x, end.held)
        return map_, ahead - map_.Phi.dot(self.moving.rate_of(t, x, before))
