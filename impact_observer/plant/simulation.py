"""A whole run of the plant: its events and its true states on a grid of stamps."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from impact_observer.events import ImpactEvent
from impact_observer.plant.plant import Impact, Plant, event_of
from impact_observer.states import Stamps, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a plant did.

    Attributes:
        stamps: ns, shape (samples,).
        states: true states (q, u), shape (samples, 2n); at an impact's stamp after it.
        impacts: all impacts up to the last stamp.
        events: what an ideal sensor tells of them.
    """

    stamps: Stamps
    states: Vector
    impacts: tuple[Impact, ...]
    events: tuple[ImpactEvent, ...]


def simulate(
    plant: Plant, stamps: Stamps, *, progress: Callable[[int], None] = lambda _: None
) -> Run:
    """Run ``plant`` from its present phase through all ``stamps``.

    Args:
        plant: is advanced.
        stamps: where to sample, ns, ascending, shape (samples,).
        progress: told the stamp of every impact.

    Raises:
        LastingContactError: a contact stays closed, or impacts accumulate.
    """
    states = np.empty((stamps.size, 2 * plant.system.n))
    impacts: list[Impact] = []
    events: list[ImpactEvent] = []
    done = 0
    last = int(stamps[-1]) if stamps.size else plant.epoch
    while (impact := plant.next_impact(last)) is not None:
        upto = int(np.searchsorted(stamps, impact.instant.stamp))
        states[done:upto] = plant.states(stamps[done:upto])
        done = upto
        plant.cross(impact)
        impacts.append(impact)
        events.append(
            event_of(impact, plant.system, sequence=len(impacts), episode=0, epoch=plant.epoch)
        )
        progress(impact.instant.stamp)
    states[done:] = plant.states(stamps[done:])
    return Run(stamps, states, tuple(impacts), tuple(events))
