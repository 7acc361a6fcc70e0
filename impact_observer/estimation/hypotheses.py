"""A hypothesis: what each event was, the state that follows from it, and its probability."""

from collections.abc import Mapping, Sequence
from itertools import takewhile
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from impact_observer.estimation.gaussian_state import GaussianState
from impact_observer.estimation.square_root import triangular
from impact_observer.events import Kind, Ruling

_NONE: Mapping[int, float] = MappingProxyType({})


class Note(NamedTuple):
    """What a hypothesis decides on one contact of an event, or on an impact it inserts.

    Attributes:
        event: stamp (ns) and sequence of the event at which it was decided.
        stamp: of the impact, ns: that of the event, or an earlier one for an inserted impact.
        contact: index.
        ruling: applied, rejected or inserted.
        reason: in plain words; empty for an event that is accepted as it was reported.
        innovation: in standard deviations; -1 where there is none.
    """

    event: tuple[int, int]
    stamp: int
    contact: int
    ruling: Ruling
    reason: str = ""
    innovation: float = -1.0

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
    """

    contact: int
    kind: Kind
    ago: float
    depth: float


class Hypothesis(NamedTuple):
    """One explanation of the events, and the state that follows from it.

    Attributes:
        state: estimate and covariance.
        clock: standard deviation of a stamp, s.
        weight: logarithm of its probability.
        notes: its decisions on the latest events, in their order.
        penetrating: contacts whose gap or load is negative now, with the logarithm of the
            probability that this is an error of the estimate.
        missed: missed switches since the last event.
    """

    state: GaussianState
    clock: float
    weight: float = 0.0
    notes: tuple[Note, ...] = ()
    penetrating: Mapping[int, float] = _NONE
    missed: tuple[MissedSwitch, ...] = ()

    @property
    def penalised_weight(self) -> float:
        """Its weight, less for the contacts that it penetrates."""
        return self.weight + sum(self.penetrating.values()) if self.penetrating else self.weight

    def notes_on(self, event: tuple[int, int]) -> list[Note]:
        """Its notes on the contacts of ``event``, which is the latest."""
        latest = takewhile(lambda note: note.event == event, reversed(self.notes))
        return [note for note in latest if not note.is_inserted][::-1]


def mixture(hypotheses: Sequence[Hypothesis]) -> GaussianState:
    """The state of the first of ``hypotheses``, with the covariance of all of them about it."""
    best = hypotheses[0].state
    if len(hypotheses) == 1:
        return best
    weights = np.exp([h.weight for h in hypotheses])
    columns = []
    for weight, h in zip(np.sqrt(weights / np.sum(weights)), hypotheses, strict=True):
        differences = np.append(h.state.x - best.x, h.state.constants - best.constants)
        columns += [weight * h.state.root, weight * differences[:, None]]
    return best._replace(root=triangular(np.hstack(columns)))
