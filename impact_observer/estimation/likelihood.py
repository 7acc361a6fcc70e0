# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an event, given the prior."""

import math
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.estimation.joint import Expected, Joint
from impact_observer.estimation.square_root import lengths
from impact_observer.events import Contacts
from impact_observer.kernel._kernel import CLOSING, TINY

LOG_ROOT_2PI = math.log(2 * math.pi) / 2
"""By which the logarithm of a normal density is less than that of its exponential."""


class Innovation(NamedTuple):
    """How an event differed from its prediction.

    Attributes:
        normalised: in standard deviations; positive where the predicted gap was negative.
        deviation: the standard deviation, m.
    """

    normalised: float
    deviation: float

    @property
    def residual(self) -> float:
        """The innovation, m."""
        return self.normalised * self.deviation


class Likelihood(NamedTuple):
    """The likelihood of an event.

    Attributes:
        density: logarithm of the probability density of its instant, 1/s for each contact.
        innovations: absolute innovation of each contact, in standard deviations.
        normalised: innovation of the first contact, in standard deviations; positive where its
            predicted gap is negative.
        deviation: standard deviation of that innovation, m.
        expected: the predicted measurement, linearised about the prior; None where it was not
            computed.
    """

    density: float
    innovations: dict[int, float]
    normalised: float = 0.0
    deviation: float = math.inf
    expected: Expected | None = None

    @property
    def innovation(self) -> Innovation:
        """The innovation of the first contact."""
        return Innovation(self.normalised, self.deviation)

    @classmethod
    def of_single(
        cls, contact: int, density: float, normalised: float, deviation: float
    ) -> "Likelihood":
        """Of an impact of one contact."""
        return cls(density, {contact: abs(normalised)}, normalised, deviation)


CERTAIN = Likelihood(0.0, {})
"""Of what measures nothing."""


def likelihood_of(contacts: Contacts, expected: Expected, prior: Joint) -> Likelihood:
    """The likelihood of an event at ``contacts``, given its predicted measurement.

    The density of the instant is that of the gap at the stamp, times the speed at which the gap
    goes through zero, times the probability that it does so from above.
    """
    root, innovation = expected.innovation_root(prior), expected.innovation.tolist()
    white = np.linalg.solve(root, expected.innovation).tolist()
    slopes = expected.expansion.H[:, 0].tolist()
    spreads = lengths(expected.expansion.D.dot(prior.own[1:]))
    density = 0.0
    for i, (each, slope, spread) in enumerate(zip(white, slopes, spreads, strict=True)):
        density += _density(each, root[i, i], slope, spread)
    if len(contacts) == 1:
        density += _from_above(slopes[0], spreads[0])
    deviations = lengths(root)
    sizes = [abs(each) / s for each, s in zip(innovation, deviations, strict=True)]
    innovations = dict(zip(contacts, sizes, strict=True))
    normalised = float(innovation[0]) / deviations[0]
    return Likelihood(density, innovations, normalised, deviations[0], expected)


def _density(white: float, deviation: float, slope: float, spread: float) -> float:
    """Logarithm of the density of the instant at which one gap goes through zero, 1/s."""
    speed = math.log(math.hypot(slope, spread) + TINY)
    return speed - white * white / 2 - math.log(abs(deviation)) - LOG_ROOT_2PI


def _from_above(slope: float, spread: float) -> float:
    """Logarithm of the probability that a gap of this ``slope`` closes."""
    return float(special.log_ndtr(slope / max(spread, CLOSING * abs(slope), TINY)))
