# SPDX-License-Identifier: Apache-2.0

# ruff: noqa: D102 (overrides have the docstrings of ``Prediction``)
"""Predictions of the minimum-variance law: estimate and covariance until the next event."""

import math
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.events import Contacts, Kind, Ruling
from impact_observer.filter.between_events import BetweenEvents
from impact_observer.filter.filter_bank import FilterBank
from impact_observer.filter.forecast import Dip, Forecast
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, mean_level, mixture
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.linear import LinearPrediction
from impact_observer.filter.misfit import SILENCE
from impact_observer.filter.missed_switch import insert_switch
from impact_observer.filter.model_error import ErrorKind
from impact_observer.filter.square_root import lengths, triangular
from impact_observer.filter.tuning import TUNING
from impact_observer.observer.belief import Belief, Prediction
from impact_observer.states import Matrix, Vector


class MixturePrediction(Prediction):
    """The prediction of several hypotheses, which are computed at the first request.

    Attributes:
        agreeing: the prediction of the hypotheses that the test of ``synchronized`` counts.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        t: float,
        hypotheses: Callable[[], Sequence[Hypothesis]],
        prior: Callable[[float], Belief],
    ) -> None:
        self._filter = filter_
        self.agreeing: Prediction = self
        self._t = t
        self._shown = hypotheses
        self._prior = prior

    @cached_property
    def _hypotheses(self) -> Sequence[Hypothesis]:
        return self._shown()

    @cached_property
    def _linear(self) -> LinearPrediction:
        level = mean_level(self._hypotheses, ErrorKind.ACCELERATION)
        return self._filter.predict(self._t, mixture(self._hypotheses), level)

    def state(self, s: float) -> Vector:
        return self._linear.state(s)

    def root(self, s: float) -> Matrix:
        return self._linear.root(s)

    def agreeing_root(self, s: float) -> Matrix | None:
        return self.agreeing.root(s)

    def belief(self, s: float) -> Belief:
        return self._prior(s)

    def _with_stopped(self, root: Matrix, largest: Vector) -> Matrix:
        """``root`` with a plant that has stopped anywhere within its motion so far.

        ``largest`` is the magnitude of each component of (q, u) in that motion, shape (2n,).
        """
        return np.hstack([root, math.sqrt(TUNING.silent_share) * self._anywhere(largest)])

    def _anywhere(self, largest: Vector) -> Matrix:
        """A root of the covariance of a plant that is anywhere within a motion, (2n, 2n)."""
        return np.diag(self._filter.scales.sizes(largest))


def predicted_by(
    bank: FilterBank,
    t: float,
    hypotheses: Callable[[], Sequence[Hypothesis]],
    prior: Callable[[float], Belief],
) -> MixturePrediction:
    """The prediction of hypotheses of a ``bank``, from ``t`` (s since the epoch) on.

    ``prior`` finds the whole belief some seconds later.
    """
    if bank.trusts_events:
        return TrustedPrediction(bank.filter, t, hypotheses, prior)
    return MissedSwitchPrediction(bank.between, t, hypotheses, prior)


class TrustedPrediction(MixturePrediction):
    """The prediction of a sensor that is declared without faults, so that none is inserted.

    An estimate that was inside a stop, and not for a moment only, contradicts the declaration.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        t: float,
        hypotheses: Callable[[], Sequence[Hypothesis]],
        prior: Callable[[float], Belief],
    ) -> None:
        super().__init__(filter_, t, hypotheses, prior)
        self._step = TUNING.brief_flight * filter_.scales.timescale
        self._looked, self._inside = 0, np.zeros(filter_.system.m, dtype=bool)
        self._inside_since = math.inf
        self._largest = np.zeros(2 * filter_.system.n)

    def root(self, s: float) -> Matrix:
        root = super().root(s)
        return self._with_stopped(root, self._largest) if self._is_inside(s) else root

    def belief(self, s: float) -> Belief:
        prior = super().belief(s)
        return prior._replace(fit=prior.fit.contradicted()) if self._is_inside(s) else prior

    def silence(self, s: float) -> str:
        return f"a predicted impact was {SILENCE}" if self._is_inside(s) else ""

    def _is_inside(self, s: float) -> bool:
        """Whether the estimate was inside a stop at two steps in a row within ``s`` seconds."""
        while self._inside_since == math.inf and (self._looked + 1) * self._step <= s:
            self._looked += 1
            at, before = self._looked * self._step, self._inside
            x = self.state(at)
            self._largest = np.maximum(self._largest, np.abs(x))
            self._inside = self._contacts_inside(at, x)
            if np.any(before & self._inside):
                self._inside_since = at
        return self._inside_since <= s

    def _contacts_inside(self, s: float, x: Vector) -> NDArray[np.bool_]:
        """Which open contacts have a gap far below zero at ``x`` after ``s`` seconds, (m,)."""
        system, n = self._filter.near(x), self._filter.system.n
        gaps = system.gap(x[:n])
        inside = np.asarray(gaps < 0, dtype=np.bool_)
        inside[list(self._hypotheses[0].state.closed)] = False
        if inside.any():
            deviations = lengths(system.W.T @ self._linear.root(s)[:n])
            inside &= gaps < -TUNING.contradiction * np.array(deviations)
        return inside


