"""Whether an impact can raise ``V``: the eigenvalue test on contacts that can close together.

A velocity jump on the contacts A never raises ``V`` when ``H = G - E G E`` is positive
semidefinite, ``G = W_A^T M^-1 W_A``, ``E = diag(eps)``. It then is on every part of A, so only
the largest sets that can close together count.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse
from scipy.sparse import csgraph

from impact_observer.check.closing_sets import (
    LISTED,
    Answer,
    ClosingSets,
    NotDecidedError,
    circuit,
    first,
    smallest,
)
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector, frozen

_EIGENVALUE = 1e-9
"""Negative eigenvalue of ``H`` that is rounding, relative to the norm of ``G``."""
_COUPLED = 1e-12
"""Entry of ``H`` that counts as zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """Two solutions that an impact drives apart.

    Both take an impulse at all contacts; ``one`` closes every contact, so it can be a plant.

    Attributes:
        contacts: indices of those that close, sorted.
        factor: the most that an impact of exactly these contacts multiplies ``V`` by.
        one: contact speeds before the impact, shape (len(contacts),), m/s.
        two: the same of the other solution, shape (len(contacts),), m/s.
    """

    contacts: Contacts
    factor: float
    one: Vector
    two: Vector


def expansive(closing: ClosingSets) -> Answer:
    """Sets of contacts that can close together where an impact can raise ``V``.

    Pairs are looked at first, larger sets only where no pair is found. Every set found is
    linearly independent: the law moves any set of contacts as an independent part of it does.
    Conservative in one case: an impact of the set alone is meant, also where it never closes
    without some other contact.

    Args:
        closing: of any system; its steps are used up.

    Returns:
        Sets for which ``G - E G E`` has a negative eigenvalue; none and decided where an impact
        never raises ``V``.
    """
    test = _Expansion(closing)
    try:
        if pairs := test.pairs():
            return Answer(pairs, True)
        # Larger sets depend on each other. (numpy before 2 knows no rank of an empty matrix.)
        if closing.B.shape[1] <= 2 or np.linalg.matrix_rank(closing.B) <= 2:
            return Answer((), True)
        for component in test.components():
            if found := first(closing, test.fails, test.conflict, component):
                return Answer((smallest(test.fails, found),), True)
    except NotDecidedError:
        return Answer((), False)
    return Answer((), True)


class _Expansion:
    """The eigenvalue test of a system, whole and without what no set to be tested contains.

    Pairs that never close together, or that are parallel, are in no such set: their entries of
    ``H`` may be anything, zero for one. Where either matrix is positive semidefinite, so are the
    principal parts that count.
    """

    def __init__(self, closing: ClosingSets) -> None:
        self._closing = closing
        self._whole = (1 - np.outer(closing.eps, closing.eps)) * closing.G
        self._reduced = self._whole.copy()
        for pair in closing.conflicts.union(closing.parallel()):
            self._leave_out(pair)

    def _leave_out(self, contacts: Contacts) -> None:
        if len(contacts) == 2:
            i, j = contacts
            self._reduced[i, j] = self._reduced[j, i] = 0.0

    def fails(self, contacts: Contacts) -> bool:
        """Whether neither matrix is positive semidefinite on ``contacts``."""
        index = list(contacts)
        if not index or np.ptp(self._closing.eps[index]) == 0:
            return False  # exactly, whatever rounding does to the eigenvalues
        at = np.ix_(index, index)
        shift = _EIGENVALUE * float(np.linalg.norm(self._closing.G[at], np.inf))
        return not any(
            _definite(H[at] + shift * np.eye(len(index))) for H in (self._reduced, self._whole)
        )

    def conflict(self, contacts: Contacts) -> Contacts | None:
        """Some of ``contacts`` that depend on each other or cannot close together."""
        closing = self._closing
        found = (
            closing.known_conflict(contacts)
            or circuit(closing.B, contacts)
            or closing.conflict(contacts)
        )
        self._leave_out(found or ())
        return found

    def components(self) -> list[Contacts]:
        """Contacts that are coupled, directly or through others; each part passes or not."""
        graph = sparse.csr_matrix(np.abs(self._reduced) > _COUPLED)
        count, labels = csgraph.connected_components(graph, directed=False)
        parts = [tuple(np.flatnonzero(labels == k).tolist()) for k in range(count)]
        return [part for part in parts if len(part) > 2]  # pairs are looked at before

    def pairs(self) -> tuple[Contacts, ...]:
        """Pairs that fail and can close together, at most ``LISTED``.

        Raises:
            NotDecidedError: too many steps, and no pair found.
        """
        H, eps = self._reduced, self._closing.eps
        diagonal = np.diag(H)
        mean = (diagonal[:, None] + diagonal) / 2
        least = mean - np.hypot((diagonal[:, None] - diagonal) / 2, H)
        fail = (least < -_EIGENVALUE * (1 + np.abs(H))) & (eps[:, None] != eps)
        pairs = np.argwhere(np.triu(fail, k=1))
        # Stops that face the same way are the ones most likely to close together.
        order = np.argsort(-self._closing.G[pairs[:, 0], pairs[:, 1]], kind="stable")
        found: list[Contacts] = []
        try:
            for i, j in pairs[order].tolist():
                if self.conflict((i, j)) is None:
                    found.append((i, j))
                if len(found) == LISTED:
                    break
        except NotDecidedError:
            if not found:
                raise
        return tuple(found)


