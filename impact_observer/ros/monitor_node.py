# SPDX-License-Identifier: Apache-2.0
"""The monitor node: the estimate's distance from the truth. Only this node has both."""

from collections import OrderedDict

import numpy as np
from rclpy.node import Node

from impact_observer.dynamics.lyapunov import distance
from impact_observer.io import interfaces
from impact_observer.io.interfaces import Quality
from impact_observer.io.messages import AnyMessage, EstimateError, JointState
from impact_observer.model import read_model
from impact_observer.ros import parameters
from impact_observer.ros.introduction import introduce
from impact_observer.ros.message_classes import message_class, read_state, ros_messages
from impact_observer.ros.qos import qos_profile

_DEPTH = 2000
"""States kept until their counterpart arrives, and depth of the subscriptions."""


class MonitorNode(Node):
    """Publishes ``~/error`` for each estimate and the true state of the same stamp."""

    def __init__(self) -> None:
        super().__init__("monitor")
        values = parameters.declare(self, parameters.MONITOR)
        self._system = read_model(values.text("model")).system
        self._make = ros_messages()
        self._truth: OrderedDict[int, JointState] = OrderedDict()
        self._waiting: OrderedDict[int, JointState] = OrderedDict()
        quality = qos_profile(interfaces.STATES)
        joint_state = message_class(interfaces.JOINT_STATE)
        self._errors = self.create_publisher(
            message_class(interfaces.MONITOR_ERROR.type), "~/error", quality
        )
        burst = qos_profile(Quality(depth=_DEPTH))
        self.create_subscription(joint_state, "plant/joint_states", self._on_truth, burst)
        estimates = self.create_subscription(
            joint_state, "observer/joint_states", self._on_estimate, burst
        )
        self._law = values.text("law") or estimates.topic_name.rpartition("/")[0].lstrip("/")
        waits = "a true state and an estimate of one stamp"
        introduce(self, f"model {self._system.name}, law {self._law}", waits)

    def _on_truth(self, message: AnyMessage) -> None:
        state = read_state(self, "plant/joint_states", message, self._system.coordinates)
        if state is None:
            return
        _keep(self._truth, state)
        estimate = self._waiting.pop(state.stamp, None)
        if estimate is not None:
            self._compare(state, estimate)

    def _on_estimate(self, message: AnyMessage) -> None:
        """An estimate may arrive twice: the second is corrected by a late event."""
        state = read_state(self, "observer/joint_states", message, self._system.coordinates)
        if state is None:
            return
        truth = self._truth.get(state.stamp)
        if truth is None:
            _keep(self._waiting, state)
        else:
            self._compare(truth, state)

    def _compare(self, truth: JointState, estimate: JointState) -> None:
        q, u = estimate.q - truth.q, estimate.u - truth.u
        v = float(distance(self._system, q, u))
        error = EstimateError(truth.stamp, self._law, v, truth.names, np.asarray(q), np.asarray(u))
        self._errors.publish(self._make.estimate_error(error))


def _keep(states: OrderedDict[int, JointState], state: JointState) -> None:
    """Keep ``state`` by its stamp, and drop the oldest."""
    states[state.stamp] = state
    while len(states) > _DEPTH:
        states.popitem(last=False)
