# SPDX-License-Identifier: Apache-2.0
"""Which hypotheses are kept: step "prune" of the filter."""

import math
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from impact_observer.filter.contact_change import ContactChange
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
from impact_observer.filter.ledger import Note
from impact_observer.filter.square_root import lengths
from impact_observer.filter.tuning import TUNING
from impact_observer.filter.weighing import Branch
from impact_observer.model import System


class _HasWeight(Protocol):
    """Something with a logarithm of a probability."""

    @property
    def weight(self) -> float: ...


_Some = TypeVar("_Some", bound=_HasWeight)


def likeliest_first(some: Iterable[_Some]) -> list[_Some]:
    """Hypotheses or branches in the order of their probabilities."""
    return sorted(some, key=lambda each: each.weight, reverse=True)


class Pruning:
    """The rules by which hypotheses are dropped.

    Attributes:
        most: hypotheses that are kept at most.
        compares_states: whether hypotheses with the same latest decisions may be kept.
    """

    def __init__(self, system: System, most: int, *, keeps_exact: bool) -> None:
        """Rules for the hypotheses of ``system``.

        Where it ``keeps_exact``, the likeliest hypotheses with an exact model are kept, however
        unlikely they are, so that their odds can be tested.
        """
        affordable = TUNING.hypothesis_numbers // (2 * system.n)
        self.most = min(most, max(TUNING.least_hypotheses, affordable))
        self._keeps_exact = keeps_exact
        self._scan = TUNING.scan * system.n
        self.compares_states = system.m > 1

    def likely_branches(self, ordered: Sequence[Branch]) -> list[Branch]:
        """Those of the branches ``ordered``, the likeliest first, that are corrected."""
        count = min(_likely(ordered), self.most)
        found = [*ordered[:count]]
        if not self._keeps_exact:
            return found
        enough = ordered[0].weight + TUNING.log_forlorn
        exact = [b for b in ordered if b.weight > enough and b.before.is_exact]
        exact = exact[: min(_likely(exact), self.most)]
        return found + exact[sum(b.before.is_exact for b in found) :]

    def likely(self, ordered: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Those of the hypotheses ``ordered``, the likeliest first, that are kept."""
        count = min(_likely(ordered), self.most)
        found, rest = [*ordered[:count]], ordered[count:]
        if self._keeps_exact and any(not h.is_exact for h in found):
            enough = ordered[0].weight + TUNING.log_forlorn
            exact = [h for h in rest if h.is_exact and h.weight > enough]
            found += exact[: _likely(exact)]
        return found

    def distinct_branches(self, change: ContactChange, likely: Sequence[Branch]) -> list[Branch]:
        """Those of the branches ``likely`` at an event that ``distinct`` may keep, in order.

        Where states are not compared, the decisions tell before the correction. Robots' jumps
        branch once more after it.
        """
        decisions, own = _DecisionNumbers(), len(change.contacts)
        earlier: dict[int, tuple[object, ...]] = {}  # branches share ledgers
        found: dict[object, Branch] = {}
        for branch in likely:
            h, is_true = branch.before, branch.here is not None
            is_exact = h.is_exact_after(is_true)
            if self.compares_states and is_exact:
                found[id(branch)] = branch
                continue
            if id(h.ledger) not in earlier:
                missed = ((each.contact, each.kind, each.is_dead) for each in h.ledger.missed)
                all_ = (*decisions.of_notes(h.ledger.notes[-self._scan :]), *missed)
                earlier[id(h.ledger)] = all_[max(len(all_) + own - self._scan, 0) :]
            now = is_true, branch.reason.partition(":")[0], *earlier[id(h.ledger)]
            same = (h.clock, id(h.jump_error), h.error.kind, h.subset, is_exact, *now)
            found.setdefault(same, branch)
        return [*found.values()]

    def distinct(self, made: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The likeliest of those that are alike, in order (N-scan pruning).

        Hypotheses that differ in older decisions only have nearly the same state. With several
        contacts they need not: the latest decisions may be on one contact that is hit often.
        """
        if len(made) <= 1:
            return [*made]
        found: dict[object, list[Hypothesis]] = {}
        decisions = _DecisionNumbers()
        for h in likeliest_first(made):
            latest = decisions.of_notes(h.ledger.notes[-self._scan :])
            inserted = tuple((each.contact, each.kind) for each in h.ledger.missed)
            jump = h.jump_error and h.jump_error.latest
            same = (h.clock, jump, h.error.kind, h.subset, h.is_exact, inserted, *latest)
            kept = found.setdefault(same, [])
            compares = self.compares_states and h.is_exact
            if not any(not compares or _are_near(h.state, each.state) for each in kept):
                kept.append(h)
        return likeliest_first(h for kept in found.values() for h in kept)

    def settled_jumps(self, ordered: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The likeliest of those that differ by the size of a jump's error, once it is over."""
        found, known = list[Hypothesis](), set[tuple[int, float]]()
        for h in ordered:
            same = id(h.ledger), h.clock
            if h.jump_error is None or h.jump.ago <= TUNING.jump_window or same not in known:
                found.append(h)
                known.add(same)
        return found


class _DecisionNumbers:
    """Numbers of decisions: equal ones have the same number."""

    def __init__(self) -> None:
        self._numbers: dict[object, int] = {}
        self._known: dict[int, int] = {}  # hypotheses share notes

    def of_notes(self, notes: Sequence[Note]) -> list[int]:
        """The numbers of the decisions of ``notes``, which live as long as this."""
        known = self._known
        for note in notes:
            if id(note) not in known:
                known[id(note)] = self._numbers.setdefault(note.decision, len(self._numbers))
        return [known[id(note)] for note in notes]


def _are_near(one: GaussianState, other: GaussianState) -> bool:
    """Whether two states differ by no more than the deviations of either explain."""
    if one.closed != other.closed:
        return False
    size = one.x.size
    deviations = np.minimum(lengths(one.root[:size]), lengths(other.root[:size]))
    return bool(np.all(np.abs(one.x - other.x) <= TUNING.near * deviations))


def _likely(ordered: Sequence[_HasWeight]) -> int:
    """How many of ``ordered``, the likeliest first, hold all but ``Tuning.negligible``."""
    if not ordered:
        return 0
    shares = [math.exp(each.weight - ordered[0].weight) for each in ordered]
    left = TUNING.negligible * sum(shares)
    while len(shares) > 1 and (left := left - shares[-1]) >= 0:
        shares.pop()
    return len(shares)
