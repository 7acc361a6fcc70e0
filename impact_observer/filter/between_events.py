# SPDX-License-Identifier: Apache-2.0
"""Hypotheses from one event to the next: where they penetrate a stop, an impact was missed."""

import math
from collections.abc import Iterator, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.events import Kind
from impact_observer.filter.error_accounts import ErrorAccounts
from impact_observer.filter.flight_of import flight_of
from impact_observer.filter.forecast import Dip, Flight, Forecast, dips_of
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis, Jump
from impact_observer.filter.impact_filter import ImpactFilter
from impact_observer.filter.ledger import MissedSwitch
from impact_observer.filter.missed_switch import insert_switch
from impact_observer.filter.moving_system import MovingSystem
from impact_observer.filter.settling import rest_after
from impact_observer.filter.tuning import TUNING
from impact_observer.states import Vector

_LEAST_SURVIVAL = -1e3
"""Least logarithm of a survival: sums with smaller ones would lose the digits of a weight."""
_KEPT_FLIGHTS = 8
"""Flights of which the guards are kept, for hypotheses to share."""


class _Path(NamedTuple):
    """A hypothesis until the next event, or from a missed switch on.

    Attributes:
        t: where it begins, s since the epoch.
        left: seconds until the event.
        h: the hypothesis then.
    """

    t: float
    left: float
    h: Hypothesis


class _Missed(NamedTuple):
    """A switch on a path that was missed.

    Attributes:
        path: the path.
        dip: the penetration that begins there.
        weight: logarithm of the probability of the path with this switch.
        is_dead: whether it is in the sensor's dead time.
    """

    path: _Path
    dip: Dip
    weight: float
    is_dead: bool


def _flights(
    paths: Sequence[_Path],
) -> tuple[Vector, Vector, list[GaussianState], list[float]]:
    """Instants, durations, states and model errors of ``paths``, as the filter wants them."""
    return (
        np.array([path.t for path in paths]),
        np.array([path.left for path in paths]),
        [path.h.state for path in paths],
        [path.h.acceleration_error for path in paths],
    )


