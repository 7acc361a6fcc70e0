# SPDX-License-Identifier: Apache-2.0
"""Errors of estimates, their energy V, and contact speeds, of linear systems and of robots.

The V of a robot is ``1/2 du' M(q) du + 1/2 dq' M(q) dq / s^2`` with the true ``q``: a robot has no
stiffness, so the inertia weighs the errors of positions too, over one second.
"""

import math

import numpy as np

from impact_observer.dynamics.lyapunov import distance
from impact_observer.model import System
from impact_observer.robots.robot import Robot
from impact_observer.states import Matrix, Vector


def errors_of(system: System | Robot, truth: Matrix, estimate: Matrix) -> Matrix:
    """Estimate minus truth (dq, du), of states (q, u), all of shape (samples, 2n).

    Whole turns of a robot's continuous joints are no errors: an encoder may count modulo a turn.
    """
    error = np.asarray(estimate - truth)
    if isinstance(system, Robot) and system.turns.any():
        turning = np.flatnonzero(system.turns)
        error[:, turning] -= math.tau * np.round(error[:, turning] / math.tau)
    return error


def energies(system: System | Robot, truth: Matrix, error: Matrix) -> Vector:
    """V, J, shape (samples,), of errors (dq, du), shape (samples, 2n), at true states."""
    n = system.n
    if isinstance(system, System):
        return distance(system, error[:, :n], error[:, n:])
    M = np.array([system.mass(q) for q in truth[:, :n]]).reshape(-1, n, n)
    halves = error.reshape(-1, 2, n)
    return np.asarray(np.einsum("kai,kij,kaj->k", halves, M, halves) / 2)


def contact_speeds(system: System | Robot, x: Matrix) -> Matrix:
    """Contact speeds, shape (samples, m), m/s, in states (q, u), shape (samples, 2n)."""
    if isinstance(system, System):
        return np.asarray(x[:, system.n :] @ system.W)
    return np.array([system.contact_speeds(each) for each in x]).reshape(len(x), system.m)
