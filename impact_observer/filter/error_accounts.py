# SPDX-License-Identifier: Apache-2.0
"""Hypotheses that the model is in error: how such an error begins, is matched to events, ends.

An error begins in retrospect: it has been there since the last event, and explains this one.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from impact_observer.events import Contacts
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.hypotheses import Hypothesis, Jump
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.likelihood import Likelihood
from impact_observer.filter.model_error import (
    NO_ERROR,
    ErrorKind,
    LearnedError,
    largest,
    unit_kicks,
)
from impact_observer.filter.tuning import TUNING
from impact_observer.kernel._kernel import TINY
from impact_observer.states import Matrix, Vector


class ErrorAccounts:
    """The errors of the model that the hypotheses of one filter may have."""

    def __init__(self, filter_: ImpactFilter, clocks: Sequence[float]) -> None:
        """Errors in the motion of a filter's system; ``clocks``: deviations of a stamp, s."""
        self._system = filter_.system
        self._moving = filter_.members.given.moving
        self._timescale = filter_.scales.timescale
        self._brief = TUNING.brief_flight * self._timescale
        self._clocks = sorted(clocks)
        kicks = unit_kicks(filter_.system)
        self._kicks = np.concatenate([np.zeros_like(kicks), kicks])

    def is_coarse(self, clock: float) -> bool:
        """Whether so large a deviation of stamps, s, may be an error of the model."""
        return clock > TUNING.coarse_clock * self._clocks[0]

    def others(
        self, h: Hypothesis, here: ContactChange, likelihood: Likelihood
    ) -> Iterator[Hypothesis]:
        """``h`` with other model errors before an impact that was ``here``."""
        size, deviation = abs(likelihood.normalised), likelihood.deviation
        if not (here.hit and likelihood.innovations and h.jump.ago > self._brief):
            return
        clocks = [h.clock]
        if h.error.level:
            yield h._replace(error=NO_ERROR)
            if (clock := self._clock_instead(h, here)) != h.clock:
                yield h._replace(error=NO_ERROR, clock=clock)
        else:
            clocks = clocks if size > TUNING.unexplained else []
            clocks += self._clocks[:1] if self.is_coarse(h.clock) else []
            if not clocks:
                return
        for kind in (ErrorKind.ACCELERATION, ErrorKind.RESTITUTION):
            if kind is h.error.kind or (root := self._root(h, kind, here.t)) is None:
                continue
            if (unit := self._seen_of(root, here)) <= TINY:
                continue
            level = min(max(size, 1.0) * deviation / unit, self._largest(h, kind, here))
            state = h.state.with_error(level * root)
            for clock in clocks:
                yield h._replace(state=state, clock=clock, error=LearnedError(kind, level))

    def after(
        self, h: Hypothesis, here: ContactChange, likelihood: Likelihood, posterior: Hypothesis
    ) -> Hypothesis:
        """The ``posterior`` of ``h`` with its model error, matched to the event ``here``."""
        error = h.error
        if error.level and here.hit:
            unit, most = self._seen(h, error.kind, here), self._largest(h, error.kind, here)
            error = error.matched(likelihood.normalised, likelihood.deviation, unit, most)
        if error is not NO_ERROR:
            ledger = posterior.ledger._replace(last_error=posterior.ledger.events)
            posterior = posterior._replace(error=error, ledger=ledger)
        return posterior if here.closed else self.kicked(posterior, h.state.x, here.hit)

    def kicked(self, after: Hypothesis, x: Vector, hit: Contacts) -> Hypothesis:
        """``after`` an impact of the contacts ``hit`` at the state ``x``; no contact is closed."""
        if not hit:
            return after
        state = after.state
        if after.error.kind is ErrorKind.RESTITUTION:
            state = state.with_error(after.error.level * self.kicks(x, hit))
        return after._replace(state=state, jump=Jump(0.0, x, hit))

    def kicks(self, x: Vector, hit: Contacts) -> Matrix:
        """What an error of 1 of the restitution adds at an impact at the state ``x``, (2n, k)."""
        speeds = np.abs(self._system.W[:, hit].T.dot(x[self._system.n :]))
        return np.asarray(self._kicks[:, hit] * speeds)

    def _root(self, h: Hypothesis, kind: ErrorKind, t: float) -> Matrix | None:
        """What a model error of level 1 has added to ``h`` by ``t``, since the last event.

        Shape (2n, any). None where the restitution has not acted.
        """
        closed, ago = h.state.closed, h.jump.ago
        began = t - ago, h.state.x
        if kind is ErrorKind.ACCELERATION:
            return self._moving.diffusion(*began, closed, ago)
        if h.jump.x is None:
            return None
        kicks = self.kicks(h.jump.x, h.jump.hit)
        return self._moving.carried(*began, kicks, ago, closed)

    def _seen(self, h: Hypothesis, kind: ErrorKind, here: ContactChange) -> float:
        """The standard deviation that this gives the gap of the impact, m."""
        root = self._root(h, kind, here.t)
        return 0.0 if root is None else self._seen_of(root, here)

    def _seen_of(self, root: Matrix, here: ContactChange) -> float:
        """The standard deviation that an error with this ``root`` gives the gap, m."""
        w = self._system.W[:, here.hit[0]]
        seen = w.dot(root[: w.size])
        return math.sqrt(seen.dot(seen))

    def _largest(self, h: Hypothesis, kind: ErrorKind, here: ContactChange) -> float:
        rate = self._moving.rate_of(here.t, h.state.x, here.before)
        return largest(kind, rate[self._system.n :], self._timescale)

    def _clock_instead(self, h: Hypothesis, here: ContactChange) -> float:
        """The deviation of stamps that would explain as much as the model error of ``h``, s."""
        speed = float(self._system.W[:, here.hit[0]] @ h.state.x[self._system.n :])
        seen = h.error.level * self._seen(h, h.error.kind, here)
        clock = math.hypot(seen / max(abs(speed), TINY), h.clock)
        return min(self._clocks, key=lambda each: abs(math.log(each / clock)))
