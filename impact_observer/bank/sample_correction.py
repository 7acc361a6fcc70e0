# SPDX-License-Identifier: Apache-2.0
"""Corrects and weighs hypotheses by samples of what is measured beside the impacts."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.bank import Array, Hypotheses
from impact_observer.bank.predict import Flights
from impact_observer.events import Contacts
from impact_observer.square_roots import triangular
from impact_observer.stamps import Elapsed
from impact_observer.states import Vector

_ROUNDING = 1e-13
"""Rounding of a measured function, over the size of its terms."""
_LATE = 4.0
"""Deviations of a stamp by which a hypothesis inside a stop may be waiting for an event."""


class Function(NamedTuple):
    """A linear function of position, velocity and acceleration, or a gap.

    Attributes:
        position: factors, shape (n,).
        velocity: the same.
        acceleration: the same.
        offset: in the unit of the function.
        contact: whose gap is measured; -1 for none.
        parameters: factors of parameters, as of the motion of grounds, shape (p,); None for zeros.
    """

    position: Vector
    velocity: Vector
    acceleration: Vector
    offset: float = 0.0
    contact: int = -1
    parameters: Vector | None = None

    def at(self, x: Array, t: Elapsed, held: Contacts, flights: Flights) -> tuple[Vector, Array]:
        """Values at states (H, N), and their derivatives by the states, shapes (H,) and (H, N)."""
        d = flights.d
        n, rows = d // 2, np.zeros(x.shape)
        if self.contact >= 0:
            guard = flights.guard(self.contact, x)
            return guard.g + self.offset, guard.by
        rows[:, :n], rows[:, n:d] = self.position, self.velocity
        values = np.einsum("hi,hi->h", rows, x) + self.offset
        if np.any(self.acceleration):
            mechanism = flights.mechanism
            values += mechanism.rates([t], x[:, :d], held)[:, n:] @ self.acceleration
            slopes = mechanism.rate_slopes([t], x[:, :d], held)
            by_x, by = (self.acceleration @ each[:, n:] for each in slopes)
            rows[:, :d] += by_x
            rows[:, d : d + flights.p] = by
            values += flights.change(by[:, None], x)[:, 0]
        if self.parameters is not None:
            own = slice(d, d + flights.p)
            values += x[:, own] @ self.parameters
            rows[:, own] += self.parameters
        return values, rows


class LinearSample(NamedTuple):
    """A sample of a function.

    Attributes:
        function: what is measured.
        value: as measured, less what depends on time alone.
        variance: of its noise.
        gate: largest innovation that is used, in standard deviations.
        period: of the function, in its unit; 0 for none.
    """

    function: Function
    value: float
    variance: float
    gate: float
    period: float = 0.0


class Sampled(NamedTuple):
    """Hypotheses after a sample.

    Attributes:
        rows: the hypotheses, not normalised.
        innovation: value less predicted value, of each, shape (H,).
        z: its magnitude in standard deviations, shape (H,).
    """

    rows: Hypotheses
    innovation: Vector
    z: Vector


def sampled(
    rows: Hypotheses,
    sample: LinearSample,
    t: Elapsed,
    flights: Flights,
    considered: NDArray[np.intp],
) -> Sampled:
    """Hypotheses after a ``sample`` at ``t``, s since the epoch; those that it rejects stay.

    A hypothesis inside a stop waits for an event: whether the plant has jumped is not known, so
    the jump is noise of the sample.
    """
    d, ladders = flights.d, flights.ladders
    value, by = np.empty(rows.size), np.empty(rows.x.shape)
    for own, held in rows.by_held():
        value[own], by[own] = sample.function.at(rows.x[own], t, held, flights)
    innovation = sample.value - value
    if sample.period:
        innovation -= sample.period * np.round(innovation / sample.period)
    rounding = _ROUNDING * np.abs(by * rows.x).sum(axis=1) + 1e-300
    noise = sample.variance + rounding**2
    if rows.paid.any():
        noise += _jumps(rows, sample.function, t, flights) ** 2
    root = rows.roots(ladders)
    row = (by[:, None] @ root)[:, 0]
    variance = np.einsum("hk,hk->h", row, row) + noise
    z = np.abs(innovation) / np.sqrt(variance)
    logw = rows.logw - np.minimum(z, sample.gate) ** 2 / 2 - np.log(variance) / 2
    gain = (root @ row[:, :, None])[..., 0] / variance[:, None]
    gain[:, considered] = 0.0
    gain[z > sample.gate] = 0.0
    x = rows.x + gain * innovation[:, None]
    N = x.shape[1]
    if len(considered):
        wide = root - gain[:, :, None] * row[:, None, :]
        wide = np.concatenate([wide, (gain * np.sqrt(noise)[:, None])[:, :, None]], axis=2)
        S, B = triangular(wide), np.zeros_like(rows.B)
    else:  # Potter's form, of both parts of the root together
        part = 1 / (1 + np.sqrt(noise / variance))
        change = (gain * part[:, None])[:, :, None] * row[:, None, :]
        S = rows.S - change[:, :, :N]
        by_error = np.einsum("hi,hik->hk", by[:, :d], rows.B)
        part = np.where(ladders.errors[rows.r] > 0, part, 1.0)
        B = rows.B - (gain[:, :d] * part[:, None])[:, :, None] * by_error[:, None, :]
    return Sampled(rows._replace(x=x, S=S, B=B, logw=logw), innovation, z)


def _jumps(rows: Hypotheses, function: Function, t: Elapsed, flights: Flights) -> Vector:
    """Changes of a function by the jumps of hypotheses inside stops that may be late, (H,)."""
    d, jump, gaps = flights.d, np.zeros(rows.size), flights.mechanism.gaps(rows.x[:, : flights.d])
    for own, held in rows.by_held():
        for contact in np.flatnonzero(rows.paid[own].any(axis=0)).tolist():
            gap, speed = gaps.g[own, contact], gaps.gamma[own, contact]
            late = _LATE * flights.clock(contact, rows.c[own]) * np.abs(speed)
            which = own[(gap < 0) & (-gap < late)]
            if which.size:
                hit = rows.x[which].copy()
                hit[:, :d] = flights.mechanism.impact(hit[:, :d], (contact,)).x
                before, after = (function.at(x, t, held, flights)[0] for x in (rows.x[which], hit))
                jump[which] += after - before
    return jump
