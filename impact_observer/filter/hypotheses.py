# SPDX-License-Identifier: Apache-2.0
"""A hypothesis: what each event was, the state that follows from it, and its probability."""

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.dynamics import lyapunov
from impact_observer.events import Contacts
from impact_observer.filter.gaussian_state import GaussianState
from impact_observer.filter.jump_error import LEVELS, JumpError
from impact_observer.filter.ledger import Ledger
from impact_observer.filter.likelihood import Innovation
from impact_observer.filter.model_error import NO_ERROR, ErrorKind, LearnedError
from impact_observer.filter.square_root import triangular
from impact_observer.filter.tuning import TUNING
from impact_observer.model import System
from impact_observer.states import Matrix, Vector

NOTHING: Mapping[int, float] = MappingProxyType({})
"""The survival where no gap and no load is negative."""


class Jump(NamedTuple):
    """The latest jump of a state: at an event, or at a switch that was inserted after the event.

    Attributes:
        ago: seconds since then.
        x: the state (q, u-) before the jump, shape (2n,), of an impact of which the restitution
            may err; else None.
        hit: the contacts that hit.
    """

    ago: float = 0.0
    x: Vector | None = None
    hit: Contacts = ()

    def later(self, s: float) -> "Jump":
        """The same jump, seen ``s`` seconds later."""
        return Jump(self.ago + s, self.x, self.hit)


class Hypothesis(NamedTuple):
    """One explanation of the events, and the state that follows from it.

    Attributes:
        state: estimate and covariance.
        clock: standard deviation of a stamp, s.
        weight: logarithm of its probability.
        ledger: its decisions on the events.
        survival: of contacts whose gap or load is negative, the least logarithm of the
            probability that the plant's was not: of no impact in the plant. The weight has it.
        error: of the model.
        jump: the latest jump.
        jump_error: of a robot: the errors of its jumps; None for other systems.
        innovation: of the last event. None where the event was rejected or measured nothing.
        subset: which of the parameters it estimates, as a number; 0 for all.
    """

    state: GaussianState
    clock: float
    weight: float = 0.0
    ledger: Ledger = Ledger()
    survival: Mapping[int, float] = NOTHING
    error: LearnedError = NO_ERROR
    jump: Jump = Jump()
    jump_error: JumpError | None = None
    innovation: Innovation | None = None
    subset: int = 0

    @property
    def is_exact(self) -> bool:
        """Whether it explains the events by an exact model.

        The latest, and but for the first, once these are over.
        """
        return self.is_exact_after(0)

    def is_exact_after(self, events: int) -> bool:
        """``is_exact`` once it has explained so many more ``events``."""
        if self.error.level or not (last := self.ledger.last_error):
            return not self.error.level
        events += self.ledger.events
        return last <= TUNING.first_events <= events or events - last >= TUNING.exact_events

    @property
    def is_undisturbed(self) -> bool:
        """Whether no contact is closed, no gap is negative, and no switch was missed just now."""
        return not (self.survival or self.ledger.missed or self.state.closed)

    def weight_without(self, contacts: Contacts) -> float:
        """The logarithm of its probability without the survival of ``contacts``.

        An impact or release of these contacts explains the negative gaps and loads.
        """
        if not self.survival:
            return self.weight
        return self.weight - sum(self.survival.get(i, 0.0) for i in contacts)

    def survival_without(self, contacts: Contacts) -> Mapping[int, float]:
        """``survival`` after an event of ``contacts``."""
        if not self.survival:
            return NOTHING
        return {i: each for i, each in self.survival.items() if i not in contacts}

    @property
    def jump_unexplained(self) -> JumpError | None:
        """``jump_error`` if samples soon after the latest hit contradict the state."""
        error = self.jump_error
        is_soon = self.jump.ago <= TUNING.jump_window
        return error.unexplained if error is not None and is_soon else error

    def with_jump_errors(self, root: Matrix | None) -> Iterator["Hypothesis"]:
        """After a hit, with each size of the error of its jump.

        ``root``, shape (2n, n), is that of the covariance of an error as large as the jump; None
        where jumps have none.
        """
        if root is None:
            yield self
            return
        before = self.jump_error or JumpError()
        for level, size in enumerate(LEVELS):
            yield self._replace(
                state=self.state.with_error(size * root),
                weight=self.weight + before.log_prior(level),
                jump_error=before.after_hit(level),
            )

    @property
    def acceleration_error(self) -> float:
        """The level of white accelerations, m/s^1.5."""
        return self.error.level if self.error.kind is ErrorKind.ACCELERATION else 0.0

    def disordered(self, s: float) -> "Hypothesis":
        """It pays for two stamps whose order is wrong by ``s`` seconds."""
        unlikely = float(special.log_ndtr(-s / (math.sqrt(2.0) * self.clock)))
        return self._replace(weight=self.weight + max(unlikely, TUNING.log_least_disorder))


