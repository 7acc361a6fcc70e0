# SPDX-License-Identifier: Apache-2.0
"""Hypotheses as arrays, one row each, and the bank of them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.ladders import Ladders, lengths_of, triangular
from impact_observer.events import Contacts
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]
TRUE, SPURIOUS, MISSED, OTHER, RESTART = range(1, 6)
"""Decisions on an event or a predicted impact; a decision is ``8 contact + one of these``."""


class Hypotheses(NamedTuple):
    """Hypotheses on what the events were, at one instant.

    Attributes:
        x: means of the states (q, u, constants), shape (H, N).
        S: roots of their covariances, without the error of the model since the last impact,
            shape (H, N, N).
        B: what that error adds to a root, for a relative error of one, shape (H, N, N).
        logw: logarithms of the probabilities, shape (H,).
        r: rungs of the ladder of errors, shape (H,).
        c: rungs of the ladder of the clock, shape (H,).
        past: the latest decisions, the newest last, shape (H, L).
        paid: log probability of no impact that a dip which still lasts has cost, shape (H, m).
        held: bits of the contacts that are closed, shape (H,).
        just: bits of the contacts that have hit last, shape (H,).
        tried: bits of the contacts whose dip lasts and has branched already, shape (H,).
    """

    x: Array
    S: Array
    B: Array
    logw: Vector
    r: NDArray[np.intp]
    c: NDArray[np.intp]
    past: NDArray[np.intp]
    paid: Array
    held: NDArray[np.intp]
    just: NDArray[np.intp]
    tried: NDArray[np.intp]

    @property
    def size(self) -> int:
        """Number of hypotheses."""
        return len(self.logw)

    def take(self, which: Any) -> "Hypotheses":  # noqa: ANN401 (what indexes an array)
        """The chosen hypotheses."""
        return Hypotheses(*(each[which] for each in self))

    @staticmethod
    def joined(parts: Sequence["Hypotheses"]) -> "Hypotheses":
        """All hypotheses of ``parts``."""
        if len(parts) == 1:
            return parts[0]
        return Hypotheses(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def decided(self, decision: int | NDArray[np.intp]) -> NDArray[np.intp]:
        """``past`` after one more decision."""
        past = np.roll(self.past, -1, axis=1)
        past[:, -1] = decision
        return past

    def roots(self, ladders: Ladders) -> Array:
        """Roots of the whole covariances, shape (H, N, 2N)."""
        return np.concatenate([self.S, ladders.errors[self.r, None, None] * self.B], axis=2)

    @property
    def weights(self) -> Vector:
        """Probabilities, shape (H,)."""
        each = np.exp(self.logw - self.logw.max())
        return np.asarray(each / each.sum())


class Bank(NamedTuple):
    """What a filter knows at one instant.

    Attributes:
        t: the instant, s since the epoch.
        rows: the hypotheses.
        replica: a geometric replica (q, u) from which the filter restarts, shape (2n,).
        squares: mean squares of the replica's motion, shape (2n,).
        intensity: of the white accelerations of a relative error of one, m/s^1.5, length n.
    """

    t: Elapsed
    rows: Hypotheses
    replica: Vector
    squares: Vector
    intensity: tuple[float, ...]

    @property
    def sizes(self) -> Vector:
        """Amplitudes of the motion, shape (2n,)."""
        return np.sqrt(2 * self.squares)


def mixture(rows: Hypotheses, ladders: Ladders, unpublished: float) -> tuple[Vector, Matrix]:
    """The state of the likeliest hypothesis, and a root of the covariance of all about it.

    The least likely hypotheses, which hold less than ``unpublished`` together, are left out.

    Returns:
        Shapes (N,) and (N, N).
    """
    order = np.argsort(-rows.logw)
    weights = rows.weights[order]
    kept = 1 + int(np.searchsorted(np.cumsum(weights), 1 - unpublished))
    order, weights = order[:kept], weights[:kept] / weights[:kept].sum()
    if kept == 1:
        return rows.x[order[0]], triangular(rows.roots(ladders)[order[0]])
    x = rows.x[order]
    mean = x[0]
    root = rows.roots(ladders)[order]
    wide = np.concatenate([root, (x - mean)[:, :, None]], axis=2) * np.sqrt(weights)[:, None, None]
    return mean, triangular(wide.transpose(1, 0, 2).reshape(len(mean), -1))


def bits(contacts: Contacts) -> int:
    """Contacts as a number."""
    return sum(1 << i for i in contacts)


def contacts_of(number: int) -> Contacts:
    """The contacts of a number of ``bits``."""
    return tuple(i for i in range(number.bit_length()) if number >> i & 1)


def spread_of(rows: Hypotheses, ladders: Ladders, functions: Array) -> Array:
    """Deviations of linear functions, shape (H, ..., N), of each hypothesis, shape (H, ...)."""
    return lengths_of(np.einsum("h...i,hik->h...k", functions, rows.roots(ladders)))
