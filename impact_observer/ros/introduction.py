# SPDX-License-Identifier: Apache-2.0
"""The line with which each node starts its log."""

from collections.abc import Iterable

from rclpy.node import Node

from impact_observer.plain_text import printable

_OF_ROS = {"/rosout", "/parameter_events", "/clock"}
"""Topics that every node has."""


def introduce(node: Node, what: str, waits_for: str) -> None:
    """Log what a node runs, its topics, and what it waits for."""
    parts = [what]
    for verb, some in (("receives", node.subscriptions), ("publishes", node.publishers)):
        if topics := _names(each.topic_name for each in some):
            parts.append(f"{verb} {topics}")
    node.get_logger().info(printable("; ".join([*parts, f"waits for {waits_for}"])))


def _names(topics: Iterable[str]) -> str:
    return ", ".join(sorted({*topics} - _OF_ROS))
