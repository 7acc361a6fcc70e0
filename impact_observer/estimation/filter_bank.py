# SPDX-License-Identifier: Apache-2.0
"""A bank of impact filters: each holds another hypothesis of what the events were.

Multiple hypothesis tracking (Blackman and Popoli, Design and Analysis of Modern Tracking Systems,
1999, chapter 16), as ``docs/theory/filter.md`` describes.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from impact_observer.errors import ImpactLawError
from impact_observer.estimation.between_events import BetweenEvents
from impact_observer.estimation.contact_change import ContactChange
from impact_observer.estimation.error_accounts import ErrorAccounts
from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.hypotheses import (
    Hypothesis,
    log_sum,
    normalised,
)
from impact_observer.estimation.impact_filter import Asked, ImpactFilter
from impact_observer.estimation.ledger import Ledger, Note
from impact_observer.estimation.likelihood import CERTAIN, Likelihood
from impact_observer.estimation.settling import Rest, settled
from impact_observer.estimation.square_root import lengths
from impact_observer.estimation.tuning import TUNING
from impact_observer.estimation.uncertainty import Uncertainty
from impact_observer.events import Kind, Ruling
from impact_observer.kernel._kernel import TINY
from impact_observer.states import Vector

_SHORTLY = 50_000_000
"""Time since another event of the contact up to which a rejection names it, ns."""


Restarts: TypeAlias = Callable[[], Sequence[Hypothesis]]
"""Makes the hypotheses of a restart; their probabilities add up to one."""


class Extent(NamedTuple):
    """How large the motion is, by a replica that follows the events whatever the filter does.

    Attributes:
        u: its velocities now, shape (n,).
        largest: magnitude of each component of (q, u) so far, the initial standard deviation
            included, shape (2n,).
    """

    u: Vector
    largest: Vector


class _Branch(NamedTuple):
    """One interpretation of an event.

    Attributes:
        weight: logarithm of its probability, without the likelihood of ``here``.
        before: the hypothesis before it, with the clock and the model error that it assumes.
        here: what the event was; None for nothing.
        reason: of its notes.
        likelihood: of ``here``, or of the event if it had not been nothing.
    """

    weight: float
    before: Hypothesis
    here: ContactChange | None = None
    reason: str = ""
    likelihood: Likelihood = CERTAIN

    @property
    def asked(self) -> Asked:
        """What the filter is asked; of an event that was something."""
        assert self.here is not None, "an event"
        return Asked(self.here, self.before.state, self.before.clock, self.likelihood)


_Draft: TypeAlias = tuple[float, Hypothesis, ContactChange, str]
"""Weight, hypothesis before, event and reason of a branch whose likelihood is not known yet."""


class LogPriors(NamedTuple):
    """Logarithms of what is known of an event before it is seen.

    Attributes:
        reported: probability that an impact is reported.
        missed: probability that it is not.
        spurious: odds of a spurious event, times their rate, 1/s.
    """

    reported: float
    missed: float
    spurious: float


class FilterBank:
    """Hypotheses of one system from event to event.

    Attributes:
        filter: predicts and corrects the state of each of them.
        trusts_events: whether every event is what it is reported to be.
        trusts_estimate: whether nothing makes its covariance wrong.
        between: predicts hypotheses from one event to the next.
    """

    def __init__(
        self,
        filter_: ImpactFilter,
        uncertainty: Uncertainty,
        clocks: Sequence[float] = (),
        most: int = TUNING.most_hypotheses,
    ) -> None:
        """A bank for the ``uncertainty``.

        ``clocks`` are standard deviations of stamps, s; ``most`` hypotheses are kept at most.
        """
        self.filter = filter_
        self._next_clocks = {
            clock: tuple(clocks[i + k] for k in TUNING.clock_steps if 0 <= i + k < len(clocks))
            for i, clock in enumerate(clocks)
        }
        self.trusts_events = uncertainty.trusts_events
        # Where parameters are estimated the estimate may be wrong though every event is true.
        self.trusts_estimate = self.trusts_events and uncertainty.unknowns is None
        learns_error = uncertainty.model_error is None and clocks
        self.errors = ErrorAccounts(filter_, clocks) if learns_error else None
        self._missed, self._reported = _logs(uncertainty.missed)
        self._has_dead_time = uncertainty.dead_time > 0
        self._mislabelled, _ = _logs(uncertainty.mislabelled)
        self._rate = -math.log(filter_.phases.scales.timescale)
        spurious, true = _logs(uncertainty.spurious)
        self._spurious = spurious - true + math.log(TUNING.spurious_rate) + self._rate
        affordable = TUNING.hypothesis_numbers // (2 * filter_.system.n)
        self._most = min(most, max(TUNING.least_hypotheses, affordable))
        self._judges = self.errors is not None and uncertainty.unknowns is None
        self._scan = TUNING.scan * filter_.system.n
        self._compares_states = filter_.system.m > 1
        self.between = BetweenEvents(
            filter_,
            self.errors,
            trusts_events=self.trusts_events,
            missed=uncertainty.missed,
            dead_time=uncertainty.dead_time,
            most=self._most,
            judges=self._judges,
        )

    def likely(self, ordered: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those of ``ordered``, the likeliest first, that are kept."""
        count = min(_likely(ordered), self._most)
        found, rest = [*ordered[:count]], ordered[count:]
        if self._judges and any(not h.is_exact for h in found):
            enough = ordered[0].weight + TUNING.log_forlorn
            exact = [h for h in rest if h.is_exact and h.weight > enough]
            found += exact[: _likely(exact) if exact else 0]
        return found

    @property
    def log_priors(self) -> LogPriors:
        """What it assumes of any event."""
        return LogPriors(self._reported, self._missed, self._spurious)

    def correct(
        self,
        change: ContactChange,
        hypotheses: Sequence[Hypothesis],
        restarts: Restarts,
        extent: Extent,
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` after an event, the likeliest first; their probabilities add to one.

        ``restarts`` makes those of a restart.
        """
        if not self._has_dead_time:
            return self._corrected(change, hypotheses, restarts, extent)
        before = hypotheses[0].ledger.reported
        reported = {**before, **dict.fromkeys(change.hit, change.t)}
        found = self._corrected(change, hypotheses, restarts, extent)
        return tuple([h._replace(ledger=h.ledger._replace(reported=reported)) for h in found])

    def _corrected(
        self,
        change: ContactChange,
        hypotheses: Sequence[Hypothesis],
        restarts: Restarts,
        extent: Extent,
    ) -> tuple[Hypothesis, ...]:
        """``hypotheses`` after an event, but for what has been reported."""
        root_energy = self._root_energy(extent.u)
        if change.disorder:
            hypotheses = [h.disordered(change.disorder) for h in hypotheses]
        branches = self._branches(change, hypotheses, root_energy, extent.largest)
        branches.sort(key=_weight)
        likely = branches[: min(_likely(branches), self._most)]
        likely += self._unlikely_exact(branches, len(likely))
        made = self.distinct([h for h in self._made(change, likely) if h.state.is_finite])
        if not self.trusts_estimate:
            made = [*made, *self._restarted(change, branches, made, restarts)]
        return normalised(sorted(made, key=_weight))

    def _unlikely_exact(self, branches: Sequence[_Branch], likely: int) -> list[_Branch]:
        """Of ``branches`` after the ``likely`` ones the likeliest with an exact model."""
        if not self._judges or all(each.before.is_exact for each in branches):
            return []
        enough = branches[0].weight + TUNING.log_forlorn
        exact = [b for b in branches if b.before.is_exact and b.weight > enough]
        exact = exact[: min(_likely(exact), self._most)]
        return exact[sum(b.before.is_exact for b in branches[:likely]) :]

    def _restarted(
        self,
        change: ContactChange,
        branches: Sequence[_Branch],
        made: Sequence[Hypothesis],
        restarts: Restarts,
    ) -> Iterator[Hypothesis]:
        """Restarts of those with an exact model and of the others, if they did not predict it."""
        if not made:
            yield from _restarted(change, made, restarts())
        for exact in (True, False):
            own = [h for h in made if h.is_exact is exact]
            first = next((b for b in branches if b.before.is_exact is exact), None)
            if own and first is not None and not self._is_expected(first):
                yield from _restarted(change, own, restarts())

    def _root_energy(self, u: Vector) -> float:
        """The root of twice the kinetic energy of velocities ``u``, shape (n,)."""
        return math.sqrt(u.dot(self.filter.phases.inertia(u)))

    def _branches(
        self,
        change: ContactChange,
        hypotheses: Sequence[Hypothesis],
        root_energy: float,
        largest: Vector,
    ) -> list[_Branch]:
        """The interpretations of an event; more of them under hypotheses that lead."""
        weights = [each.weight_without(change.contacts) for each in hypotheses]
        leading, leading_exact = max(weights) + TUNING.log_leading, math.inf
        if self._judges:
            of_exact = [w for w, h in zip(weights, hypotheses, strict=True) if h.is_exact]
            leading_exact = max(of_exact, default=0.0) + TUNING.log_leading
        found: list[_Branch] = []
        true: list[_Draft] = []
        clocks: list[_Draft] = []
        leads = []
        for h, weight in zip(hypotheses, weights, strict=True):
            here = change.from_closed(h.state.closed)
            if h.ledger.settled and (bounce := self._bounce(change, h, weight)):
                found.append(bounce)
                continue
            if here.is_nothing:
                found.append(self._spurious_event(change, h, "its contact is not closed"))
                continue
            prior = self._reported + h.weight_without(here.contacts)
            true.append((prior, h, here, ""))
            leads.append(weight >= leading or (h.is_exact and weight >= leading_exact))
            nexts = self._next_clocks.get(h.clock, ()) if leads[-1] else ()
            clocks += [
                (prior + TUNING.log_clock_change, h._replace(clock=clock), here, "")
                for clock in nexts
            ]
        weighed = self._weighed([*true, *clocks], root_energy)
        others = [
            other
            for each, leading_ in zip(weighed, leads, strict=False)
            for other in self._others(change, each, largest, leads=leading_)
        ]
        if self._spurious > -math.inf:
            found += [
                self._spurious_event(change, each.before, likelihood=each.likelihood)
                for each in weighed[: len(true)]
            ]
        return [*found, *weighed, *(self._weighed(others, root_energy) if others else ())]

    def _weighed(self, drafts: Sequence[_Draft], root_energy: float) -> list[_Branch]:
        """Branches with the likelihoods of what the event was."""
        asked = [Asked(here, h.state, h.clock) for _, h, here, _ in drafts]
        return [
            _Branch(
                weight + likelihood.density + self._slowness(here, h, root_energy),
                h,
                here,
                reason,
                likelihood,
            )
            for (weight, h, here, reason), likelihood in zip(
                drafts, self.filter.likelihoods(asked), strict=True
            )
        ]

    def _slowness(self, here: ContactChange, h: Hypothesis, root_energy: float) -> float:
        """Logarithm of the probability that an impact is so slow after the time since the last.

        A body that rests on several stops has gaps of zero, which fit any event. It hits nothing.
        ``root_energy`` is that of twice the kinetic energy of the fallback.
        """
        if len(here.hit) != 1 or here.before:
            return 0.0
        i, phases = here.hit[0], self.filter.phases
        mean = self.filter.speed(i, h.state)
        least = TUNING.slow_impact * float(phases.length[i]) * root_energy
        if abs(mean) >= least:
            return 0.0
        applied = (n for n in reversed(h.ledger.notes) if n.ruling is not Ruling.REJECTED)
        if (last := next((n.stamp for n in applied if n.switched == i), None)) is not None:
            flight = (here.stamp - last) / 1e9  # it may bounce: slower, but sooner
            least *= min(flight / (2 * phases.scales.timescale), 1.0)
        speed = math.hypot(mean, self.filter.speed_deviation(i, h.state), TINY)
        return min(math.log(speed / least), 0.0) if least > 0 else 0.0

    def _others(
        self, change: ContactChange, true: _Branch, largest: Vector, *, leads: bool
    ) -> Iterator[_Draft]:
        """Alternatives to the branch in which the event is ``true``, but for other clocks."""
        h, here, likelihood = true.before, true.here, true.likelihood
        assert here is not None, "it is true"
        prior = h.weight_without(here.contacts)
        depth = max(likelihood.innovations.values(), default=-1.0)
        if leads and self.errors is not None:
            changed = prior + self._reported + TUNING.log_error_change
            for other in self.errors.others(h, here, likelihood):
                yield changed, other, here, ""
        if leads and depth > TUNING.surprise and not self.trusts_estimate:
            part = self.filter.part_of(here.contacts)
            for factor in (TUNING.widening, TUNING.large_widening):
                state = self.filter.widened(h.state, factor * depth, largest, part)
                wider = h._replace(state=state)
                reason = f"accepted: the covariance is made {factor * depth:.3g} times wider"
                yield prior + TUNING.log_restart, wider, here, reason
        impact = len(change.hit) == 1 and here.before == here.closed
        if impact and self._mislabelled > -math.inf and not self._is_expected(true):
            closed = h.state.closed
            contacts = range(self.filter.system.m)
            others = [i for i in contacts if i not in (*change.hit, *closed)]
            for i in others:
                other_contact = change._replace(before=closed, hit=(i,), closed=closed)
                weight = h.weight_without((i,)) + self._mislabelled - math.log(len(others))
                reason = f"mislabelled: it hit {self.filter.system.contact_names[i]}"
                yield weight, h, other_contact, reason

    def _is_expected(self, branch: _Branch) -> bool:
        """Whether the event came about when it was predicted."""
        if branch.here is None:
            return False
        likelihood = branch.likelihood
        soon = likelihood.density > max(len(branch.here.contacts), 1) * self._rate
        return soon and max(likelihood.innovations.values(), default=0.0) < TUNING.surprise

    def _made(self, change: ContactChange, branches: Sequence[_Branch]) -> list[Hypothesis]:
        """The hypotheses of ``branches`` after the event, if it is possible in them."""
        true = [each.asked for each in branches if each.here and not each.here.is_nothing]
        after, found = iter(self._posteriors(true)), []
        for each in branches:
            if each.here is None:
                found.append(self._rejected(change, each))
                continue
            state = each.before.state if each.here.is_nothing else next(after)
            if state is not None:
                found.append(self._accepted(change, each, each.here, state))
        return found

    def _posteriors(self, asked: Sequence[Asked]) -> Sequence[GaussianState | None]:
        """The states after an event; None where the impact law has no solution.

        As for a hit while contacts are closed that it cannot be, of one body between two stops.
        """
        try:
            return self.filter.posteriors(asked)
        except ImpactLawError:
            if len(asked) == 1:
                return [None]
            return [self._posteriors([each])[0] for each in asked]

    def _accepted(
        self, change: ContactChange, branch: _Branch, here: ContactChange, state: GaussianState
    ) -> Hypothesis:
        """The event was ``here``, and leads to a ``state`` after it."""
        h, likelihood, rests = branch.before, branch.likelihood, dict[int, Rest]()
        kind = Kind.CLOSE
        if not here.is_nothing:
            kind = Kind.IMPACT
            if rest := settled(self.filter, branch.asked, state, h.jump.ago):
                here, state, kind = rest.change, rest.state, Kind.CLOSE
                rests[here.hit[0]] = rest.rest
        settled_before = h.ledger.settled.items()
        rests = {i: each for i, each in settled_before if i in state.closed} | rests
        innovations, switched = likelihood.innovations, change.contacts
        if here is not change and len(here.contacts) == len(switched):
            switched = here.contacts
            pairs = zip(change.contacts, switched, strict=True)
            innovations = {i: innovations[j] for i, j in pairs if j in innovations}
        ruling = (Ruling.APPLIED, branch.reason)
        ledger = h.ledger.with_event(change, ruling, innovations, switched, kind=kind)
        posterior = Hypothesis(
            state,
            h.clock,
            branch.weight,
            ledger._replace(events=h.ledger.events + 1, settled=rests),
            survival=h.survival_without(here.contacts),
            innovation=likelihood.innovation if innovations else None,
            subset=h.subset,
        )
        if self.errors is None:
            return posterior
        return self.errors.after(h, here, likelihood, posterior)

    @staticmethod
    def _rejected(change: ContactChange, branch: _Branch) -> Hypothesis:
        """The event was nothing."""
        h = branch.before
        reason = branch.reason or _excuse(change, h.ledger.notes, branch.likelihood)
        ledger = h.ledger.with_event(change, (Ruling.REJECTED, reason), {})
        return h._replace(weight=branch.weight, ledger=ledger, innovation=None)

    def _bounce(self, change: ContactChange, h: Hypothesis, weight: float) -> _Branch | None:
        """The event was one of the last bounces of a contact that has settled, or None."""
        if not len(change.contacts) == len(change.hit) == 1:
            return None
        contact, closed = change.hit[0], h.state.closed
        rest = h.ledger.settled.get(contact) if contact in closed else None
        density = None if rest is None else rest.log_density(change.t)
        if density is None:
            return None
        here = change._replace(before=closed, hit=(), closed=closed)
        weight += self._reported + density
        return _Branch(weight, h, here, "", Likelihood(density, {}))

    def _spurious_event(
        self,
        change: ContactChange,
        h: Hypothesis,
        reason: str = "",
        likelihood: Likelihood = CERTAIN,
    ) -> _Branch:
        """The event was nothing, for a ``reason`` or as its ``likelihood`` is small."""
        odds = self._spurious if self._spurious > -math.inf else 0.0
        weight = h.weight + len(change.contacts) * odds
        return _Branch(weight, h, None, reason, likelihood)

    def distinct(self, made: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The likeliest of those that are alike, in order (N-scan pruning).

        Those that differ in older decisions only have nearly the same state. They need not where
        there are several contacts: the latest decisions may be on one that is hit often.
        """
        if len(made) <= 1:
            return [*made]
        found: dict[object, list[Hypothesis]] = {}
        numbers: dict[object, int] = {}
        known: dict[int, int] = {}  # hypotheses share notes
        for h in sorted(made, key=_weight):
            notes = h.ledger.notes[-self._scan :]
            for note in notes:
                if id(note) not in known:
                    known[id(note)] = numbers.setdefault(note.decision, len(numbers))
            decisions = [known[id(note)] for note in notes]
            inserted = tuple((each.contact, each.kind) for each in h.ledger.missed)
            same = (h.clock, h.error.kind, h.subset, h.is_exact, inserted, *decisions)
            kept = found.setdefault(same, [])
            compares = self._compares_states and h.is_exact
            if not any(not compares or _are_near(h.state, each.state) for each in kept):
                kept.append(h)
        return sorted((h for kept in found.values() for h in kept), key=_weight)


def _are_near(one: GaussianState, other: GaussianState) -> bool:
    """Whether two states differ by no more than the deviations of either explain."""
    if one.closed != other.closed:
        return False
    size = one.x.size
    deviations = np.minimum(lengths(one.root[:size]), lengths(other.root[:size]))
    return bool(np.all(np.abs(one.x - other.x) <= TUNING.near * deviations))


def _likely(ordered: Sequence[Hypothesis | _Branch]) -> int:
    """How many of ``ordered``, the likeliest first, are kept."""
    shares = [math.exp(each.weight - ordered[0].weight) for each in ordered]
    left = TUNING.negligible * sum(shares)
    while len(shares) > 1 and (left := left - shares[-1]) >= 0:
        shares.pop()
    return len(shares)


def _excuse(change: ContactChange, notes: Sequence[Note], likelihood: Likelihood) -> str:
    """Why an event of this likelihood as a true one is spurious, after those of the ``notes``."""
    depth = max(likelihood.innovations.values(), default=-1.0)
    numbers = f"innovation {depth:.3g} standard deviations"
    others = (each for each in reversed(notes) if each.contact in change.contacts)
    before = next((each.stamp for each in others if each.ruling is Ruling.APPLIED), None)
    if before is not None and (after := change.stamp - before) <= _SHORTLY:
        numbers += f", {after / 1e6:.3g} ms after another"
    if depth > TUNING.surprise:
        return f"spurious: {numbers}"
    return f"spurious: more likely than a true impact ({numbers})"


def _restarted(
    change: ContactChange, made: Sequence[Hypothesis], restarts: Sequence[Hypothesis]
) -> Iterator[Hypothesis]:
    """``restarts`` after an event, weighed beside the hypotheses ``made`` of it."""
    total = log_sum([h.weight for h in made]) if made else 0.0
    ruling = (Ruling.APPLIED, "restart: the estimate before it is rejected")
    before = made[0].ledger.without_event(change) if made else Ledger()
    ledger = before._replace(settled={}).with_event(change, ruling, {})
    for h in restarts:
        yield Hypothesis(h.state, h.clock, h.weight + total + TUNING.log_restart, ledger)


def _logs(probability: float) -> tuple[float, float]:
    return (math.log(probability) if probability else -math.inf), math.log1p(-probability)


def _weight(h: Hypothesis | _Branch) -> float:
    return -h.weight
