# SPDX-License-Identifier: Apache-2.0
"""Impulses that scatter: a restitution that differs a little from hit to hit.

An impulse is ``1 + eta`` times that of the impact law, and the ``eta`` are independent normal
errors with one deviation. So a gap at a hit has two kinds of errors, those of the stamps and those
of the impulses: ``A x + B e + C eta = d``. The deviation of the ``eta`` is not declared. The most
likely one is taken, with ``x`` integrated out (restricted maximum likelihood; Patterson and
Thompson, Recovery of inter-block information when block sizes are unequal, 1971).

A motion that depends more on its impulses explains any stamps by smaller errors. So the least
squares of ``e`` and ``eta`` are not the most likely motion: the likelihood of the stamps alone has
the determinant of their covariance, too (Laplace's approximation; Wolfinger, Laplace's
approximation for nonlinear mixed models, 1993).
"""

from typing import NamedTuple

import numpy as np
from scipy import linalg, optimize

from impact_observer.states import Matrix, Vector

_SPAN = 1e-4, 1e4
"""Least and largest effect of impulses on gaps, over that of stamps, that is searched."""
_PLACES = 33
"""Ratios of deviations at which the likelihood is computed before the search."""


class Deviations(NamedTuple):
    """Standard deviations that residuals show.

    Attributes:
        clock: of a stamp, s.
        scatter: of the relative error of an impulse.
        gain: twice the logarithm of the likelihood over that without scatter.
    """

    clock: float
    scatter: float
    gain: float


def shown_deviations(
    A: Matrix, B: Matrix, C: Matrix, d: Vector, *, clock: float, least: float | None
) -> Deviations:
    """The most likely deviations of ``e`` and ``eta`` in ``A x + B e + C eta = d``.

    Args:
        A: shape (r, k), of full column rank.
        B: shape (r, any), of full row rank; ``e`` is in s.
        C: shape (r, any).
        d: shape (r,).
        clock: deviation of ``e``, s.
        least: least deviation of ``e`` where ``clock`` is not known; None where it is.
    """
    left = linalg.qr(A)[0][:, A.shape[1] :].T
    own = left @ B
    L = linalg.cholesky(own @ own.T, lower=True)
    axes, singular, _ = linalg.svd(linalg.solve_triangular(L, left @ C, lower=True))
    z = axes.T @ linalg.solve_triangular(L, left @ d, lower=True)
    effect = np.zeros(z.size)
    effect[: singular.size] = singular**2

    def deviation_of_clock(widths: Vector) -> float:
        shown = float(np.sqrt(np.mean(z**2 / widths)))
        return clock if least is None else max(shown, least)

    def cost(ratio: float) -> float:
        """Minus twice the logarithm of the likelihood of a ``ratio`` of deviations."""
        widths = 1.0 + ratio**2 * effect
        own = deviation_of_clock(widths)
        return float(np.sum(np.log(widths) + z**2 / widths / own**2) + 2 * z.size * np.log(own))

    unit = 1.0 / np.sqrt(effect[0])
    places = np.log(unit * np.geomspace(*_SPAN, _PLACES))
    costs = [cost(float(np.exp(place))) for place in places]
    k = int(np.argmin(costs))
    bracket = places[max(k - 1, 0)], places[min(k + 1, _PLACES - 1)]
    found = optimize.minimize_scalar(
        lambda place: cost(float(np.exp(place))), bounds=bracket, method="bounded"
    )
    ratio = float(np.exp(found.x))
    shown = deviation_of_clock(1.0 + ratio**2 * effect)
    return Deviations(shown, ratio * shown, cost(0.0) - float(found.fun))


def log_determinant(rows: Matrix, stamps: int) -> float:
    """Logarithm of the determinant of the covariance of stamps, in units of their errors.

    Args:
        rows: derivatives of the gaps by errors of stamps and then of impulses, both in units of
            the clock, shape (stamps, any).
        stamps: number of the stamps.

    Raises:
        linalg.LinAlgError: contacts have no speed.
    """
    J = np.linalg.solve(rows[:, :stamps], rows[:, stamps:])
    return float(np.linalg.slogdet(np.eye(stamps) + J @ J.T)[1])


def without_unknowns(A: Matrix, columns: Matrix) -> Matrix:
    """Rows that lack the unknowns of ``A``, shape (r, k): ``columns``, of k rows less.

    One row after another is eliminated, each with the unknown that it depends on most: the order
    of the others stays.
    """
    for j in range(A.shape[1]):
        k = int(np.argmax(np.abs(A[:, j])))
        share = A[:, j] / A[k, j]
        A, columns = (
            np.delete(each - np.outer(share, each[k]), k, axis=0) for each in (A, columns)
        )
    return columns


def innovations(B: Matrix, d: Vector) -> Vector:
    """Independent errors, of the unit of ``e``, that explain ``B e = d`` one row after another.

    ``B`` is of full row rank. Each value is what a row differs from the prediction by the rows
    before it, over the deviation of that prediction; where ``B`` is triangular these are ``e``.
    """
    L = linalg.qr(B.T, mode="r")[0][: len(B)].T
    return np.asarray(linalg.solve_triangular(L * np.sign(np.diag(L)), d, lower=True))
