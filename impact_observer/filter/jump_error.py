# SPDX-License-Identifier: Apache-2.0
"""Errors of the velocity jumps of a robot: each hit branches into errors of several sizes.

A tip that rubs, a soft cover and joints that bend change velocities at a hit otherwise than the
impact law. The error of a jump has, by the mass matrix, as much energy in every direction, and its
size is one of a few levels times the size of the jump. The samples after the hit weigh the levels.
The prior of a level is its share of the hits so far (Dirichlet's distribution with forgetting), as
in an interacting multiple model (Blom and Bar-Shalom, IEEE TAC, 1988) whose transitions are
learned. The largest level makes the filter forget the velocities at a hit.
"""

import math
from typing import NamedTuple

from impact_observer.filter.tuning import TUNING

LEVELS = TUNING.jump_errors
"""Standard deviations of an error over the size of its jump."""


class JumpError(NamedTuple):
    """What a hypothesis supposes of the errors of the jumps so far.

    Attributes:
        counts: hits of each level, with those that are supposed beforehand.
        latest: index of the level of the latest hit; -1 before a hit.
    """

    counts: tuple[float, ...] = TUNING.jump_counts
    latest: int = -1

    @property
    def is_strange(self) -> bool:
        """Whether the impact law does not explain the jumps of many hits."""
        faded = sum(self.counts) - sum(TUNING.jump_counts)
        large = sum(self.counts[1:]) - sum(TUNING.jump_counts[1:])
        return large > TUNING.unexplained_jumps * max(faded, TUNING.jump_hits)

    def log_prior(self, level: int) -> float:
        """Logarithm of the probability that the next hit has a level, by its index."""
        return math.log(self.counts[level] / sum(self.counts))

    @property
    def unexplained(self) -> "JumpError":
        """The same if the latest hit has the largest error."""
        if self.latest < 0:
            return self
        counts = [*self.counts]
        counts[self.latest] -= 1.0
        counts[-1] += 1.0
        return JumpError(tuple(counts), len(counts) - 1)

    def after_hit(self, level: int) -> "JumpError":
        """The same after a hit of a level, by its index."""
        faded = [
            first + TUNING.forgetting * (now - first)
            for first, now in zip(TUNING.jump_counts, self.counts, strict=True)
        ]
        faded[level] += 1.0
        return JumpError(tuple(faded), level)
