# SPDX-License-Identifier: Apache-2.0
"""A live table of plants and observers, from the topics that they publish."""

import math
import time
from collections import Counter, defaultdict, deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
from rclpy.subscription import Subscription
from rich.console import Group, RenderableType
from rich.table import Table

from impact_observer.draw.reports import literal_text
from impact_observer.dynamics import Mechanism, mechanism_of
from impact_observer.errors import ImpactObserverError
from impact_observer.io import interfaces
from impact_observer.io.interfaces import interface
from impact_observer.io.messages import (
    AnyMessage,
    JointState,
    read,
    read_estimate,
    read_event,
    read_verdict,
)
from impact_observer.model import parse_model
from impact_observer.model.multibody import Multibody, errors_of, multibody_of
from impact_observer.process_end import Stop
from impact_observer.ros.session import ros_node
from impact_observer.ros.topics import common_offer, message_class, qos_profile, waiting_messages
from impact_observer.stamps import seconds_between
from impact_observer.states import Estimate

View: TypeAlias = dict[str, Any]
"""Everything at one moment; SI units, None for what is not known."""
_WATCHED = (
    interfaces.OBSERVER_STATES,
    interfaces.OBSERVER_VERDICTS,
    interfaces.IMPACTS,
    interfaces.PLANT_MODEL,
    interfaces.PLANT_JOINT_STATES,
)
_KEPT = 2000
"""Messages of a topic that may wait, and states kept to find the truth of an estimate's stamp."""
_SHOWN = 6
"""Verdicts shown of each observer."""
_PERIOD = 0.25
"""Time between two views, s."""


class Listener:
    """Keeps the last messages of plants and observers; those of one namespace belong together."""

    def __init__(self, system: Multibody | None = None) -> None:
        """Listen to all plants and observers.

        Args:
            system: gives V; None for the model that the plant publishes.
        """
        self._given = None if system is None else mechanism_of(system)
        self._mechanisms = dict[str, Mechanism]()
        self._truths = defaultdict[str, dict[int, JointState]](dict)
        self._estimates = defaultdict[str, dict[int, tuple[tuple[str, ...], Estimate]]](dict)
        self._verdicts = defaultdict[str, deque[View]](lambda: deque(maxlen=_SHOWN))
        self._counts = defaultdict[str, Counter[str]](Counter)
        self._epochs, self._impacts, self._warning = dict[str, int](), 0, ""

    def wants(self, topic: str, type_name: str) -> bool:
        """Whether the messages of a topic are used."""
        kind = interface(topic)
        return kind is not None and kind in _WATCHED and kind.type == type_name

    def receive(self, topic: str, message: AnyMessage) -> None:
        """Take in a message of a wanted topic; one without sense is a warning."""
        kind, owner = interface(topic), topic.rpartition("/")[0]
        namespace = owner.removesuffix("/plant")
        try:
            if kind == interfaces.OBSERVER_STATES:
                names, estimate = read_estimate(message)
                _keep(self._estimates[owner], estimate.stamp, (names, estimate))
            elif kind == interfaces.OBSERVER_VERDICTS:
                verdict, _ = read_verdict(message)
                ruling = verdict.ruling.name.lower().replace("_", " ")
                if not verdict.revises:
                    self._counts[owner][ruling] += 1
                row = {"stamp": verdict.stamp, "contact": verdict.contact, "verdict": ruling}
                self._verdicts[owner].appendleft({**row, "reason": verdict.reason})
            elif kind == interfaces.PLANT_JOINT_STATES:
                state = read(JointState, message)
                _keep(self._truths[namespace], state.stamp, state)
            elif kind == interfaces.PLANT_MODEL:
                system = multibody_of(parse_model(message.data, topic))
                self._mechanisms[namespace] = mechanism_of(system)
            else:
                self._epochs[owner] = read_event(message).epoch
                self._impacts += 1
        except ImpactObserverError as error:
            self._warning = f"{topic}: not understood: {error}"

    def view(self) -> View:
        """Everything at present; times are seconds since the epoch of the events."""
        observers = [self._observer(each) for each in sorted(self._estimates)]
        return {"impacts": self._impacts, "warning": self._warning, "observers": observers}

    def _observer(self, name: str) -> View:
        """An observer with its newest estimate that has a truth of the same stamp, if any has."""
        namespace, estimates = name.rpartition("/")[0], self._estimates[name]
        epoch, truths = self._epochs.get(namespace, 0), self._truths[namespace]
        paired = (each for each in reversed(estimates) if each in truths)
        stamp = next(paired, next(reversed(estimates)))
        names, estimate = estimates[stamp]
        x, truth, v = np.concatenate([estimate.q, estimate.u]), None, None
        if stamp in truths and sorted(truths[stamp].names) == sorted(names):
            state = truths[stamp].ordered(names)
            truth = np.concatenate([state.q, state.u])
        mechanism = self._given or self._mechanisms.get(namespace)
        if mechanism is not None and mechanism.system.coordinates != names:
            mechanism = None
        if mechanism is not None and truth is not None:
            error = errors_of(mechanism.system, truth[None], x[None])
            v = float(mechanism.distance(truth[None], error)[0])
        variances = np.diag(estimate.covariance).clip(0.0) if estimate.covariance.size else None
        return {
            "name": name,
            "law": estimate.law,
            "time": seconds_between(epoch, stamp),
            "synchronized": estimate.synchronized,
            "v": v,
            "states": [*names, *(f"d{each}/dt" for each in names)],
            "units": [""] * x.size if mechanism is None else [*mechanism.system.state_units],
            "estimate": x.tolist(),
            "deviation": None if variances is None else np.sqrt(variances).tolist(),
            "truth": None if truth is None else truth.tolist(),
            "counts": dict(self._counts[name]),
            "verdicts": [
                {"time": seconds_between(epoch, each["stamp"]), **each}
                for each in self._verdicts[name]
            ],
        }


