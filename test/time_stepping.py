# SPDX-License-Identifier: Apache-2.0
"""Moreau's time stepping with theta = 1/2: an oracle that shares neither flow nor search nor law.

Over a step of ``h`` seconds, with ``u_theta = (u + u+) / 2`` and ``q_theta = q + h u_theta / 2``::

    M (u+ - u) + h C u_theta + h K q_theta - h f_theta = W P,    q+ = q + h u_theta
    0 <= gamma+ + r(gamma)  _|_  P >= 0    on contacts with    g + h gamma / 2 <= 0

The scheme is of first order with contacts (Jean 1999; Moreau 1988; Acary and Brogliato 2008,
chapter 10).
"""

from itertools import chain, combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.model import System

Array = NDArray[np.float64]
_SLOW = 1e-2
"""Speed below which a contact is held and not hit, m/s."""


class Stepped(NamedTuple):
    """A run of the scheme.

    Attributes:
        impacts: ends of steps with an impact, s since the epoch, and the contact.
        state: (q, u) at the end, in the coordinates of the model, shape (2n,).
    """

    impacts: list[tuple[float, int]]
    state: Array


def stepped(model: System, position: Array, velocity: Array, h: float, seconds: float) -> Stepped:
    """The motion from a state at the epoch, in steps of ``h`` s."""
    start = np.concatenate([position, velocity])[None]
    q, u = np.split(model.to_frame(np.zeros(1, dtype=np.int64), start)[0], 2)
    whole = model.M + h / 2 * model.C + h**2 / 4 * model.K
    inverse = np.asarray(np.linalg.inv(whole), dtype=np.float64)
    impacts, count = list[tuple[float, int]](), round(seconds / h)
    for k in range(count):
        force = (model.forcing(k * h) + model.forcing((k + 1) * h)) / 2
        pull = force - model.C @ u - model.K @ (q + h / 2 * u)
        after = u + h * inverse @ pull
        gamma = model.contact_speed(u)
        active = np.flatnonzero(model.gap(q) + h / 2 * gamma <= 0.0)
        if active.size:
            after = _pushed(model, inverse, after, gamma, active.tolist())
            jump = model.contact_speed(after) - gamma
            hit = [i for i in active.tolist() if gamma[i] < -_SLOW and jump[i] > 0]
            impacts += [((k + 1) * h, i) for i in hit]
        q, u = q + h / 2 * (u + after), after
    end = np.array([round(count * h * 1e9)])
    return Stepped(impacts, model.from_frame(end, np.concatenate([q, u])[None])[0])


def _pushed(model: System, inverse: Array, free: Array, gamma: Array, active: list[int]) -> Array:
    """The velocities after the impulses of some of the ``active`` contacts: all are tried."""
    rebound = np.array([law.rebound(g) for law, g in zip(model.rebounds, gamma, strict=True)])
    some = chain.from_iterable(combinations(active, k) for k in range(len(active) + 1))
    for pressing in map(list, some):
        W = model.W[:, pressing]
        lacking = -(W.T @ free + rebound[pressing])
        impulses = np.linalg.solve(W.T @ inverse @ W, lacking)
        after = free + inverse @ W @ impulses
        spare = (model.contact_speed(after) + rebound)[active]
        if np.all(impulses >= 0) and np.all(spare >= -1e-9 * (1 + np.max(np.abs(gamma)))):
            return after
    raise AssertionError("no impulses solve the impact law")
