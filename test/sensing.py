# SPDX-License-Identifier: Apache-2.0
"""Switchings made by hand, and the messages of a simulated sensor."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from systems import EPOCH, system

from impact_observer.events import Kind, Switch
from impact_observer.model import System
from impact_observer.plant import SensorMessage, SensorModel, Switching, simulate_sensor
from impact_observer.stamps import NS_PER_S, Instant

THREE = system(
    np.eye(3), np.zeros((3, 3)), np.eye(3), contacts=[(row, 1.0, 0.5) for row in np.eye(3)]
)
"""Three contacts, each of a coordinate of its own."""

FULL: dict[str, Any] = {
    "delay": 0.02,
    "jitter": 0.003,
    "quantisation": 0.001,
    "dead_time": 0.4,
    "missed": 0.3,
    "spurious": 2.0,
    "mislabelled": 0.3,
    "clock_offset": -0.05,
    "clock_drift": 1e-4,
    "threshold": 0.5,
    "impacts_only": True,
    "transport": 0.6,
}
"""Every fault, large enough to act within seconds."""


def switching(
    seconds: float,
    switchings: Sequence[tuple[int, Kind]],
    speed: float = 1.0,
    model: System = THREE,
) -> Switching:
    """Contacts that approach with ``speed``, m/s, and switch at ``seconds`` since ``EPOCH``."""
    which = tuple(i for i, _ in switchings)
    before = np.concatenate([np.zeros(model.n), np.full(model.n, -speed)])
    names = model.contact_names
    return Switching(
        instant=Instant(EPOCH + round(seconds * NS_PER_S)),
        contacts=which,
        closed=(),
        held=(),
        before=before,
        after=before,
        switches=tuple(Switch(names[i], kind) for i, kind in switchings),
    )


def impacts(count: int, every: float = 1.0, model: System = THREE) -> list[Switching]:
    """Impacts of one contact after the other, ``every`` so many seconds."""
    return [
        switching((k + 1) * every, [(k % model.m, Kind.IMPACT)], model=model) for k in range(count)
    ]


def messages(
    sensor: SensorModel,
    switchings: Sequence[Switching],
    *,
    model: System = THREE,
    seconds: float = 0.0,
) -> list[SensorMessage]:
    """A sensor's messages, by sequence number, of a run of at least ``seconds``."""
    last = max([EPOCH + round(seconds * NS_PER_S), *(each.instant.stamp for each in switchings)])
    found = simulate_sensor(sensor, model, switchings, epoch=EPOCH, last=last, seed=1)
    return sorted(found, key=lambda each: each.event.sequence)
