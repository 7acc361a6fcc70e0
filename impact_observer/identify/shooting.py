# SPDX-License-Identifier: Apache-2.0
"""Gaps of a motion that is switched at given instants, and their derivatives."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from impact_observer.identify.general_motion import GeneralMotion, is_general
from impact_observer.identify.motion import EquationsOfMotion, FlightEnd
from impact_observer.identify.sensor_rows import CountedSamples, RowMaker, Rows
from impact_observer.model.parametric_family import ParametricFamily
from impact_observer.states import Matrix, Vector


class Shot(NamedTuple):
    """The gaps of the contacts that hit, and their derivatives.

    Attributes:
        gaps: just before each hit, shape (hits,), m.
        speeds: contact speeds then, shape (hits,), m/s.
        by_start: derivatives with respect to initial state and parameters, shape (hits, 2n + p).
        by_instant: derivatives with respect to the instants, shape (hits, moments).
        moment: index of each hit's moment, shape (hits,).
        states: (q, u) just after each moment, shape (moments, 2n).
        sensors: rows of what is measured beside the impacts.
    """

    gaps: Vector
    speeds: Vector
    by_start: Matrix
    by_instant: Matrix
    moment: np.ndarray
    states: Matrix
    sensors: tuple[Rows, ...] = ()


def equations_of(family: ParametricFamily, values: Vector) -> EquationsOfMotion:
    """The equations of motion for parameter ``values``, shape (p,)."""
    numbers = family.coefficients_at(values)
    if is_general(family.system):
        return GeneralMotion(family, numbers, values)
    return EquationsOfMotion(family, numbers)


def shoot(
    family: ParametricFamily,
    start: Vector,
    moments: Sequence[FlightEnd],
    t: Vector,
    t0: float,
    *,
    samples: Sequence[CountedSamples] = (),
) -> Shot:
    """The motion that is switched at the instants ``t``, and its gaps there.

    Args:
        family: the system and its free parameters.
        start: initial state (q, u) and parameters, shape (2n + p,).
        moments: the contacts that switch.
        t: their instants, ascending, s since the epoch, shape (moments,).
        t0: where the initial state holds, s since the epoch.
        samples: of each sensor beside the impacts.
    """
    n = family.system.n
    equations = equations_of(family, start[2 * n :])
    z, Z = equations.start(start[: 2 * n], moments, t, t0)
    W, d = family.system.W, start.size
    states = np.zeros((len(moments), 2 * n))
    maker = RowMaker(family, start[2 * n :], samples, t) if samples else None
    if maker:
        maker.flight(-1, t0, z[: 2 * n], Z[: 2 * n], ())
    rows: list[tuple[float, float, Vector, int]] = []
    for k, moment in enumerate(moments):
        before = moments[k - 1].held if k else ()
        z, Z, sooner = equations.flown(k, z, Z)
        Z[:, d + k] += equations.rate(k, z)
        if k:
            Z[:, d + k - 1] += sooner
        for i in moment.hit:
            row = W[:, i] @ Z[:n]
            row[2 * n : d] += equations.gap_change[:, i]
            gap = float(W[:, i] @ z[:n] + equations.numbers.gap[i])
            rows.append((gap, float(W[:, i] @ z[n : 2 * n]), row, k))
        if moment.lasts and not before:
            z, Z = equations.lasted(k, z, Z, moment)
        else:
            z, Z = equations.jumped(z, Z, moment)
        states[k] = z[: 2 * n]
        if maker:
            maker.flight(k, float(t[k]), states[k], Z[: 2 * n], moment.held)
    table = np.array([row[2] for row in rows]).reshape(len(rows), d + len(moments))
    return Shot(
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows]),
        table[:, :d],
        table[:, d:],
        np.array([row[3] for row in rows], dtype=int),
        states,
        maker.rows(len(moments)) if maker else (),
    )