class _Stretch(NamedTuple):
    """The likeliest hypothesis between two missed switches.

    Attributes:
        since: when the stretch becomes the estimate, s since the last event.
        start: when the stretch begins, s since the last event.
        forecast: prediction and penetrations of the hypothesis.
        closed: contacts that the hypothesis holds closed.
        spread: the prediction whose covariance is that of the whole mixture.
        largest: magnitude of each component of (q, u) at the starts so far, shape (2n,).
        silent: predicted impacts that were not reported so far; a row of bounces counts once.
        is_lost: whether no more switches are inserted: the plant may be anywhere.
    """

    since: float
    start: float
    forecast: Forecast
    closed: Contacts
    spread: LinearPrediction
    largest: Vector
    silent: int = 0
    is_lost: bool = False


class MissedSwitchPrediction(MixturePrediction):
    """The prediction of several hypotheses, with missed switches inserted.

    The estimate is a function of time alone: a missed switch counts once its dip is as deep as
    ``Tuning.confident_depth``, whatever the order of the calls.
    """

    def __init__(
        self,
        between: BetweenEvents,
        t: float,
        hypotheses: Callable[[], Sequence[Hypothesis]],
        prior: Callable[[float], Belief],
    ) -> None:
        super().__init__(between.filter, t, hypotheses, prior)
        self._between = between
        self._first = between.filter.members.given.moving.first_window
        self._searched, self._window = 0.0, self._first
        self._ahead = list[Dip]()

    def state(self, s: float) -> Vector:
        stretch = self._stretch(s)
        return stretch.forecast.prediction.state(s - stretch.start)

    def root(self, s: float) -> Matrix:
        stretch = self._stretch(s)
        if stretch.is_lost:
            return self._anywhere(stretch.largest)
        root = stretch.spread.root(s - stretch.start)
        return self._with_stopped(root, stretch.largest) if self.silence(s) else root

    def silence(self, s: float) -> str:
        late = TUNING.late * self._hypotheses[0].clock
        silent = self._stretch(max(s - late, 0.0)).silent
        is_silent = silent >= self._fewest_silent
        return f"{silent} predicted impacts in a row were {SILENCE}" if is_silent else ""

    @cached_property
    def _fewest_silent(self) -> int:
        """How many impacts in a row are improbable to be missed, at the rate of misses so far.

        The rate is a deviation above its posterior mean; its prior is worth
        ``Tuning.silent_prior`` impacts.
        """
        notes = self._hypotheses[0].ledger.notes
        missed = sum(note.is_inserted and not note.is_dead for note in notes)
        reported = sum(note.ruling is Ruling.APPLIED for note in notes)
        count = TUNING.silent_prior + missed + reported
        mean = (TUNING.silent_prior * self._between.missed + missed) / count
        rate = mean + math.sqrt(mean * (1 - mean) / (count + 1))
        return max(math.ceil(TUNING.log_silent / math.log(rate)), 2) if 0 < rate < 1 else 2

    def closed(self, s: float) -> Contacts:
        return self._stretch(s).closed

    def _stretch(self, s: float) -> _Stretch:
        while self._searched < s:
            if self._ahead:
                self._insert()
            else:
                self._search()
        return next(each for each in reversed(self._stretches) if each.since <= s)

    @cached_property
    def _stretches(self) -> list[_Stretch]:
        root = mixture(self._hypotheses).root
        return [self._begun(0.0, 0.0, self._hypotheses[0].state, root)]

    def _begun(self, since: float, start: float, state: GaussianState, root: Matrix) -> _Stretch:
        t = self._t + start
        forecast = self._between.forecast(t, state, self._hypotheses[0].acceleration_error)
        spread = forecast.prediction
        if root is not state.root:
            level = mean_level(self._hypotheses, ErrorKind.ACCELERATION)
            spread = self._filter.predict(t, state._replace(root=root), level)
        return _Stretch(since, start, forecast, state.closed, spread, np.abs(state.x))

    def _search(self) -> None:
        """Search the window for missed switches; none counts before its dip begins."""
        if len(self._stretches) > TUNING.most_missed:
            self._give_up()
            return
        start, forecast = self._stretches[-1].start, self._stretches[-1].forecast
        dips = forecast.dips(self._window)
        self._ahead = [dip for dip in dips if dip.depth >= TUNING.confident_depth]
        if self._ahead:
            self._searched = start + self._ahead[0].began
        else:
            self._look_further()

    def _look_further(self) -> None:
        """Go on after the window, which doubles."""
        self._searched = self._stretches[-1].start + self._window
        self._window *= 2

    def _insert(self) -> None:
        """Insert the first of the missed switches ahead that the impact law allows."""
        _, start, forecast, _, spread, largest, silent, _ = self._stretches[-1]
        ahead, self._ahead = self._ahead, []
        for dip in ahead:
            at, t = dip.began, self._t + start + dip.began
            before = forecast.prediction.prior(at)
            if (inserted := insert_switch(self._filter, t, before, dip)) is not None:
                break
        else:
            self._look_further()
            return
        state, kind, _ = inserted
        since = start + forecast.confident_from(dip, TUNING.confident_depth)
        # The other hypotheses jump too, so their differences are reversed in the same way.
        differences, size = spread.full_root(at).copy(), state.x.size
        if kind is not Kind.OPEN:
            pressed = tuple(sorted({*state.closed, dip.contact}))
            mirror = self._filter.member(state).mirror_about(before.x, pressed)
            differences[:size] = mirror.J @ differences[:size]
        parts = [state.root, differences]
        level = mean_level(self._hypotheses, ErrorKind.RESTITUTION)
        if level and kind is Kind.IMPACT and not state.closed:
            assert self._between.errors is not None, "a level is learned"
            kicked = level * self._between.errors.kicks(before.x, (dip.contact,))
            parts.append(np.pad(kicked, ((0, len(state.root) - size), (0, 0))))
        root = triangular(np.hstack(parts))
        next_ = self._begun(since, start + at, state, root)
        largest = np.maximum(largest, next_.largest)
        silent += self._is_silent(dip, kind, t, at)
        self._stretches.append(next_._replace(largest=largest, silent=silent))
        self._searched, self._window = since, self._first

    def _is_silent(self, dip: Dip, kind: Kind, t: float, flight: float) -> bool:
        """Whether a switch at ``t`` (s) that was not reported counts, after a ``flight``, s.

        It does not in the sensor's dead time, nor as a bounce in a row with the switch before.
        """
        is_bounce = flight < TUNING.brief_flight * self._filter.scales.timescale
        dead = self._between.dead(self._hypotheses[0], dip.contact, kind, t)
        return kind is not Kind.OPEN and not is_bounce and dead <= TUNING.dead

    def _give_up(self) -> None:
        """Insert no more switches: the motion passes through stops, the plant may be anywhere.

        Deviations stay the largest that the modes of the motion so far can give.
        """
        self._stretches[-1] = self._stretches[-1]._replace(is_lost=True)
        self._searched = math.inf
