# SPDX-License-Identifier: Apache-2.0
"""Which hypotheses are kept: step "prune" of the filter."""

import math
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.hypotheses import Hypothesis
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
        self._compares_states = system.m > 1

    def likely_branches(self, ordered: Sequence[Branch]) -> list[Branch]:
        """Those of the branches ``ordered``, the likeliest first, that are corrected."""
        count = min(_likely(ordered), self.most)
        found = [*ordered[:count]]
        if not self._keeps_exact or all(each.before.is_exact for each in ordered):
            return found
        enough = ordered[0].weight + TUNING.log_forlorn
        exact = [b for b in ordered if b.before.is_exact and b.weight > enough]
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

    def distinct(self, made: Sequence[Hypothesis]) -> list[Hypothesis]:
        """The likeliest of those that are alike, in order (N-scan pruning).

        Hypotheses that differ in older decisions only have nearly the same state. With several
        contacts they need not: the latest decisions may be on one contact that is hit often.
        """
        if len(made) <= 1:
            return [*made]
        found: dict[object, list[Hypothesis]] = {}
        numbers: dict[object, int] = {}
        known: dict[int, int] = {}  # hypotheses share notes
        for h in likeliest_first(made):
            notes = h.ledger.notes[-self._scan :]
            for note in notes:
                if id(note) not in known:
                    known[id(note)] = numbers.setdefault(note.decision, len(numbers))
            decisions = [known[id(note)] for note in notes]
            inserted = tuple((each.contact, each.kind) for each in h.ledger.missed)
            jump = h.jump_error and h.jump_error.latest
            same = (h.clock, jump, h.error.kind, h.subset, h.is_exact, inserted, *decisions)
            kept = found.setdefault(same, [])
            compares = self._compares_states and h.is_exact
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