def _keep(states: dict[int, Any], stamp: int, state: object) -> None:
    """Keep a state by its stamp, ns, as the newest, and drop the oldest."""
    states.pop(stamp, None)
    states[stamp] = state
    if len(states) > _KEPT:
        del states[next(iter(states))]


def table(view: View) -> RenderableType:
    """A view as tables for the terminal."""
    head = f"{view['impacts']} impacts"
    if not view["observers"]:
        head += ", waiting for observers: expected observer/state or observer_<law>/state"
    parts: list[RenderableType] = [literal_text(head)]
    parts += [literal_text(view["warning"], "bold yellow")] if view["warning"] else []
    for each in view["observers"]:
        v = "unknown" if each["v"] is None else f"{each['v']:.2e} J"
        agreed = "synchronized" if each["synchronized"] else "not synchronized"
        title = f"{each['name']} ({each['law']})  t = {each['time']:.3f} s  V = {v}  {agreed}"
        states = Table(box=None, header_style="dim")
        for heading in ("state", "unit", "estimate", "deviation", "truth"):
            states.add_column(heading, justify="left" if heading in "state unit" else "right")
        nothing = [None] * len(each["states"])
        forms = {"estimate": "{:+.6f}", "deviation": "{:.1e}", "truth": "{:+.6f}"}
        columns = [
            ["" if number is None else form.format(number) for number in each[key] or nothing]
            for key, form in forms.items()
        ]
        for cells in zip(each["states"], each["units"], *columns, strict=True):
            states.add_row(*map(literal_text, cells))
        counts = ", ".join(f"{n} {ruling}" for ruling, n in sorted(each["counts"].items()))
        lines = [f"verdicts: {counts or 'none yet'}"]
        for one in each["verdicts"]:
            words = (f"{one['time']:13.6f} s", one["contact"] or "all", one["verdict"])
            lines.append("  ".join([*words, one["reason"]]))
        parts += [literal_text(f"\n{title}"), states, literal_text("\n".join(lines))]
    return Group(*parts)


def watch(listener: Listener, show: Callable[[View], object], duration: float = math.inf) -> View:
    """Receive until SIGINT, SIGTERM or the end of ``duration``, s; returns the last view.

    A topic is subscribed to when its first publisher appears, with the quality of service that
    all its publishers offer, so that earlier events and the model are received too.

    Args:
        listener: receives the messages.
        show: called with a view four times a second.
        duration: how long, s of wall time.
    """
    subscriptions: dict[str, Subscription] = {}
    with Stop() as stop, ros_node("watch") as (node, _):
        end = time.monotonic() + duration
        while not stop.requested and time.monotonic() < end:
            for topic, types in node.get_topic_names_and_types():
                if topic in subscriptions or not listener.wants(topic, types[0]):
                    continue
                if publishers := node.get_publishers_info_by_topic(topic):
                    offer = replace(common_offer(topic, publishers), depth=_KEPT)
                    subscriptions[topic] = node.create_subscription(
                        message_class(types[0]), topic, lambda _: None, qos_profile(offer)
                    )
            for topic, subscription in subscriptions.items():
                for message, _ in waiting_messages(subscription, _KEPT):
                    listener.receive(topic, message)
            show(listener.view())
            time.sleep(_PERIOD)
    return listener.view()
