# SPDX-License-Identifier: Apache-2.0
"""Hypotheses as arrays, one row each, and the bank of them."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_observer.bank.balance import ImpactState
from impact_observer.bank.ladders import Ladders
from impact_observer.events import Contacts
from impact_observer.square_roots import lengths_of, triangular
from impact_observer.stamps import Elapsed
from impact_observer.states import Matrix, Vector

Array = NDArray[np.float64]
TRUE, SPURIOUS, MISSED, OTHER, RESTART = range(1, 6)
"""Decisions on an event or a predicted impact; a decision is ``8 contact + one of these``."""


_ONLY = np.zeros(1, dtype=np.intp)


class Missed(NamedTuple):
    """An impact that was predicted and not reported.

    Attributes:
        contact: index.
        t: when, s since the epoch.
        depth: penetration that the estimate would reach without it, in standard deviations.
        is_dead: whether the sensor could not report it.
        state: of the hypothesis then.
    """

    contact: int
    t: Elapsed
    depth: float
    is_dead: bool
    state: ImpactState


class Hypotheses(NamedTuple):
    """Hypotheses on what the events were, at one instant.

    A state has N numbers: d = 2n of (q, u), the parameters of the model, and the delay of the
    stamps where it is estimated.

    Attributes:
        x: means of the states, shape (H, N).
        S: roots of their covariances, without the error of the model since the last impact,
            shape (H, N, N).
        B: what that error adds to the root of (q, u), for a relative error of one, (H, d, d).
        logw: logarithms of the probabilities, shape (H,).
        r: rungs of the ladder of errors, shape (H,).
        c: rungs of the ladder of the clock, shape (H,).
        past: the latest decisions as numbers, the newest last, shape (H, L).
        paid: log probability of no impact that a dip which still lasts has cost, shape (H, m).
        sunk: the least log probability that a dip has cost since the last event, shape (H,).
        held: bits of the contacts that are closed, shape (H,).
        just: bits of the contacts that have hit last, shape (H,).
        tried: bits of the contacts whose dip lasts and has branched already, shape (H,).
        missed: impacts since the last event, tuples of ``Missed``, shape (H,).
        notes: decisions on the latest events, tuples of ``Note``, shape (H,).
    """

    x: Array
    S: Array
    B: Array
    logw: Vector
    r: NDArray[np.intp]
    c: NDArray[np.intp]
    past: NDArray[np.intp]
    paid: Array
    sunk: Vector
    held: NDArray[np.intp]
    just: NDArray[np.intp]
    tried: NDArray[np.intp]
    missed: NDArray[np.object_]
    notes: NDArray[np.object_]

    @property
    def size(self) -> int:
        """Number of hypotheses."""
        return len(self.logw)

    @property
    def best(self) -> int:
        """Index of the likeliest hypothesis."""
        return int(np.argmax(self.logw))

    def by_held(self) -> Iterator[tuple[NDArray[np.intp], Contacts]]:
        """Indices of the hypotheses with the same closed contacts, and these contacts."""
        if self.size == 1:
            yield _ONLY, contacts_of(int(self.held[0]))
            return
        for number in sorted({*self.held.tolist()}):
            yield np.flatnonzero(self.held == number), contacts_of(number)

    def shown(self, unpublished: float) -> "Hypotheses":
        """The likeliest first, without the least likely ones, ``unpublished`` together."""
        if self.size == 1:
            return self
        order = np.argsort(-self.logw)
        kept = 1 + int(np.searchsorted(np.cumsum(self.weights[order]), 1 - unpublished))
        return self.take(order[:kept])

    def take(self, which: Any) -> "Hypotheses":  # noqa: ANN401 (what indexes an array)
        """The chosen hypotheses."""
        return Hypotheses(*(each[which] for each in self))

    @staticmethod
    def joined(parts: Sequence["Hypotheses"]) -> "Hypotheses":
        """All hypotheses of ``parts``."""
        if len(parts) == 1:
            return parts[0]
        return Hypotheses(*(np.concatenate(each) for each in zip(*parts, strict=True)))

    def decided(self, decisions: int | NDArray[np.intp]) -> NDArray[np.intp]:
        """``past`` after one more decision each."""
        past = np.roll(self.past, -1, axis=1)
        past[:, -1] = decisions
        return past

    def roots(self, ladders: Ladders) -> Array:
        """Roots of the whole covariances, shape (H, N, N + d)."""
        H, N, d = *self.x.shape, self.B.shape[1]
        found = np.zeros((H, N, N + d))
        found[:, :, :N] = self.S
        found[:, :d, N:] = ladders.errors[self.r, None, None] * self.B
        return found

    def published(self, ladders: Ladders) -> Array:
        """``roots`` as published: errors of a model persist, and white noise does not.

        So after the first event deviations of (q, u) are larger where the model is in error.
        """
        found = self.roots(ladders)
        found[:, : self.B.shape[1]] *= self.persistence(ladders)[:, None, None]
        return found

    def persistence(self, ladders: Ladders) -> Vector:
        """Factors of the published deviations of (q, u), shape (H,)."""
        return np.where(self.past.any(axis=1), ladders.persistence[self.r], 1.0)

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
        constants: parameters and delay about which flights are linearised, shape (N - 2n,).
        reported: when each contact was reported to hit last, s since the epoch, shape (m,).
        doubted: events in a row after which the model was in error almost surely.
        ago: how long ago the replica holds, s: at the last event.
        closed: contacts that the replica holds closed, as reported.
        contradicted: events for which the last contradiction is still told.
        farthest: innovation at that one, in standard deviations.
        is_expected: whether the last event was; then a restart at the next one is less likely.
        late: stamp of the last event less ``t``, s: the delay of the stamps as estimated.
    """

    t: Elapsed
    rows: Hypotheses
    replica: Vector
    squares: Vector
    intensity: tuple[float, ...]
    constants: Vector
    reported: Vector
    doubted: int = 0
    ago: float = 0.0
    is_expected: bool = False
    late: float = 0.0
    contradicted: int = 0
    farthest: float = 0.0
    closed: Contacts = ()

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
    rows = rows.shown(unpublished)
    mean, root = rows.x[0], rows.published(ladders)
    if rows.size == 1:
        return mean, triangular(root[0])
    scale = np.sqrt(rows.weights)[:, None, None]
    wide = np.concatenate([root, (rows.x - mean)[:, :, None]], axis=2) * scale
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


def objects(values: Sequence[Any]) -> NDArray[np.object_]:
    """An array of tuples, one each."""
    found = np.empty(len(values), dtype=np.object_)
    found[:] = values
    return found
