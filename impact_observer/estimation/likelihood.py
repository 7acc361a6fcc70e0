"""How an event fits what was known before it."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.estimation.joint import Expected, Joint
from impact_observer.estimation.square_root import Correction, lengths
from impact_observer.events import Contacts
from impact_observer.states import Vector

STILL = 1e-150
"""Speed that is none."""
_CLOSING = 1e-3
"""Standard deviation of a closing speed below which its sign is sure, relative to it."""
FAR = 30.0
"""Innovation, in standard deviations, beyond which an event cannot be what it is said to be."""
_NORMAL = math.log(2 * math.pi) / 2


class Likelihood(NamedTuple):
    """How an event fits what was known.

    Attributes:
        density: logarithm of the probability density of its instant, 1/s for each contact.
        innovations: by contact, how far the innovation was from zero, in standard deviations.
        linear: what was expected about what was known, what the event tells of that, and by
            how much it was something else, whitened; None where that was not needed.
    """

    density: float
    innovations: dict[int, float]
    linear: tuple[Expected, Correction, list[float]] | None = None


def likelihood(contacts: Contacts, expected: Expected, prior: Joint) -> Likelihood:
    """The density of the instant of an event at ``contacts``, of which this is ``expected``.

    The density of a gap at an instant, times the speed at which it goes through zero, is the
    density of the instant; and it can only go through it from above.
    """
    learnt, innovation = expected.learnt(prior), expected.innovation.tolist()
    white = learnt.whitened(innovation)
    slopes = expected.expansion.H[:, 0].tolist()
    spreads = lengths(expected.expansion.D.dot(prior.own[1:]))
    density = 0.0
    for i, (each, slope, spread) in enumerate(zip(white, slopes, spreads, strict=True)):
        density += _density(each, learnt.innovation[i, i], slope, spread)
    if len(contacts) == 1:
        density += _from_above(slopes[0], spreads[0])
    sizes = [abs(each) / s for each, s in zip(innovation, learnt.deviations, strict=True)]
    innovations = dict(zip(contacts, sizes, strict=True))
    return Likelihood(density, innovations, (expected, learnt, white))


def likelihood_of_one(
    contact: int, white: float, deviation: float, slope: float, spread: float
) -> Likelihood:
    """The same of a single contact.

    Args:
        contact: index.
        white: innovation of its gap, in standard deviations.
        deviation: one, of either sign, m.
        slope: of the gap, m/s.
        spread: standard deviation of that, m/s.
    """
    density = _density(white, deviation, slope, spread) + _from_above(slope, spread)
    return Likelihood(density, {contact: abs(float(white))})


def _density(white: float, deviation: float, slope: float, spread: float) -> float:
    """Logarithm of the density of the instant at which one gap goes through zero, 1/s."""
    speed = math.log(math.hypot(slope, spread) + STILL)
    return speed - white * white / 2 - math.log(abs(deviation)) - _NORMAL


def _from_above(slope: float, spread: float) -> float:
    """Logarithm of the probability that a gap of this ``slope`` does so from above."""
    surely = max(spread, _CLOSING * abs(slope), STILL)
    return float(special.log_ndtr(slope / surely))


def far_off(
    contacts: Contacts, expected: Expected, prior: Joint, rate: Callable[[], Vector]
) -> Likelihood | None:
    """The evidence of an impact that is so far off that no more need be known; else None.

    Args:
        contacts: that hit.
        expected: of it.
        prior: what is known before it.
        rate: finds ``dx/dt`` at the estimate, shape (2n,).
    """
    value, H, D, _ = expected.expansion
    seen = H[:, 1:].dot(prior.own[1:])
    if prior.parameters:
        seen += expected.turn.dot(prior.root[prior.of_theta])
    values, slopes, late = value.tolist(), H[:, 0].tolist(), prior.e
    parts = list(zip(values, slopes, lengths(seen), expected.rounded, strict=True))
    clock, bent = float(prior.root[0, 0]), [0.0] * len(parts)
    if max(_deviations(parts, bent, late, clock)) < FAR:  # bent ones are less far off
        return None
    bent = np.abs(D.dot(rate())).tolist()
    sizes = _deviations(parts, bent, late, clock)
    if max(sizes) < FAR:
        return None
    density = -sum(size * size for size in sizes) / 2
    return Likelihood(density, dict(zip(contacts, sizes, strict=True)))


def _deviations(
    parts: Sequence[tuple[float, float, float, float]],
    bent: Sequence[float],
    late: float,
    clock: float,
) -> list[float]:
    """How far off gaps are at an event, in standard deviations.

    Args:
        parts: of each its value and what it changes by per second back, m, m/s, its deviation and
            rounding, m.
        bent: what those speeds change by, m/s2.
        late: of the event's stamp, s.
        clock: standard deviation of the stamp, s.
    """
    return [
        abs(value + slope * late)
        / (math.hypot(spread, (abs(slope) + bend * clock) * clock) + rounded)
        for (value, slope, spread, rounded), bend in zip(parts, bent, strict=True)
    ]
