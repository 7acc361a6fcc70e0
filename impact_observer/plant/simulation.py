# SPDX-License-Identifier: Apache-2.0
"""A whole run of the plant: its events and its true states on a grid of stamps."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent
from impact_observer.model.model_file import ModelSource, model_of
from impact_observer.model.multibody import Multibody
from impact_observer.plant.event_driven import Plant
from impact_observer.plant.switching import Switching
from impact_observer.stamps import whole_stamps
from impact_observer.states import Stamps, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """The recorded motion of a plant.

    Attributes:
        epoch: stamp of ``t = 0``, ns.
        stamps: ns, shape (samples,).
        states: true states (q, u), shape (samples, 2n); at the stamp of a switching, the state
            after the switching.
        switchings: all changes of contacts up to the last stamp.
        events: events of an ideal sensor; for a real sensor see ``simulate_sensor``.
    """

    epoch: int
    stamps: Stamps
    states: Vector
    switchings: tuple[Switching, ...]
    events: tuple[ImpactEvent, ...]

    def __repr__(self) -> str:
        return (
            f"<Run: epoch {self.epoch} ns, {len(self.stamps)} states,"
            f" {len(self.switchings)} switchings>"
        )

    def sampled_at(self, stamps: Stamps) -> "Run":
        """The run with only the states at ``stamps``, a part of the stamps of the run."""
        which = np.searchsorted(self.stamps, stamps)
        return replace(self, stamps=stamps, states=self.states[which])

    def nearest(self, system: Multibody) -> tuple[float, str]:
        """The smallest gap of the states, m, and the name of the contact; needs a contact."""
        least = np.min(system.gaps_at(self.stamps - self.epoch, self.states), axis=0)
        contact = int(np.argmin(least))
        return float(least[contact]), system.contact_names[contact]

    @property
    def impacts(self) -> tuple[Switching, ...]:
        """The switchings with an impact."""
        return tuple(each for each in self.switchings if each.contacts)


def simulate(
    plant: Plant | ModelSource,
    stamps: Stamps,
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> Run:
    """Run ``plant`` from its present phase through all ``stamps``, ns, ascending, (samples,).

    A model, or the path of its file, is run from its initial state, whose epoch is the first
    stamp. ``progress`` is called with the stamp of every switching, ns.

    Raises:
        ModelError: the model file is wrong, or has no initial state.
        ImpactLawError: the impact law has no solution.
        DynamicsError: the forcing ends before the last stamp.
        UsageError: stamps that do not ascend, or are no integers.
    """
    stamps = whole_stamps(stamps)
    if np.any(stamps[1:] < stamps[:-1]):
        raise UsageError("stamps: they fall; expected an ascending array, such as one of grid")
    if not isinstance(plant, Plant):
        model = model_of(plant, "simulate")
        epoch = int(stamps[0]) if stamps.size else 1
        plant = Plant(model, epoch=epoch)
    states = np.empty((stamps.size, 2 * plant.system.n))
    switchings: list[Switching] = []
    events: list[ImpactEvent] = []
    done = 0
    last = int(stamps[-1]) if stamps.size else plant.epoch
    while (switching := plant.next_switching(last)) is not None:
        stamp = switching.instant.stamp
        if done < stamps.size and stamps[done] < stamp:
            upto = int(np.searchsorted(stamps, stamp))
            states[done:upto] = plant.states(stamps[done:upto])
            done = upto
        plant.cross(switching)
        switchings.append(switching)
        if switching.switches:
            events.append(
                ImpactEvent(stamp, switching.switches, len(events) + 1, epoch=plant.epoch)
            )
        progress(stamp)
    states[done:] = plant.states(stamps[done:])
    return Run(plant.epoch, stamps, states, tuple(switchings), tuple(events))
