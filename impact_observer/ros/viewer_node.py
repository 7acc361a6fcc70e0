# SPDX-License-Identifier: Apache-2.0
"""The viewer node: plant and estimates side by side as markers for RViz."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from impact_observer.draw.observer_topics import ObserverTopics
from impact_observer.draw.scene.scene import Scene
from impact_observer.errors import UsageError
from impact_observer.events import ImpactEvent, Kind
from impact_observer.io import interfaces
from impact_observer.io.messages import JointState, read_event, read_joint_state
from impact_observer.model import read_model
from impact_observer.observer.sender_runs import SenderRuns
from impact_observer.ros import parameters
from impact_observer.ros.managed_node import ManagedNode
from impact_observer.ros.markers import ESTIMATE, PLANT, MarkerRow, Painter
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.subscribing import Receiver
from impact_observer.stamps import NS_PER_S

_GLOW = NS_PER_S // 5
"""How long a stop is lit after an impact, ns."""
PLANT_ROW = "plant"
"""Name of the plant's row, and of its node."""


class ViewerNode(ManagedNode):
    """Publishes ``~/markers`` of the last state of the plant and of each observer."""

    def __init__(self) -> None:
        super().__init__("viewer", parameters.VIEWER)

    def configure(self) -> None:
        """Implement ``ManagedNode``."""
        model = read_model(self.values.text("model"))
        self._system = model.system
        states = () if model.position is None else [model.position]
        scene = Scene.of_system(model.system, states, self.values.number("amplitude"))
        self._painter = Painter(scene, self.values.text("frame"))
        self._rows = _rows(self.values.text("observers"))
        self._states: dict[str, JointState] = {}
        self._hits: dict[int, int] = {}
        self._closed: set[int] = set()
        self._runs = SenderRuns()
        self._markers = self.publisher(interfaces.VIEWER_MARKERS)
        self._subscribe()
        self._cleared = False
        self.create_timer(1.0 / self.values.number("rate"), self._publish_markers)
        for line in scene.omitted:
            self.lines.warning(f"{model.system.name}: shown {line}")
        self.introduce(f"model {model.system.name}", "states of plant or observers")

    def _subscribe(self) -> None:
        """Subscribe to the states of all rows, and to impacts."""
        names = self._system.coordinates
        for row in self._rows:
            Receiver(
                self,
                f"{row.name}/joint_states",
                partial(self._on_states, row.name),
                read=lambda message, _: read_joint_state(message).ordered(names),
            ).connect(interfaces.JOINT_STATE, interfaces.STATES)
        # Volatile: past events are of no use here, and a played bag may not offer them.
        events = Receiver(
            self, "impacts", self._on_events, read=lambda message, _: read_event(message)
        )
        events.connect(interfaces.IMPACT_EVENT, interfaces.Quality(depth=interfaces.EVENTS.depth))

    def _on_states(self, name: str, states: Sequence[JointState]) -> None:
        """Keep the last state of a row."""
        for state in states:
            before = self._states.get(name)
            if name == PLANT_ROW and before is not None and state.stamp < before.stamp:
                self._closed.clear()  # a bag is played again
            self._states[name] = state

    def _on_events(self, events: Sequence[ImpactEvent]) -> None:
        """Take the events of the run of the sender that is in use, by the rule of the observer."""
        for event in events:
            weighed = self._runs.weigh(event)
            if weighed.reason:
                continue
            run, previous = self._runs.in_use, weighed.previous
            is_other = run and previous and not previous.goes_on_as(run)
            if is_other or weighed.replaces:
                self._hits.clear()
                self._closed.clear()
            for each in (*weighed.released, event):
                self._note_switches(each)

    def _note_switches(self, event: ImpactEvent) -> None:
        """Keep the time of impacts, and the closed contacts."""
        for switch in event.switches:
            if switch.contact not in self._system.contact_names:
                continue
            contact = self._system.contact_names.index(switch.contact)
            if switch.kind is Kind.OPEN:
                self._closed.discard(contact)
                continue
            self._hits[contact] = event.stamp
            if switch.kind is Kind.CLOSE:
                self._closed.add(contact)

    def _publish_markers(self) -> None:
        """Publish all rows that have a state; first delete the markers of an earlier node."""
        if not self.is_active:
            return
        if not self._cleared:
            self._markers.publish(self._painter.clear(self.get_clock().now().to_msg()))
            self._cleared = self._markers.get_subscription_count() > 0
        epoch = self._runs.in_use.epoch if self._runs.in_use else 0
        markers = []
        for row in self._rows:
            if (state := self._states.get(row.name)) is None:
                continue
            stamps = np.array([state.stamp - epoch])
            moved = self._system.gap_motion(stamps)[0] if epoch else None
            time = self.make.time(state.stamp)
            markers += self._painter.markers(row, state.q, self._lit(state), time, moved)
        if markers:
            self._markers.publish(message_class(interfaces.MARKERS)(markers=markers))

    def _lit(self, state: JointState) -> set[int]:
        """The contacts that are closed, or had an impact shortly before a state."""
        hit = {i for i, stamp in self._hits.items() if 0 <= state.stamp - stamp < _GLOW}
        return hit | self._closed


def _rows(observers: str) -> tuple[MarkerRow, ...]:
    """The plant first, then the named observers, each once.

    Raises:
        UsageError: a name is empty, invalid for a node, or the plant's.
    """
    names = list(dict.fromkeys(name.strip() for name in observers.split(","))) if observers else []
    for name in names:
        if not name:
            raise UsageError(
                f"parameter observers: {observers!r} has an empty name; expected NAME,NAME,..."
            )
        if name == PLANT_ROW:
            raise UsageError("parameter observers: the plant is shown in any case; leave it out")
        ObserverTopics.of_node(name)
    rows = [MarkerRow(PLANT_ROW, 0, PLANT)]
    return (*rows, *(MarkerRow(name, i, ESTIMATE) for i, name in enumerate(names, start=1)))
