# SPDX-License-Identifier: Apache-2.0
"""Impacts that can raise ``V``: an eigenvalue test on contacts that can close together.

An impact of the contacts A never raises ``V`` when ``H = G - E G E`` is positive semidefinite,
with ``G = W_A^T M^-1 W_A`` and ``E = diag(eps)``. ``H`` of every subset of A then is positive
semidefinite too, so only the largest sets that can close together need the test.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg, optimize, sparse
from scipy.sparse import csgraph

from impact_observer.check.closing_sets import (
    LISTED,
    ClosingSets,
    NotDecidedError,
    SearchResult,
    first_failing,
    minimal_dependent,
)
from impact_observer.events import Contacts
from impact_observer.model import System
from impact_observer.states import Matrix, Vector, frozen

_EIGENVALUE = 1e-9
"""Negative eigenvalue of ``H`` that counts as rounding, relative to the norm of ``G``."""
_COUPLED = 1e-12
"""Entry of ``H`` that counts as zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Growth:
    """Growth, by an impact, of the difference between two solutions.

    Both solutions have an impulse at every contact. ``one`` closes every contact, so a plant can
    have this solution.

    Attributes:
        contacts: indices of the contacts that close, sorted.
        factor: the most by which an impact of exactly these contacts multiplies ``V``.
        one: contact speeds before the impact, shape (len(contacts),), m/s.
        two: contact speeds of the other solution, shape (len(contacts),), m/s.
    """

    contacts: Contacts
    factor: float
    one: Vector
    two: Vector


def expansive(closing: ClosingSets) -> SearchResult:
    """Sets of contacts that can close together where an impact can raise ``V``.

    Pairs are tested first, larger sets only if no pair fails. Every set of the result is linearly
    independent, since the impact law acts on dependent contacts as on an independent subset. The
    test is conservative in one case: the impact of a set alone is tested even if the set never
    closes without some other contact.

    Args:
        closing: the sets of a system; the search uses up the steps.

    Returns:
        Sets for which ``G - E G E`` has a negative eigenvalue; none, and decided, if no impact
        raises ``V``.
    """
    test = _EigenvalueTest(closing)
    try:
        if pairs := test.pairs():
            return SearchResult(pairs, True)
        # Larger sets are dependent. (numpy before 2 has no rank of an empty matrix.)
        if closing.B.shape[1] <= 2 or np.linalg.matrix_rank(closing.B) <= 2:
            return SearchResult((), True)
        for component in test.components():
            if failing := first_failing(closing, test.fails, test.conflict, component):
                for i in failing:  # only what the failure needs is kept
                    fewer = tuple(k for k in failing if k != i)
                    failing = fewer if test.fails(fewer) else failing
                return SearchResult((failing,), True)
    except NotDecidedError:
        return SearchResult((), False)
    return SearchResult((), True)


class _EigenvalueTest:
    """The eigenvalue test of a system, on ``H`` and on a reduced ``H``.

    Pairs that cannot close together, or that are parallel, are in none of the sets to be tested.
    Their entries of ``H`` do not count and are zero in the reduced ``H``. A set passes if either
    matrix is positive semidefinite, since then all its admissible subsets pass.
    """

    def __init__(self, closing: ClosingSets) -> None:
        self._closing = closing
        self._whole = (1 - np.outer(closing.eps, closing.eps)) * closing.G
        self._reduced = self._whole.copy()
        for pair in closing.conflicts.union(closing.parallel()):
            self._exclude(pair)

    def _exclude(self, contacts: Contacts) -> None:
        if len(contacts) == 2:
            i, j = contacts
            self._reduced[i, j] = self._reduced[j, i] = 0.0

    def fails(self, contacts: Contacts) -> bool:
        """Whether neither matrix is positive semidefinite on ``contacts``."""
        index = list(contacts)
        if not index or np.ptp(self._closing.eps[index]) == 0:
            return False  # exactly zero or positive; rounding must not decide
        at = np.ix_(index, index)
        shift = _EIGENVALUE * float(np.linalg.norm(self._closing.G[at], np.inf))
        return all(
            float(linalg.eigvalsh(H[at], subset_by_index=(0, 0))[0]) < -shift
            for H in (self._reduced, self._whole)
        )

    def conflict(self, contacts: Contacts) -> Contacts | None:
        """A subset that is dependent or cannot close together; None without such a subset."""
        closing = self._closing
        blocked = (
            closing.conflict_so_far(contacts)
            or minimal_dependent(closing.B, contacts)
            or closing.conflict(contacts)
        )
        self._exclude(blocked or ())
        return blocked

    def components(self) -> list[Contacts]:
        """Connected components of more than two contacts; each is tested by itself."""
        graph = sparse.csr_matrix(np.abs(self._reduced) > _COUPLED)
        count, labels = csgraph.connected_components(graph, directed=False)
        parts = [tuple(np.flatnonzero(labels == k).tolist()) for k in range(count)]
        return [part for part in parts if len(part) > 2]

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
        failing: list[Contacts] = []
        try:
            for i, j in pairs[order].tolist():
                if self.conflict((i, j)) is None:
                    failing.append((i, j))
                if len(failing) == LISTED:
                    break
        except NotDecidedError:
            if not failing:
                raise
        return tuple(failing)


def growth(closing: ClosingSets, contacts: Contacts) -> Growth:
    """The largest rise of ``V`` by an impact of ``contacts``, and two solutions that show it.

    With an impulse at every contact ``dgamma+ = -E dgamma-``, in the metric ``G^-1``. The factor
    is the largest ratio of the two norms squared. Impulses at fewer contacts give a smaller
    factor: the Rayleigh quotient of ``E G E`` over ``G`` on fewer coordinates.

    Args:
        closing: the sets of the system.
        contacts: linearly independent contacts.
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
    one, two = (closing.still[index] + each * lengths for each in (one, two))
    return Growth(contacts, factor, frozen(one), frozen(two))


def _closing_impulses(G: Matrix) -> Vector:
    """Impulses ``Lambda > 0`` with ``G Lambda > 0``, for a positive definite G."""
    # Maximise t subject to G Lambda >= t, Lambda >= t, Lambda <= 1.
    count = len(G)
    rows = np.hstack([np.vstack([-G, -np.eye(count)]), np.ones((2 * count, 1))])
    cost = np.append(np.zeros(count), -1.0)
    bounds = [(0.0, 1.0)] * count + [(None, None)]
    solution = optimize.linprog(cost, A_ub=rows, b_ub=np.zeros(2 * count), bounds=bounds)
    return np.asarray(solution.x[:count])


def expansive_sets(system: System) -> tuple[Contacts, ...]:
    """Sets of contacts that can close together where an impact can raise ``V``, as indices.

    The result is also empty if ``is_nonexpansive`` is None, that is, not decided.
    """
    return expansive(ClosingSets(system)).sets


def is_nonexpansive(system: System) -> bool | None:
    """Whether no impact of contacts that can close together raises ``V``.

    Returns:
        None if ``STEPS`` steps do not decide.
    """
    return expansive(ClosingSets(system)).is_empty
