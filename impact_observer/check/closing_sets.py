"""Which contacts can close together, and which of them are redundant then.

A set A can close together when ``{q: g_A = 0, g >= 0}`` is not empty: a linear programme. What can
close together can in every part of it, so a search starts from all contacts and leaves some out
only where it must; nothing is enumerated.

With ``q = L^-T y``, ``M = L L^T``, and columns ``B = L^-1 W`` scaled to length one, everything is
in one metric: ``G`` has a unit diagonal, and gaps are divided by the lengths.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse

from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

STEPS = 200
"""Most linear programmes, and sets looked at, for one question; beyond it: "not decided"."""
LISTED = 100
"""Most sets listed as an answer."""
_TOUCHING = 1e-8
"""Gap that counts as closed, relative to the largest gap in the rest position."""
_FEASIBLE = 1e-10
"""The same within a linear programme, the least that HiGHS accepts."""
_INSIDE = 1e-12
"""Depth inside a stop that is rounding, relative to the largest gap in the rest position."""
_RANK = 1e-10
"""Singular value that counts as zero, of columns of length one."""


class NotDecidedError(Exception):
    """The bound on the number of steps was reached; never leaves this module's answers."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What a search has found.

    Attributes:
        sets: sets of contacts, as sorted indices; the smallest ones first.
        decided: whether it was completed; where sets were found, there may be more of them.
    """

    sets: tuple[Contacts, ...]
    decided: bool


class ClosingSets:
    """Which contacts of one system can close together; counts its linear programmes.

    Attributes:
        B: directions, columns of length one, shape (n, m).
        G: ``B^T B``, shape (m, m).
        eps: restitution coefficients, shape (m,).
        lengths: of the columns before they were scaled, shape (m,), kg^(-1/2).
        gap: gaps in the rest position, scaled, shape (m,), the largest 1.
        clearance: the largest least gap, scaled, at most 1; negative where ``g >= 0`` is empty.
        conflicts: sets known to be unable to close together.
    """

    def __init__(self, system: System) -> None:
        """Scale directions and gaps, and find a position as clear of all stops as can be."""
        factor = linalg.cholesky(system.M, lower=True)
        B = linalg.solve_triangular(factor, system.W, lower=True)
        self.lengths: Vector = np.linalg.norm(B, axis=0)
        self.B: Matrix = B / self.lengths
        self.G: Matrix = self.B.T @ self.B
        self.eps = system.eps
        gap = system.q_r / self.lengths
        # A common factor of all gaps changes nothing, and HiGHS has absolute tolerances.
        self.gap: Vector = gap / (float(np.max(np.abs(gap), initial=0.0)) or 1.0)
        self._steps = STEPS
        # In coordinates divided by the roots of their masses, rows are about as long as B's.
        roots = np.sqrt(np.diag(system.M))
        self._rows = sparse.csr_matrix(system.W.T / np.outer(self.lengths, roots))
        self.clearance, self._clear = self._clearest()
        self.conflicts: set[Contacts] = {
            (i, j) for i, j in self.parallel() if not self._level(i, j)
        }  # two-sided stops, and stops one behind the other: no programme needed

    @property
    def possible(self) -> bool:
        """Whether some position is outside all stops."""
        return self.clearance >= -_TOUCHING

    @property
    def roomy(self) -> bool:
        """Whether some position is clear of all stops at once."""
        return self.clearance > _TOUCHING

    def parallel(self) -> list[tuple[int, int]]:
        """Pairs ``i < j`` of contacts with the same or the opposite direction."""
        near = np.argwhere(np.triu(np.abs(self.G) > 1 - 1e-9, k=1)).tolist()
        B, G = self.B, self.G
        return [
            (i, j)
            for i, j in near
            if np.linalg.norm(B[:, i] - np.sign(G[i, j]) * B[:, j]) <= _RANK
        ]

    def _level(self, i: int, j: int) -> bool:
        """Whether two parallel contacts close at the same place."""
        return abs(float(self.gap[i] - np.sign(self.G[i, j]) * self.gap[j])) <= _TOUCHING

    def step(self) -> None:
        """Count one step.

        Raises:
            NotDecidedError: it is one too many.
        """
        if self._steps == 0:
            raise NotDecidedError
        self._steps -= 1

    def conflict(self, contacts: Contacts) -> Contacts | None:
        """Some of ``contacts`` that cannot close together, no more than needed; None if all can.

        Raises:
            NotDecidedError: too many steps.
        """
        if (known := self.known_conflict(contacts)) is not None:
            return known
        found = self._blocked(contacts)
        if found is None:
            return None
        for i in found:
            if len(found) > 2:
                found = self._blocked(tuple(k for k in found if k != i)) or found
        self.conflicts.add(found)
        return found

    def known_conflict(self, contacts: Contacts) -> Contacts | None:
        """The same as far as it is known without a step."""
        if not self.possible:
            return contacts
        chosen = set(contacts)
        return next((each for each in self.conflicts if chosen.issuperset(each)), None)

    def _blocked(self, contacts: Contacts) -> Contacts | None:
        """Like ``conflict``, not yet reduced: ``min sum g_A`` subject to ``g >= 0``.

        With multipliers ``z`` its value c is ``sum g_A - sum z_j g_j``, so those of A with
        ``z_i < 1`` alone have ``sum (1 - z_i) g_i >= c``: they cannot be zero together.
        """
        index = list(contacts)
        if self._touched(index):
            return None
        cost = np.asarray(self._rows[index].sum(axis=0)).ravel()
        found = self._solve(cost, self._rows, self.gap)
        if found.fun + np.sum(self.gap[index]) <= _TOUCHING * len(index):
            return None
        multipliers = -np.asarray(found.ineqlin.marginals)
        return tuple(i for i in contacts if multipliers[i] < 1 - _TOUCHING) or contacts

    def _touched(self, index: list[int]) -> bool:
        """Whether the nearest position with ``g_A = 0`` is outside all stops: no programme."""
        if len(index) > self.B.shape[0]:
            return False
        try:
            factor = linalg.cho_factor(self.G[np.ix_(index, index)])
        except linalg.LinAlgError:
            return False
        towards = linalg.cho_solve(factor, self._clear[index])
        gap = self._clear - self.G[:, index] @ towards
        return bool(np.all(np.abs(gap[index]) <= _INSIDE) and np.all(gap >= -_INSIDE))

    def _clearest(self) -> tuple[float, Vector]:
        """The largest least gap, at most 1, and all gaps in such a position."""
        m, n = self._rows.shape
        if m == 0:
            return 1.0, np.zeros(0)
        rows = sparse.bmat([[self._rows, -np.ones((m, 1))], [None, -np.ones((1, 1))]]).tocsr()
        try:
            found = self._solve(np.append(np.zeros(n), -1.0), rows, np.append(self.gap, 1.0))
        except NotDecidedError:
            self._steps = 0  # nothing that needs a programme will be decided
            return 1.0, self.gap
        return float(found.x[n]), np.asarray(self._rows @ found.x[:n] + self.gap)

    def _solve(
        self, cost: Vector, rows: sparse.csr_matrix, gap: Vector
    ) -> optimize.OptimizeResult:
        """Minimise ``cost . x`` subject to ``rows x + gap >= 0``."""
        self.step()
        tolerances = {
            "primal_feasibility_tolerance": _FEASIBLE,
            "dual_feasibility_tolerance": _FEASIBLE,
        }
        found = optimize.linprog(
            cost, A_ub=-rows, b_ub=gap, bounds=(None, None), method="highs", options=tolerances
        )
        if found.status != 0:  # feasible and bounded by construction: out of digits
            raise NotDecidedError
        return found


def redundant(closing: ClosingSets) -> Answer:
    """Smallest sets of contacts that depend on each other and can close together.

    Args:
        closing: of any system; its steps are used up.

    Returns:
        Sets with linearly dependent directions, none a part of another: all parallel pairs, and
        of larger ones enough to name every contact that the others make redundant.
    """
    found: list[Contacts] = []
    try:
        for pair in closing.parallel():
            if len(found) < LISTED and closing.conflict(pair) is None:
                found.append(pair)
        contacts = _on_dependent_lines(closing, {pair[1] for pair in found})
        while contacts and len(found) < LISTED:
            closed = first(closing, _closing_dependent(closing), closing.conflict, contacts)
            if closed is None:
                break
            found.append(circuit(closing.B, closed))
            contacts = tuple(i for i in contacts if i != found[-1][-1])
    except NotDecidedError:
        return Answer(tuple(found), False)
    return Answer(tuple(found), True)


def _closing_dependent(closing: ClosingSets) -> Callable[[Contacts], bool]:
    """The test whether ``W_A a = 0`` and ``q_r,A . a = 0`` for some ``a``.

    Where dependent contacts close together both hold, since ``g_A = 0``.
    """
    columns = np.vstack([closing.B, closing.gap])

    def test(contacts: Contacts) -> bool:
        index = list(contacts)
        return all(
            _rank_deficient(matrix[:, index], tolerance)
            for matrix, tolerance in ((columns, _TOUCHING), (closing.B, _RANK))
        )

    return test


def _rank_deficient(columns: Matrix, tolerance: float) -> bool:
    rows, count = columns.shape
    if count == 0 or count > rows:
        return bool(count)
    return float(linalg.svdvals(columns)[-1]) <= tolerance


def _on_dependent_lines(closing: ClosingSets, without: set[int]) -> Contacts:
    """Contacts whose line depends on other lines; both sides of a stop are on one line."""
    line = np.arange(closing.G.shape[0])
    for i, j in closing.parallel():
        line[j] = min(line[j], line[i])
    lines = np.unique(line)
    if not _rank_deficient(closing.B[:, lines], _RANK):
        return ()
    null = linalg.null_space(closing.B[:, lines], rcond=_RANK)
    involved = lines[np.max(np.abs(null), axis=1, initial=0.0) > _TOUCHING]
    return tuple(i for i in np.flatnonzero(np.isin(line, involved)).tolist() if i not in without)


def circuit(B: Matrix, contacts: Contacts) -> Contacts:
    """Some of ``contacts`` that depend on each other, and no part of them does; () if none."""
    if not contacts:
        return ()
    R, order = linalg.qr(B[:, list(contacts)], mode="r", pivoting=True)
    diagonal = np.abs(np.diag(R))
    rank = int(np.sum(diagonal > _RANK))
    if rank == len(contacts):
        return ()
    shares = linalg.solve_triangular(R[:rank, :rank], R[:rank, rank])
    members = [*order[:rank][np.abs(shares) > _TOUCHING], order[rank]]
    return tuple(sorted(contacts[k] for k in members))


def first(
    closing: ClosingSets,
    bad: Callable[[Contacts], bool],
    conflict: Callable[[Contacts], Contacts | None],
    contacts: Contacts,
) -> Contacts | None:
    """A set of ``contacts`` that is bad and without conflict; None if there is none.

    What is not bad has no bad part, and what has no conflict is without one in every part. So a
    bad set with a conflict leaves those sets to look at that lack one contact of the conflict.

    Raises:
        NotDecidedError: too many steps.
    """
    waiting, seen = [contacts], {contacts}
    while waiting:
        chosen = waiting.pop()
        closing.step()
        if not bad(chosen):
            continue
        found = conflict(chosen)
        if found is None:
            return chosen
        for i in found:
            fewer = tuple(k for k in chosen if k != i)
            if fewer not in seen:
                seen.add(fewer)
                waiting.append(fewer)
    return None


def smallest(bad: Callable[[Contacts], bool], contacts: Contacts) -> Contacts:
    """A part of a bad set that is bad and has no bad part: leave out halves, quarters, ..."""
    size = len(contacts)
    while size > 1:
        size, start = (size + 1) // 2, 0
        while start < len(contacts):
            fewer = contacts[:start] + contacts[start + size :]
            if bad(fewer):
                contacts = fewer
            else:
                start += size
    return contacts