class BetweenEvents:
    """Predicts hypotheses, and inserts switches that the sensor missed.

    Attributes:
        filter: predicts the state of each.
        errors: that a model may have; None where none is learned.
        missed: probability that the sensor misses a switch.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        errors: ErrorAccounts | None,
        *,
        trusts_events: bool,
        missed: float,
        dead_time: float,
        most: int,
        keeps_exact: bool,
    ) -> None:
        """For the hypotheses of a bank.

        Args:
            filter_: predicts the state of each.
            errors: that a model may have, or None.
            trusts_events: whether none is spurious and none is missed: then nothing is inserted.
            missed: probability that the sensor misses a switch.
            dead_time: after an event, in which it reports no other hit of the contact, s.
            most: hypotheses of which twice as many are kept.
            keeps_exact: whether hypotheses with an exact model are kept for comparison.
        """
        self.filter = filter_
        self.errors = errors
        self._trusts_events = trusts_events
        self.missed = missed
        self._dead_time = dead_time
        self._most = most
        self._keeps_exact = keeps_exact
        changes = filter_.system.live or filter_.is_of_robot
        self._flight = flight_of if changes else lru_cache(_KEPT_FLIGHTS)(flight_of)

    def predict(
        self, hypotheses: Sequence[Hypothesis], t: float, s: float
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` of ``t`` (s since the epoch) ``s`` seconds later, the likeliest first.

        A hypothesis that penetrates a stop branches: the sensor missed a switch, or the estimate
        is in error.
        """
        if any(each.ledger.missed for each in hypotheses):
            hypotheses = [each._replace(ledger=each.ledger.later(s)) for each in hypotheses]
        if self._trusts_events:
            levels = [each.acceleration_error for each in hypotheses]
            states = self.filter.priors(t, s, [each.state for each in hypotheses], levels)
            return tuple(
                h._replace(state=state, jump=h.jump.later(s))
                for h, state in zip(hypotheses, states, strict=True)
            )
        found: list[tuple[float, Hypothesis]] = []
        paths, flights = [_Path(t, s, h) for h in hypotheses], 1
        most = -math.inf
        while paths:
            dips = self._dips(paths)
            flown = [*self._flown(paths, dips)]
            most = most if found else max(chance for chance, _ in flown)
            found += flown
            missed: list[_Missed] = []
            for path, some, (chance, _) in zip(paths, dips, flown, strict=True):
                most = max(most, chance)
                if some and flights + len(missed) < TUNING.most_flights:
                    missed += self._missed_first(path, some, most + self._least(path.h))
            flights += len(missed)
            paths = self._inserted(missed) if missed else []
        found.sort(key=lambda each: -each[0])
        most = found[0][0]
        likely = [h for w, h in found[: 2 * self._most] if w >= most + self._least(h)]
        return tuple(sorted(likely, key=lambda each: each.weight, reverse=True))

    def _least(self, h: Hypothesis) -> float:
        """Logarithm of a probability, relative to the largest, below which ``h`` is not kept."""
        return TUNING.log_forlorn if self._keeps_exact and h.is_exact else TUNING.log_unlikely

    def _dips(self, paths: Sequence[_Path]) -> list[list[Dip]]:
        """Of each path its dips; of one that they make impossible, the first dips."""
        reach = TUNING.first_reach * self.filter.scales.timescale
        found = self._dips_within(reach, paths)
        while reach < max(path.left for path in paths):
            reach *= 4
            more = [k for k, path in enumerate(paths) if self._goes_on(path, reach / 4, found[k])]
            if not more:
                break
            for k, dips in zip(
                more, self._dips_within(reach, [paths[k] for k in more]), strict=True
            ):
                found[k] = dips
        return found

    def _goes_on(self, path: _Path, reach: float, dips: Sequence[Dip]) -> bool:
        """Whether a path of which ``dips`` are known within ``reach`` seconds may be possible."""
        unlikely = sum(dip.unlikely for dip in dips if dip.over)
        return reach < path.left and unlikely > _LEAST_SURVIVAL

    def _dips_within(self, reach: float, paths: Sequence[_Path]) -> list[list[Dip]]:
        """Of each path its dips in the first ``reach`` seconds."""
        paths = [_Path(t, min(left, reach), h) for t, left, h in paths]
        by_kernel = self.filter.gaps((), max(path.left for path in paths)) is not None
        free = [path for path in paths if by_kernel and not path.h.state.closed]
        found = iter(dips_of(self.filter, *_flights(free)) or () if free else ())
        return [
            next(found)
            if by_kernel and not h.state.closed
            else self.forecast(t, h.state, h.acceleration_error).dips(s)
            for t, s, h in paths
        ]

    def _flown(
        self, paths: Sequence[_Path], dips: Sequence[Sequence[Dip]]
    ) -> Iterator[tuple[float, Hypothesis]]:
        """The hypotheses of ``paths`` at their ends, with the survival of the dips on the way.

        A dip that had begun before counts by how much deeper it has become. Beside each hypothesis
        stands the logarithm of its probability if the next event explains the dips that go on.
        """
        for (_, s, h), state, found in zip(paths, self._priors(paths), dips, strict=True):
            weight, chance, survival = h.weight, h.weight, dict[int, float]()
            for dip in found:
                before = h.survival.get(dip.contact, 0.0) if dip.goes_on else 0.0
                now = before
                if not self._is_now(dip, s, h):
                    now = min(max(dip.unlikely, _LEAST_SURVIVAL), before)
                weight += now - before
                if dip.over:
                    chance += now - before
                elif now:
                    chance -= before
                    survival[dip.contact] = now
            jump = h.jump.later(s)
            yield chance, h._replace(state=state, weight=weight, survival=survival, jump=jump)

    def undisturbed(
        self, hypotheses: Sequence[Hypothesis], t: float, s: float
    ) -> Sequence[Hypothesis] | None:
        """``predict`` of undisturbed ``hypotheses``, in a fraction of the time.

        None if a contact may have been closed.
        """
        if not s:
            return hypotheses
        levels = [h.acceleration_error for h in hypotheses]
        states = self.filter.priors(t, s, [h.state for h in hypotheses], levels)
        if not all(self.filter.is_open(state, s) for state in states):
            return None
        return [
            h._replace(state=state, jump=h.jump.later(s))
            for h, state in zip(hypotheses, states, strict=True)
        ]

    def _priors(self, paths: Sequence[_Path]) -> list[GaussianState]:
        """The states of ``paths`` at their ends."""
        return self.filter.flights(*_flights(paths))

    def _missed_first(self, path: _Path, dips: Sequence[Dip], enough: float) -> Iterator[_Missed]:
        """The first of ``dips`` that may be a missed switch, if any.

        None below ``enough``, the logarithm of a probability.
        """
        h = path.h
        likely = (
            dip
            for dip in dips
            if dip.depth > (TUNING.possible_depth if dip.over else TUNING.confident_depth)
            and not self._is_now(dip, path.left, h)
        )
        dip = next(likely, None)
        if dip is None or len(h.ledger.missed) >= TUNING.most_missed:
            return
        dead = self.dead(h, dip.contact, dip.kind, path.t + dip.began)
        weight = h.weight + self.log_missed(dead) + float(special.log_ndtr(dip.depth))
        if dip.goes_on:
            weight -= h.survival.get(dip.contact, 0.0)  # the impact explains the negative gap
        if weight < enough:
            return
        yield _Missed(path, dip, weight, dead > TUNING.dead)

    def _inserted(self, missed: Sequence[_Missed]) -> list[_Path]:
        """Paths after missed switches, but for those that the impact law does not allow."""
        before = self._priors([each.path._replace(left=each.dip.began) for each in missed])
        t = [each.path.t + each.dip.began for each in missed]
        found = []
        for (path, dip, weight, is_dead), at, prior in zip(missed, t, before, strict=True):
            if (inserted := insert_switch(self.filter, at, prior, dip)) is None:
                continue
            state, kind, flight = inserted
            h, left = path.h, path.left - dip.began
            switch = MissedSwitch(dip.contact, kind, left, dip.depth, is_dead)
            rest = None
            if kind is Kind.CLOSE:
                rest = rest_after(self.filter, dip.contact, at, flight, h.clock)
            h = h._replace(
                state=state,
                weight=weight,
                ledger=h.ledger.with_missed(switch, rest),
                survival=h.survival_without((dip.contact,)),
                jump=Jump(),
            )
            if self.errors is not None:
                hit = (dip.contact,) if kind is Kind.IMPACT and not state.closed else ()
                h = self.errors.kicked(h, prior.x, hit)
            found.append(_Path(at, left, h))
        return found

    def _is_now(self, dip: Dip, now: float, h: Hypothesis) -> bool:
        """Whether an impact comes so late that it may be the event, of which the stamp errs.

        Parameters in doubt leave its instant in doubt: there a dip is now that has just been seen.
        A gap that is negative at the start of the flight was zero when its speed says.
        """
        if dip.over:
            return False
        began = dip.below if self.filter.members.family.size else dip.began
        if dip.goes_on and dip.kind is Kind.IMPACT:
            began = -self.filter.since_root(dip.contact, h.state)
        return now - began <= TUNING.late * h.clock

    def dead(self, h: Hypothesis, contact: int, kind: Kind, t: float) -> float:
        """Probability that the sensor could not report a switch of ``contact`` at ``t``, s.

        It cannot in its dead time after the last report, of which the stamp has an error, nor can
        it report the end of a rest that it has not reported. A row of which it has reported the
        first edge as CLOSE is not reported until the contact rests.
        """
        if contact in h.ledger.unreported:
            return 1.0
        if kind is Kind.OPEN and self._dead_time:
            return float(h.ledger.closed_unreported(contact))
        last = h.ledger.reported.get(contact)
        if last is None or not self._dead_time:
            return 0.0
        return float(special.ndtr((last + self._dead_time - t) / h.clock))

    def log_missed(self, dead: float) -> float:
        """Logarithm of the probability that a switch is not reported.

        ``dead`` is that with which the sensor could not.
        """
        missed = dead + (1.0 - dead) * self.missed
        return math.log(missed) if missed else -math.inf

    def forecast(self, t: float, state: GaussianState, model_error: float = 0.0) -> Forecast:
        """The prediction of ``state`` from ``t`` (s since the epoch) on, with its penetrations."""
        prediction = self.filter.predict(t, state, model_error)
        flight = partial(self._flight_of, t, state, prediction.moving)
        return Forecast(flight, prediction, state, self.filter, t=t, level=model_error)

    def _flight_of(self, t: float, state: GaussianState, moving: MovingSystem) -> Flight:
        members = self.filter.members
        member = members.with_given_restitution(self.filter.member(state))
        return self._flight(member.system, moving, t, state.closed)
