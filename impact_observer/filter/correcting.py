# SPDX-License-Identifier: Apache-2.0
"""The hypotheses after an event: their states, ledgers and errors of the model."""

from collections.abc import Iterator, Sequence

from impact_observer.errors import ImpactLawError
from impact_observer.events import Kind, Ruling
from impact_observer.filter.branching import Extent
from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.error_accounts import ErrorAccounts
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.impact_filter import EventQuery, ImpactFilter
from impact_observer.filter.ledger import Note
from impact_observer.filter.likelihood import Likelihood
from impact_observer.filter.settling import settled
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.weighing import Branch

_SHORTLY = 50_000_000
"""Time since another event of the contact up to which a rejection names that event, ns."""


class Correcting:
    """Makes the hypotheses after an event."""

    def __init__(self, filter_: ImpactFilter, errors: ErrorAccounts | None) -> None:
        """States are corrected by ``filter_``; ``errors`` of the model are matched, if any."""
        self._filter = filter_
        self._errors = errors

    def posteriors(
        self, change: ContactChange, branches: Sequence[Branch], extent: Extent
    ) -> list[Hypothesis]:
        """The hypotheses of ``branches`` after the event, of a motion of this ``extent``.

        Branches in which the event is impossible, or whose state overflows or is that of no
        possible motion, are left out.
        """
        true = [each.query for each in branches if each.here and not each.here.is_nothing]
        after, found = iter(self._states(true)), []
        for each in branches:
            if each.here is None:
                found.append(_rejected(change, each))
                continue
            state = each.before.state if each.here.is_nothing else next(after)
            if state is not None:
                found += self._accepted(change, each, each.here, state)
        energy = self._filter.largest_energy(extent.largest)
        return [h for h in found if self._filter.is_possible(h.state, change.hit, energy)]

    def _states(self, queries: Sequence[EventQuery]) -> Sequence[GaussianState | None]:
        """The states after an event; None where the impact law has no solution.

        The law has none for a hit of one body between two stops, one of which is closed.
        """
        try:
            return self._filter.posteriors(queries)
        except ImpactLawError:
            if len(queries) == 1:
                return [None]
            return [self._states([each])[0] for each in queries]

    def _accepted(
        self, change: ContactChange, branch: Branch, here: ContactChange, state: GaussianState
    ) -> Iterator[Hypothesis]:
        """The event was ``here``, and leads to a ``state`` after it."""
        h, likelihood, kind = branch.before, branch.likelihood, Kind.CLOSE
        rest = None
        if not here.is_nothing:
            kind = Kind.IMPACT
            if rest := settled(self._filter, branch.query, state, h.jump.ago):
                here, state, kind = rest.change, rest.state, Kind.CLOSE
        rests = {i: each for i, each in h.ledger.settled.items() if i in state.closed}
        if rest:
            rests[here.hit[0]] = rest.rest
        innovations, switched = likelihood.innovations, change.contacts
        if here is not change and len(here.contacts) == len(switched):
            switched = here.contacts
            pairs = zip(change.contacts, switched, strict=True)
            innovations = {i: innovations[j] for i, j in pairs if j in innovations}
        ruling = (Ruling.APPLIED, branch.reason)
        ledger = h.ledger.with_event(
            change, ruling, innovations, switched, kind=kind, is_dead=branch.is_row
        )
        posterior = Hypothesis(
            state,
            h.clock,
            branch.weight,
            ledger._replace(events=h.ledger.events + 1, settled=rests),
            survival=h.survival_without(here.contacts),
            innovation=likelihood.innovation if innovations else None,
            subset=h.subset,
            jump_error=h.jump_error,
        )
        if branch.is_row or ledger.unreported:
            row = here.hit if branch.is_row else ()
            others = (i for i in ledger.unreported if i not in here.contacts)
            ledger = posterior.ledger._replace(unreported=(*others, *row))
            posterior = posterior._replace(ledger=ledger)
        if self._errors is not None:
            posterior = self._errors.after(h, here, likelihood, posterior)
        jump = self._filter.members.given.jump_root(h.state.x, state.x) if here.hit else None
        return posterior.with_jump_errors(jump)


def _rejected(change: ContactChange, branch: Branch) -> Hypothesis:
    """The event was spurious."""
    h = branch.before
    reason = branch.reason or _excuse(change, h.ledger.notes, branch.likelihood)
    ledger = h.ledger.with_event(change, (Ruling.REJECTED, reason), {})
    return h._replace(weight=branch.weight, ledger=ledger, innovation=None)


def _excuse(change: ContactChange, notes: Sequence[Note], likelihood: Likelihood) -> str:
    """Why an event of this likelihood as a true one is spurious, after those of the ``notes``."""
    depth = max(likelihood.innovations.values(), default=-1.0)
    numbers = f"innovation {depth:.3g} standard deviations"
    others = (each for each in reversed(notes) if each.contact in change.contacts)
    before = next((each.stamp for each in others if each.ruling is Ruling.APPLIED), None)
    if before is not None and (ago := change.stamp - before) <= _SHORTLY:
        numbers += f", {ago / 1e6:.3g} ms after another"
    if depth > TUNING.surprise:
        return f"spurious: {numbers}"
    return f"spurious: more likely than a true impact ({numbers})"