def log_sum(weights: Sequence[float]) -> float:
    """The logarithm of the sum of the probabilities whose logarithms are ``weights``."""
    largest = max(weights)
    return largest + math.log(sum(math.exp(each - largest) for each in weights))


def normalised(hypotheses: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
    """``hypotheses`` with probabilities that add up to one."""
    if not hypotheses:
        return ()
    total = log_sum([h.weight for h in hypotheses])
    return tuple([h._replace(weight=h.weight - total) for h in hypotheses])


def published(hypotheses: Sequence[Hypothesis], *, misfit: bool) -> Sequence[Hypothesis]:
    """Those whose mixture is published, the estimate's own first.

    The variance of the whole mixture would be that of its rarest members. A model error is tried
    at many events and rarely there: hypotheses that differ in it from the likeliest are left out
    while they hold less than ``Tuning.unpublished_error``. In a ``misfit`` those without a model
    error are wrong, however likely. Of the rest the least likely are left out that hold less than
    ``Tuning.unpublished`` together.
    """
    if len(hypotheses) == 1:
        return hypotheses
    ordered = sorted(hypotheses, key=lambda h: -h.weight)
    in_error = [h for h in ordered if h.error.level]
    if in_error and len(in_error) < len(ordered):
        if misfit:
            ordered = in_error
        else:
            alike = [h for h in ordered if (h.error.level > 0) == (ordered[0].error.level > 0)]
            if _share(alike, ordered)[-1] > 1 - TUNING.unpublished_error:
                ordered = alike
    shares = _share(ordered, ordered)
    return ordered[: 1 + int(np.searchsorted(shares, 1 - TUNING.unpublished))]


def agreeing(hypotheses: Sequence[Hypothesis], system: System) -> Sequence[Hypothesis]:
    """Those nearest to the first by their expected V about it, which hold nearly all probability.

    ``Tuning.disagreeing`` is what the others hold at most. The first stays the first.
    """
    if len(hypotheses) == 1:
        return hypotheses
    n, count = system.n, len(hypotheses)
    roots = [h.state.root[: 2 * n] for h in hypotheses]
    apart = [(h.state.x - hypotheses[0].state.x)[:, None] for h in hypotheses]
    whose = np.append(np.repeat(range(count), [root.shape[1] for root in roots]), range(count))
    errors = np.hstack([*roots, *apart])
    parts = lyapunov.distance(system, errors[:n].T, errors[n:].T)
    order = np.argsort(np.bincount(whose, parts, count))
    held = np.cumsum(probabilities(hypotheses)[order])
    found = order[: 1 + int(np.searchsorted(held, 1 - TUNING.disagreeing))]
    return [hypotheses[0], *(hypotheses[k] for k in found if k)]


def _share(some: Sequence[Hypothesis], whole: Sequence[Hypothesis]) -> Vector:
    """The probability that the first, the first two, ... of ``some`` hold of ``whole``."""
    total = log_sum([h.weight for h in whole])
    return np.cumsum(np.exp([h.weight - total for h in some]))


def probabilities(hypotheses: Sequence[Hypothesis]) -> Vector:
    """Of each of ``hypotheses``, if it is one of them."""
    weights = np.array([h.weight for h in hypotheses])
    found = np.exp(weights - weights.max())
    return np.asarray(found / found.sum())


def error_share(hypotheses: Sequence[Hypothesis]) -> float:
    """The probability that the model is in error."""
    if not any(h.error.level for h in hypotheses):
        return 0.0
    return float(probabilities(hypotheses) @ [h.error.level > 0 for h in hypotheses])


def exact_share(hypotheses: Sequence[Hypothesis]) -> float:
    """The probability that the model has been exact at the latest events."""
    if all(h.is_exact for h in hypotheses):
        return 1.0
    return float(probabilities(hypotheses) @ [h.is_exact for h in hypotheses])


def mixture(hypotheses: Sequence[Hypothesis]) -> GaussianState:
    """The state of the first of ``hypotheses``, with the covariance of all of them about it."""
    best = hypotheses[0].state
    if len(hypotheses) == 1:
        return best
    x = np.array([h.state.x for h in hypotheses]) - best.x
    constants = np.array([h.state.constants for h in hypotheses]) - best.constants
    apart = np.hstack([x, constants])[:, :, None]
    each = zip(np.sqrt(probabilities(hypotheses)), hypotheses, apart, strict=True)
    columns = [share * part for share, h, far in each for part in (h.state.root, far)]
    return best._replace(root=triangular(np.hstack(columns)))


def mean_level(hypotheses: Sequence[Hypothesis], kind: ErrorKind) -> float:
    """The root mean square of the levels of one kind of model error, of those published."""
    squares = np.array([h.error.level**2 if h.error.kind is kind else 0.0 for h in hypotheses])
    if not squares.any():
        return 0.0
    weights = probabilities(hypotheses)
    return math.sqrt(float(np.average(squares, weights=weights)))
