# SPDX-License-Identifier: Apache-2.0
"""The monitor node: publishes the distance of the estimate from the truth.

No other node receives both truth and estimates.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np

from impact_observer.dynamics import mechanism_of
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Interface, Quality
from impact_observer.io.messages import EstimateError, JointState, read
from impact_observer.model import read_model
from impact_observer.model.multibody import errors_of, multibody_of
from impact_observer.ros import parameters
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.intake import Receiver

_DEPTH = 2000
"""States that are kept until their counterpart arrives, and depth of the subscriptions."""


class MonitorNode(BaseNode):
    """Publishes ``~/error`` for each estimate and the true state of the same stamp."""

    def __init__(self) -> None:
        super().__init__("monitor", parameters.MONITOR)

    def configure(self) -> None:
        """Implement ``BaseNode``."""
        self._system = multibody_of(read_model(self.values["model"]))
        self._mechanism = mechanism_of(self._system)
        self._truth: OrderedDict[int, JointState] = OrderedDict()
        self._waiting: OrderedDict[int, JointState] = OrderedDict()
        self._errors = self.publisher(interfaces.MONITOR_ERROR)
        self._receive("plant/joint_states", self._on_truth)
        estimates = self._receive("observer/joint_states", self._on_estimates)
        owner = estimates.topic.rpartition("/")[0].lstrip("/")
        self._law = self.values["law"] or owner
        self.introduce(
            f"model {self._system.name}, law {self._law}",
            "a true state and an estimate of one stamp",
        )

    def _receive(
        self, topic: str, on_states: Callable[[Sequence[JointState]], None]
    ) -> Receiver[JointState]:
        """The receiver of states, with their columns in the order of the model."""
        names = self._system.coordinates
        return Receiver(
            self,
            Interface(topic, interfaces.JOINT_STATE, Quality(depth=_DEPTH)),
            on_states,
            read=lambda message, _: [read(JointState, message).ordered(names)],
        )

    def _on_truth(self, states: Sequence[JointState]) -> None:
        """Compare true states with the estimates that have arrived before."""
        for state in states:
            _keep(self._truth, state)
            if (estimate := self._waiting.pop(state.stamp, None)) is not None:
                self._compare(state, estimate)

    def _on_estimates(self, states: Sequence[JointState]) -> None:
        """Compare estimates with true states; an estimate that is corrected comes again."""
        for state in states:
            if (truth := self._truth.get(state.stamp)) is None:
                _keep(self._waiting, state)
            else:
                self._compare(truth, state)

    def _compare(self, truth: JointState, estimate: JointState) -> None:
        """Publish the error of an estimate."""
        x, estimated = (np.concatenate([each.q, each.u])[None] for each in (truth, estimate))
        errors = errors_of(self._system, x, estimated)
        (v,) = self._mechanism.distance(x, errors).tolist()
        q, u = np.split(errors[0], 2)
        error = EstimateError(truth.stamp, self._law, v, truth.names, q, u)
        self.publish(self._errors, self.make.estimate_error, error)


def _keep(states: OrderedDict[int, JointState], state: JointState) -> None:
    """Keep ``state`` by its stamp, and drop the oldest states."""
    states[state.stamp] = state
    while len(states) > _DEPTH:
        states.popitem(last=False)