def _definite(matrix: Matrix) -> bool:
    try:
        linalg.cholesky(matrix, lower=True, overwrite_a=True)
    except linalg.LinAlgError:
        return False
    return True


def growth(closing: ClosingSets, contacts: Contacts) -> Growth:
    """By how much, and for which two solutions, an impact of ``contacts`` can raise ``V``.

    With all contacts pressed ``dgamma+ = -E dgamma-``, measured in ``G^-1``. The factor is the
    most that this multiplies; sets of fewer pressed contacts multiply by less, since theirs is
    the Rayleigh quotient of ``E G E`` over ``G`` on fewer coordinates.

    Args:
        closing: of the system.
        contacts: linearly independent ones.
    """
    index = list(contacts)
    eps, lengths = closing.eps[index], closing.lengths[index]
    R = np.atleast_2d(linalg.qr(closing.B[:, index], mode="economic")[1])
    G = R.T @ R
    expansion = linalg.solve_triangular(R.T, (eps[:, None] * R.T), lower=True)
    _, singular, directions = linalg.svd(expansion)
    factor = float(singular[0]) ** 2
    impulses = _closing_impulses(G)
    one = -(G @ impulses) / (1 + eps)
    step = R.T @ directions[0]
    pull = linalg.cho_solve((R, False), (1 + eps) * step)
    two = one + step * (0.5 * np.min(impulses) / np.max(np.abs(pull)))
    return Growth(contacts, factor, frozen(one * lengths), frozen(two * lengths))


def _closing_impulses(G: Matrix) -> Vector:
    """Impulses ``Lambda > 0`` with ``G Lambda > 0``: they exist for every positive definite G."""
    count = len(G)
    rows = np.vstack([np.hstack([-G, np.ones((count, 1))]), np.eye(count, count + 1) * -1.0])
    rows[count:, count] = 1.0
    cost = np.append(np.zeros(count), -1.0)
    bounds = [(0.0, 1.0)] * count + [(None, None)]
    found = optimize.linprog(cost, A_ub=rows, b_ub=np.zeros(2 * count), bounds=bounds)
    return np.asarray(found.x[:count])


def expansive_sets(system: System) -> tuple[Contacts, ...]:
    """Sets of contacts that can close together where an impact can raise ``V``, as indices.

    Empty also where ``is_nonexpansive`` says None, not decided.
    """
    return expansive(ClosingSets(system)).sets


def is_nonexpansive(system: System) -> bool | None:
    """Whether no impact of contacts that can close together ever raises ``V``.

    Returns:
        None where ``STEPS`` were not enough to decide.
    """
    answer = expansive(ClosingSets(system))
    return False if answer.sets else True if answer.decided else None
