# SPDX-License-Identifier: Apache-2.0
"""Bags with one fault each, for the tests of checks."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from impact_observer.events import ImpactEvent, Switch
from impact_observer.io import BagWriter, JointState
from impact_observer.io.messages import AnyMessage, bag_messages
from impact_observer.resources import shared

S = 1_000_000_000
MAKE = bag_messages()
STOP = (Switch("stop"),)
GOOD = [ImpactEvent(k * S, STOP, k - 1, 1, S) for k in range(2, 7)]
"""Five impacts of two_mass, from 2 s to 6 s."""


def model(name: str = "two_mass") -> str:
    """A sample model's text."""
    return shared(f"config/{name}.yaml").read_text("utf-8")


def state(stamp: int, names: tuple[str, ...] = ("x1", "x2")) -> AnyMessage:
    """A joint state message."""
    return MAKE.joint_state(JointState(stamp, names, np.zeros(2), np.ones(2)))


def three(stamp: int) -> AnyMessage:
    """A state of three_mass."""
    return MAKE.joint_state(JointState(stamp, ("x1", "x2", "x3"), np.zeros(3), np.ones(3)))


def write(
    events: Sequence[ImpactEvent] | None = GOOD,
    *,
    text: str | None = None,
    truth: Sequence[AnyMessage] | None = None,
    more: Sequence[tuple[str, int, object]] = (),
    types: dict[str, str] | None = None,
    delay: int = 0,
) -> Path:
    """A bag named ``bag``: two_mass with its truth; the arguments change that."""
    if truth is None:
        truth = [state(k * S) for k in range(1, 8)]
    with BagWriter(Path("bag")) as writer:
        for topic, kind in (types or {}).items():
            writer.declare(topic, type_name=kind)
        if text != "":
            writer.write("/plant/model", S, MAKE.model(text or model()))
        for k, each in enumerate(truth):
            writer.write("/plant/joint_states", (k + 1) * S, each)
        for event in events or ():
            writer.write("/impacts", event.stamp + delay, MAKE.event(event))
        if events == []:
            writer.declare("/impacts")
        for topic, log_time, message in more:
            writer.write(topic, log_time, message)
    return Path("bag")


def event_message(event: ImpactEvent, **changes: int) -> AnyMessage:
    """An event's message with other numbers in its header."""
    message = MAKE.event(event)
    for name, value in changes.items():
        setattr(message.header.stamp, name, value)
    return message
