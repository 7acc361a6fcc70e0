# SPDX-License-Identifier: Apache-2.0
"""Velocities of a robot from encoders, with a proof for exact positions.

``robots/velocity_observer.py`` has the observer in continuous time, its V and what is proved of
it. Here the encoders of n joints come as samples, each at its own instants. A replica ``(q^, u^)``
moves as the robot does between samples. At a sample of joint j, ``h`` seconds after the one before
of the same joint, with the innovation ``i = y - q^_j``,

    q^_j = y    and    u^_j += (1 - exp(-l h)) / h i

where ``i / h`` is the error of the speed in the mean over ``h``, so that the error decays as by
``l (dq - u^ dt)``. For ``h`` to zero both observers are the same.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, cast

import numpy as np

from impact_observer.dynamics.contact.impact_balance import ImpactBalance, impact_balance
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.observer.contact_change import ContactChange
from impact_observer.observer.laws.law import Law
from impact_observer.observer.laws.replica_law import OwnMotions
from impact_observer.observer.samples import Reading, SampleOutcome
from impact_observer.robots.robot import Robot
from impact_observer.robots.robot_mechanism import RobotMechanism
from impact_observer.robots.tangent_robot import tangent
from impact_observer.robots.velocity_observer import MARGIN, certified_gain
from impact_observer.states import Matrix, Vector


class MeasuredPosition(Law):
    """Encoders move the velocities, impacts let them jump by Newton's law with their own speeds.

    A contact that stays closed takes its speed from the estimate for good, as the plant has none.
    That is a projection in the metric of V, and the load of the contact then does no work on the
    error. So the proof needs no sprag clutch.
    """

    name: ClassVar[str] = "measured-position"
    uses_measurements: ClassVar[bool] = True
    takes: ClassVar[tuple[type[System | Robot], ...]] = (Robot,)

    @property
    def _robot(self) -> Robot:
        return cast(Robot, self.system)

    @cached_property
    def _mechanism(self) -> RobotMechanism:
        return RobotMechanism(self._robot)

    def begin(self, replicas: Matrix, root: Matrix, closed: Contacts) -> Belief:
        """Replicas whose ``closed`` contacts have no speed."""
        del root
        n = self._robot.n
        held = [self._held(x[:n], x[n:], closed) for x in replicas]
        return Belief.of(np.array(held), unmeasured=np.full(n, math.inf))

    def correct(self, change: ContactChange, prior: Belief) -> Belief:
        """Every replica after its own impact, at the positions that encoders have given it."""
        if not change.hit:
            return prior
        after = [self._jumped(change, x) for x in prior.replicas]
        return prior.moved(np.array(after))

    def measure(
        self, readings: Sequence[Reading], before: Belief, prediction: Prediction, s: float
    ) -> tuple[Belief | None, list[SampleOutcome]]:
        """Every replica after the samples of encoders of one joint each; no others are used."""
        belief, outcomes = None, list[SampleOutcome]()
        for reading in readings:
            if reading.sensor.measurement.encoded is None:
                reason = f"{self.name} uses positions of single joints alone"
                outcomes.append(SampleOutcome.unused(reason))
                continue
            if belief is None:
                belief = prediction.belief(s) if s > 0 else before
            belief, innovation = self._after(reading, belief)
            outcomes.append(SampleOutcome(innovation))
        return belief, outcomes

    def _after(self, reading: Reading, prior: Belief) -> tuple[Belief, float]:
        """The belief after a sample of an encoder of one joint, and its innovation."""
        declared, period = reading.sensor.measurement, reading.sensor.period
        assert declared.encoded is not None, "an encoder"
        assert prior.unmeasured is not None, "a belief of this law"
        joint, scale = declared.encoded
        j = self._robot.coordinates.index(joint)
        innovations, after = list[float](), list[Vector]()
        for x in prior.replicas:
            innovation = reading.value - (scale * float(x[j]) + declared.offset)
            if period:
                innovation = math.remainder(innovation, period)
            innovations.append(innovation)
            h = float(prior.unmeasured[j])
            after.append(self._moved_to(x, j, innovation / scale, h, reading.closed))
        unmeasured = prior.unmeasured.copy()
        unmeasured[j] = 0.0
        belief = Belief.of(np.array(after), unmeasured=unmeasured)
        return belief, innovations[0]

    def impact_balance(
        self, change: ContactChange, before: Belief, prediction: Prediction, after: Belief
    ) -> ImpactBalance:
        """The balance of the contacts that hit, by the replica's own speeds at its positions."""
        del before, after
        x, active, n = prediction.state(change.flown), change.active, self._robot.n
        near, pressed = tangent(self._robot, x), self._robot.pushed(x[:n], x[n:], active)
        gamma = near.contact_speed(x[n:])[list(active)]
        values = impact_balance(near, active, pressed, gamma)
        return ImpactBalance.without_deviations(values[[active.index(i) for i in change.hit]])

    def predict(self, t: float, posterior: Belief, closed: Contacts) -> Prediction:
        """Each replica by its own motion."""
        motions = [self._mechanism.course(t, x, closed) for x in posterior.replicas]
        return _Unmeasured(motions, posterior)

    def _jumped(self, change: ContactChange, x: Vector) -> Vector:
        """A replica ``x``, shape (2n,), after its impact."""
        n = self._robot.n
        u = self._robot.velocity_after(x[:n], x[n:], change.active)
        return self._held(x[:n], u, change.closed)

    def _moved_to(self, x: Vector, j: int, shift: float, h: float, closed: Contacts) -> Vector:
        """A replica whose joint ``j`` is shifted, ``h`` seconds after the sample before."""
        n = self._robot.n
        q, u = x[:n].copy(), x[n:].copy()
        q[j] += shift
        if h > 0:
            u[j] -= math.expm1(-h * certified_gain(self._robot, q, u, MARGIN)) / h * shift
        return self._held(q, u, closed)

    def _held(self, q: Vector, u: Vector, closed: Contacts) -> Vector:
        """The state, shape (2n,), with the nearest ``u`` at which ``closed`` contacts rest."""
        return np.concatenate([q, self._robot.stopped(q, u, closed)])


class _Unmeasured(OwnMotions):
    """Motions during which nothing is measured."""

    def belief(self, s: float) -> Belief:
        before = self._belief.unmeasured
        assert before is not None, "a belief of this law"
        return super().belief(s)._replace(unmeasured=before + s)
