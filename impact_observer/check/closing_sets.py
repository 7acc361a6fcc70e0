# SPDX-License-Identifier: Apache-2.0
"""Sets of contacts that can close together, and redundant contacts in such sets.

The contacts of a set A can close together when ``{q: g_A = 0, g >= 0}`` is not empty, which a
linear programme decides. If A can close, every subset of A can close. A search therefore starts
from all contacts and removes some only if it must; the subsets are never enumerated.

With ``q = L^-T y``, ``M = L L^T``, and columns ``B = L^-1 W`` scaled to length one, ``G = B^T B``
has a unit diagonal; gaps are divided by the same lengths.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from impact_observer.dynamics.flow.few import Factor
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

STEPS = 200
"""Most linear programmes and tested sets for one question; then the answer is "not decided"."""
LISTED = 100
"""Most sets that an answer lists."""
_CLOSED = 1e-8
"""Gap that counts as closed, relative to the largest gap in the rest position."""
_FEASIBLE = 1e-10
"""Tolerance of the linear programmes, the smallest that HiGHS accepts."""
_RANK = 1e-10
"""Singular value that counts as zero, for columns of length one."""


class NotDecidedError(Exception):
    """A search took ``STEPS`` steps; the searches catch this error and answer "not decided"."""


@dataclass(frozen=True, slots=True)
class SearchResult:
    """The result of a search for sets of contacts.

    Attributes:
        sets: as sorted indices.
        decided: whether the search was completed; else further sets may exist.
    """

    sets: tuple[Contacts, ...]
    decided: bool

    @property
    def is_empty(self) -> bool | None:
        """Whether no such set exists; None if the search did not decide."""
        return False if self.sets else True if self.decided else None


class ClosingSets:
    """Decides which contacts of one system can close together, with at most ``STEPS`` steps.

    Attributes:
        B: directions, columns of length one, shape (n, m).
        G: ``B^T B``, shape (m, m).
        eps: restitution coefficients, shape (m,).
        still: contact speeds that an impact of the contact alone leaves, shape (m,), m/s.
        lengths: of the columns before scaling, shape (m,), kg^(-1/2).
        gap: gaps in the rest position, scaled, shape (m,), the largest 1.
        feasible: whether some position is outside all stops.
        has_clearance: whether some position is clear of all stops at once.
        conflicts: known sets that cannot close together.
    """

    def __init__(self, system: System) -> None:
        """Scale directions and gaps, and find a position with the largest clearance."""
        B = Factor(system.M).solved(system.W)
        self.lengths: Vector = np.linalg.norm(B, axis=0)
        self.B: Matrix = B / self.lengths
        self.G: Matrix = self.B.T @ self.B
        self.eps = system.eps
        self.still = -system.rebound(np.zeros(system.m)) / (1 + system.eps)
        gap = system.q_r / self.lengths
        # A common factor of all gaps changes nothing, and HiGHS has absolute tolerances.
        self.gap: Vector = gap / (float(np.max(np.abs(gap), initial=0.0)) or 1.0)
        self._steps = STEPS
        # In coordinates divided by the roots of their masses, rows are about as long as B's.
        roots = np.sqrt(np.diag(system.M))
        self._rows = sparse.csr_matrix(system.W.T / np.outer(self.lengths, roots))
        clearance = self._largest_clearance()
        self.feasible, self.has_clearance = clearance >= -_CLOSED, clearance > _CLOSED
        # Two-sided stops, and stops one behind the other, need no programme.
        self.conflicts: set[Contacts] = {
            (i, j)
            for i, j in self.parallel()
            if abs(float(self.gap[i] - np.sign(self.G[i, j]) * self.gap[j])) > _CLOSED
        }

    def parallel(self) -> list[tuple[int, int]]:
        """Pairs ``i < j`` of contacts with the same or the opposite direction."""
        near = np.argwhere(np.triu(np.abs(self.G) > 1 - 1e-9, k=1)).tolist()
        B, G = self.B, self.G
        return [
            (i, j)
            for i, j in near
            if np.linalg.norm(B[:, i] - np.sign(G[i, j]) * B[:, j]) <= _RANK
        ]

    def step(self) -> None:
        """Count one step.

        Raises:
            NotDecidedError: ``STEPS`` steps were taken before.
        """
        if self._steps == 0:
            raise NotDecidedError
        self._steps -= 1

    def conflict(self, contacts: Contacts) -> Contacts | None:
        """A small subset of ``contacts`` that cannot close together; None if all can close.

        Raises:
            NotDecidedError: too many steps.
        """
        if (earlier := self.conflict_so_far(contacts)) is not None:
            return earlier
        blocked = self._blocked(contacts)
        if blocked is None:
            return None
        for i in blocked:
            if len(blocked) > 2:
                blocked = self._blocked(tuple(k for k in blocked if k != i)) or blocked
        self.conflicts.add(blocked)
        return blocked

    def conflict_so_far(self, contacts: Contacts) -> Contacts | None:
        """A known subset of ``contacts`` that cannot close together, without a new search."""
        if not self.feasible:
            return contacts
        chosen = set(contacts)
        return next((each for each in self.conflicts if chosen.issuperset(each)), None)

    def _blocked(self, contacts: Contacts) -> Contacts | None:
        """A subset that cannot close together, of any size: minimise ``sum g_A`` for ``g >= 0``.

        With multipliers ``z`` the minimum c is ``sum g_A - sum z_j g_j``. So the contacts of A
        with ``z_i < 1`` alone have ``sum (1 - z_i) g_i >= c``: they cannot be zero together.
        """
        index = list(contacts)
        cost = np.asarray(self._rows[index].sum(axis=0)).ravel()
        minimum = self._solve(cost, self._rows, self.gap)
        if minimum.fun + np.sum(self.gap[index]) <= _CLOSED * len(index):
            return None
        multipliers = -np.asarray(minimum.ineqlin.marginals)
        return tuple(i for i in contacts if multipliers[i] < 1 - _CLOSED) or contacts

    def _largest_clearance(self) -> float:
        """The maximum over q of the smallest gap, at most 1; negative if ``g >= 0`` is empty."""
        m, n = self._rows.shape
        if m == 0:
            return 1.0
        rows = sparse.bmat([[self._rows, -np.ones((m, 1))], [None, -np.ones((1, 1))]]).tocsr()
        try:
            largest = self._solve(np.append(np.zeros(n), -1.0), rows, np.append(self.gap, 1.0))
        except NotDecidedError:
            self._steps = 0  # no programme will be solved
            return 1.0
        return float(largest.x[n])

    def _solve(
        self, cost: Vector, rows: sparse.csr_matrix, gap: Vector
    ) -> optimize.OptimizeResult:
        """Minimise ``cost . x`` subject to ``rows x + gap >= 0``."""
        self.step()
        names = ("primal_feasibility_tolerance", "dual_feasibility_tolerance")
        options = dict.fromkeys(names, _FEASIBLE)
        solution = optimize.linprog(cost, -rows, gap, bounds=(None, None), options=options)
        if solution.status != 0:  # the programme is feasible and bounded: a numerical failure
            raise NotDecidedError
        return solution


def redundant(closing: ClosingSets) -> SearchResult:
    """Minimal sets of contacts that are linearly dependent and can close together.

    Args:
        closing: the sets of a system; the search uses up the steps.

    Returns:
        All parallel pairs, and enough of the larger sets to name every contact that the others
        make redundant. No set contains another.
    """
    columns = np.vstack([closing.B, closing.gap])

    def dependent(contacts: Contacts) -> bool:
        """Whether some ``a`` has ``W_A a = 0`` and ``q_r,A . a = 0``, as closed contacts have."""
        index = list(contacts)
        return _rank_deficient(columns[:, index], _CLOSED) and _rank_deficient(
            closing.B[:, index], _RANK
        )

    dependent_sets: list[Contacts] = []
    try:
        for pair in closing.parallel():
            if len(dependent_sets) < LISTED and closing.conflict(pair) is None:
                dependent_sets.append(pair)
        contacts = _on_dependent_lines(closing, {pair[1] for pair in dependent_sets})
        while contacts and len(dependent_sets) < LISTED:
            closed = first_failing(closing, dependent, closing.conflict, contacts)
            if closed is None:
                break
            dependent_sets.append(minimal_dependent(closing.B, closed))
            contacts = tuple(i for i in contacts if i != dependent_sets[-1][-1])
    except NotDecidedError:
        return SearchResult(tuple(dependent_sets), False)
    return SearchResult(tuple(dependent_sets), True)


def _rank_deficient(columns: Matrix, tolerance: float) -> bool:
    rows, count = columns.shape
    if count == 0 or count > rows:
        return bool(count)
    return float(linalg.svdvals(columns)[-1]) <= tolerance


def _on_dependent_lines(closing: ClosingSets, without: set[int]) -> Contacts:
    """Contacts whose line depends on other lines; parallel contacts share a line."""
    line = np.arange(closing.G.shape[0])
    for i, j in closing.parallel():
        line[j] = min(line[j], line[i])
    lines = np.unique(line)
    if not _rank_deficient(closing.B[:, lines], _RANK):
        return ()
    null = linalg.null_space(closing.B[:, lines], rcond=_RANK)
    involved = lines[np.max(np.abs(null), axis=1, initial=0.0) > _CLOSED]
    return tuple(i for i in np.flatnonzero(np.isin(line, involved)).tolist() if i not in without)


def minimal_dependent(B: Matrix, contacts: Contacts) -> Contacts:
    """A minimal linearly dependent subset of ``contacts``; empty for independent contacts."""
    if not contacts:
        return ()
    R, order = linalg.qr(B[:, list(contacts)], mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > _RANK))
    if rank == len(contacts):
        return ()
    shares = linalg.solve_triangular(R[:rank, :rank], R[:rank, rank])
    members = [*order[:rank][np.abs(shares) > _CLOSED], order[rank]]
    return tuple(sorted(contacts[k] for k in members))


def first_failing(
    closing: ClosingSets,
    fails: Callable[[Contacts], bool],
    conflict: Callable[[Contacts], Contacts | None],
    contacts: Contacts,
) -> Contacts | None:
    """A subset of ``contacts`` that fails a test and has no conflict; None if no subset does.

    Subsets of a set that passes the test pass too. If a failing set has a conflict, the search
    takes only the subsets that lack one contact of the conflict.

    Args:
        closing: counts the steps.
        fails: the test.
        conflict: a subset that makes a set inadmissible, or None.
        contacts: where the search starts.

    Raises:
        NotDecidedError: too many steps.
    """
    waiting, seen = [contacts], {contacts}
    while waiting:
        chosen = waiting.pop()
        closing.step()
        if not fails(chosen):
            continue
        blocked = conflict(chosen)
        if blocked is None:
            return chosen
        for i in blocked:
            fewer = tuple(k for k in chosen if k != i)
            if fewer not in seen:
                seen.add(fewer)
                waiting.append(fewer)
    return None
