# SPDX-License-Identifier: Apache-2.0
"""Corrects hypotheses by an impact: the gap is zero at its own instant, ``v`` before the stamp.

``v``, the error of the stamp, is one more unknown beside the state, with the deviation of the
clock, and with the delay where that is estimated. The gap ``v`` before the stamp is an exact
measurement of both together. The state flows back to its own instant, jumps, and flows to the
stamp again. No root is divided by a speed, so grazing needs no care.

Considered parameters are not corrected: their rows of the gain are zero (Schmidt 1966).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.balance import ImpactState, impact_states
from impact_observer.bank.bank import Array, Hypotheses
from impact_observer.bank.predict import Flights
from impact_observer.dynamics.mechanism import Flown
from impact_observer.events import Contacts
from impact_observer.square_roots import lengths_of, triangular
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

_ITERATIONS = 4
"""Most linearisations of a gap about the corrected state."""
_SETTLED = 1e-9
"""Change of an instant that ends them, over the fastest time scale."""
_FARTHEST = 16.0
"""Error of a stamp to which states are taken back at most, over the fastest time scale."""
_ROUNDING = 8 * float(np.finfo(np.float64).eps)
"""Rounding of a state by an event, over its size."""


class Hit(NamedTuple):
    """An impact as hypotheses suppose it.

    Attributes:
        t: the stamp less the delay, s since the epoch.
        contacts: those that hit.
        held: contacts that are closed before.
        closed: contacts that are closed afterwards.
    """

    t: Elapsed
    contacts: Contacts
    held: Contacts
    closed: Contacts


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


def corrected(
    rows: Hypotheses, hit: Hit, flights: Flights, considered: NDArray[np.intp]
) -> tuple[Hypotheses, list[ImpactState]]:
    """Hypotheses after an impact, and what they know of the impact.

    Their rungs are those by which they explain the impact.

    Args:
        rows: hypotheses with the same closed contacts.
        hit: the impact.
        flights: near their parameters.
        considered: numbers of the state that are not estimated.

    Raises:
        ImpactLawError: the impact law has no solution on these contacts.
    """
    stamped = _stamped(rows, flights, hit.contacts[0])
    for contact in hit.contacts:
        stamped = _measured(stamped, contact, hit, flights, considered)
    return _jumped(rows, stamped, hit, flights)


def _stamped(rows: Hypotheses, flights: Flights, contact: int) -> Stamped:
    """Hypotheses at a stamp of a ``contact``, with the errors of the stamp."""
    (H, N), d = rows.x.shape, flights.d
    root = np.zeros((H, N + 1, N + d + 2))
    root[:, :N, : N + d] = rows.roots(flights.ladders)
    root[:, N, N + d] = flights.clock(contact, rows.c)
    v = np.zeros(H)
    if d + flights.p < N:  # the delay
        root[:, N, :N] = rows.S[:, N - 1]
        v = rows.x[:, -1] - flights.constants[-1]
    return Stamped(rows.x, v, root)


def _measured(
    prior: Stamped, contact: int, hit: Hit, flights: Flights, considered: NDArray[np.intp]
) -> Stamped:
    """The states whose gap of a ``contact`` is zero ``v`` before the stamp."""
    (H, N), d = prior.x.shape, flights.d
    root, x, v = prior.root, prior.x, prior.v
    # the product of an error of the speed and an error of the stamp
    along = flights.guard(contact, x).along
    noise = lengths_of(np.einsum("hi,hik->hk", along, root[:, :d])) * lengths_of(root[:, N])
    noise += 1e-16 * np.sum(np.abs(x[:, :d]), axis=1)
    farthest = _FARTHEST / flights.rate  # damped motions overflow backwards in time
    samples = flights.mechanism.system.forcing.sampled
    known = np.inf if samples is None else float(hit.t) - float(samples.time[0])
    earliest = max(min(farthest, known), 0.0)
    row, gain = np.zeros((H, root.shape[2])), np.zeros((H, N + 1))
    for _ in range(_ITERATIONS):
        back = flights.images([hit.t], x, -v, hit.held)
        guard = flights.guard(contact, np.hstack([back.x, x[:, d:]]))
        by_x, by_v, by_own = guard.by, -guard.gamma, guard.by[:, None, :d].copy()
        by_x[:, :d] = (by_own @ back.Phi)[:, 0]
        by_x[:, d:] += (by_own @ back.Gamma)[:, 0]
        row = np.einsum("hi,hik->hk", by_x, root[:, :N]) + by_v[:, None] * root[:, N]
        row[:, -1] = noise
        shift = np.einsum("hi,hi->h", by_x, prior.x - x) + by_v * (prior.v - v)
        residual = guard.g + shift
        gain = np.einsum("hik,hk->hi", root, row) / np.sum(row * row, axis=1)[:, None]
        gain[:, considered] = 0.0
        x = prior.x - gain[:, :N] * residual[:, None]
        before, v = v, np.clip(prior.v - gain[:, N] * residual, -farthest, earliest)
        if np.all(np.abs(v - before) < _SETTLED / flights.rate):
            break
    root = root - gain[:, :, None] * row[:, None, :]
    if len(hit.contacts) > 1:
        root = np.concatenate([root, np.zeros_like(root[:, :, :1])], axis=2)
    return Stamped(x, v, root)


def _jumped(
    rows: Hypotheses, stamped: Stamped, hit: Hit, flights: Flights
) -> tuple[Hypotheses, list[ImpactState]]:
    """States at the stamp after a jump ``v`` before it, and at the jump."""
    x, v, root = stamped
    (H, N), d, p, mechanism = x.shape, flights.d, flights.p, flights.mechanism
    back = flights.images([hit.t], x, -v, hit.held)
    after = x.copy()
    after[:, :d], jump, by_jump = _pressed(back.x, x, hit, flights)
    times = [hit.t + -each for each in v.tolist()]
    forth = flights.images(times, after, v, hit.closed)
    whole = x.copy()
    whole[:, :d] = forth.x
    by_x = forth.Phi @ jump @ back.Phi
    S = root[:, :N].copy()
    S[:, :d] = by_x @ root[:, :d]
    if p:
        by = forth.Gamma + forth.Phi @ (jump @ back.Gamma)
        by[:, :, :p] += forth.Phi @ by_jump
        S[:, :d] += by @ root[:, d:N]
    later = mechanism.rates([hit.t], whole[:, :d], hit.closed)
    before = mechanism.rates([hit.t], x[:, :d], hit.held)
    by_v = later - (by_x @ before[..., None])[..., 0]
    S[:, :d] += by_v[:, :, None] * root[:, N:]
    error = flights.ladders.kicks[rows.r]
    if error.any() and not hit.closed:
        kicks, gamma = np.zeros((H, N, len(hit.contacts))), mechanism.gaps(back.x).gamma
        for k, contact in enumerate(hit.contacts):
            stops = mechanism.stops(back.x, (contact,))[:, :, 0]
            kicks[:, d // 2 : d, k] = (error * gamma[:, contact])[:, None] * stops
        S = np.concatenate([S, kicks], axis=2)
    rounding = np.zeros((H, N, d))
    sizes = np.abs(whole[:, :d]).reshape(H, 2, -1).max(axis=2)
    rounding[:, range(d), range(d)] = _ROUNDING * np.repeat(sizes, d // 2, axis=1)
    S = np.concatenate([S, rounding], axis=2)
    rows = rows._replace(
        x=whole,
        S=triangular(S),
        B=np.zeros_like(rows.B),
        paid=np.zeros_like(rows.paid),
        sunk=np.zeros_like(rows.sunk),
        tried=np.zeros_like(rows.tried),
    )
    return rows, _states_at_jump(rows, stamped, back, hit, flights, times=times)


def _states_at_jump(
    rows: Hypotheses,
    stamped: Stamped,
    back: Flown,
    hit: Hit,
    flights: Flights,
    *,
    times: Sequence[Elapsed],
) -> list[ImpactState]:
    """What hypotheses know at ``times``, ``v`` before the stamp, where flights ``back`` led."""
    x, v, root = stamped
    (H, N), d = x.shape, flights.d
    rates = flights.mechanism.rates(times, back.x, hit.held)
    own = root[:, :N].copy()
    own[:, :d] = (
        back.Phi @ root[:, :d] + back.Gamma @ root[:, d:N] - rates[..., None] * root[:, N:]
    )
    own[:, :d] *= rows.persistence(flights.ladders)[:, None, None]
    return impact_states(
        flights.mechanism,
        hit.contacts,
        np.hstack([back.x, x[:, d:]]),
        own,
        held=[hit.held] * H,
        scatter=flights.ladders.kicks[rows.r],
        early=v,
    )


def _pressed(own: Array, x: Array, hit: Hit, flights: Flights) -> tuple[Array, Array, Array]:
    """(q, u) after the jump from ``own``, with the parameters of ``x``, and its derivatives.

    Returns:
        Shapes (H, d), (H, d, d) by the states, (H, d, p) by the parameters.
    """
    mechanism, d = flights.mechanism, flights.d
    active = tuple(sorted({*hit.held, *hit.contacts}))
    groups: dict[Contacts, list[int]] = {}
    if len(active) == 1:
        groups[active] = [*range(len(own))]
    else:
        for h, each in enumerate(own):
            taking = {*mechanism.pressed(each, active, hit.contacts)}
            taking |= {*hit.held} & {*hit.closed}
            groups.setdefault(tuple(sorted(taking)), []).append(h)
    y, Phi = np.empty_like(own), np.empty((*own.shape, d))
    Gamma = np.zeros((*own.shape, flights.p))
    for pressed, which in groups.items():
        jumps = mechanism.impact(own[which], pressed)
        if hit.closed:
            still = mechanism.rest(jumps.x, hit.closed)
            Gamma[which] = still.Phi @ jumps.Gamma + still.Gamma
            y[which], Phi[which] = still.x, still.Phi @ jumps.Phi
        else:
            y[which], Phi[which], Gamma[which] = jumps
    return y + flights.change(Gamma, x), Phi, Gamma
