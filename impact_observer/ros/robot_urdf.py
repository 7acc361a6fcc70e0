# SPDX-License-Identifier: Apache-2.0
"""The URDF of a robot from its latched topic, such as ``robot_description``."""

from dataclasses import replace

from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future

from impact_observer.errors import UsageError
from impact_observer.model import Model
from impact_observer.ros.base_node import BaseNode
from impact_observer.ros.message_classes import message_class

_PATIENCE = 10.0
"""How long a node waits for the URDF, s."""


def with_urdf_of_topic(node: BaseNode, model: Model) -> Model:
    """The ``model`` whose robot has its URDF; a ``node`` waits for that if a topic has it.

    Raises:
        UsageError: nothing comes on the topic.
        ModelError: the URDF does not fit the model file.
    """
    robot = model.robot
    if robot is None or robot.urdf is not None:
        return model
    received: Future = Future()
    subscription = node.create_subscription(
        message_class("std_msgs/msg/String"),
        robot.topic,
        lambda message: received.done() or received.set_result(message.data),
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    )
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    try:
        executor.spin_until_future_complete(received, _PATIENCE)
    finally:
        executor.remove_node(node)
        executor.shutdown()
        node.destroy_subscription(subscription)
    if not received.done():
        raise UsageError(
            f"{robot.name}: no URDF came on the topic {subscription.topic_name} within"
            f" {_PATIENCE:g} s; expected a latched std_msgs/String, as of robot_state_publisher"
        )
    return replace(model, robot=robot.with_urdf(received.result()))
