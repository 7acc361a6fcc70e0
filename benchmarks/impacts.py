# SPDX-License-Identifier: Apache-2.0
"""Impacts of the sample models and energies of states, for runs without bags or ROS."""

import time
from collections.abc import Iterable

import numpy as np

from impact_observer.dynamics.lyapunov import distance
from impact_observer.events import ImpactEvent
from impact_observer.model import System, read_model
from impact_observer.observer import Observer
from impact_observer.plant import Plant, simulate
from impact_observer.stamps import from_seconds, grid
from impact_observer.states import Vector

EPOCH = 1_000_000_000


def impacts(name: str, seconds: float) -> tuple[ImpactEvent, ...]:
    """The events of an ideal sensor on a sample model."""
    model = read_model(name)
    stamps = grid(EPOCH, EPOCH + from_seconds(seconds), 1 / seconds)
    return simulate(Plant(model.system, *model.initial_state(), epoch=EPOCH), stamps).events


def each_received(observer: Observer, events: Iterable[ImpactEvent]) -> list[float]:
    """How long each event takes, s."""
    taken: list[float] = []
    for event in events:
        begin = time.perf_counter()
        observer.receive(event)
        taken.append(time.perf_counter() - begin)
    return taken


def energy(system: System, x: Vector) -> Vector:
    """Kinetic and elastic energy, J, of states (q, u) in the last axis; of errors it is ``V``."""
    return distance(system, *np.split(x, 2, axis=-1))
