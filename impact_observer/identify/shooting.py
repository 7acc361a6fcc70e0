# SPDX-License-Identifier: Apache-2.0
"""Gaps of a motion that is switched at given instants, and their derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.identify.sensor_rows import CountedSamples, RowMaker, Rows
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector
from impact_observer.trajectory.linearised_system import FlightEnd, LinearisedSystem


class Shot(NamedTuple):
    """The gaps of the contacts that hit, and their derivatives.

    Attributes:
        gaps: just before each hit, shape (hits,), m.
        speeds: contact speeds then, shape (hits,), m/s.
        by_start: derivatives with respect to initial state and parameters, shape (hits, 2n + p).
        by_instant: derivatives with respect to the instants, shape (hits, moments).
        by_impulse: derivatives with respect to the relative errors of the impulses, shape
            (hits, moments), or (hits, 0) where these are not unknown.
        moment: index of each hit's moment, shape (hits,).
        states: (q, u) just after each moment, shape (moments, 2n).
        sensors: rows of what is measured beside the impacts.
    """

    gaps: Vector
    speeds: Vector
    by_start: Matrix
    by_instant: Matrix
    by_impulse: Matrix
    moment: np.ndarray
    states: Matrix
    sensors: tuple[Rows, ...] = ()


def shoot(
    family: ParametricFamily,
    start: Vector,
    moments: Sequence[FlightEnd],
    t: Vector,
    t0: float,
    *,
    samples: Sequence[CountedSamples] = (),
    impulses: Vector | None = None,
) -> Shot:
    """The motion that is switched at the instants ``t``, and its gaps there.

    Args:
        family: the system and its free parameters.
        start: initial state (q, u) and parameters, shape (2n + p,).
        moments: the contacts that switch.
        t: their instants, ascending, s since the epoch, shape (moments,).
        t0: where the initial state holds, s since the epoch.
        samples: of each sensor beside the impacts.
        impulses: relative errors of the impulses, shape (moments,); None if all are as the law
            says, as where there are ``samples``. No error changes the closing of a contact.
    """
    n, d = family.system.n, start.size
    system = LinearisedSystem(family, start[2 * n :])
    closed = [(), *(end.held for end in moments)]
    system.prepare(zip(closed, np.diff(t, prepend=t0).tolist(), strict=False))
    width = len(moments) * (1 if impulses is None else 2)
    at = system.begin(t0, start[: 2 * n], width)
    maker = RowMaker(system, samples, t) if samples else None
    if maker:
        maker.flight(0, at)
    states, count = np.zeros((len(moments), 2 * n)), sum(len(each.hit) for each in moments)
    gaps, speeds, moment = np.zeros(count), np.zeros(count), np.zeros(count, dtype=int)
    table = np.zeros((count, d + width))
    first = 0
    for k, (instant, end) in enumerate(zip(t.tolist(), moments, strict=True)):
        at = system.flight(at, instant)
        if end.hit:
            own = slice(first, first := first + len(end.hit))
            gaps[own], table[own] = system.gaps(at, end.hit)
            speeds[own], moment[own] = system.contact_rows(end.hit)[0] @ at.x[n:], k
            table[own, d + k] = speeds[own]
        before = at
        at, sooner = system.switch(at, end)
        if impulses is not None and has_impulse(end):
            change, share = at.x - before.x, 1.0 + impulses[k]
            X = before.X + share * (at.X - before.X)
            at, sooner = at._replace(x=before.x + share * change, X=X), share * sooner
            at.X[:, d + len(moments) + k] = change
        at.X[:, d + k] -= sooner
        states[k] = at.x
        if maker:
            maker.flight(k + 1, at)
    by_start, by_instant, by_impulse = np.split(table, [d, d + len(moments)], axis=1)
    rows = maker.rows(len(moments)) if maker else ()
    return Shot(gaps, speeds, by_start, by_instant, by_impulse, moment, states, rows)


def has_impulse(end: FlightEnd) -> bool:
    """Whether something rebounds at a moment, and no contact stays closed."""
    return bool(end.pressed) and not end.held
