# SPDX-License-Identifier: Apache-2.0
"""Corrects hypotheses by an impact: the gap is zero at its own instant, ``v`` before the stamp.

The error ``v`` of the stamp is one more unknown beside the state, with the deviation of the clock.
The gap ``v`` before the stamp is an exact measurement of both together. The state flows back to
its own instant, jumps, and flows to the stamp again. No root is divided by a speed, so grazing
needs no care.
"""

from typing import NamedTuple

import numpy as np

from impact_observer.bank.bank import Array, Hypotheses
from impact_observer.bank.ladders import lengths_of, triangular
from impact_observer.bank.predict import Flights
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

_ITERATIONS = 3
"""Linearisations of a gap about the corrected state."""


class Hit(NamedTuple):
    """An impact as hypotheses suppose it.

    Attributes:
        t: the stamp, s since the epoch.
        contacts: those that hit.
        held: contacts that are closed before.
    """

    t: Elapsed
    contacts: Contacts
    held: Contacts


class Stamped(NamedTuple):
    """States at the stamp without the impact, and errors of the stamp.

    Attributes:
        x: means of the states, shape (H, N).
        v: means of the errors, s, shape (H,).
        root: of both together, the error last, shape (H, N + 1, any); its last column is free.
    """

    x: Array
    v: Vector
    root: Array


def corrected(rows: Hypotheses, hit: Hit, flights: Flights) -> Hypotheses:
    """Hypotheses after an impact.

    Their rungs are those by which they explain the impact; their weights stay.
    """
    H, N = rows.x.shape
    root = np.zeros((H, N + 1, 2 * N + 2))
    root[:, :N, : 2 * N] = rows.roots(flights.ladders)
    root[:, N, 2 * N] = flights.ladders.clocks[rows.c]
    stamped = Stamped(rows.x, np.zeros(H), root)
    for contact in hit.contacts:
        stamped = _measured(stamped, contact, hit, flights)
    return _jumped(rows, stamped, hit, flights)


def _measured(prior: Stamped, contact: int, hit: Hit, flights: Flights) -> Stamped:
    """The states whose gap of a ``contact`` is zero ``v`` before the stamp."""
    (H, N), d = prior.x.shape, 2 * flights.n
    w, u = flights.gap_rows[contact], flights.speed_rows[contact]
    root, x, v = prior.root, prior.x, prior.v
    # the product of an error of the speed and an error of the stamp
    noise = lengths_of(u @ root[:, :d]) * lengths_of(root[:, N])
    by_x, row = np.zeros((H, N)), np.zeros((H, root.shape[2]))
    for _ in range(_ITERATIONS):
        maps = flights.tangent.flights([hit.t] * H, -v, hit.held)
        own = maps.of(x[:, :d])
        by_x[:, :d], by_v = w @ maps.Phi, -own @ u
        row = np.einsum("hi,hik->hk", by_x, root[:, :N]) + by_v[:, None] * root[:, N]
        row[:, -1] = noise
        residual = own @ w + flights.rest[contact]
        residual += np.einsum("hi,hi->h", by_x, prior.x - x) + by_v * (prior.v - v)
        gain = np.einsum("hik,hk->hi", root, row) / np.sum(row * row, axis=1)[:, None]
        x = prior.x - gain[:, :N] * residual[:, None]
        v = prior.v - gain[:, N] * residual
    axis = row / lengths_of(row)[:, None]
    root = root - np.einsum("hik,hk->hi", root, axis)[:, :, None] * axis[:, None, :]
    if len(hit.contacts) > 1:
        root = np.concatenate([root, np.zeros_like(root[:, :, :1])], axis=2)
    return Stamped(x, v, root)


def _jumped(rows: Hypotheses, stamped: Stamped, hit: Hit, flights: Flights) -> Hypotheses:
    """States at the stamp after a jump ``v`` before it."""
    x, v, root = stamped
    (H, N), d = x.shape, 2 * flights.n
    tangent, instants = flights.tangent, [hit.t] * H
    back, forth = tangent.flights(instants, -v, hit.held), tangent.flights(instants, v, hit.held)
    own = back.of(x[:, :d])
    jumps = tangent.impact(own, (*hit.held, *hit.contacts))
    whole = x.copy()
    whole[:, :d] = (forth.Phi @ (jumps.x - back.drift)[..., None])[..., 0]
    by_x = forth.Phi @ jumps.Phi @ back.Phi
    after = tangent.rates([hit.t], whole[:, :d], hit.held)[0]
    before = tangent.rates([hit.t], x[:, :d], hit.held)[0]
    by_v = after - (by_x @ before[..., None])[..., 0]
    S = root[:, :N].copy()
    S[:, :d] = by_x @ root[:, :d] + by_v[:, :, None] * root[:, N:]
    most = flights.numbers.most_kick_error
    error = np.minimum(flights.ladders.errors[rows.r], most)
    if error.any():
        kicks = np.zeros((H, N, len(hit.contacts)))
        for k, contact in enumerate(hit.contacts):
            gamma = error * (own @ flights.speed_rows[contact])
            kicks[:, :d, k] = gamma[:, None] * tangent.impulse(contact)
        S = np.concatenate([S, kicks], axis=2)
    zeros, none = np.zeros_like(rows.B), np.zeros_like(rows.paid)
    return rows._replace(
        x=whole, S=triangular(S), B=zeros, paid=none, tried=np.zeros_like(rows.tried)
    )
