# SPDX-License-Identifier: Apache-2.0
"""The likelihood of an event, given the prior."""

import math
from typing import NamedTuple

import numpy as np
from scipy import linalg

from impact_observer.events import Contacts
from impact_observer.filter.joint import Expected, Joint
from impact_observer.filter.square_root import lengths
from impact_observer.kernel._kernel import log_mean_positive

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


UNMEASURED = Likelihood(0.0, {})
"""Of what measures nothing."""


def likelihood_of(contacts: Contacts, expected: Expected, prior: Joint) -> Likelihood:
    """The likelihood of an event at ``contacts``, given its predicted measurement.

    The density of the instant is that of the gap at the stamp, times the mean of the speed at
    which the gap closes, where that is positive (Rice, Mathematical analysis of random noise,
    1945). The speed is that at a gap of zero.
    """
    root, innovation = expected.innovation_root(prior), expected.innovation
    white = linalg.solve_triangular(root, innovation, lower=True)
    _, H, D, E = expected.expansion
    speeds = D.dot(prior.own[1:])
    speeds[:, 0] += E * prior.root[0, 0]
    seen = expected.rows(prior).dot(prior.root)
    gain = linalg.solve_triangular(root, seen.dot(speeds.T), lower=True)
    means = H[:, 0] + gain.T.dot(white)
    left = speeds - gain.T.dot(linalg.solve_triangular(root, seen, lower=True))
    noise = gain.T.dot(linalg.solve_triangular(root, expected.noise, lower=True))
    density = -float(white.dot(white)) / 2 - white.size * LOG_ROOT_2PI
    for mean, row, rest, scale in zip(means, left, noise, np.diag(root), strict=True):
        spread = math.hypot(*row.tolist(), *rest.tolist())
        density += log_mean_positive(float(mean), spread) - math.log(abs(scale))
    deviations = lengths(root)
    sizes = [abs(each) / s for each, s in zip(innovation.tolist(), deviations, strict=True)]
    innovations = dict(zip(contacts, sizes, strict=True))
    normalised = float(innovation[0]) / deviations[0]
    return Likelihood(density, innovations, normalised, deviations[0], expected)
