# SPDX-License-Identifier: Apache-2.0
"""The URDF of a robot from its latched topic, such as ``robot_description``."""

import time
from dataclasses import replace

from rclpy.qos import DurabilityPolicy, QoSProfile

from impact_observer.errors import UsageError
from impact_observer.model import Model
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.message_classes import message_class
from impact_observer.ros.subscribing import waiting_messages

_PATIENCE = 10.0
"""How long a node waits for the URDF, s."""
_LOOK_PERIOD = 0.02
"""Time between two looks for the URDF, s."""


def with_urdf_of_topic(node: BaseNode, model: Model) -> Model:
    """The ``model`` whose robot has its URDF; a ``node`` waits for that if a topic has it.

    Raises:
        UsageError: nothing comes on the topic.
        ModelError: the URDF does not fit the model file.
    """
    robot = model.robot
    if robot is None or robot.urdf is not None:
        return model
    subscription = node.create_subscription(
        message_class("std_msgs/msg/String"),
        robot.topic,
        lambda _: None,  # the message is taken below
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    end = time.monotonic() + _PATIENCE
    while not (received := [*waiting_messages(subscription, 1)]) and time.monotonic() < end:
        time.sleep(_LOOK_PERIOD)
    node.destroy_subscription(subscription)
    if not received:
        raise UsageError(
            f"{robot.name}: no URDF came on the topic {subscription.topic_name} within"
            f" {_PATIENCE:g} s; expected a latched std_msgs/String, as of robot_state_publisher"
        )
    return replace(model, robot=robot.with_urdf(received[0][0].data))
