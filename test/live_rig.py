# SPDX-License-Identifier: Apache-2.0
"""A rig with a live force on a ground that moves: its samples, its plant, and a bag of both."""

from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from systems import EPOCH

from impact_observer.events import ImpactEvent
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, bag_messages
from impact_observer.io.writer import BagWriter
from impact_observer.model import parse_model
from impact_observer.model.live_signals import LiveSignals, connected
from impact_observer.plant import Plant
from impact_observer.stamps import NS_PER_S

Array = NDArray[np.float64]
RIG = """\
name: rig
bodies:  [{name: x1, mass: 1}, {name: x2, mass: 2}]
grounds: [{name: base, motion: {harmonics: [{amplitude: 0.1, frequency: 3}]}}]
springs:
  - {between: [base, x1], stiffness: 10, damping: 0.3}
  - {between: [x1, x2], stiffness: 20, damping: 0.2}
  - {between: [x2, ground], stiffness: 5}
forces:  [{body: x2, input: motor}, {body: x1, amplitude: 0.5, frequency: 2}]
stops:
  - {name: foot, between: [base, x1], gap: 0.2, restitution: 0.7}
  - {name: head, body: x2, limit: 0.3, side: above, restitution: 0.7}
"""
START = np.array([0.1, 0.0]), np.array([0.0, 0.5])
SECONDS = 5.0


def motor(t: float) -> float:
    """The force of the input, N."""
    return float(4 * np.cos(2.5 * t))


Sample = tuple[int, float]
"""Stamp (ns) and value (N)."""


@cache
def samples(step: float = 2e-3) -> list[Sample]:
    """From the epoch to the end."""
    times = np.arange(0.0, SECONDS + step, step).tolist()
    return [(EPOCH + round(t * NS_PER_S), motor(t)) for t in times]


def give(live: LiveSignals | None, sample: Sample) -> str:
    """Add a sample."""
    assert live is not None
    return live.add_force("motor", *sample)


@cache
def simulated(pauses: int = 25) -> tuple[list[ImpactEvent], NDArray[np.int64], Array]:
    """Events and states of a plant that gets so many samples at a time."""
    given = samples()
    system, live = connected(parse_model(RIG, "rig").system, causal=True)
    give(live, given[0])
    plant = Plant(system, *START, epoch=EPOCH, live=live)
    assert isinstance(plant, Plant)
    events: list[ImpactEvent] = []
    stamps: list[int] = []
    states: list[Array] = []
    shown = EPOCH

    def show(until: int) -> None:
        nonlocal shown
        while shown <= until:
            stamps.append(shown)
            states.append(plant.states(np.array([shown]))[0])
            shown += NS_PER_S // 100

    for k in range(1, len(given), pauses):
        for sample in given[k : k + pauses]:
            give(live, sample)
        until = plant.known_until
        while (switching := plant.next_switching(until)) is not None:
            show(switching.instant.stamp - 1)
            plant.cross(switching)
            number = len(events) + 1
            stamp = switching.instant.stamp
            events.append(ImpactEvent(stamp, switching.switches, number, epoch=EPOCH))
        show(until)
    return events, np.array(stamps), np.array(states)


LATE = 30_000_000
"""How much later a twentieth of the samples arrive, ns."""


def arrivals() -> list[int]:
    """When each sample is received, ns: after 0.1 ms, or late."""
    late = np.random.default_rng(2).random(len(samples())) < 0.05
    return [
        sample[0] + (LATE if is_late else 100_000)
        for sample, is_late in zip(samples(), late.tolist(), strict=True)
    ]


def bag(path: Path) -> Path:
    """A recording of the rig: its model, impacts, samples as they arrived, and true states."""
    make, (events, stamps, states) = bag_messages(), simulated()
    model = parse_model(RIG, "rig")
    names, n = model.system.coordinates, model.system.n
    messages: list[tuple[int, str, object]] = [
        (EPOCH, interfaces.PLANT_MODEL.topic, make.model(model.text()))
    ]
    messages += [(e.stamp, interfaces.IMPACTS.topic, make.event(e)) for e in events]
    for at, (stamp, value) in zip(arrivals(), samples(), strict=True):
        sample = make.joints(stamp, ["motor"], effort=[value])
        messages.append((at, interfaces.FORCING.topic, sample))
    for stamp, x in zip(stamps.tolist(), states, strict=True):
        state = make.joint_state(JointState(stamp, names, x[:n], x[n:]))
        messages.append((stamp, interfaces.PLANT_JOINT_STATES.topic, state))
    with BagWriter(path) as writer:
        for at, topic, message in sorted(messages, key=lambda each: each[0]):
            writer.write(topic, at, message)
    return path
