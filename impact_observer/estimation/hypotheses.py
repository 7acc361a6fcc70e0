# SPDX-License-Identifier: Apache-2.0
"""A hypothesis: what each event was, the state that follows from it, and its probability."""

import math
from collections.abc import Mapping, Sequence
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from scipy import special

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.model_error import NO_ERROR, ErrorKind, LearnedError
from impact_observer.estimation.settling import Rest
from impact_observer.estimation.square_root import triangular
from impact_observer.events import Contacts, Kind, Ruling
from impact_observer.states import Vector

_RARE = 1e-3
"""Probability up to which the least likely hypotheses are not published."""
_RARE_ERROR = 0.05
"""Probability up to which hypotheses of another model error are not published."""
_DISORDERED = -50.0
"""Least logarithm of the probability of stamps in a wrong order."""
FIRST = 12
"""Events from the start in which the state is not known: an error of the model is no sign then."""
_EXACT = 24
"""Events in a row without an error of the model, after which it counts as exact again."""
NOTHING: Mapping[int, float] = MappingProxyType({})
"""The survival where no gap and no load is negative."""
NONE_SETTLED: Mapping[int, Rest] = MappingProxyType({})


class Note(NamedTuple):
    """What a hypothesis decides on one contact of an event, or on an impact it inserts.

    Attributes:
        event: stamp (ns) and sequence of the event at which it was decided.
        stamp: of the impact, ns: that of the event, or an earlier one for an inserted impact.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty for an event that is accepted as it was reported.
        innovation: in standard deviations; -1 where there is none.
        switched: index of the contact that has switched: another one where it was mislabelled.
        kind: how it has switched, of an inserted one; of others CLOSE where a contact has settled
            though it was reported to bounce on.
        is_dead: whether it was in the sensor's dead time, which could not report it.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0
    switched: int = -1
    kind: Kind = Kind.IMPACT
    is_dead: bool = False

    @property
    def is_inserted(self) -> bool:
        """Whether it is on a missed impact that the hypothesis inserts."""
        return self.ruling is Ruling.INSERTED

    @property
    def decision(self) -> tuple[object, ...]:
        """The decision without its numbers, which follow the colon of the reason."""
        return self.event, self.contact, self.ruling, self.reason.partition(":")[0]


class MissedSwitch(NamedTuple):
    """A switch that was predicted and not reported.

    Attributes:
        contact: index.
        kind: how it switches.
        ago: when, seconds before the next event.
        depth: penetration that the estimate would reach without it, in standard deviations.
        is_dead: whether it is in the sensor's dead time, which cannot report it.
    """

    contact: int
    kind: Kind
    ago: float
    depth: float
    is_dead: bool = False


class Hypothesis(NamedTuple):
    """One explanation of the events, and the state that follows from it.

    Attributes:
        state: estimate and covariance.
        clock: standard deviation of a stamp, s.
        weight: logarithm of its probability.
        notes: its decisions on the latest events, in their order.
        survival: of contacts whose gap or load is negative, the least logarithm of the
            probability that the plant's was not: of no impact in the plant. The weight has it.
        missed: missed switches since the last event.
        error: of the model.
        since: duration of the flight, s: since the last event, or a switch inserted after it.
        impact: at the start of the flight: the state (q, u-) before it, shape (2n,), and the
            contacts that hit. None where that was no impact of which the restitution may err.
        innovation: of the last event, in standard deviations; positive where the predicted gap
            was negative. None where it was rejected or measured nothing.
        residual: the same in m.
        subset: which of the parameters it estimates, as a number; 0 for all.
        events: that it has explained.
        last_error: which of them it has explained by an error of the model, the last; 0 for none.
        reported: when the sensor has reported each contact last, s since the epoch; empty where it
            has no dead time.
        settled: closed contacts of which bounces may still be reported.
    """

    state: GaussianState
    clock: float
    weight: float = 0.0
    notes: tuple[Note, ...] = ()
    survival: Mapping[int, float] = NOTHING
    missed: tuple[MissedSwitch, ...] = ()
    error: LearnedError = NO_ERROR
    since: float = 0.0
    impact: tuple[Vector, Contacts] | None = None
    innovation: float | None = None
    residual: float = 0.0
    subset: int = 0
    events: int = 0
    last_error: int = 0
    reported: Mapping[int, float] = NOTHING
    settled: Mapping[int, Rest] = NONE_SETTLED

    @property
    def is_exact(self) -> bool:
        """Whether it explains the events by an exact model.

        The latest, and but for the first, once these are over.
        """
        last, events = self.last_error, self.events
        by_first = last <= FIRST <= events
        return not self.error.level and (not last or by_first or events - last >= _EXACT)

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
    def acceleration_error(self) -> float:
        """The level of white accelerations, m/s^1.5."""
        return self.error.level if self.error.kind is ErrorKind.ACCELERATION else 0.0

    def disordered(self, s: float) -> "Hypothesis":
        """It pays for two stamps whose order is wrong by ``s`` seconds."""
        unlikely = float(special.log_ndtr(-s / (math.sqrt(2.0) * self.clock)))
        return self._replace(weight=self.weight + max(unlikely, _DISORDERED))

    def later(self, s: float) -> "Hypothesis":
        """Its missed switches are another ``s`` seconds ago."""
        return self._replace(missed=tuple(m._replace(ago=m.ago + s) for m in self.missed))

    def is_as_reported(self, event: tuple[int, int]) -> bool:
        """Whether ``event``, the latest, happened as it was reported, and nothing before it.

        Nothing that the sensor could have reported.
        """
        latest = [*takewhile(lambda note: note.event == event, reversed(self.notes))]
        return all(
            note.is_dead or (note.ruling is Ruling.APPLIED and not note.reason) for note in latest
        )

    def closed_unreported(self, contact: int) -> bool:
        """Whether ``contact``, which is closed, was closed in the sensor's dead time."""
        latest = next((each for each in reversed(self.missed) if each.contact == contact), None)
        if latest is not None:
            return latest.is_dead
        notes = (each for each in reversed(self.notes) if each.switched == contact)
        return next((each.is_dead for each in notes), False)

    def notes_on(self, event: tuple[int, int]) -> list[Note]:
        """Its notes on the contacts of ``event``, which is the latest."""
        latest = takewhile(lambda note: note.event == event, reversed(self.notes))
        return [note for note in latest if not note.is_inserted][::-1]


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
    while they hold less than ``_RARE_ERROR`` of the probability. In a ``misfit`` those without a
    model error are wrong, however likely. Of the rest the least likely are left out that hold less
    than ``_RARE`` together.
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
            if _share(alike, ordered)[-1] > 1 - _RARE_ERROR:
                ordered = alike
    return ordered[: 1 + int(np.searchsorted(_share(ordered, ordered), 1 - _RARE))]


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
    weights = probabilities(hypotheses)
    columns = []
    for weight, h in zip(np.sqrt(weights), hypotheses, strict=True):
        differences = np.append(h.state.x - best.x, h.state.constants - best.constants)
        columns += [weight * h.state.root, weight * differences[:, None]]
    return best._replace(root=triangular(np.hstack(columns)))


def mean_level(hypotheses: Sequence[Hypothesis], kind: ErrorKind) -> float:
    """The root mean square of the levels of one kind of model error, of those published."""
    squares = np.array([h.error.level**2 if h.error.kind is kind else 0.0 for h in hypotheses])
    if not squares.any():
        return 0.0
    weights = probabilities(hypotheses)
    return math.sqrt(float(np.average(squares, weights=weights)))
