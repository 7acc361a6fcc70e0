# SPDX-License-Identifier: Apache-2.0
"""An observer of velocities from exact positions and the switching of contacts, with a proof.

``du^ = M^-1 (tau - C(q, u^) u^ - h - D u^) dt + l (dq - u^ dt)`` and contact impulses at the
measured ``q`` with the contact speeds of ``u^`` itself. With ``e = u - u^``, Christoffel's ``C``
and ``mu(q, u^) = lambda_max(-(C + C')(q, u^), M)``, ``V = 1/2 e' M(q) e`` has between jumps
``dV/dt = -e' C(q, u^) e - e' D e - l e' M e <= (mu / 2 - l) 2 V``. So
``l >= mu / 2 + alpha`` gives ``V(t) <= V(0) exp(-2 alpha t)``, for whichever contacts are
switched, if ``G - E G E >= 0`` on each set that is switched at once (``Robot.is_nonexpansive``).

This is proved of exact ``q(t)``, the true torques and parameters, and the true instants of
impacts that last no time. Nothing is proved of noisy or sampled positions, wrong stamps, wrong
parameters or friction. The bound is a certificate, not the best estimate: in noise a filter is
several times better. Observers of this class are known: A. Tanwani, B. Brogliato, C. Prieur,
"Observer design for unilaterally constrained Lagrangian systems: a passivity-based approach",
IEEE Transactions on Automatic Control 61(9), 2016.

The law ``measured-position`` (``observer/laws/measured_position.py``) is this observer with
encoders that come as samples.
"""

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.events import Contacts
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector

MARGIN = 10.0
"""``alpha`` where no other is given, 1/s."""


def growth_rate(robot: Robot, q: Vector, u: Vector) -> float:
    """``mu(q, u)``, 1/s: an error grows no faster than by ``exp(mu t / 2)`` if ``l`` is 0."""
    C, root = robot.coriolis(q, u), np.linalg.cholesky(robot.mass(q))
    half = np.linalg.solve(root, -(C + C.T))
    return float(np.linalg.eigvalsh(np.linalg.solve(root, half.T))[-1])


def certified_gain(robot: Robot, q: Vector, u: Vector, margin: float) -> float:
    """The least ``l``, 1/s, with which V falls at least by ``exp(-2 margin t)``."""
    return max(growth_rate(robot, q, u), 0.0) / 2 + margin


class VelocityObserver:
    """The observer of one robot with n joints.

    Attributes:
        robot: the robot.
        velocity: the estimate ``u^``, shape (n,), rad/s or m/s.
        margin: ``alpha``, 1/s: V falls at least by ``exp(-2 alpha t)``.
        gain: ``l`` of the last step, 1/s.
    """

    def __init__(self, robot: Robot, velocity: Vector, *, margin: float = MARGIN) -> None:
        """Start from a ``velocity``, shape (n,).

        Raises:
            UsageError: a margin that is not positive, or a velocity that cannot be used.
        """
        if not margin > 0:
            raise UsageError(f"margin: {margin:g} found; expected a positive number, 1/s")
        self.robot, self.margin, self.gain = robot, margin, margin
        _, self.velocity = robot.checked_state(np.zeros(robot.n), velocity)

    def step(
        self, positions: Matrix, seconds: float, tau: Vector, closed: Contacts = ()
    ) -> Vector:
        """Go on by ``seconds``, in which contacts ``closed`` stay closed; returns the velocity.

        The step is one of Runge and Kutta, of 4th order: proved is the motion that it approaches.
        A closed contact acts as a sprag clutch: its speed in the estimate may not be negative.

        Args:
            positions: true coordinates at begin, middle and end of the step, shape (3, n).
            seconds: length of the step, s.
            tau: torques during the step, shape (n,).
            closed: indices of closed contacts.
        """
        robot, h = self.robot, seconds
        begin, middle, end = positions
        self.gain = gain = certified_gain(robot, begin, self.velocity, self.margin)

        # v = u^ - l (q - q(begin)), which is smooth where dq is not known
        def rate(v: Vector, q: Vector) -> Vector:
            u = v + gain * (q - begin)
            return np.asarray(robot.acceleration(q, u, tau) - gain * u)

        one = rate(self.velocity, begin)
        two = rate(self.velocity + h / 2 * one, middle)
        three = rate(self.velocity + h / 2 * two, middle)
        four = rate(self.velocity + h * three, end)
        v = self.velocity + h / 6 * (one + 2 * two + 2 * three + four)
        self.velocity = np.asarray(v + gain * (end - begin))
        if closed:
            self.velocity = robot.velocity_after(end, self.velocity, closed, plastic=True)
        return self.velocity

    def correct(self, q: Vector, contacts: Contacts) -> Vector:
        """Jump as ``contacts``, all that are closed at an impact, do; returns the velocity.

        Raises:
            ImpactLawError: Newton's law has no solution on these contacts.
        """
        self.velocity = self.robot.velocity_after(q, self.velocity, contacts)
        return self.velocity

    def distance(self, q: Vector, u: Vector) -> float:
        """``V``, J, to the true velocities ``u`` at ``q``."""
        return self.robot.kinetic_energy(q, u - self.velocity)
